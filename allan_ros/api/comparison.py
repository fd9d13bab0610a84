# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public functions that compare several recordings: `compare`, `common` and `inflate`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from string import ascii_uppercase
from typing import Any

from ..core.check import MARGIN
from ..core.errors import AllanError
from ..core.filters.noise_parameters import measure_inflation
from ..core.settings import LIST, SegmenterSettings, check_range, expect
from ..readers import Recording, topics_of
from ..readers.files import PATH
from ..readers.recording_sums import Observer, ReadJob, Silent
from ..results.common_result import CommonResult as PlainCommonResult
from ..results.common_result import common_of
from ..results.comparison import REST, RUNNING, compare_runs
from ..results.comparison import Inflation as PlainInflation
from ..results.comparison import RunComparison as PlainRunComparison
from ..results.datasheets import load_sensor
from ..results.documents import labels_of
from ..results.results import Results as PlainResults
from ..results.simulation import is_truth
from .analysis import ResultSettings, read_settings, results_of
from .classes import public


class CommonResult(PlainCommonResult):
    __doc__ = PlainCommonResult.__doc__

    def __repr__(self) -> str:
        from ..view.comparison import common_lines

        return '\n'.join(common_lines(self))

    def plot(self) -> Any:
        """Draw the coherence against the averaging time, and return the matplotlib Figure.

        Raises AllanError if matplotlib is missing.
        """
        from ..view.plots import common_figure

        return common_figure(self)


class RunComparison(PlainRunComparison):
    __doc__ = PlainRunComparison.__doc__

    def __repr__(self) -> str:
        from ..view.comparison import sentences

        return '\n'.join(sentences(self))


class Inflation(PlainInflation):
    __doc__ = PlainInflation.__doc__

    def __repr__(self) -> str:
        from ..view.comparison import inflation_lines

        return '\n'.join(inflation_lines(self))


@public
def compare(
    *sources: PlainResults | str | os.PathLike[str],
    sensor: str | Sequence[str] = (),
    margin: float = MARGIN,
    within: float = 0.0,
    method: str = 'likelihood',
    observer: Observer = Silent(),
) -> RunComparison:
    """Compare recordings with the first of them, and with datasheets.

    Parameters
    ----------
    *sources : Results or path
        Results of `analyze` or `load`, or paths of a results.json, a sums.json, the folder of an
        analysis, a recording, or the truth file of a simulated recording. If there is a truth file,
        the other inputs are compared with the truth. In the output, each path is named after its
        file or folder. If two of these names are equal, the paths are the names. Results of
        `analyze` or `load` have the names A, B, C ..., according to their position; truth files are
        placed first.
    sensor : str, or list or tuple of str
        Datasheets to compare each recording with: names that `allan sensors` lists, or paths of
        .yaml files.
    margin : float
        A coefficient exceeds the limit of a datasheet if its complete 95 % interval lies above
        limit * (1 + margin).
    within : float
        Fraction by which coefficients may differ and still be regarded as equal. Equality is tested
        only if this fraction is not 0.
    method : str
        Method of the fit of Allan sums and recordings, as in `analyze`; results are not fitted
        again.
    observer : Observer
        Shows the progress of reading recordings; by default, nothing is shown.

    Returns
    -------
    RunComparison
        ``differences`` are the comparisons of each recording with the first recording, and
        ``checked`` are the results compared with the datasheets. ``differs`` states whether any
        difference is significant or any limit is exceeded. If ``within`` is not 0, ``equivalent``
        states whether N of all common axes is shown to be equal up to this fraction, and no other
        coefficient is shown to differ by more. ``differs`` then states whether ``equivalent`` is
        False or any limit is exceeded.

    Raises
    ------
    AllanError
        When an input cannot be read, a path is given twice, an argument is invalid, there is
        nothing to compare, or an input has no axis in common with the first one.

    Examples
    --------
    >>> import allan_ros as ar
    >>> quiet = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=1))
    >>> noisy = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=2, gyro={'N': 0.5}))
    >>> ar.compare(quiet, noisy).differs
    True
    """
    ResultSettings(method=method, margin=margin)  # checks the values before recordings are read
    check_range(0.0, 10.0, within=within)
    expect((*PATH, *LIST), 'a datasheet or a list of datasheets', sensor=sensor)
    sensors = [sensor] if isinstance(sensor, PATH) else sensor
    sheets = [load_sensor(str(name)) for name in sensors]
    sources = tuple(sorted(sources, key=lambda s: not (isinstance(s, PATH) and is_truth(s))))
    expect_different_paths(sources)
    unshortened_names = [
        _name_by_position(i) if isinstance(s, PlainResults) else str(s)
        for i, s in enumerate(sources)
    ]
    labels = labels_of(unshortened_names)
    if len({*labels}) < len(labels):
        raise AllanError('an input is given twice: give different recordings')
    if len(sources) + len(sheets) < 2 or not sources:
        raise AllanError(
            'nothing to compare: give two recordings, or one recording and a datasheet'
        )
    runs = (results_of(source, method, observer) for source in sources)
    return RunComparison(**vars(compare_runs(dict(zip(labels, runs)), sheets, margin, within)))


