# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`analyze` returns the results of recordings or samples; `load` reads results from files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

from ..core.check import MARGIN
from ..core.errors import AllanError
from ..core.fit.result import METHODS
from ..core.settings import (
    UNIT_SYSTEMS,
    CheckedSettings,
    SegmenterSettings,
    check_names,
    check_rate,
    describe,
    expect,
    parameter,
)
from ..readers import ReadOptions
from ..readers.files import PATH
from ..readers.recording_sums import (
    Observer,
    ReadJob,
    RecordingSums,
    Silent,
    add_recordings,
    read_in_processes,
    read_in_turn,
    read_recording,
)
from ..results.analysis import analyze_recorded, one_thread
from ..results.documents import RESULTS, SUMS, load_sums
from ..results.documents import load as load_results
from ..results.results import Results as PlainResults
from .classes import Results, compared, public


@dataclass(frozen=True)
class ResultSettings(CheckedSettings):
    """Settings for the fit, the comparison and the output of results."""

    method: str = parameter(
        'likelihood',
        'Method of the fit: likelihood (maximum likelihood, with confidence intervals) or paper '
        '(plain least squares, as in Cong et al. 2019).',
        choices=METHODS,
    )
    units: str = parameter(
        'deg/h',
        'Units of the output: deg/h for the units in datasheets, such as deg/h and ug, or SI.',
        choices=UNIT_SYSTEMS,
    )
    export: tuple[str, ...] = parameter(
        (),
        'Further configuration files: kalibr, openvins, px4 ... (`allan export --list` lists all, '
        '`allan export` has more options).',
    )
    sensor: str = parameter(
        '',
        'Datasheet to compare with: a name that `allan sensors` lists, or the path of a .yaml '
        'file.',
    )
    baseline: str = parameter(
        '', 'Earlier run of this IMU to compare with: its results.json, or its folder.'
    )
    noise: str = parameter(
        '',
        'Earlier run of this IMU at rest, whose noise predicts the errors in motion: its '
        'results.json, or its folder. By default, the noise in the rests of the recording is used.',
    )
    plots: tuple[str, ...] = parameter(
        (), 'Also draw the Allan deviation of each sensor as a figure: png, svg, pdf.'
    )
    margin: float = parameter(
        MARGIN,
        'Margin of the limits: a coefficient exceeds the datasheet or the earlier run only if the '
        'complete 95 % interval of its ratio to the limit lies above 1 + margin.',
        low=0.0,
        high=1.0,
        percent=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.plots:
            from ..view.result_files import check_plots

            check_plots(self.plots)

    @property
    def stated_margin(self) -> float | None:
        """The margin that the user chose; None if ``margin`` has its default value.

        With None, results that are read from a file keep the margin that is stored in the file.
        """
        return None if self.margin == MARGIN else self.margin


@public
def load(path: str | os.PathLike[str], method: str = 'likelihood') -> Results:
    """Read the results of an earlier analysis.

    Parameters
    ----------
    path : path
        The folder of an analysis, a results.json, a sums.json, or a checkpoint. The Allan sums in
        a sums.json or checkpoint are fitted again; if a folder has a results.json, its results are
        read instead. Results from a results.json alone, or from a folder without a sums.json, have
        no Allan sums, and therefore cannot be added or saved.
    method : str
        Method of the fit of Allan sums: 'likelihood' or 'paper', as in `analyze`. Results that are
        read from a results.json keep their method.

    Returns
    -------
    Results

    Raises
    ------
    AllanError
        When ``method`` is unknown, the file is missing or invalid, the files in the folder are of
        different analyses, or the Allan sums cannot be fitted.

    Examples
    --------
    >>> import tempfile
    >>> import allan_ros as ar
    >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = results.save(folder)
    ...     ar.load(folder).samples == results.samples
    True
    """
    ResultSettings(method=method)  # an unknown method is an error, also if nothing is fitted
    return Results.of(load_results(path, method))


def results_of(
    path: PlainResults | str | os.PathLike[str],
    method: str = 'likelihood',
    observer: Observer = Silent(),
    segmenter: SegmenterSettings = SegmenterSettings(),
) -> PlainResults:
    """Return results that are read from files of an analysis, or computed from a recording.

    Parameters
    ----------
    path : Results or path
        Path of a recording, a JSON file or the folder of an analysis. The truth file of a simulated
        recording gives results with the true noise. Results are returned unchanged.
    method : str
        Method of the fit of Allan sums and recordings.
    observer : Observer
        Shows the progress of reading a recording.
    segmenter : SegmenterSettings
        Settings that select the data at rest of a recording.

    Raises
    ------
    AllanError
        When the path cannot be read, or its data cannot be analyzed.
    """
    from ..results.simulation import is_truth, results_of_truth  # rarely needed

    expect((PlainResults, *PATH), 'results or a path', source=path)
    if isinstance(path, PlainResults):
        return path
    if is_truth(path):
        return results_of_truth(path)
    if is_document(path):
        return load_results(path, method)
    (recorded,) = read_in_turn([ReadJob(str(path), segmenter=segmenter)], observer)
    return analyze_recorded(recorded, method)


def is_document(path: str | os.PathLike[str]) -> bool:
    """Return whether a path has the suffix .json, or is the folder of an analysis."""
    place = Path(path)
    has_document = any(os.path.isfile(place / name) for name in (RESULTS, SUMS))
    return has_document or place.suffix.lower() == '.json'


@public
@one_thread()  # not only the fit, but also Allan sums and spectra are computed in one thread
def analyze(
    source: Any,
    *,
    rate: float = 0.0,
    axes: str | Sequence[str] | None = None,
    gyro_unit: str = '',
    accel_unit: str = '',
    method: str = 'likelihood',
    sensor: str = '',
    baseline: PlainResults | str | os.PathLike[str] = '',
    noise: PlainResults | str | os.PathLike[str] = '',
    margin: float = MARGIN,
    hardware_id: str = '',
    processes: int = 1,
    **options: Any,
) -> Results:
    """Measure the noise of an IMU from its recordings or samples.

    By default, motion and gaps are detected and excluded.

    Parameters
    ----------
    source : path, Results, list of these, array, DataFrame, mapping of columns, or ImuBatch
        Several paths or results must belong to the same IMU, and give one common result. A path may
        also be an earlier analysis with its Allan sums: a folder, a sums.json, or a checkpoint. The
        Allan sums are then added and fitted, and the recordings are not read again. Arrays are (n,)
        or (n, axes), with one row per sample. An ImuBatch, such as from `simulate`, has six axes.
    rate : float
        Sample rate in Hz; 0 if unknown. It is required for samples without times. If it is given
        for an array, a DataFrame or a mapping, it replaces their times. For a recording or an
        ImuBatch with stamps, it is compared with the rate of the stamps. It is also used if these
        stamps are missing, and to detect lost samples if the stamps are bursty or have regular
        gaps.
    axes : str or sequence of str, optional
        The axes of the columns of an array: a name such as ``'gyro_z'``, ``'gyro'`` or ``'accel'``
        for three axes, or a list of names. By default, one column is ``gyro_x``, three columns are
        the gyro, and six columns are gyro and accelerometer. Of a DataFrame or a mapping, only
        these axes are used. An ImuBatch is used with all its axes.
    gyro_unit, accel_unit : str
        Units of the samples, such as 'deg/s' and 'g', if the source does not state them. The
        defaults are rad/s and m/s^2. An ImuBatch is always in rad/s and m/s^2.
    method : str
        Method of the fit: 'likelihood' (maximum likelihood, with confidence intervals) or 'paper'
        (plain least squares, as in Cong et al. 2019).
    sensor : str
        Datasheet to compare with: a name that `allan sensors` lists, or the path of a .yaml file.
    baseline : Results or path
        An earlier run of this IMU to compare with: results, or the path of a results.json, a
        sums.json, a checkpoint, or the folder of an analysis.
    noise : Results or path
        An earlier run of this IMU at rest, whose noise predicts the errors in motion. By default,
        the noise at rest in the source predicts these errors.
    margin : float
        Fraction by which a coefficient may exceed a limit of the datasheet or the earlier run. A
        coefficient exceeds a limit of the datasheet if its complete 95 % interval lies above
        limit * (1 + margin). It exceeds the earlier run if it is significantly higher, and the
        complete 95 % interval of the ratio of the new to the earlier coefficient lies above
        1 + margin.
    hardware_id : str
        Serial number of the IMU in recordings and samples. Results and earlier analyses in
        ``source`` keep their own serial number. Results with a common axis can be added only if
        their serial numbers are equal, and their frame_ids if both are known.
    processes : int
        Largest number of recordings that are read at the same time, each in its own process. With
        1, they are read one after the other in this process.
    **options
        Options of `allan analyze` for reading and for the data at rest, with underscores. For
        example, ``skip`` is the time in s that is excluded at the start, ``motion_gate=False`` also
        uses data in motion, and ``topic`` selects a topic of a bag.

    Returns
    -------
    Results
        The coefficients, curves and findings of each axis.

    Raises
    ------
    AllanError
        When the source cannot be read, an argument is invalid, too few data at rest are found, or
        several sources are of different IMUs, have different sample rates, or overlap in time.

    Examples
    --------
    >>> import numpy as np
    >>> import allan_ros as ar
    >>> white = np.random.default_rng(0).normal(scale=0.01, size=20_000)
    >>> results = ar.analyze(white, rate=100, axes='gyro_z')
    >>> round(results['gyro_z'].N.value, 4)  # rad/s/sqrt(Hz)
    0.001
    >>> round(results['gyro_z'].N.to('deg/sqrt(h)').value, 1)
    3.4
    >>> # two recordings of one IMU, without reading them again
    >>> a, b = (ar.analyze(ar.simulate(hours=0.1, rate=50, seed=i)) for i in (1, 2))
    >>> ar.analyze([a, b]).samples == a.samples + b.samples
    True
    """
    units = {'gyro_unit': gyro_unit, 'accel_unit': accel_unit}
    reading, segmenter = read_settings({**options, **units}, rate)
    ResultSettings(method=method, margin=margin)  # checks the values before recordings are read
    expect(str, hardware_id=hardware_id)
    expect(Integral, processes=processes)
    expect((PlainResults, *PATH), 'results or a path', noise=noise)
    rest_results = (
        noise if isinstance(noise, PlainResults) else load_results(noise) if str(noise) else None
    )
    if axes is not None:
        expect((str, Sequence), 'a text or a list', axes=axes)
    sources = list(source) if isinstance(source, (list, tuple)) else [source]
    if not sources:
        raise AllanError('the list of sources is empty: give a recording, results or samples')
    if all(isinstance(each, (PlainResults, *PATH)) for each in sources):
        if axes is not None:
            raise AllanError(
                'axes are for arrays, not files: name the columns of a table with columns='
            )
        has_sums = [isinstance(each, PlainResults) or is_document(each) for each in sources]
        earlier_sums = [_stored(each) for each, is_stored in zip(sources, has_sums) if is_stored]
        jobs = [
            ReadJob(str(path), reading, segmenter, hardware_id, True)
            for path, is_stored in zip(sources, has_sums)
            if not is_stored
        ]
        in_parallel = min(processes, len(jobs)) > 1
        new_sums = read_in_processes(jobs, processes) if in_parallel else read_in_turn(jobs)
        recorded = add_recordings([*new_sums, *earlier_sums])
    else:
        from ..readers.arrays import recording_in_memory

        recording = recording_in_memory(source, reading, axes)
        job = ReadJob(recording.info.path, reading, segmenter, hardware_id, True)
        recorded = read_recording(job, recording)
    results = Results.of(analyze_recorded(recorded, method, rest_results))
    return compared(results, sensor, baseline, margin)


def read_settings(options: Mapping[str, Any], rate: float) -> tuple[ReadOptions, SegmenterSettings]:
    """Return the settings for reading and the settings for selecting data at rest in ``options``.

    Both settings contain the sample ``rate`` in Hz, which is 0 if unknown. Raises AllanError if the
    rate or an option is invalid, or an option is unknown.
    """
    check_rate(rate)
    reading_names = [name for name in describe(ReadOptions) if name != 'rate_hz']
    segmenter_names = [name for name in describe(SegmenterSettings) if name != 'declared_rate']
    check_names(options, [*segmenter_names, *reading_names])
    reading = {name: options[name] for name in reading_names if name in options}
    segmenter = {name: options[name] for name in segmenter_names if name in options}
    return ReadOptions(rate_hz=rate, **reading), SegmenterSettings(declared_rate=rate, **segmenter)


def _stored(source: PlainResults | str | os.PathLike[str]) -> RecordingSums:
    """Return the Allan sums of results, or of the earlier analysis at a path.

    Raises AllanError if there are no Allan sums.
    """
    if not isinstance(source, PlainResults):
        return load_sums(source)
    if source.recorded is None:
        raise AllanError(
            'these results were read from a file without their sums: give the folder of the '
            'analysis or its sums.json'
        )
    return source.recorded
