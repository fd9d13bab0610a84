# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Results`: the coefficients, curves and findings of one analysis. Fits sums to obtain them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import Any

from ..core.compare import MARGIN, Comparison, Measured, Run, differences
from ..core.errors import AllanError
from ..core.estimate import Estimate
from ..core.findings import Finding
from ..core.fit.temperature import TemperatureModel
from ..core.imu import ImuIdentity, sensor_of
from ..core.settings import LIST, UNIT_SYSTEMS, choose, expect, settings_from
from ..export import ExportOptions, make_export, target_of
from ..readers.files import PATH, public, write_atomic
from ..readers.recorded import Provenance, RecordingSums
from ..view.format import check_plots
from .axis_result import AxisResult
from .datasheets import (
    Datasheet,
    DatasheetComparison,
    against_datasheet,
    exceeds_limit,
    load_sensor,
)
from .verdict import TOO_SHORT_S, Verdict, summary_lines, verdict_of


@dataclass(frozen=True)
class Results:
    """The results of one analysis of one IMU.

    ``results['gyro_z']`` is the `AxisResult` of an axis, and iteration gives the names of the axes.
    Printed, the results are a summary.

    Attributes
    ----------
    identity : ImuIdentity
        The frame_id and the serial number of the IMU.
    method : str
        Method of the fit: 'likelihood' or 'paper'.
    tau0, duration_s : float
        Sample period, and total time of all used samples, in s. If gyro and accelerometer have
        different rates, these are of the sensor with more samples.
    samples, segments : int
        Number of used samples, and of segments without gaps or motion, of the same sensor.
    axes : mapping of axis name to AxisResult
        The measured axes: gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z, if present.
    provenance : Provenance
        The recordings, their segments and counts of samples, and the settings.
    findings : tuple of Finding
        Messages about the recording, the fit, and the comparison with a datasheet.
    datasheet : DatasheetComparison or None
        The comparison with a datasheet; None if no datasheet was given.
    baselines : mapping of name to Results
        Earlier runs of this IMU with which the results are compared.
    margin : float
        A coefficient exceeds a limit or an earlier run if its complete 95 % interval lies above it
        by this fraction.
    recorded : RecordingSums or None
        The sums to which the coefficients were fitted; None if they are not known, for example in
        results that were read from a results.json alone.

    Examples
    --------
    >>> import allan_ros as ar
    >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
    >>> results.samples, round(results.rate_hz), list(results)[:2]
    (18000, 50, ['gyro_x', 'gyro_y'])
    >>> results.noise['gyro_x']['N'].status, len(results.table()), results.verdict.level
    ('estimated', 30, 'measured')
    >>> figure = results.plot('gyro')
    >>> checked = results.compared(sensor='adis16475-3')
    >>> checked.comparisons[0].term, checked.comparisons[0].verdict
    ('N', 'within')
    >>> results.export('kalibr').splitlines()[-1]
    'update_rate: 50.0'
    """

    identity: ImuIdentity
    method: str
    tau0: float
    samples: int
    duration_s: float
    segments: int
    axes: Mapping[str, AxisResult]
    provenance: Provenance
    findings: tuple[Finding, ...]
    datasheet: DatasheetComparison | None = None
    baselines: Mapping[str, Results] = field(default_factory=dict, repr=False, compare=False)
    margin: float = field(default=MARGIN, repr=False, compare=False)
    recorded: RecordingSums | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.datasheet is not None:
            checks = self._undecided_if_short(self.datasheet.comparisons)
            object.__setattr__(self, 'datasheet', replace(self.datasheet, comparisons=checks))

    def _undecided_if_short(self, comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
        """Return the comparisons, with the verdict 'undecided' below `TOO_SHORT_S` of data at
        rest."""
        short = self.duration_s < TOO_SHORT_S
        return tuple(replace(c, verdict='undecided') if short else c for c in comparisons)

    @property
    def rate_hz(self) -> float:
        """Sample rate in Hz."""
        return 1.0 / self.tau0

    @property
    def verdict(self) -> Verdict:
        """Whether the IMU is healthy (``level``), with the reasons and the next steps."""
        return verdict_of(self)

    @property
    def noise(self) -> dict[str, Mapping[str, Estimate]]:
        """The coefficients in SI: axis -> term -> Estimate."""
        return {name: axis.fit.noise for name, axis in self.axes.items()}

    @property
    def measured(self) -> Run:
        """The coefficients and the curve of each axis, for comparing recordings."""
        return {name: Measured(axis.fit.noise, axis.curve) for name, axis in self.axes.items()}

    @property
    def temperature_models(self) -> dict[str, dict[str, TemperatureModel]]:
        """The models of the bias over temperature: sensor -> axis -> model, if there are any."""
        found: dict[str, dict[str, TemperatureModel]] = {}
        for name, axis in self.axes.items():
            if axis.temperature is not None:
                found.setdefault(sensor_of(name), {})[name] = axis.temperature
        return found

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The comparisons of the coefficients with the datasheet and with the earlier runs.

        Allan deviations are compared with the earlier runs, too. If a deviation of an axis exceeds
        an earlier run although none of its coefficients does, the largest such excess is included.
        """
        found = list(self.datasheet.comparisons) if self.datasheet else []
        pairs = [(earlier.measured, self.measured) for earlier in self.baselines.values()]
        for name, of_run in zip(self.baselines, differences(pairs)):
            known = [c for d in of_run if (c := d.against(name, self.margin)) is not None]
            found += [c for c in known if c.tau is None]
            explained = {c.axis for c in found if c.reference == name and c.verdict == 'exceeds'}
            excess: dict[str, Comparison] = {}
            for c in sorted(known, key=lambda c: c.at_least):
                if c.tau is not None and c.verdict == 'exceeds' and c.axis not in explained:
                    excess[c.axis] = c
            found += excess.values()
        return self._undecided_if_short(found)

    def __getitem__(self, axis: str) -> AxisResult:
        try:
            return self.axes[axis]
        except (KeyError, TypeError):
            raise AllanError(
                f'there is no axis {axis!r}: choose one of {", ".join(self.axes)}'
            ) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.axes)

    def __repr__(self) -> str:
        return '\n'.join(summary_lines(self))

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
        from ..view.coefficient_table import coefficient_list
        from ..view.table import records

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
        from ..view.plots import draw_axes, sensor_figure

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
            Options of `allan export` with underscores, such as ``inflate=2``.

        Raises
        ------
        AllanError
            When the target or an option is unknown, the target needs an axis that was not
            measured, or the file cannot be written.
        """
        expect(str, target=target)
        text = make_export(self, target, settings_from(ExportOptions, options)).text
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
        from ..view.result_files import write_result_files

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
        sensor: Datasheet | str = '',
        baseline: Results | str | os.PathLike[str] = '',
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
        sensor: Datasheet | str = '',
        baseline: Results | str | os.PathLike[str] = '',
        margin: float | None = None,
    ) -> Results:
        """Return a copy that is compared with a datasheet, an earlier run, or both.

        Arguments and errors are the same as in `check`.
        """
        from .documents import labels_of, load

        expect((Results, *PATH), 'results or a path', baseline=baseline)
        expect((Datasheet, *PATH), 'a datasheet or its name', sensor=sensor)
        stated = self.margin if margin is None else margin
        expect(Real, margin=stated)
        if not stated >= 0.0:
            raise AllanError(f'margin is {stated:g}: give 0 or more')
        results = replace(self, margin=stated)
        if isinstance(baseline, Results):
            results = replace(results, baselines={'the earlier run': baseline})
        elif str(baseline):
            (label,) = labels_of([str(baseline)])
            results = replace(results, baselines={label: load(baseline)})
        sheet = self.datasheet.datasheet if self.datasheet else None
        if sensor:
            sheet = sensor if isinstance(sensor, Datasheet) else load_sensor(str(sensor))
        return results if sheet is None else results.against_datasheet(sheet, stated)

    def against_datasheet(self, datasheet: Datasheet, margin: float) -> Results:
        """Return a copy that is compared with this datasheet instead of any earlier one.

        Each coefficient that exceeds its limit by more than the fraction ``margin`` adds a finding.

        Examples
        --------
        >>> import allan_ros as ar
        >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
        >>> checked = results.compared(sensor='adis16475-3')
        >>> sheet = checked.datasheet.datasheet
        >>> results.against_datasheet(sheet, margin=0.2).comparisons == checked.comparisons
        True
        >>> results.measured['gyro_x'].curve is results['gyro_x'].curve
        True
        >>> results.temperature_models  # no temperature was recorded
        {}
        """
        others = (f for f in self.findings if f.id != 'exceeds_limit')
        comparison = against_datasheet(self.noise, datasheet, margin)
        found = (
            exceeds_limit(c, self.noise[c.axis][c.term], margin, (c.axis,))
            for c in self._undecided_if_short(comparison.comparisons)
            if c.verdict == 'exceeds'
        )
        return replace(self, datasheet=comparison, margin=margin, findings=(*others, *found))
