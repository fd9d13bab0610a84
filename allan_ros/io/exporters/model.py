# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`FilterNoise`: the levels of one IMU for one target, each number with its origin in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from ...core.errors import AllanError
from ...core.filters.noise_parameters import (
    AxisReduction,
    Level,
    SensorLevel,
    axis_level,
    midpoint_white_std,
    reduce_axis,
    sensor_level,
    white_std,
)
from ...core.filters.reductions import Horizons, States, closest_process, common_correlation_time
from ...core.findings import Finding, finding
from ...core.imu import AXES, SENSORS, SI_UNITS, UNITS, sensor_of
from ...core.noise import ProcessModel
from ..axis_result import AxisResult
from ..format import LIMIT_DIGITS, VALUE_DIGITS, significant
from ..results import Results
from .convention import Convention, Entry
from .options import AXIS_RULE, ExportOptions

DIGITS = 6
"""Significant digits written: two more than any interval is known to."""


class Quantity(NamedTuple):
    """Form in which a target takes N and K.

    Attributes
    ----------
    formula : str
        Template of the formula in words, of the term and ''.
    unit : str
        Template of the unit, of the unit of the density and that of the std per sample.
    convert : callable
        From the density and the rate in Hz to the number.
    """

    formula: str
    unit: str
    convert: Callable[[float, float], float]


QUANTITIES = {
    'density': Quantity('', '{density}', lambda value, rate: value),
    'std': Quantity('{term} sqrt(f)', '{std}', white_std),
    'midpoint': Quantity('N sqrt(2 f)', '{std}', midpoint_white_std),
    'variance': Quantity('{term}^2 f', '({std})^2', lambda value, rate: value**2 * rate),
    'step_variance': Quantity('{term}^2 / f', '({bias})^2', lambda value, rate: value**2 / rate),
    'covariance': Quantity('{term}^2', '({density})^2', lambda value, rate: value**2),
}
"""See `allan_ros.core.filters.noise_parameters` for which filter takes which."""

KeyedTerms = Mapping[str, tuple[str, str]]
"""Key of a file -> the sensor and the term it holds."""


@dataclass(frozen=True)
class SensorProcess:
    """First-order Gauss-Markov bias of a sensor.

    Attributes
    ----------
    sigma, tau : (x, y, z)
        Standard deviation in SI, including the inflation; correlation time in s.
    words : str
        Origin of the numbers.
    findings : tuple of Finding
    """

    sigma: tuple[float, float, float]
    tau: tuple[float, float, float]
    words: str
    findings: tuple[Finding, ...] = ()


def rounded(value: float) -> float:
    """Return the value with the digits that are written."""
    return float(f'{value:.{DIGITS}g}')


