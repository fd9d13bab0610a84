# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public classes of results, which add texts, export, plots and files to the plain data.

The module for an output is imported only when the output is requested, because most analyses need
few outputs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import wraps
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from ..core.errors import AllanError
from ..core.findings import grouped
from ..core.imu import sensor_of
from ..core.settings import LIST, MAX_FLOAT, UNIT_SYSTEMS, check_choice, expect, settings_from
from ..export import ExportOptions, make_export, write_export
from ..readers.files import PATH, with_checked_paths
from ..results.datasheets import Datasheet as PlainDatasheet
from ..results.datasheets import load_sensor
from ..results.documents import labels_of
from ..results.documents import load as load_results
from ..results.from_datasheet import DEFAULT_RATE_HZ, results_of_datasheet
from ..results.results import Results as PlainResults
from ..view.finding_text import explained, finding_line

if TYPE_CHECKING:
    from ..view.verdict_text import Verdict

P = ParamSpec('P')
T = TypeVar('T')
R = TypeVar('R', bound=PlainResults)


def public(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function, decorated so that its AllanErrors contain the texts of their findings.

    Errors of the operating system become AllanErrors, too.
    """
    checked = with_checked_paths(function)

    @wraps(function)
    def with_explained_errors(*args: P.args, **given: P.kwargs) -> T:
        try:
            return checked(*args, **given)
        except AllanError as error:
            raise explained(error) from error.__cause__

    return with_explained_errors


class Results(PlainResults):
    __doc__ = PlainResults.__doc__

    def __repr__(self) -> str:
        from ..view.verdict_text import summary_lines

        return '\n'.join(summary_lines(self))

    @property
    def verdict(self) -> Verdict:
        """Verdict on the IMU: level, summary, reasons and next steps."""
        from ..view.verdict_text import verdict_of

        return verdict_of(self)

    def messages(self, units: str = 'deg/h') -> list[str]:
        """Return the texts of the findings, the most important finding first.

        ``units`` is 'deg/h' or 'SI'. Raises AllanError for other units.

        >>> import allan_ros as ar
        >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50, vibration_gyro=3e-4))
        >>> any('Vibration' in message for message in results.messages())
        True
        """
        check_choice(UNIT_SYSTEMS, units=units)
        return [finding_line(finding, units) for finding in grouped(self.findings)]

    @classmethod
    def of(cls, results: PlainResults) -> Results:
        """Return plain results (the data without methods for output) as an object of this class.

        >>> import allan_ros as ar
        >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
        >>> ar.Results.of(results) == results
        True
        """
        return cls(**{field.name: getattr(results, field.name) for field in fields(results)})

    def _repr_html_(self) -> str:
        """Return the verdict and the coefficients as HTML for the output of a notebook cell."""
        from ..view.notebook import notebook_html

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
            The columns axis, term, value, ci95_low, ci95_high, upper95 and unit. The table is a
            DataFrame if pandas is installed. Unknown numbers are None, or NaN in a column of a
            DataFrame that also has known numbers.

        Raises
        ------
        AllanError
            When ``units`` is not 'deg/h' or 'SI'.
        """
        from ..view.coefficient_table import coefficient_list
        from ..view.table import records

        check_choice(UNIT_SYSTEMS, units=units)
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
            Axes to draw into. By default, a figure with a panel for each of these axes that has a
            curve is created.
        units : 'deg/h' or 'SI'
            Units of the figure.

        Returns
        -------
        matplotlib Axes, Figure or None
            The given Axes, or the created figure; None if no figure is created because no axis has
            a curve.

        Raises
        ------
        AllanError
            When the results have no sensor or axis ``what``, an argument is invalid, or matplotlib
            is missing.
        """
        from ..view.plots import draw_axes, sensor_figure

        check_choice(UNIT_SYSTEMS, units=units)
        names = [
            name for name in self.axes if isinstance(what, str) and what in (name, sensor_of(name))
        ]
        if not names:
            raise AllanError(
                f'there is no axis or sensor {what!r:.60}: choose one of {", ".join(self.axes)}'
            )
        axes = {name: self.axes[name] for name in names}
        if ax is None:
            return sensor_figure(replace(self, axes=axes), sensor_of(names[0]), units=units)
        if not hasattr(ax, 'loglog'):
            raise AllanError(f'ax is {ax!r:.60}: a matplotlib Axes is expected')
        draw_axes(ax, axes, units)
        return ax

    @public
    def export(
        self,
        target: str,
        path: str | os.PathLike[str] | None = None,
        overwrite: bool = False,
        **options: Any,
    ) -> str:
        """Return the text of a configuration file of a state estimator or simulator.

        Parameters
        ----------
        target : str
            An export target from the list of `allan export --list`, such as 'kalibr'.
        path : path, optional
            File to which the text is also written, or an existing folder for the file.
        overwrite : bool
            Whether a file that was not written by this package is replaced. An exported file is
            always replaced.
        **options
            Options of `allan export` with underscores, such as ``inflate=2``,
            ``inflate={'gyro': 2, 'accel': 3}`` or ``motion=True``.

        Raises
        ------
        AllanError
            When the export target is unknown, an option is unknown or invalid, the results lack an
            axis or a number that the file needs, or the file cannot be written. Without
            ``overwrite=True`` also when a file at ``path`` was not written by this package. Without
            ``force=True`` also when the samples are probably not in SI units, or the recording does
            not show the noise of the sensor.
        """
        text = make_export(self, target, settings_from(ExportOptions, options), finding_line).text
        if path is not None:
            expect(PATH, 'a path', path=path)
            expect(bool, overwrite=overwrite)
            write_export(path, target, text, overwrite)
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
        """Write results, sums, report, configuration files and figures, and return their paths.

        `allan analyze -o` writes the same files. `load` reads the folder again. A
        configuration file is omitted if the results lack an axis or a number that the file needs,
        if the units of the samples are probably wrong, or if the recording does not show the noise
        of the sensor. A finding in the report then states the reason.

        Parameters
        ----------
        folder : path
            Folder for the files; it is created if it is missing.
        units : 'deg/h' or 'SI'
            Units of the report and the figures.
        targets : list or tuple of str
            Export targets from the list of `allan export --list`. The files for these targets are
            written in addition to the file for Kalibr.
        plots : list or tuple of str
            File formats of figures that are written in addition to the report: 'png', 'svg', 'pdf'.
        overwrite : bool
            Whether results of another recording in this folder, with another file name or topic,
            and configuration files that this package did not write are replaced. Samples in memory
            all have the name 'array'.

        Raises
        ------
        AllanError
            When the results have no Allan sums, an argument is invalid, a file cannot be written,
            matplotlib is missing for figures, or another process writes to the folder. Without
            ``overwrite`` also when the folder has results of another recording, or a configuration
            file that would be replaced and was not written by this package.
        """
        from ..view.result_files import check_plots, write_result_files

        expect(PATH, 'a path', folder=folder)
        check_choice(UNIT_SYSTEMS, units=units)
        expect(LIST, targets=targets, plots=plots)
        for target in targets:
            expect(str, target=target)
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
        """Return a verdict on the IMU after a comparison with a datasheet, an earlier run, or both.

        Parameters
        ----------
        sensor : str or Datasheet
            A datasheet, a name that `allan sensors` lists, or the path of a .yaml file. With '',
            the results keep the datasheet with which they were compared, if any.
        baseline : Results or path
            An earlier run: results, or the path of a results.json, a sums.json, a checkpoint or the
            folder of an analysis. With '', the results keep their earlier runs, if any.
        margin : float, optional
            Fraction by which a coefficient may exceed a limit of the datasheet or the earlier run.
            A coefficient exceeds a limit of the datasheet if its complete 95 % interval lies above
            limit * (1 + margin). It exceeds the earlier run if it is significantly higher, and the
            complete 95 % interval of the ratio of the new to the earlier coefficient lies above
            1 + margin. The default is the margin of the results, which is 0.2 unless it was
            changed.

        Returns
        -------
        Verdict
            ``level``, ``summary``, ``reasons`` and ``next_steps``. The level is 'healthy',
            'attention', 'unknown' or 'failed', as in `Results.level`. Instead of 'healthy' or
            'attention', it is 'measured' if no coefficient could be compared.

        Raises
        ------
        AllanError
            When the datasheet or the earlier run cannot be read, an argument has a wrong type, or
            the margin is below 0 or not finite.

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

    @public
    def compared(
        self,
        sensor: PlainDatasheet | str = '',
        baseline: PlainResults | str | os.PathLike[str] = '',
        margin: float | None = None,
    ) -> Results:
        """Return a copy of the results, compared with a datasheet, an earlier run, or both.

        Arguments and errors are the same as in `check`.
        """
        return compared(self, sensor, baseline, margin)


