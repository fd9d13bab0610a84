# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Results`: all that one analysis says, as the value every writer starts from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..core.allan.curve import AllanCurve, allan_curve
from ..core.allan.sums import AllanSums
from ..core.filters.noise_parameters import sample_variance
from ..core.findings import Finding
from ..core.fit import TERMS, AxisFit, NoiseModel
from ..core.fit.regions import Region, read_curve
from ..core.fit.settled import fit_settled
from ..core.imu import AXES, ImuIdentity
from ..core.noise import NoiseTerms, gauss_markov_avar, sinusoid_avar, term_avar
from ..core.settings import AUTO
from .datasheet_comparison import DatasheetComparison, against_datasheet, datasheet_findings
from .datasheets import Datasheet
from .recorded import Provenance, RecordingSums


@dataclass(frozen=True)
class AxisCurve:
    """The Allan deviation of one axis with its 68.3 % limits; all arrays are (factors,)."""

    m: NDArray[np.int64]
    tau: NDArray[np.float64]
    n: NDArray[np.int64]
    adev: NDArray[np.float64]
    ci_low: NDArray[np.float64]
    ci_high: NDArray[np.float64]


@dataclass(frozen=True)
class AxisResult:
    """What is known of one axis.

    Attributes
    ----------
    tau0 : float
        Its sample period in s.
    fit : AxisFit
    curve : AxisCurve or None
        None where only the coefficients were passed on.
    regions : tuple of Region
        Which noise rules in which range of tau.
    sample_std : float or None
        Standard deviation of the samples about their mean of up to a second, as measured.
    """

    tau0: float
    fit: AxisFit
    curve: AxisCurve | None = None
    regions: tuple[Region, ...] = ()
    sample_std: float | None = None

    def part_adev(self, m: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the deviation each of the five terms makes at factors m, (factors, 5), SI."""
        return np.sqrt(self._part_avar(m))

    def extra_adev(self, m: NDArray[np.int64]) -> dict[str, NDArray[np.float64]]:
        """Return the deviation of the Gauss-Markov noise and the sinusoid, where there are any."""
        drift, line = self.fit.gauss_markov, self.fit.sinusoid
        extras = {}
        if drift is not None:
            unit = gauss_markov_avar(m, drift.correlation_time / self.tau0)
            extras['Gauss-Markov'] = drift.sigma * np.sqrt(unit)
        if line is not None:
            unit = sinusoid_avar(m, line.frequency * self.tau0)
            extras['sinusoid'] = line.amplitude * np.sqrt(unit)
        return extras

    def total_adev(self, m: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the deviation of the fit at factors m, (factors,), SI.

        A ramp that is not observable is left out: its square would count its own scatter.
        """
        parts = self._part_avar(m)
        if self.fit.noise['R'].status != 'estimated':
            parts[:, TERMS.index('R')] = 0.0
        extras = sum(adev**2 for adev in self.extra_adev(m).values())
        total: NDArray[np.float64] = np.sqrt(parts.sum(axis=1) + extras)
        return total

    def _part_avar(self, m: NDArray[np.int64]) -> NDArray[np.float64]:
        values = {term: c.value or 0.0 for term, c in self.fit.noise.items()}
        return term_avar(m, self.tau0, NoiseTerms(**values))


@dataclass(frozen=True)
class Results:
    """One analysis of one IMU.

    Attributes
    ----------
    identity : ImuIdentity
    method : str
        How the curve was fitted.
    tau0, samples, duration_s, segments : float, int, float, int
        Sample period, samples, their time in all, and segments of the sensor with the most
        samples; an axis that ticks differently has its own tau0.
    axes : mapping of axis name to AxisResult
        In the order of `AXES`; an absent sensor is absent.
    provenance : Provenance
    findings : tuple of Finding
        Those of the provenance, then those of the fit and of the comparison.
    datasheet : DatasheetComparison or None
        The comparison with a datasheet, if one was named.
    recorded : RecordingSums or None
        The sums that were fitted; None for results that were read from a file.
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
    recorded: RecordingSums | None = field(default=None, repr=False, compare=False)

    @property
    def rate_hz(self) -> float:
        """Sample rate in Hz."""
        return 1.0 / self.tau0

    def against_datasheet(self, datasheet: Datasheet, margin: float) -> Results:
        """Return the same with the comparison with a datasheet, and a finding for each excess."""
        noise = {name: axis.fit.noise for name, axis in self.axes.items()}
        comparison = against_datasheet(noise, datasheet, margin)
        found = datasheet_findings(noise, comparison)
        return replace(self, datasheet=comparison, findings=(*self.findings, *found))


def analyse_recorded(recorded: RecordingSums, method: str = 'gls') -> Results:
    """Fit the sums of one IMU and return the results.

    Raises
    ------
    AllanError
        When there is too little data to compute anything.
    """
    skip = recorded.provenance.settings.get('skip', AUTO)
    settle = isinstance(skip, (int, float)) and skip < 0.0
    fitted = [fit_settled(s, method, settle) for s in recorded.sums]
    sums, fits = [s for s, _ in fitted], [fit for _, fit in fitted]
    curves = [allan_curve(s) for s in sums]
    axes = dict(_axis_results(zip(curves, fits)))
    longest = max(sums, key=lambda s: s.samples)
    tau0 = longest.tau0 or float('nan')
    findings = (*recorded.provenance.findings, *(f for fit in fits for f in fit.findings))
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
    fitted: Iterable[tuple[AllanCurve, NoiseModel]],
) -> Iterable[tuple[str, AxisResult]]:
    for curve, fit in fitted:
        for i, name in enumerate(curve.axes):
            variance = sample_variance(curve.m, curve.adev[:, i], fit.tau0)
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
                ),
            )