class FilterNoise:
    """The noise of one IMU, with one set of options, for one target.

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
    horizons : Horizons
        Range over which a reduction holds.

    Raises
    ------
    AllanError
        When an option does not fit the target.
    """

    def __init__(self, results: Results, options: ExportOptions, convention: Convention) -> None:
        if options.exact and not convention.exact:
            raise AllanError('exact is for vins_fusion only: leave --exact out')
        if options.axis == 'each' and not convention.three:
            raise AllanError('this file takes one number a sensor: choose --axis worst or mean')
        if not 0.0 < results.tau0 < math.inf:
            raise AllanError('these results have no sample rate: record longer, or analyse again')
        self.results = results
        self.options = options
        self.convention = convention
        self.rule = options.axis or ('each' if convention.three else AXIS_RULE)
        self.rate, self.rate_words = _rate(results, options, convention)
        self.horizons = Horizons.up_to(options.horizon or convention.horizon_s)
        self._used: dict[str, AxisReduction] = {}

    # --- N and K ----------------------------------------------------------------------------------

    def keyed(
        self, keys: KeyedTerms, quantity: str = 'density', parent: tuple[str, ...] = ()
    ) -> Iterator[Entry]:
        """Yield an entry for each key: three numbers where the target takes them, else one.

        Parameters
        ----------
        keys : mapping of key to (sensor, term)
        quantity : str
            One of `QUANTITIES`, or a unit of the density.
        parent : tuple of str
            The mappings that contain the keys.

        Raises
        ------
        AllanError
            When the sensor is absent, or an axis has neither value nor limit.
        """
        for key, (sensor, term) in keys.items():
            one = QUANTITIES.get(quantity)
            units = SI_UNITS[sensor]
            if one is None:
                factor, formula, unit = UNITS[quantity].factor, '', quantity
                convert = _divided(factor)
            else:
                formula = one.formula.format(term=term)
                unit = one.unit.format(
                    density=units[term], std=units['B' if term == 'N' else 'R'], bias=units['B']
                )
                convert = one.convert
            yield self.entry((*parent, key), self.level(sensor, term), formula, unit, convert)

    def entry(
        self,
        path: tuple[str, ...],
        level: SensorLevel,
        formula: str,
        unit: str,
        convert: Callable[[float, float], float],
    ) -> Entry:
        """Return the entry of a level, with its formula, unit and axes in words."""
        values = [rounded(convert(value, self.rate)) for value in level.values]
        equals = f' = {formula}' if formula else ''
        words = f'[{unit}]{equals}: {"; ".join(map(level_words, level.levels))}'
        is_limit = any(one.is_limit for one in level.levels)
        return Entry(path, values if self.convention.three else values[0], words, is_limit)

    def level(self, sensor: str, term: str) -> SensorLevel:
        """Return the level of a term of a sensor; N and K are those of the reduction.

        Raises
        ------
        AllanError
            When the sensor is absent, or an axis has neither value nor limit.
        """
        levels = [self._axis_level(axis, term) for axis in self.axes_of(sensor)]
        return sensor_level(levels, self.rule, self.options.inflate)

    def axes_of(self, sensor: str) -> Mapping[str, AxisResult]:
        """Return the three axes of a sensor.

        Raises
        ------
        AllanError
            When the sensor is absent.
        """
        names = AXES[SENSORS[sensor]]
        if not all(name in self.results.axes for name in names):
            raise AllanError(f'no {sensor} in these results: this file needs gyro and accel')
        return {name: self.results.axes[name] for name in names}

    def reduction(
        self, axis: str, states: States = 'walk', expect_walk: bool = False
    ) -> AxisReduction:
        """Return the reduction of one axis over the horizons of the file."""
        fit = self.results.axes[axis].fit
        return reduce_axis(axis, fit, states, self.horizons, self.options.strict, expect_walk)

    def _axis_level(self, axis: str, term: str) -> Level:
        reduces = term == 'K' or (term == 'N' and self.convention.walk)
        if self.options.fidelity == 'coefficients' or not reduces:
            return axis_level(axis, self.results.axes[axis].fit, term, self.options.strict)
        if axis not in self._used:
            self._used[axis] = self.reduction(axis)
        white, walk = self._used[axis].white, self._used[axis].walk
        assert walk is not None
        return white if term == 'N' else walk

    # --- Gauss-Markov bias ------------------------------------------------------------------------

    def process(self, sensor: str, common: bool = False) -> SensorProcess:
        """Return the Gauss-Markov bias of a sensor.

        Parameters
        ----------
        sensor : str
        common : bool
            Whether the file has one correlation time for all sensors.

        Raises
        ------
        AllanError
            When the sensor is absent, or an axis has neither value nor limit.
        """
        names = list(self.axes_of(sensor))
        tau = self.common_tau if common or self.rule != 'each' else None
        pairs = [self._closest(name, tau) for name in names]
        sigmas, taus = zip(*pairs)
        levels = [Level(name, 'sigma', sigma) for name, sigma in zip(names, sigmas)]
        sigma = sensor_level(levels, self.rule, self.options.inflate).values
        fitted = [name for name in names if self.results.axes[name].fit.selected.gauss_markov]
        unit = SI_UNITS[sensor]['B']
        described = '; '.join(
            f'{name} {significant(s, VALUE_DIGITS)} {unit}, {t:.4g} s'
            for name, (s, t) in zip(names, pairs)
        )
        bounds = 'bounds' if self.convention.bound else 'follows'
        words = f'sigma and correlation time whose growth {bounds} that of the model: {described}'
        others = tuple(name for name in names if name not in fitted)
        said = finding('export_no_gauss_markov', others, horizons=self.horizons)
        return SensorProcess(sigma, (taus[0], taus[1], taus[2]), words, (said,) if others else ())

    @cached_property
    def common_tau(self) -> float:
        """The correlation time in s that suits all axes."""
        models = [self._drifting(name) for name in self.results.axes]
        tau = common_correlation_time(models, self.horizons)
        assert tau is not None  # every model drifts
        return tau

    def _drifting(self, axis: str) -> ProcessModel:
        return self.reduction(axis, 'processes').reduction.model()

    def _closest(self, axis: str, tau: float | None) -> tuple[float, float]:
        fit = self.results.axes[axis].fit
        model = fit.selected if fit.selected.gauss_markov else self._drifting(axis)
        (pair,) = closest_process(model, self.horizons, tau, self.convention.bound)
        return pair

    # --- the header -------------------------------------------------------------------------------

    def reduction_lines(self) -> list[str]:
        """Return what the header says about the reduction of N and K."""
        if self.options.fidelity == 'coefficients':
            return ['fidelity: bare coefficients; N and K alone underestimate flicker and drift']
        if not self._used:
            return []
        ratios = [one.reduction.ratio for one in self._used.values()]
        low, high = min(r[0] for r in ratios), max(r[1] for r in ratios)
        return [
            f'reduction: N and K bound the error growth of the complete model over '
            f'{self.horizons}; predicted over model growth {low:.2f} to {high:.2f}'
        ]

    def reduction_findings(self) -> list[Finding]:
        """Return a warning for the axes that N and K cannot describe."""
        poor = {
            axis: one.reduction.ratio[1]
            for axis, one in self._used.items()
            if one.reduction.poor or self.results.axes[axis].fit.selected.gauss_markov
        }
        if not poor:
            return []
        return [
            finding(
                'export_two_numbers',
                tuple(poor),
                horizons=self.horizons,
                ratio=max(poor.values()),
            )
        ]


