# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Results`: the coefficients, curves and findings of one analysis, as plain data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeVar

from ..core.check import MARGIN, AxisNoise, Check, Run, differences, worst_verdict
from ..core.errors import AllanError
from ..core.estimate import Estimate
from ..core.findings import Finding
from ..core.fit.fit_findings import TOO_SHORT_S, longest_recommended, recommended_duration
from ..core.fit.result import TemperatureModel
from ..core.imu import ImuIdentity, sensor_of
from ..core.settings import check_range, expect
from ..readers.recording_sums import Provenance, RecordingSums
from .axis_result import AxisResult
from .datasheets import Datasheet, against_datasheet, below_typical, exceeds_limit

if TYPE_CHECKING:
    from ..core.filters.motion_factors import NoiseInMotion

R = TypeVar('R', bound='Results')

Level = Literal['healthy', 'attention', 'measured', 'unknown', 'failed']

SENSOR_FAULTS = ('no_noise', 'sensor_all_zero')
"""Ids of findings that indicate a broken sensor."""

WRONG_UNITS = ('gyro_unit', 'gyro_unit_changed', 'accel_unit')
"""Ids of findings about a wrong unit of measurement. With such a finding, a comparison with limits
says nothing about the sensor."""

MOTION_MEASURED = ('error_in_motion', 'motion_as_at_rest')
"""Ids of the findings that state the ratio of the errors in motion to the predicted errors."""

UNSUITABLE = ('sensors_exchanged', 'not_noise', 'not_settled')
"""Ids of findings about data that do not show the noise of the sensor at rest, or show
the noise of the other sensor."""


