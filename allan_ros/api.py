# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public functions, and the classes of their results with export, plots and files.

The classes add methods to the plain data in `allan_ros.results`. The command line calls the
functions of this file, too, so both give the same results.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import wraps
from numbers import Integral
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from .core.compare import MARGIN
from .core.errors import AllanError
from .core.filters.noise_parameters import measure_inflation
from .core.findings import grouped
from .core.imu import sensor_of
from .core.settings import (
    LIST,
    UNIT_SYSTEMS,
    SegmenterSettings,
    check_names,
    check_range,
    check_rate,
    choose,
    describe,
    expect,
    settings_from,
)
from .export import ExportOptions, make_export, target_of
from .readers import ReadOptions, Recording, topics_of
from .readers.files import PATH, write_atomic
from .readers.files import public as with_checked_paths
from .readers.recorded import (
    Observer,
    ReadJob,
    RecordingSums,
    Silent,
    add_recordings,
    read_in_processes,
    read_in_turn,
    read_recording,
)
from .results.analysis import analyze_recorded, one_thread
from .results.common_noise import CommonResult as PlainCommonResult
from .results.common_noise import common_of
from .results.comparison import REST, RUNNING, Inflation, RunComparison, compare_runs
from .results.datasheets import Datasheet as PlainDatasheet
from .results.datasheets import load_sensor
from .results.documents import RESULTS, SUMS, labels_of, load_sums
from .results.documents import load as load_results
from .results.from_datasheet import DEFAULT_RATE_HZ, results_of_datasheet
from .results.from_truth import is_truth, results_of_truth
from .results.references import compared
from .results.results import Results as PlainResults
from .view.coefficient_table import coefficient_list
from .view.finding_text import explained, finding_line
from .view.notebook import notebook_html
from .view.settings import ResultSettings, check_plots
from .view.table import records
from .view.verdict_text import Verdict, summary_lines, verdict_of

P = ParamSpec('P')
T = TypeVar('T')


