# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Results`: the coefficients, curves and findings of one analysis, as plain data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

from ..core.compare import MARGIN, AxisNoise, Check, Run, differences
from ..core.errors import AllanError
from ..core.estimate import Estimate
from ..core.filters.motion_factors import NoiseInMotion
from ..core.findings import Finding
from ..core.fit.temperature import TemperatureModel
from ..core.imu import ImuIdentity, sensor_of
from ..readers.recorded import Provenance, RecordingSums
from .axis_result import AxisResult
from .datasheets import (
    Datasheet,
    DatasheetComparison,
    against_datasheet,
    below_typical,
    exceeds_limit,
)
from .verdict import TOO_SHORT_S, Level, level_of

R = TypeVar('R', bound='Results')


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
    motion : NoiseInMotion or None
        Errors in motion relative to the prediction from the noise at rest; None if the recordings
        have too few drives between two rests.
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
    >>> checked.comparisons[0].quantity, checked.comparisons[0].verdict
    ('N', 'within')
    >>> results.export('kalibr').splitlines()[-1]
    'update_rate: 50.0'
    >>> sheet = checked.datasheet.datasheet
    >>> results.against_datasheet(sheet, margin=0.2).comparisons == checked.comparisons
    True
    >>> results.measured['gyro_x'].curve is results['gyro_x'].curve
    True
    >>> results.temperature_models  # no temperature was recorded
    {}
    >>> results.level, results.undecided_if_short([])
    ('measured', ())
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
    motion: NoiseInMotion | None = None

    def __post_init__(self) -> None:
        if self.datasheet is not None:
            checks = self.undecided_if_short(self.datasheet.comparisons)
            object.__setattr__(self, 'datasheet', replace(self.datasheet, comparisons=checks))

    def undecided_if_short(self, comparisons: Sequence[Check]) -> tuple[Check, ...]:
        """Return the comparisons, with the verdict 'undecided' below `TOO_SHORT_S` of data at
        rest."""
        short = self.duration_s < TOO_SHORT_S
        return tuple(replace(c, verdict='undecided') if short else c for c in comparisons)

    @property
    def rate_hz(self) -> float:
        """Sample rate in Hz."""
        return 1.0 / self.tau0

    @cached_property
    def level(self) -> Level:
        """Whether the IMU is healthy."""
        return level_of(self)

    @property
    def noise(self) -> dict[str, Mapping[str, Estimate]]:
        """The coefficients in SI: axis -> term -> Estimate."""
        return {name: axis.fit.noise for name, axis in self.axes.items()}

    @property
    def measured(self) -> Run:
        """The coefficients and the curve of each axis, for comparing recordings."""
        return {name: AxisNoise(axis.fit.noise, axis.curve) for name, axis in self.axes.items()}

    @property
    def temperature_models(self) -> dict[str, dict[str, TemperatureModel]]:
        """The models of the bias over temperature: sensor -> axis -> model, if there are any."""
        found: dict[str, dict[str, TemperatureModel]] = {}
        for name, axis in self.axes.items():
            if axis.temperature is not None:
                found.setdefault(sensor_of(name), {})[name] = axis.temperature
        return found

    @cached_property
    def comparisons(self) -> tuple[Check, ...]:
        """The comparisons of the coefficients with the datasheet and with the earlier runs.

        Allan deviations are compared with the earlier runs, too. If a deviation of an axis exceeds
        an earlier run although none of its coefficients does, the largest such excess is included.
        """
        found = list(self.datasheet.comparisons) if self.datasheet else []
        pairs = [(name, run.measured, self.measured) for name, run in self.baselines.items()]
        for name, of_run in zip(self.baselines, differences(pairs)):
            known = [c for d in of_run if (c := d.as_limit(self.margin)) is not None]
            found += [c for c in known if c.tau is None]
            explained = {c.axis for c in found if c.reference == name and c.verdict == 'exceeds'}
            excess: dict[str, Check] = {}
            for c in sorted(known, key=lambda c: c.at_least):
                if c.tau is not None and c.verdict == 'exceeds' and c.axis not in explained:
                    excess[c.axis] = c
            found += excess.values()
        return self.undecided_if_short(found)

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
        """Return a copy that is compared with this datasheet instead of any earlier one.

        Each coefficient that exceeds its limit by more than the fraction ``margin`` adds a finding,
        and each N that is implausibly small.
        """
        others = (f for f in self.findings if f.id not in ('exceeds_limit', 'below_typical'))
        comparison = against_datasheet(self.noise, datasheet, margin)
        checks = self.undecided_if_short(comparison.comparisons)
        found = [exceeds_limit(c, margin, (c.axis,)) for c in checks if c.verdict == 'exceeds']
        quiet = [f for c in checks if (f := below_typical(c, (c.axis,))) is not None]
        findings = (*others, *found, *quiet)
        return replace(self, datasheet=comparison, margin=margin, findings=findings)