class Datasheet(PlainDatasheet):
    __doc__ = PlainDatasheet.__doc__

    def results(self, rate: float = DEFAULT_RATE_HZ) -> Results:
        """Return the noise model of the datasheet as results of an IMU with the sample rate in Hz.

        The model has the stated N and B. If the datasheet states no B, the flicker noise is assumed
        to equal the white noise at an averaging time of 10 s. Axes of which the datasheet states
        nothing are absent. Raises AllanError if the datasheet states B but no N of an axis, or the
        rate is not a number from 1e-6 to 1e6.
        """
        return Results.of(results_of_datasheet(self, rate))

    def export(
        self,
        target: str,
        path: str | os.PathLike[str] | None = None,
        overwrite: bool = False,
        **options: Any,
    ) -> str:
        """Return the text of a configuration file with the noise of the datasheet.

        Arguments and errors are the same as in `Results.export`. In addition, AllanError is raised
        if the datasheet states B but no N of an axis, and for ``motion=True``, because a datasheet
        states no noise in motion. The option ``filter_rate`` in Hz is also used as the sample rate
        of the IMU; the default is 200 Hz.
        """
        rate = settings_from(ExportOptions, options).filter_rate or DEFAULT_RATE_HZ
        return self.results(rate).export(target, path, overwrite, **options)


