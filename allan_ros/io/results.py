# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Results`: the coefficients, curves and findings of one analysis."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..core.allan.curve import AllanCurve, allan_curve
from ..core.allan.sums import AllanSums
from ..core.compare import MARGIN, Comparison, DeviationCurve, Measured, Run, differences
from ..core.errors import AllanError
from ..core.filters.bias import TurnOnBias, turn_on_bias
from ..core.filters.noise_parameters import Growth, growth_table, sample_variance
from ..core.findings import Finding
from ..core.fit import AxisFit, Coefficient, NoiseModel
from ..core.fit.findings import rounding_step
from ..core.fit.regions import Region, read_curve
from ..core.fit.stationary import fit_stationary
from ..core.imu import AXES, SI_UNITS, UNITS, ImuIdentity, sensor_of, to_si
from ..core.noise import NoiseTerms, ProcessModel
from ..core.settings import AUTO
from ..core.stream.findings import sums_findings
from .datasheets import (
    Datasheet,
    DatasheetComparison,
    against_datasheet,
    datasheet_findings,
    load_sensor,
)
from .recorded import Provenance, RecordingSums

if TYPE_CHECKING:
    from .verdict import Verdict


@dataclass(frozen=True)
class Quantity:
    """One coefficient of one axis with its unit.

    Attributes
    ----------
    value : float or None
        The estimate; None where the term is not resolved. The ramp R is given without its sign.
    ci95 : (low, high) or None
        95 % confidence interval.
    upper95 : float or None
        95 % upper limit of a term that is not resolved.
    unit : str
    sign : int
        Sign of the ramp R, else 0.

    Examples
    --------
    >>> Quantity(1e-4, (9e-5, 1.1e-4), None, 'rad/s/sqrt(Hz)').to('deg/sqrt(h)')
    0.3438 (0.309..0.378) deg/sqrt(h)
    >>> Quantity(None, None, 2e-5, 'rad/s').to('deg/h')
    < 4.13 deg/h
    """

    value: float | None
    ci95: tuple[float, float] | None
    upper95: float | None
    unit: str
    sign: int = 0

    def to(self, unit: str) -> Quantity:
        """Return the same in another unit of the same quantity.

        Raises
        ------
        AllanError
            When the unit is unknown, or of another quantity; it lists the units that fit.
        """
        factor = to_si(1.0, self.unit, UNITS[self.unit].si) / to_si(1.0, unit, UNITS[self.unit].si)
        low_high = self.ci95 and (self.ci95[0] * factor, self.ci95[1] * factor)
        return replace(
            self,
            value=None if self.value is None else self.value * factor,
            ci95=low_high,
            upper95=None if self.upper95 is None else self.upper95 * factor,
            unit=unit,
        )

    def __repr__(self) -> str:
        from .format import ShownUnit, interval_text, value_text

        known = Coefficient(
            self.value,
            self.ci95,
            self.upper95,
            'not_observable' if self.value is None else 'estimated',
            self.sign,
        )
        unit = ShownUnit(self.unit, 1.0)
        interval = interval_text(known, unit)
        return f'{value_text(known, unit)}{f" ({interval})" if interval else ""} {self.unit}'


@dataclass(frozen=True)
class AxisCurve:
    """Overlapping Allan deviation with its 68.3 % confidence limits.

    Attributes
    ----------
    m : (factors,) int64 array
        Averaging factors in samples.
    tau : (factors,) float64 array
        Averaging times in s.
    n : (factors,) int64 array
        Number of second differences in each point.
    adev, ci_low, ci_high : (factors,) float64 arrays
        Deviation and its limits in the unit of the samples; (factors, columns) of several columns.

    Examples
    --------
    >>> import allan_ros as ar
    >>> ar.adev([1.0, 2.0, 1.0, 3.0, 1.0], rate=2.0).tau
    array([0.5, 1. ])
    """

    m: NDArray[np.int64]
    tau: NDArray[np.float64]
    n: NDArray[np.int64]
    adev: NDArray[np.float64]
    ci_low: NDArray[np.float64]
    ci_high: NDArray[np.float64]

    @property
    def limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """The deviation, and its lower and upper limit."""
        return self.adev, self.ci_low, self.ci_high