@dataclass(frozen=True)
class Results:
    """The results of one analysis of one IMU.

    ``results['gyro_z']`` is the `AxisResult` of an axis, and iteration yields the names of the
    axes. If `allan_ros.analyze` or `allan_ros.load` returned the results, ``str(results)`` is a
    summary.

    Attributes
    ----------
    identity : ImuIdentity
        The frame_id and the serial number of the IMU.
    method : str
        Method of the fit: 'likelihood' or 'paper'; 'datasheet' or 'truth' for noise that was not
        measured.
    tau0, duration_s : float
        Sample period, and total time of all used samples, in s. If gyro and accelerometer have
        different rates, these numbers describe the sensor with more samples.
    samples, segments : int
        Number of used samples, and number of segments without gaps or motion, of the sensor that
        ``tau0`` describes.
    axes : mapping of axis name to AxisResult
        The measured axes: gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z, if present.
    provenance : Provenance
        The recordings, their longest segments, counts of samples, and the settings.
    findings : tuple of Finding
        Messages about the recording, the fit, the errors in motion, and the comparison with a
        datasheet.
    datasheet : Datasheet or None
        The datasheet with which the coefficients are compared; None if there is none.
    baselines : mapping of name to Results
        Results of earlier recordings of this IMU, with which these results are compared.
    margin : float
        Fraction by which a coefficient may exceed a limit: the limit of the datasheet, or the
        coefficient in an earlier result. The limit of the datasheet is exceeded if the complete
        95 % interval of the coefficient lies above limit * (1 + margin). An earlier coefficient is
        exceeded if the new coefficient is significantly higher, and the complete 95 % interval of
        the ratio of the new to the earlier coefficient lies above 1 + margin.
    motion : NoiseInMotion or None
        Errors in motion relative to the prediction from the noise at rest; None if the recordings
        have too few drives between two rests, or if the noise at rest is not known well enough.
    recorded : RecordingSums or None
        The Allan sums to which the coefficients were fitted; None if the sums are unknown, for
        example if only a results.json was read.

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
    >>> checked.comparisons[0].quantity, checked.comparisons[0].verdict
    ('N', 'within')
    >>> results.export('kalibr').splitlines()[-1]
    'update_rate: 50.0'
    >>> again = results.against_datasheet(checked.datasheet, margin=0.2)
    >>> again.comparisons == checked.comparisons == checked.datasheet_checks
    True
    >>> results.measured['gyro_x'].curve is results['gyro_x'].curve
    True
    >>> results.temperature_models  # no temperature was recorded
    {}
    >>> results.level, results.is_measured, results.is_too_short, checked.is_decided
    ('measured', True, False, True)
    >>> results.time_to_record  # in s, and the terms for which it is recommended
    (14400.0, ('B', 'K'))
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
    datasheet: Datasheet | None = None
    baselines: Mapping[str, Results] = field(default_factory=dict, repr=False, compare=False)
    margin: float = field(default=MARGIN, repr=False, compare=False)
    recorded: RecordingSums | None = field(default=None, repr=False, compare=False)
    motion: NoiseInMotion | None = None

    @property
    def rate_hz(self) -> float:
        """Sample rate in Hz."""
        return 1.0 / self.tau0

    @property
    def is_measured(self) -> bool:
        """Whether any coefficient of any axis is resolved."""
        return any(c.resolved for axis in self.axes.values() for c in axis.fit.noise.values())

    @property
    def is_too_short(self) -> bool:
        """Whether no coefficient is resolved, or the data at rest last less than 20 s."""
        return not self.is_measured or self.duration_s < TOO_SHORT_S

    @cached_property
    def level(self) -> Level:
        """The verdict on the IMU: 'failed', 'unknown', 'measured', 'attention' or 'healthy'.

        The first of these conditions that holds determines the verdict: 'failed' for a broken
        sensor; 'unknown' for too little data, a wrong unit of measurement, exchanged sensors, or a
        recording of motion or of a warm-up; 'failed' for an exceeded limit; 'unknown' for another
        error, or if `is_decided` is False; 'measured' if no coefficient is compared with a
        datasheet or an earlier result; 'attention' for a warning; else 'healthy'.
        """
        ids = {finding.id for finding in self.findings}
        severities = {finding.severity for finding in self.findings}
        if ids & {*SENSOR_FAULTS}:
            return 'failed'
        if self.is_too_short or ids & {*WRONG_UNITS, *UNSUITABLE}:
            return 'unknown'
        if worst_verdict(self.comparisons) == 'exceeds':
            return 'failed'
        if 'error' in severities or not self.is_decided:
            return 'unknown'
        if not self.comparisons:
            return 'measured'
        return 'attention' if 'warning' in severities else 'healthy'

    @property
    def is_decided(self) -> bool:
        """Whether N or, if N has no limit, every compared term is within all its limits.

        If N has a limit, the other terms are ignored, because they often need a longer recording.
        True if nothing is compared.
        """
        required = [c for c in self.comparisons if c.quantity == 'N'] or self.comparisons
        return all(c.verdict == 'within' for c in required)

    @property
    def time_to_record(self) -> tuple[float, tuple[str, ...]] | None:
        """The recommended length of a recording in s, and the terms for which it is recommended.

        The longer recording is expected to resolve each of these terms, or to show that the term is
        too small to matter. None if no longer recording of at most 24 hours is recommended, or if
        the method is not 'likelihood'.
        """
        if self.method != 'likelihood':
            return None
        longest = max((s.duration_s for s in self.provenance.segments), default=0.0)
        limits: dict[str, dict[str, float]] = {}
        for c in self.datasheet_checks:
            limits.setdefault(c.axis, {})[c.quantity] = c.limit
        return longest_recommended(
            recommended_duration(axis.fit, longest or self.duration_s, limits.get(name))
            for name, axis in self.axes.items()
        )

    @property
    def noise(self) -> dict[str, Mapping[str, Estimate]]:
        """The coefficients in SI: axis -> term -> Estimate.

        Unlike `AxisResult.quantity`, the estimates contain the values of terms that are not
        resolved, and have no name, unit and axis.
        """
        return {name: axis.fit.noise for name, axis in self.axes.items()}

    @property
    def measured(self) -> Run:
        """The coefficients and the curve of each axis, for a comparison with other recordings."""
        return {name: AxisNoise(axis.fit.noise, axis.curve) for name, axis in self.axes.items()}

    @property
    def temperature_models(self) -> dict[str, dict[str, TemperatureModel]]:
        """The models of the bias over temperature: sensor -> axis -> model.

        Axes without a model are absent.
        """
        models: dict[str, dict[str, TemperatureModel]] = {}
        for name, axis in self.axes.items():
            if axis.temperature is not None:
                models.setdefault(sensor_of(name), {})[name] = axis.temperature
        return models

    @cached_property
    def datasheet_checks(self) -> tuple[Check, ...]:
        """The comparisons of all coefficients that have a limit in the datasheet, by axis and term.

        All verdicts are 'undecided' if the data at rest last less than 20 s.
        """
        sheet = self.datasheet
        checks = () if sheet is None else against_datasheet(self.noise, sheet, self.margin)
        return self._undecided_if_short(checks)

    @cached_property
    def comparisons(self) -> tuple[Check, ...]:
        """The comparisons of the coefficients with the datasheet and with the earlier results.

        Coefficients that could not be compared with an earlier result are absent. Allan deviations
        are compared with the earlier results, too. If an Allan deviation of an axis exceeds the
        earlier one although no coefficient of this axis does, the comparison of one such Allan
        deviation is included. All verdicts are 'undecided' if the data at rest last less than 20 s.
        """
        earlier_checks: list[Check] = []
        pairs = [(name, run.measured, self.measured) for name, run in self.baselines.items()]
        for name, checks in zip(self.baselines, differences(pairs)):
            limit_checks = [c for d in checks if (c := d.as_limit(self.margin)) is not None]
            earlier_checks += [c for c in limit_checks if c.tau is None]
            explained_axes = {
                c.axis for c in earlier_checks if c.reference == name and c.verdict == 'exceeds'
            }
            largest_excess: dict[str, Check] = {}
            for c in sorted(limit_checks, key=lambda c: c.at_least):
                if c.tau is not None and c.verdict == 'exceeds' and c.axis not in explained_axes:
                    largest_excess[c.axis] = c
            earlier_checks += largest_excess.values()
        return *self.datasheet_checks, *self._undecided_if_short(earlier_checks)

    def _undecided_if_short(self, checks: Sequence[Check]) -> tuple[Check, ...]:
        is_short = self.duration_s < TOO_SHORT_S
        return tuple(replace(c, verdict='undecided') if is_short else c for c in checks)

    def __getitem__(self, axis: str) -> AxisResult:
        try:
            return self.axes[axis]
        except (KeyError, TypeError):
            raise AllanError(
                f'there is no axis {axis!r}: choose one of {", ".join(self.axes)}'
            ) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.axes)

    def against_datasheet(self: R, datasheet: Datasheet, margin: float) -> R:
        """Return a copy of the results whose coefficients are compared with ``datasheet``.

        Earlier findings about limits are removed. A finding is added for each of the
        `datasheet_checks` with the verdict 'exceeds', and for each N that is implausibly small.
        ``margin`` is the fraction by which a coefficient may exceed its limit. Raises AllanError if
        ``datasheet`` is no `Datasheet`, such as a name, or ``margin`` is below 0 or not finite.
        """
        expect(Datasheet, 'a datasheet, such as allan_ros.sensor(name)', datasheet=datasheet)
        check_range(0.0, None, margin=margin)
        other_findings = (
            f for f in self.findings if f.id not in ('exceeds_limit', 'below_typical')
        )
        copy = replace(self, datasheet=datasheet, margin=margin)
        checks = copy.datasheet_checks
        excess_findings = [
            exceeds_limit(c, margin, (c.axis,)) for c in checks if c.verdict == 'exceeds'
        ]
        small_findings = [f for c in checks if (f := below_typical(c, (c.axis,))) is not None]
        return replace(copy, findings=(*other_findings, *excess_findings, *small_findings))