@public
def common(*sources: Any, rate: float = 0.0, **options: Any) -> CommonResult:
    """Separate the noise that several IMUs at rest on one body have in common from their own noise.

    The samples are aligned by their stamps, so the recordings must be made together, with one
    clock. The axes of the IMUs must be parallel.

    Parameters
    ----------
    *sources : path, array, DataFrame, mapping of columns, or ImuBatch
        One recording of each IMU, or a bag with one Imu topic for each IMU. If there is only one
        IMU, the axes of each of its sensors are compared with each other. In the output, each IMU
        is named after its file, its topic, or both. Samples in memory have the names A, B, C ...,
        according to their position.
    rate : float
        Sample rate in Hz, as in `analyze`.
    **options
        Options of `analyze` for reading and for the data at rest, such as ``topic`` or ``skip``.

    Returns
    -------
    CommonResult
        ``rows`` contains for each axis of each IMU: N as measured, *own N* (N without the noise
        that is common to the IMUs) with its interval, and the coherence with the mean of the other
        IMUs at each averaging time. With three or more IMUs, own N is measured for each IMU. With
        two IMUs, only the root mean square of the two values is measured. Own N of each IMU is
        this value times ``gain``, the factor with which the IMU measures the common noise. Own N is
        None if the common noise of the IMUs differs in more than a constant factor, or if the
        differences of their samples are constant. With one IMU, ``rows`` contains only the
        coherence of each pair of axes of a sensor.

    Raises
    ------
    AllanError
        When a source cannot be read, a path is given twice, an option is invalid, the sources have
        no axis, rate or sufficient time in common, or a single IMU has no two axes of one sensor.

    Examples
    --------
    >>> import numpy as np
    >>> import allan_ros as ar
    >>> vibration, *noises = 1e-3 * np.random.default_rng(0).normal(size=(4, 20_000))
    >>> three = ar.common(*({'gyro_z': 3.0 * vibration + noise} for noise in noises), rate=100)
    >>> row = three.rows[0]
    >>> round(row.measured.value, 4), round(row.own.value, 4)
    (0.0003, 0.0001)
    >>> round(float(row.coherence.value[0]), 1)
    0.9
    """
    from ..readers.arrays import recording_in_memory

    reading, settings = read_settings(options, rate)
    expect_different_paths(sources)
    recordings: dict[str, Recording] = {}
    paths = [str(s) if isinstance(s, PATH) else _name_by_position(i) for i, s in enumerate(sources)]
    for source, path, label in zip(sources, paths, labels_of(paths)):
        if not isinstance(source, PATH):
            recordings[label] = recording_in_memory(source, reading)
            continue
        topics = [] if reading.topic else topics_of(path)
        for topic in topics if len(topics) > 1 else [reading.topic]:
            name = topic if topics[1:] and len(sources) == 1 else f'{label} {topic}'.strip()
            recordings[name] = ReadJob(path, replace(reading, topic=topic)).open()
    if not recordings:
        raise AllanError('no recording is given: give one recording of each IMU')
    plain_result = common_of(recordings, settings)
    return CommonResult(plain_result.rows, plain_result.findings)


def expect_different_paths(sources: Sequence[Any]) -> None:
    """Raise AllanError if two of the sources are paths of the same file or folder."""
    absolute_paths = [Path(source).resolve() for source in sources if isinstance(source, PATH)]
    if len({*absolute_paths}) < len(absolute_paths):
        raise AllanError('an input is given twice: give different recordings')


def _name_by_position(position: int) -> str:
    """Return the name of a source without a path: 'A' to 'Z', then 'A2' to 'Z2', and so on."""
    earlier_alphabets, letter = divmod(position, len(ascii_uppercase))
    return f'{ascii_uppercase[letter]}{earlier_alphabets + 1 if earlier_alphabets else ""}'


@public
def inflate(
    rest: PlainResults | str | os.PathLike[str],
    running: PlainResults | str | os.PathLike[str],
    *,
    horizon: float = 30.0,
    observer: Observer = Silent(),
) -> Inflation:
    """Measure the factor by which running motors increase the IMU noise of a robot at rest.

    A state estimator that uses the noise with motors off should multiply N and K by the resulting
    factors.

    Parameters
    ----------
    rest : Results or path
        The robot at rest with motors off: results, or the path of a results.json, a sums.json, the
        folder of an analysis, or a recording.
    running : Results or path
        The robot at rest with motors on. No samples of a recording are excluded as motion, because
        the vibration of motors could be mistaken for motion.
    horizon : float
        Longest time in s for which the state estimator integrates the IMU without a correction.
    observer : Observer
        Shows the progress of reading recordings; by default, nothing is shown.

    Returns
    -------
    Inflation
        ``axes`` contains N and K of each common axis with motors off and on, and the factor by
        which motors increase them, at least 1, as in ``axes['gyro_x']['N'].factor``. ``factor`` is
        the largest factor for N of all axes. ``option`` is the largest factor for N of each sensor,
        as a value for `allan export --inflate`.

    Raises
    ------
    AllanError
        When an input cannot be read, the inputs have no axis in common, N or K of a common axis
        cannot be computed, or the horizon is not a number from 1e-3 to 1e9.

    Examples
    --------
    >>> import allan_ros as ar
    >>> motors_off = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=1, gyro={'N': 0.25}))
    >>> motors_on = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=2, gyro={'N': 0.5}))
    >>> round(ar.inflate(motors_off, motors_on).axes['gyro_x']['N'].factor, 1)
    2.0
    """
    check_range(1e-3, 1e9, 's', horizon=horizon)
    motors_off = results_of(rest, observer=observer)
    all_samples = SegmenterSettings(motion_gate=False)
    motors_on = results_of(running, 'likelihood', observer, all_samples)
    fits_off_and_on = [
        {axis: r.fit for axis, r in results.axes.items()} for results in (motors_off, motors_on)
    ]
    axes = measure_inflation(fits_off_and_on[0], fits_off_and_on[1], horizon)
    return Inflation(axes, compare_runs({REST: motors_off, RUNNING: motors_on}), horizon)