def compared(
    results: R,
    sensor: PlainDatasheet | str = '',
    baseline: PlainResults | str | os.PathLike[str] = '',
    margin: float | None = None,
) -> R:
    """Return a copy of the results, compared with a datasheet, an earlier run, or both.

    If no datasheet is given, and the results already contain one, the comparison with that
    datasheet is repeated with the new margin.

    Parameters
    ----------
    results : Results
        The results to compare.
    sensor : Datasheet, str or path
        A datasheet, its name or its path; '' for no new datasheet.
    baseline : Results or path
        Results of an earlier run, or their path, which replace the earlier runs of the results; ''
        for no new earlier run.
    margin : float, optional
        Fraction by which a limit may be exceeded; by default, the margin of the results.

    Raises
    ------
    AllanError
        When the datasheet or the earlier run cannot be read, an argument has a wrong type, or the
        margin is below 0 or not finite.
    """
    expect((PlainResults, *PATH), 'results or a path', baseline=baseline)
    expect((PlainDatasheet, *PATH), 'a datasheet or its name', sensor=sensor)
    used_margin = results.margin if margin is None else margin
    expect(Real, margin=used_margin)
    if not 0.0 <= used_margin <= MAX_FLOAT:
        raise AllanError(f'margin is {used_margin!s:.40}: give 0 or more')
    results = replace(results, margin=used_margin)
    if isinstance(baseline, PlainResults):
        results = replace(results, baselines={'the earlier run': baseline})
    elif str(baseline):
        (label,) = labels_of([str(baseline)])
        results = replace(results, baselines={label: load_results(baseline)})
    sheet = results.datasheet
    if sensor:
        sheet = sensor if isinstance(sensor, PlainDatasheet) else load_sensor(str(sensor))
    return results if sheet is None else results.against_datasheet(sheet, used_margin)


@public
def sensor(name: str | os.PathLike[str]) -> Datasheet:
    """Return a datasheet, given its name or the path of its .yaml file.

    Raises
    ------
    AllanError
        When the name is unknown, or the file is invalid.

    Examples
    --------
    >>> import allan_ros as ar
    >>> ar.sensor('adis16475-3').limits['gyro_x']['B'].stated
    '7 deg/h'
    """
    expect(PATH, 'a name or a path', name=name)
    return Datasheet(**vars(load_sensor(os.fspath(name))))
