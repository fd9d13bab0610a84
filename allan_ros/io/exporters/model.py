# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`FilterNoise`: the results as the exporters ask for them, every number with its words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from ...core.errors import AllanError
from ...core.filters.noise_parameters import (
    Level,
    SensorLevel,
    axis_level,
    bias_level,
    sensor_level,
)
from ...core.findings import finding
from ...core.imu import AXES, SENSORS, SI_UNITS, UNITS, sensor_of
from ..format import LIMIT_DIGITS, VALUE_DIGITS, significant
from ..results import Results
from .options import AXIS_RULE, ExportOptions
from .target import Entry, Target

DIGITS = 6
"""Significant digits written: two more than any interval is known to."""


def rounded(value: float) -> float:
    """Return the value with the digits that are written."""
    return float(f'{value:.{DIGITS}g}')


def _same(value: float) -> float:
    return value


class FilterNoise:
    """The noise of one IMU, under one set of options, for one target.

    Attributes
    ----------
    results : Results
    options : ExportOptions
    rule : str
        The axis rule in force.
    rate : float
        Rate in Hz at which the filter steps.
    rate_words : str
        Where that rate comes from.

    Raises
    ------
    AllanError
        When an option does not fit the target.
    """

    def __init__(self, results: Results, options: ExportOptions, target: Target) -> None:
        if options.exact and not target.exact:
            raise AllanError('exact is for vins_fusion only: leave --exact out')
        if options.axis == 'each' and not target.three:
            raise AllanError('this file takes one number a sensor: choose --axis worst or mean')
        if not 0.0 < results.tau0 < math.inf:
            raise AllanError('these results know no sample rate: record longer, or analyse anew')
        self.results = results
        self.options = options
        self.rule = options.axis or ('each' if target.three else AXIS_RULE)
        self.rate, self.rate_words = _rate(results, options, target)

    def number(
        self,
        path: tuple[str, ...],
        sensor: str,
        term: str,
        formula: str,
        unit: str,
        convert: Callable[[float], float] = _same,
    ) -> Entry:
        """Return the entry of one number that speaks for a sensor.

        Parameters
        ----------
        formula : str
            What ``convert`` does, in words; '' where it only changes the unit.
        unit : str
            That of the converted number.

        Raises
        ------
        AllanError
            When the sensor is absent, or an axis has neither value nor limit.
        """
        level = self.level(sensor, term)
        value = rounded(convert(level.values[0]))
        return Entry(path, value, self._words(level, formula, unit), _has_limit(level))

    def three(
        self,
        path: tuple[str, ...],
        sensor: str,
        term: str,
        formula: str,
        unit: str,
        convert: Callable[[float], float] = _same,
    ) -> Entry:
        """Return the entry of three numbers, of x, y and z; as `number`."""
        level = self.level(sensor, term)
        values = [rounded(convert(value)) for value in level.values]
        return Entry(path, values, self._words(level, formula, unit), _has_limit(level))

    def level(self, sensor: str, term: str) -> SensorLevel:
        """Return the level of a term of a sensor; ``term`` 'bias' is sigma, or else B.

        Raises
        ------
        AllanError
            When the sensor is absent, or an axis has neither value nor limit.
        """
        axes = AXES[SENSORS[sensor]]
        if not all(axis in self.results.axes for axis in axes):
            raise AllanError(f'no {sensor} in these results: this file needs gyro and accel')
        return sensor_level(
            [self._axis_level(axis, term) for axis in axes], self.rule, self.options.inflate
        )

    def _axis_level(self, axis: str, term: str) -> Level:
        fit, strict = self.results.axes[axis].fit, self.options.strict
        return (
            bias_level(axis, fit, strict) if term == 'bias' else axis_level(axis, fit, term, strict)
        )

    def _words(self, level: SensorLevel, formula: str, unit: str) -> str:
        equals = f' = {formula}' if formula else ''
        return f'[{unit}]{equals}: {"; ".join(level_words(one) for one in level.levels)}'


def level_words(level: Level) -> str:
    """Return which axis a number is of, its measured value and its interval, in SI."""
    unit = SI_UNITS[sensor_of(level.axis)]['B' if level.term == 'sigma' else level.term]
    words = f'{level.term} of {level.axis}'
    if level.is_limit:
        limit = significant(level.value, LIMIT_DIGITS)
        return f'{words} not observable, 95 % upper limit {limit} {unit}'
    words += f' {significant(level.value, VALUE_DIGITS)} {unit}'
    if level.ci95 is None:
        return f'{words}, no interval'
    low, high = (significant(end, VALUE_DIGITS) for end in level.ci95)
    return f'{words}, 95 % interval {low} .. {high}'


def clamped(entry: Entry, low: float, high: float) -> Entry:
    """Return the entry with its number within the range the target accepts, and said so."""
    assert isinstance(entry.value, float)
    value = min(max(entry.value, low), high)
    if value == entry.value:
        return entry
    said = finding(
        'export_clamped', key=entry.key, value=entry.value, low=low, high=high, written=value
    )
    return replace(
        entry,
        value=value,
        words=f'{entry.words}; {entry.value:g} lies outside [{low:g}, {high:g}]',
        findings=(*entry.findings, said),
    )


def in_unit(unit: str) -> Callable[[float], float]:
    """Return what converts an SI value into that unit."""
    factor = UNITS[unit].factor
    return lambda value: value / factor


def _has_limit(level: SensorLevel) -> bool:
    return any(one.is_limit for one in level.levels)


def _rate(results: Results, options: ExportOptions, target: Target) -> tuple[float, str]:
    if options.filter_rate:
        return options.filter_rate, 'given as the rate of the filter'
    if target.rate_hz:
        return rounded(target.rate_hz), "the filter's own step"
    return rounded(results.rate_hz), 'that of the recording'
