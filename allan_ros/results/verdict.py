# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The level of an IMU: whether it is healthy, and which recording would say more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Protocol

from ..core.compare import Check
from ..core.findings import Finding
from ..core.fit.record_length import longest_recommended, recommended_duration
from ..readers.recorded import Provenance
from .axis_result import AxisResult
from .datasheets import DatasheetComparison

Level = Literal['healthy', 'attention', 'measured', 'unknown', 'failed']

SENSOR_FAULTS = ('no_noise', 'sensor_all_zero')
"""Ids of findings that indicate a broken sensor."""

WRONG_UNITS = ('gyro_unit', 'gyro_unit_changed', 'accel_unit')
"""Ids of findings because of which a comparison is about the units and not about the sensor."""

UNSUITABLE = ('not_noise', 'not_settled')
"""Ids of findings because of which the numbers are not those of the sensor at rest."""

TOO_SHORT_S = 20.0
"""Time at rest in s below which no verdict is given."""


class Judged(Protocol):
    """Results on which a verdict is given, such as `allan_ros.results.results.Results`."""

    @property
    def method(self) -> str: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def axes(self) -> Mapping[str, AxisResult]: ...
    @property
    def provenance(self) -> Provenance: ...
    @property
    def findings(self) -> tuple[Finding, ...]: ...
    @property
    def datasheet(self) -> DatasheetComparison | None: ...
    @property
    def comparisons(self) -> tuple[Check, ...]: ...


def measured(results: Judged) -> bool:
    """Return whether any coefficient of any axis has a value."""
    return any(
        c.value is not None and c.status == 'estimated'
        for axis in results.axes.values()
        for c in axis.fit.noise.values()
    )


def level_of(results: Judged) -> Level:
    """Return the level of the IMU.

    'failed' for a broken sensor or an exceeded limit; 'unknown' for too little data, probably wrong
    units, a recording of motion or of a warm-up, another error, or no decided comparison;
    'measured' without a datasheet or earlier run to compare with; 'attention' for a warning.
    """
    comparisons = results.comparisons
    severities = {finding.severity for finding in results.findings}
    if {finding.id for finding in results.findings} & set(SENSOR_FAULTS):
        return 'failed'
    if too_short(results):
        return 'unknown'
    if {finding.id for finding in results.findings} & {*WRONG_UNITS, *UNSUITABLE}:
        return 'unknown'
    if 'exceeds' in {c.verdict for c in comparisons}:
        return 'failed'
    # without a limit of N, all other terms must be within; they often need a longer recording
    required = [c for c in comparisons if c.quantity == 'N'] or comparisons
    if 'error' in severities or any(c.verdict != 'within' for c in required):
        return 'unknown'
    if not comparisons:
        return 'measured'
    return 'attention' if 'warning' in severities else 'healthy'


def too_short(results: Judged) -> bool:
    """Return whether there is too little data at rest for a verdict."""
    return not measured(results) or results.duration_s < TOO_SHORT_S


def time_to_record(results: Judged) -> tuple[float, tuple[str, ...]] | None:
    """Return the recommended length of a recording in s and the terms that it resolves.

    None if the present length suffices, or the method is not 'likelihood'.
    """
    if results.method != 'likelihood':
        return None
    longest = max((s.duration_s for s in results.provenance.segments), default=0.0)
    limits: dict[str, dict[str, float]] = {}
    if results.datasheet is not None:
        for c in results.datasheet.comparisons:
            limits.setdefault(c.axis, {})[c.quantity] = c.limit
    return longest_recommended(
        recommended_duration(axis.fit, longest or results.duration_s, limits.get(name))
        for name, axis in results.axes.items()
    )