def public(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a public function: its errors are AllanErrors with complete texts."""
    checked = with_checked_paths(function)

    @wraps(function)
    def told(*args: P.args, **given: P.kwargs) -> T:
        try:
            return checked(*args, **given)
        except AllanError as error:
            raise explained(error) from error.__cause__

    return told


class Results(PlainResults):
    __doc__ = PlainResults.__doc__

    def __repr__(self) -> str:
        return '\n'.join(summary_lines(self))

    @property
    def verdict(self) -> Verdict:
        """Whether the IMU is healthy (``level``), with the reasons and the next steps."""
        return verdict_of(self)

    def messages(self, units: str = 'deg/h') -> list[str]:
        """Return the texts of the findings, the most important first.

        ``units`` is 'deg/h' or 'SI'.

        >>> import allan_ros as ar
        >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50, vibration_gyro=3e-4))
        >>> any('Vibration' in message for message in results.messages())
        True
        """
        choose(UNIT_SYSTEMS, units=units)
        return [finding_line(each, units) for each in grouped(self.findings)]

    @classmethod
    def of(cls, results: PlainResults) -> Results:
        """Return results with the methods of this class.

        >>> import allan_ros as ar
        >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
        >>> ar.Results.of(results) == results
        True
        """
        return cls(**{each.name: getattr(results, each.name) for each in fields(results)})

    def _repr_html_(self) -> str:
        """Return the verdict and the coefficients for the output of a notebook cell."""
        return notebook_html(self)

    def table(self, units: str = 'deg/h') -> Any:
        """Return all coefficients as a table with one row for each axis and term.

        Parameters
        ----------
        units : 'deg/h' or 'SI'
            Units of the numbers.

        Returns
        -------
        pandas.DataFrame or list of dict
            The columns axis, term, value, ci95_low, ci95_high, upper95 and unit; a DataFrame if
            pandas is installed. Unknown numbers are None, or NaN in a DataFrame.
        """
        choose(UNIT_SYSTEMS, units=units)
        rows = records(coefficient_list(self.noise, units))
        try:
            import pandas
        except ImportError:
            return rows
        return pandas.DataFrame(rows)

    def plot(self, what: str = 'gyro', ax: Any = None, units: str = 'deg/h') -> Any:
        """Draw the Allan deviation with its confidence limits and the fitted model.

        Parameters
        ----------
        what : str
            'gyro' or 'accel' for all axes of a sensor, or the name of an axis.
        ax : matplotlib Axes, optional
            Axes to draw into; by default a figure with a panel for each axis is created.
        units : 'deg/h' or 'SI'
            Units of the drawing.

        Returns
        -------
        matplotlib Axes or Figure
            The given axes, or the created figure.

        Raises
        ------
        AllanError
            When there is no such sensor or axis, or an argument is invalid.
        """
        from .view.plots import draw_axes, sensor_figure

        choose(UNIT_SYSTEMS, units=units)
        names = [name for name in self.axes if what in (name, sensor_of(name))]
        if not names:
            raise AllanError(f'there is no {what!r}: choose one of {", ".join(self.axes)}')
        axes = {name: self.axes[name] for name in names}
        if ax is None:
            return sensor_figure(replace(self, axes=axes), sensor_of(names[0]), units=units)
        if not hasattr(ax, 'loglog'):
            raise AllanError(f'ax is {ax!r:.60}: a matplotlib Axes is expected')
        draw_axes(ax, axes, units)
        return ax

    @public
    def export(
        self, target: str, path: str | os.PathLike[str] | None = None, **options: Any
    ) -> str:
        """Return the noise as the text of a file for a filter or simulator.

        Parameters
        ----------
        target : str
            A target that `allan export --list` lists, such as 'kalibr'.
        path : path, optional
            The text is also written to this file, or into this folder.
        **options
            Options of `allan export` with underscores, such as ``inflate=2``,
            ``inflate={'gyro': 2, 'accel': 3}`` or ``motion=True``.

        Raises
        ------
        AllanError
            When the target or an option is unknown, the target needs an axis that was not
            measured, or the file cannot be written.
        """
        expect(str, target=target)
        text = make_export(self, target, settings_from(ExportOptions, options), finding_line).text
        if path is not None:
            expect(PATH, 'a path', path=path)
            place = Path(path)
            write_atomic(place / target_of(target).file_name if place.is_dir() else place, text)
        return text

    @public
    def save(
        self,
        folder: str | os.PathLike[str],
        units: str = 'deg/h',
        targets: Sequence[str] = (),
        plots: Sequence[str] = (),
        overwrite: bool = False,
    ) -> list[Path]:
        """Write the results, the report, filter files and figures, and return their paths.

        `allan analyze -o` writes the same files. `load` reads the folder again.

        Parameters
        ----------
        folder : path
            Folder for the files; it is created if it is missing.
        units : 'deg/h' or 'SI'
            Units of the report and the figures.
        targets : sequence of str
            Targets that `allan export --list` lists; their files are written in addition to the
            file of Kalibr.
        plots : sequence of str
            File formats of figures in addition to the report: 'png', 'svg', 'pdf'.
        overwrite : bool
            Whether to replace results of another recording in this folder.

        Raises
        ------
        AllanError
            When the sums are not known, an argument is invalid, the folder has results of another
            recording, or a file cannot be written.
        """
        from .view.result_files import write_result_files

        expect(PATH, 'a path', folder=folder)
        choose(UNIT_SYSTEMS, units=units)
        expect(LIST, targets=targets, plots=plots)
        check_plots(plots)
        expect(bool, overwrite=overwrite)
        return write_result_files(
            folder, self, units=units, targets=targets, plots=plots, overwrite=overwrite
        )[1]

    @public
    def check(
        self,
        sensor: PlainDatasheet | str = '',
        baseline: PlainResults | str | os.PathLike[str] = '',
        margin: float | None = None,
    ) -> Verdict:
        """Return a verdict on the IMU after a comparison with a datasheet or an earlier run.

        Parameters
        ----------
        sensor : str or Datasheet
            A name that `allan sensors` lists, or the path of a .yaml file; '' for no datasheet.
        baseline : Results or path
            An earlier run: results, or the path of a results.json, a sums.json or the folder of an
            analysis; '' for none.
        margin : float, optional
            A coefficient exceeds the datasheet or the earlier run if its complete 95 % interval
            lies above it by this fraction. By default 0.2; a comparison with a datasheet that the
            results already contain keeps its margin.

        Returns
        -------
        Verdict
            With ``level`` ('healthy', 'attention', 'unknown' or 'failed'), ``summary``, ``reasons``
            and ``next_steps``.

        Raises
        ------
        AllanError
            When the datasheet or the earlier run cannot be read, or the margin is negative.

        Examples
        --------
        >>> import allan_ros as ar
        >>> may, june = (ar.analyze(ar.simulate(hours=0.1, rate=50, seed=i)) for i in (1, 2))
        >>> june.check(baseline=may).level
        'healthy'
        >>> worn = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=2, gyro={'N': 0.5}))
        >>> worn.check(baseline=may).level
        'failed'
        """
        return self.compared(sensor, baseline, margin).verdict

    def compared(
        self,
        sensor: PlainDatasheet | str = '',
        baseline: PlainResults | str | os.PathLike[str] = '',
        margin: float | None = None,
    ) -> Results:
        """Return a copy that is compared with a datasheet, an earlier run, or both.

        Arguments and errors are the same as in `check`.
        """
        return compared(self, sensor, baseline, margin)


class Datasheet(PlainDatasheet):
    __doc__ = PlainDatasheet.__doc__

    def results(self, rate: float = DEFAULT_RATE_HZ) -> Results:
        """Return the noise model of the datasheet for an IMU with a rate in Hz.

        It has the stated N and B. K of a file for a filter follows from its reduced-order model:
        it covers the error growth of N and B over the horizon of the filter. Raises AllanError if
        the datasheet states no N of an axis of a sensor.
        """
        return Results.of(results_of_datasheet(self, rate))

    def export(
        self, target: str, path: str | os.PathLike[str] | None = None, **options: Any
    ) -> str:
        """Return the text of a file for a filter or simulator, with the noise of the datasheet.

        The arguments are the same as in `Results.export`. ``filter_rate`` is also the rate of the
        IMU; the default is 200 Hz.
        """
        return self.results(options.get('filter_rate') or DEFAULT_RATE_HZ).export(
            target, path, **options
        )


class CommonResult(PlainCommonResult):
    __doc__ = PlainCommonResult.__doc__

    def __repr__(self) -> str:
        from .view.common_table import common_lines

        return '\n'.join(common_lines(self))

    def plot(self) -> Any:
        """Return a matplotlib Figure of the coherence over the averaging time."""
        from .view.plots import common_figure

        return common_figure(self)


@public
def sensor(name: str | os.PathLike[str]) -> Datasheet:
    """Return a datasheet, given its name or the path of its .yaml file.

    Raises
    ------
    AllanError
        If the name is unknown, or the file is invalid.

    Examples
    --------
    >>> import allan_ros as ar
    >>> ar.sensor('adis16475-3').limits['gyro_x']['B'].stated
    '7 deg/h'
    """
    expect(PATH, 'a name or a path', name=name)
    return Datasheet(**vars(load_sensor(os.fspath(name))))


@public
def load(path: str | os.PathLike[str], method: str = 'likelihood') -> Results:
    """Read the results of an earlier analysis.

    Parameters
    ----------
    path : path
        The folder of an analysis, a results.json, or a sums.json or checkpoint, whose sums are
        fitted again. Only results with sums (all but a results.json) can be added and saved.
    method : str
        Method of the fit of sums: 'likelihood' or 'paper', as in `analyze`.

    Returns
    -------
    Results

    Raises
    ------
    AllanError
        When the file is missing, or is not such a document.

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
    return Results.of(load_results(path, method))