@dataclass(frozen=True)
class AxisResult:
    """The results of one axis; ``axis.N``, ``.Q``, ``.B``, ``.K`` and ``.R`` are its coefficients.

    Attributes
    ----------
    tau0 : float
        Sample period in s.
    fit : AxisFit
    curve : AxisCurve or None
        None where only the coefficients are known.
    regions : tuple of Region
        Which noise dominates in which range of tau.
    sample_std : float or None
        Standard deviation of the samples about their mean of up to a second, as measured.
    name : str
        Name of the axis.
    rounding : float or None
        Step to which the samples are rounded, where this makes more than a tenth of their white
        noise; else None.
    turn_on : TurnOnBias or None
        Scatter of the bias between recordings; None of fewer than two.

    Examples
    --------
    >>> import allan_ros as ar
    >>> axis = ar.analyze(ar.simulate(hours=0.1, rate=50))['accel_z']
    >>> axis.name, round(axis.N.to('ug/sqrt(Hz)').value, -1)
    ('accel_z', 20.0)
    """

    tau0: float
    fit: AxisFit
    curve: AxisCurve | None = None
    regions: tuple[Region, ...] = ()
    sample_std: float | None = None
    name: str = ''
    rounding: float | None = None
    turn_on: TurnOnBias | None = None

    @property
    def Q(self) -> Quantity:
        """Quantization noise."""
        return self.quantity('Q')

    @property
    def N(self) -> Quantity:
        """Angle or velocity random walk: the continuous density of the white noise."""
        return self.quantity('N')

    @property
    def B(self) -> Quantity:
        """Bias instability: the coefficient, i.e. the minimum of the curve / 0.664."""
        return self.quantity('B')

    @property
    def K(self) -> Quantity:
        """Rate or acceleration random walk."""
        return self.quantity('K')

    @property
    def R(self) -> Quantity:
        """Rate or acceleration ramp."""
        return self.quantity('R')

    @property
    def growth(self) -> tuple[Growth, ...]:
        """Predicted growth of the error without correction, with intervals."""
        return growth_table(self.fit)

    def quantity(self, term: str) -> Quantity:
        """Return the coefficient of a term (Q, N, B, K or R) in SI."""
        c = self.fit.noise[term]
        value = c.value if c.status == 'estimated' else None
        return Quantity(value, c.ci95, c.upper95, SI_UNITS[sensor_of(self.name)][term], c.sign)

    def part_adev(self, m: NDArray[np.int64]) -> dict[str, NDArray[np.float64]]:
        """Return the deviation of each part of the selected model at averaging factors m, SI."""
        parts = self.fit.selected.parts(m * self.tau0, self.tau0)
        return {name: np.sqrt(avar) for name, avar in parts.items()}

    def limit_adev(self, m: NDArray[np.int64]) -> dict[str, NDArray[np.float64]]:
        """Return the deviation of the terms outside the model at their 95 % upper limits, SI."""
        model = self.fit.selected.terms
        limits = {
            term: c.upper95
            for term, c in self.fit.noise.items()
            if c.upper95 is not None and math.isfinite(c.upper95) and not getattr(model, term)
        }
        parts = ProcessModel(NoiseTerms(**limits)).parts(m * self.tau0, self.tau0)
        return {name: np.sqrt(avar) for name, avar in parts.items()}

    def total_adev(self, m: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the deviation of the selected model at averaging factors m, (factors,), SI."""
        total: NDArray[np.float64] = np.sqrt(self.fit.selected.avar(m * self.tau0, self.tau0))
        return total


@dataclass(frozen=True)
class Results:
    """One analysis of one IMU; ``results['gyro_z']`` is the result of an axis.

    Attributes
    ----------
    identity : ImuIdentity
    method : str
        How the curve was fitted.
    tau0, samples, duration_s, segments : float, int, float, int
        Sample period, samples, their total time, and segments of the sensor with the most
        samples; a sensor with another rate has its own tau0.
    axes : mapping of axis name to AxisResult
        In the order of `AXES`; only the axes that were measured.
    provenance : Provenance
    findings : tuple of Finding
        Of the recording, of the fit, and of the comparison with a datasheet.
    datasheet : DatasheetComparison or None
        The comparison with a datasheet, if one was named.
    baselines : mapping of name to Results
        Earlier runs of this IMU that it is compared with.
    margin : float
        Fraction by which a complete interval must exceed a limit or an earlier run.
    recorded : RecordingSums or None
        The sums that were fitted; None for results that were read from a file.

    Examples
    --------
    >>> import allan_ros as ar
    >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
    >>> results.samples, round(results.rate_hz), list(results)[:2]
    (18000, 50, ['gyro_x', 'gyro_y'])
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

    @property
    def rate_hz(self) -> float:
        """Sample rate in Hz."""
        return 1.0 / self.tau0

    @property
    def verdict(self) -> Verdict:
        """Whether the IMU is healthy, why, and what to do next."""
        from .verdict import verdict_of

        return verdict_of(self)

    @property
    def noise(self) -> dict[str, Mapping[str, Coefficient]]:
        """The coefficients: axis -> term -> Coefficient."""
        return {name: axis.fit.noise for name, axis in self.axes.items()}

    @property
    def measured(self) -> Run:
        """The coefficients and the curve of each axis, as `core.compare.differences` takes them."""
        return {
            name: Measured(
                axis.fit.noise,
                None if (c := axis.curve) is None else DeviationCurve(c.tau, *c.limits),
            )
            for name, axis in self.axes.items()
        }

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The comparisons with the datasheet and with the earlier runs.

        The deviations of an axis are tested too; the largest excess is among the comparisons if no
        coefficient of the axis exceeds the earlier run.
        """
        found = list(self.datasheet.comparisons) if self.datasheet else []
        pairs = [(earlier.measured, self.measured) for earlier in self.baselines.values()]
        for name, of_run in zip(self.baselines, differences(pairs)):
            known = [c for d in of_run if (c := d.against(name, self.margin)) is not None]
            found += [c for c in known if c.tau is None]
            explained = {c.axis for c in found if c.reference == name and c.verdict == 'beyond'}
            excess: dict[str, Comparison] = {}
            for c in sorted(known, key=lambda c: c.at_least):
                if c.tau is not None and c.verdict == 'beyond' and c.axis not in explained:
                    excess[c.axis] = c
            found += excess.values()
        return tuple(found)

    def __getitem__(self, axis: str) -> AxisResult:
        try:
            return self.axes[axis]
        except KeyError:
            raise AllanError(
                f'there is no axis {axis!r}: choose one of {", ".join(self.axes)}'
            ) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.axes)

    def __contains__(self, axis: object) -> bool:
        return axis in self.axes

    def __repr__(self) -> str:
        from .summary import summary_text

        return summary_text(self)

    def _repr_html_(self) -> str:
        from .summary import summary_html

        return summary_html(self)

    def table(self, units: str = 'datasheet') -> Any:
        """Return all coefficients, one row each.

        Parameters
        ----------
        units : 'datasheet' or 'si'

        Returns
        -------
        pandas.DataFrame or list of dict
            With axis, term, value, ci95_low, ci95_high, upper95, unit. A DataFrame if pandas is
            installed.
        """
        from .summary import table_rows

        rows = table_rows(self, units)
        try:
            import pandas
        except ImportError:
            return rows
        return pandas.DataFrame(rows)

    def plot(self, what: str = 'gyro', ax: Any = None, units: str = 'datasheet') -> Any:
        """Draw the Allan deviation with its limits and the fit.

        Parameters
        ----------
        what : str
            'gyro' or 'accel' for all axes of a sensor, or the name of an axis.
        ax : matplotlib Axes, optional
            Where to draw; without it a figure with a panel for each axis is made.
        units : 'datasheet' or 'si'

        Returns
        -------
        matplotlib Axes or Figure
            The axes that were given, or the figure that was made.
        """
        from .plots import draw_axes, sensor_figure

        names = [name for name in self.axes if what in (name, sensor_of(name))]
        if not names:
            raise AllanError(f'there is no {what!r}: choose one of {", ".join(self.axes)}')
        if ax is None:
            return sensor_figure(
                replace(self, axes={n: self.axes[n] for n in names}),
                sensor_of(names[0]),
                units=units,
            )
        draw_axes(ax, {name: self.axes[name] for name in names}, units)
        return ax

    def export(
        self, target: str, path: str | os.PathLike[str] | None = None, **options: Any
    ) -> str:
        """Return the file of a filter or simulator as text, and write it if a path is given.

        Parameters
        ----------
        target : str
            A name of `io.exporters.TARGETS`, such as 'kalibr'.
        path : path, optional
            File to write, or the folder to write it into.
        **options
            Fields of `io.exporters.ExportOptions`, such as ``inflate=2``.
        """
        from .exporters import ExportOptions, make_export, target_of
        from .files import write_atomic

        text = make_export(self, target, ExportOptions(**options)).text
        if path is not None:
            place = Path(path)
            write_atomic(place / target_of(target).file_name if place.is_dir() else place, text)
        return text

    def save(self, folder: str | os.PathLike[str], **options: Any) -> list[Path]:
        """Write the files that `allan analyze -o` writes, and return their paths.

        Parameters
        ----------
        folder : path
        **options
            As of `io.result_files.write_result_files`: ``units``, ``targets``, ``pictures`` ...
        """
        from .result_files import write_result_files

        return write_result_files(folder, self, **options)[1]

    def check(
        self,
        sensor: Datasheet | str = '',
        baseline: Results | str | os.PathLike[str] = '',
        margin: float = MARGIN,
    ) -> Verdict:
        """Return whether the IMU is as good as its datasheet and as it was before.

        Parameters
        ----------
        sensor : str or Datasheet
            A name of `allan sensors`, or the path of a .yaml file.
        baseline : Results or path
            An earlier run: results, a document, or the folder of an analysis.
        margin : float
            Fraction by which a complete interval must exceed the datasheet or the earlier run.

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
        margin: float = MARGIN,
    ) -> Results:
        """Return the same, compared with a datasheet and an earlier run, as `check` does."""
        from .documents import labels_of, load

        results = replace(self, margin=margin)
        if isinstance(baseline, Results):
            results = replace(results, baselines={'the earlier run': baseline})
        elif str(baseline):
            (label,) = labels_of([str(baseline)])
            results = replace(results, baselines={label: load(baseline)})
        if not sensor:
            return results
        sheet = sensor if isinstance(sensor, Datasheet) else load_sensor(sensor)
        return results.against_datasheet(sheet, margin)

    def against_datasheet(self, datasheet: Datasheet, margin: float) -> Results:
        """Return the same with the comparison with a datasheet, and a finding for each excess."""
        comparison = against_datasheet(self.noise, datasheet, margin)
        found = datasheet_findings(self.noise, comparison)
        return replace(self, datasheet=comparison, margin=margin, findings=(*self.findings, *found))