def level_words(level: Level) -> str:
    """Return the axis of a number, its measured value and its interval, in SI."""
    unit = SI_UNITS[sensor_of(level.axis)]['B' if level.term == 'sigma' else level.term]
    words = f'{level.term} of {level.axis}'
    if level.is_limit:
        limit = significant(level.value, LIMIT_DIGITS)
        return f'{words} not observable, 95 % upper limit {limit} {unit}'
    words += f' {significant(level.value, VALUE_DIGITS)} {unit}'
    if level.raised_from is not None:
        measured = significant(level.raised_from, VALUE_DIGITS) if level.raised_from else 'none'
        return f'{words}, raised from {measured} to cover the other terms'
    if level.ci95 is None:
        return f'{words}, no interval'
    low, high = (significant(end, VALUE_DIGITS) for end in level.ci95)
    return f'{words}, 95 % interval {low} .. {high}'


def clamped(entry: Entry, low: float, high: float) -> Entry:
    """Return the entry with its number within the range that the target accepts."""
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


def _divided(factor: float) -> Callable[[float, float], float]:
    return lambda value, rate: value / factor


def _rate(results: Results, options: ExportOptions, convention: Convention) -> tuple[float, str]:
    if options.filter_rate:
        return options.filter_rate, 'given as the rate of the filter'
    if convention.rate_hz:
        return rounded(convention.rate_hz), "the filter's own step"
    return rounded(results.rate_hz), 'that of the recording'