def results_of(
    path: PlainResults | str | os.PathLike[str],
    method: str = 'likelihood',
    observer: Observer = Silent(),
    segmenter: SegmenterSettings = SegmenterSettings(),
) -> PlainResults:
    """Load results from a JSON file or the folder of an analysis, or analyze a recording.

    If ``path`` is already a `Results` object, it is returned unchanged. ``method`` is the method of
    the fit of sums and recordings. A recording is processed with the settings ``segmenter``, and
    ``observer`` receives the progress of reading. The truth file of a simulated recording gives
    results that are known exactly. Raises AllanError when the path cannot be read.
    """
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
    """Return whether a path is a JSON file or the folder of an analysis, not a recording."""
    place = Path(path)
    in_folder = any((place / name).is_file() for name in (RESULTS, SUMS))
    return in_folder or place.suffix.lower() == '.json'


@public
@one_thread()  # the sums and spectra of the samples, too
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

    Motion and gaps are detected and excluded.

    Parameters
    ----------
    source : path, Results, sequence of these, array, DataFrame, mapping of columns, or ImuBatch
        Several paths or results must be of the same IMU and give one common result. A path can also
        be the sums of an earlier analysis: its folder, sums.json, or a checkpoint. Sums and results
        are not read again, but added and fitted. Arrays are (n,) or (n, axes), with one row per
        sample.
    rate : float
        Sample rate in Hz. It is required for samples without stamps. For recordings it is only
        compared with the stamps, and 0 disables this check.
    axes : str or sequence of str, optional
        The axis of each column of an array, such as ``'gyro_z'``, ``'accel'`` or a list. By
        default one column is ``gyro_x``, three are the gyro, six are gyro and accelerometer.
    gyro_unit, accel_unit : str
        Units of the samples, such as 'deg/s' and 'g', if the source does not state them. By default
        rad/s and m/s^2.
    method : str
        Method of the fit: 'likelihood' (maximum likelihood, with confidence intervals) or 'paper'
        (plain least squares, as in Cong et al. 2019).
    sensor : str
        Datasheet to compare with: a name that `allan sensors` lists, or the path of a .yaml file.
    baseline : Results or path
        An earlier run of this IMU to compare with: results, or the path of a results.json, a
        sums.json or the folder of an analysis.
    noise : Results or path
        An earlier run of this IMU at rest, whose noise predicts the errors in motion. By default,
        the noise of the rests of the source.
    margin : float
        A coefficient exceeds the datasheet or the earlier run if its complete 95 % interval lies
        above it by this fraction.
    hardware_id : str
        Serial number of the IMU; only results with equal serial numbers can be added.
    processes : int
        Number of recordings that are read at the same time, each in its own process.
    **options
        Further options of `allan analyze`, with underscores: ``skip`` (time in s excluded at the
        start), ``motion_gate`` (False uses all data), ``topic``, ``columns`` ...

    Returns
    -------
    Results
        The coefficients, curves and findings of each axis.

    Raises
    ------
    AllanError
        When the source cannot be read, an argument is invalid, or no data at rest are found.

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
    reading, segmenter = _settings({**options, **units}, rate)
    ResultSettings(method=method, margin=margin)  # checks them before recordings are read
    expect(str, hardware_id=hardware_id)
    expect(Integral, processes=processes)
    expect((PlainResults, *PATH), 'results or a path', noise=noise)
    at_rest = (
        noise if isinstance(noise, PlainResults) else load_results(noise) if str(noise) else None
    )
    if axes is not None:
        expect((str, Sequence), 'a text or a list', axes=axes)
    given = list(source) if isinstance(source, (list, tuple)) else [source]
    if given and all(isinstance(each, (PlainResults, *PATH)) for each in given):
        if axes is not None:
            raise AllanError(
                'axes are for arrays, not files: name the columns of a table with columns='
            )
        known = [isinstance(each, PlainResults) or is_document(each) for each in given]
        stored = [_stored(each) for each, is_known in zip(given, known) if is_known]
        jobs = [
            ReadJob(str(path), reading, segmenter, hardware_id, True)
            for path, is_known in zip(given, known)
            if not is_known
        ]
        several = min(processes, len(jobs)) > 1
        read = read_in_processes(jobs, processes) if several else read_in_turn(jobs)
        recorded = add_recordings([*read, *stored])
    else:
        from .readers.arrays import recording_in_memory

        recording = recording_in_memory(source, reading, axes)
        job = ReadJob(recording.info.path, reading, segmenter, hardware_id, True)
        recorded = read_recording(job, recording)
    results = Results.of(analyze_recorded(recorded, method, at_rest))
    return compared(results, sensor, baseline, margin)


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
        analysis, a recording, or the truth file of a simulated recording. In the output, their
        names are the paths, or A, B, C ...
    sensor : str or sequence of str
        Datasheets to compare each recording with: names that `allan sensors` lists, or paths of
        .yaml files.
    margin : float
        A coefficient exceeds the limit of a datasheet if its complete 95 % interval lies above it
        by this fraction.
    within : float
        Also test whether the coefficients are the same up to this fraction; 0 for no such test.
    method : str
        Method of the fit of sums and recordings, as in `analyze`; results are not fitted again.
    observer : Observer
        Receives the progress of reading recordings; silent by default.

    Returns
    -------
    RunComparison
        The differences of each recording from the first one (``differences``), the results
        compared with the datasheets (``checked``), and whether any difference is significant
        (``differs``); with ``within``, whether the recordings are the same up to this fraction
        (``equivalent``).

    Raises
    ------
    AllanError
        When an input cannot be read, or there is nothing to compare.

    Examples
    --------
    >>> import allan_ros as ar
    >>> quiet = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=1))
    >>> noisy = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=2, gyro={'N': 0.5}))
    >>> ar.compare(quiet, noisy).differs
    True
    """
    ResultSettings(method=method, margin=margin)  # checks them before recordings are read
    check_range(0.0, 10.0, within=within)
    expect((*PATH, *LIST), 'a datasheet or a list of them', sensor=sensor)
    sensors = [sensor] if isinstance(sensor, PATH) else sensor
    sheets = [load_sensor(str(name)) for name in sensors]
    sources = tuple(sorted(sources, key=lambda s: not (isinstance(s, PATH) and is_truth(s))))
    paths = [
        chr(ord('A') + i) if isinstance(s, PlainResults) else str(s) for i, s in enumerate(sources)
    ]
    names = labels_of(paths)
    if len({*names}) < len(names):
        raise AllanError('an input is given twice: give different recordings')
    if len(sources) + len(sheets) < 2 or not sources:
        raise AllanError('nothing to compare: give two recordings, or one and a datasheet')
    runs = (results_of(source, method, observer) for source in sources)
    return compare_runs(dict(zip(names, runs)), sheets, margin, within)


@public
def common(*sources: Any, rate: float = 0.0, **options: Any) -> CommonResult:
    """Separate the noise that several IMUs at rest on one body have in common from their own noise.

    The samples are aligned by their stamps: the recordings must be made together, with one clock,
    and the axes of the IMUs must be parallel.

    Parameters
    ----------
    *sources : path, DataFrame, mapping of columns, or ImuBatch
        One recording of each IMU, or a bag whose Imu topics are the IMUs. The axes of a single IMU
        are compared with each other. In the output, the names of the IMUs are the paths or topics,
        or A, B, C ...
    rate : float
        Sample rate in Hz, as in `analyze`.
    **options
        Options of `analyze` for reading and for the data at rest: ``topic``, ``skip`` ...

    Returns
    -------
    CommonResult
        For each axis and IMU (``rows``): N as measured; the own N of each of three or more IMUs (of
        two, the mean of both) with its interval; and the coherence with the mean of the other IMUs
        at each averaging time.

    Raises
    ------
    AllanError
        When a source cannot be read, or the sources have no axis, rate or time in common.

    Examples
    --------
    >>> import numpy as np
    >>> import allan_ros as ar
    >>> vibration, *own = 1e-3 * np.random.default_rng(0).normal(size=(4, 20_000))
    >>> three = ar.common(*({'gyro_z': 3.0 * vibration + one} for one in own), rate=100)
    >>> row = three.rows[0]
    >>> round(row.measured.value, 4), round(row.own.value, 4)
    (0.0003, 0.0001)
    >>> round(float(row.coherence.value[0]), 1)
    0.9
    """
    from .readers.arrays import recording_in_memory

    reading, settings = _settings(options, rate)
    places = [Path(source).resolve() for source in sources if isinstance(source, PATH)]
    if len({*places}) < len(places):
        raise AllanError('a recording is given twice: give one of each IMU')
    recordings: dict[str, Recording] = {}
    paths = [str(s) if isinstance(s, PATH) else chr(ord('A') + i) for i, s in enumerate(sources)]
    for source, path, label in zip(sources, paths, labels_of(paths)):
        if not isinstance(source, PATH):
            recordings[label] = recording_in_memory(source, reading)
            continue
        topics = [] if reading.topic else topics_of(path)
        for topic in topics if len(topics) > 1 else [reading.topic]:
            name = topic if topics[1:] and len(sources) == 1 else f'{label} {topic}'.strip()
            recordings[name] = ReadJob(path, replace(reading, topic=topic)).open()
    if not recordings:
        raise AllanError('no recording is given: give one of each IMU')
    found = common_of(recordings, settings)
    return CommonResult(found.rows, found.findings)


@public
def inflate(
    rest: PlainResults | str | os.PathLike[str],
    running: PlainResults | str | os.PathLike[str],
    *,
    horizon: float = 30.0,
    observer: Observer = Silent(),
) -> Inflation:
    """Measure by how much running motors increase the IMU noise of a robot at rest.

    A filter that uses the noise at rest should multiply its N and K by the resulting factors.

    Parameters
    ----------
    rest : Results or path
        The robot at rest with its motors off: results, or the path of a results.json, a sums.json,
        the folder of an analysis, or a recording.
    running : Results or path
        The robot at rest with its motors on. All samples of a recording are used, because the
        vibration of motors could be mistaken for motion.
    horizon : float
        Longest time in s for which the filter integrates the IMU without a correction.
    observer : Observer
        Receives the progress of reading recordings; silent by default.

    Returns
    -------
    Inflation
        For each axis (``axes``), N and K with motors off and on, and their ratio, such as
        ``axes['gyro_x']['N'].factor``; the largest factor for N of all axes (``factor``); and the
        largest one for each sensor as the option ``inflate`` of `Results.export` (``option``).

    Raises
    ------
    AllanError
        When an input cannot be read, or the two have no axis in common.

    Examples
    --------
    >>> import allan_ros as ar
    >>> off = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=1, gyro={'N': 0.25}))
    >>> on = ar.analyze(ar.simulate(hours=0.1, rate=50, seed=2, gyro={'N': 0.5}))
    >>> round(ar.inflate(off, on).axes['gyro_x']['N'].factor, 1)
    2.0
    """
    check_range(1e-3, 1e9, 's', horizon=horizon)
    quiet = results_of(rest, observer=observer)
    still = SegmenterSettings(motion_gate=False)
    loud = results_of(running, 'likelihood', observer, still)
    fits = [{axis: r.fit for axis, r in results.axes.items()} for results in (quiet, loud)]
    axes = measure_inflation(fits[0], fits[1], horizon)
    return Inflation(axes, compare_runs({REST: quiet, RUNNING: loud}), horizon)


def _settings(options: Mapping[str, Any], rate: float) -> tuple[ReadOptions, SegmenterSettings]:
    """Divide the options into settings for reading and for the motion gate, both with ``rate``."""
    check_rate(rate)
    of_reading = [name for name in describe(ReadOptions) if name != 'rate_hz']
    of_segmenter = [name for name in describe(SegmenterSettings) if name != 'declared_rate']
    check_names(options, [*of_segmenter, *of_reading])
    reading = {name: options[name] for name in of_reading if name in options}
    segmenter = {name: options[name] for name in of_segmenter if name in options}
    return ReadOptions(rate_hz=rate, **reading), SegmenterSettings(declared_rate=rate, **segmenter)


def _stored(source: PlainResults | str | os.PathLike[str]) -> RecordingSums:
    """Return the sums of results, or of the path of an earlier analysis."""
    if not isinstance(source, PlainResults):
        return load_sums(source)
    if source.recorded is None:
        raise AllanError('these results were read without their sums: give the folder or sums.json')
    return source.recorded