def analyse_recorded(recorded: RecordingSums, method: str = 'gls') -> Results:
    """Fit the sums of one IMU and return the results.

    Raises
    ------
    AllanError
        When there is too little data to compute anything.
    """
    skip = recorded.provenance.settings.get('skip', AUTO)
    settle = isinstance(skip, (int, float)) and skip < 0.0
    fitted = [fit_stationary(s, method, settle) for s in recorded.sums]
    sums, fits = [s for s, _ in fitted], [fit for _, fit in fitted]
    curves = [allan_curve(s) for s in sums]
    axes = dict(_axis_results(zip(recorded.sums, curves, fits)))
    longest = max(sums, key=lambda s: s.samples)
    tau0 = longest.tau0 or float('nan')
    findings = (
        *recorded.provenance.findings,
        *(f for s in sums for f in sums_findings(s)),
        *(f for fit in fits for f in fit.findings),
    )
    return Results(
        longest.identity,
        method,
        tau0,
        longest.samples,
        longest.samples * tau0,
        longest.segment_count,
        {name: axes[name] for name in AXES if name in axes},
        recorded.provenance,
        tuple(dict.fromkeys(findings)),
        recorded=recorded,
    )


def analyse_sums(sums: Sequence[AllanSums], provenance: Provenance, method: str = 'gls') -> Results:
    """Fit the sums of one IMU, as `analyse_recorded` does.

    Parameters
    ----------
    sums : sequence of AllanSums
        One with all axes, or one for each sensor when they have different rates.
    provenance : Provenance
    method : str
        One of `core.fit.METHODS`.
    """
    return analyse_recorded(RecordingSums('', tuple(sums), provenance), method)


def _axis_results(
    fitted: Iterable[tuple[AllanSums, AllanCurve, NoiseModel]],
) -> Iterable[tuple[str, AxisResult]]:
    for sums, curve, fit in fitted:
        means = np.array([one.mean for one in sums.history.recordings])
        for i, name in enumerate(curve.axes):
            variance = sample_variance(curve.m, curve.adev[:, i], fit.tau0)
            white = (fit.axes[name].noise['N'].value or 0.0) ** 2 / fit.tau0
            yield (
                name,
                AxisResult(
                    fit.tau0,
                    fit.axes[name],
                    AxisCurve(
                        curve.m,
                        curve.tau,
                        curve.n,
                        curve.adev[:, i],
                        curve.ci_low[:, i],
                        curve.ci_high[:, i],
                    ),
                    tuple(read_curve(curve, name, fit.axes[name])),
                    None if variance is None else math.sqrt(variance),
                    name,
                    rounding_step(sums.segments[0].phase[:, i], white) if sums.segments else None,
                    turn_on_bias(means[:, i]) if len(means) else None,
                ),
            )
