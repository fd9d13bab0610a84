# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compute the rows of an exported file: the noise of an IMU in the convention of a target.

Discrete-time noise
-------------------
N and K are continuous-time noise densities. A state estimator with the rate f needs discrete-time
noise. In one step of 1/f seconds, white noise must add N^2/f to the variance of the integral of the
samples, and a random walk must add K^2/f to the variance of the bias (N. Trawny, S. I. Roumeliotis,
Indirect Kalman Filter for 3D Attitude Estimation, University of Minnesota, 2005, eqs. 129, 130).
`NOTATIONS` lists the scalings that state estimators use.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from ..core.errors import AllanError
from ..core.estimate import LIMIT_DIGITS, VALUE_DIGITS, significant
from ..core.filters.noise_parameters import (
    FilterLevel,
    Reduction,
    States,
    axis_level,
    closest_process,
    horizon_text,
    reduce_axis,
)
from ..core.findings import Finding, finding
from ..core.imu import AXES, HOUR, SENSORS, SI_UNITS, UNITS, sensor_of
from ..core.noise import GaussMarkov, Part
from ..core.stream.drive_recorder import LEAST_DRIVES
from ..results.from_datasheet import FROM_DATASHEET
from ..results.results import UNSUITABLE
from .target import ExportOptions, Key, Row, Target

if TYPE_CHECKING:
    from ..results.axis_result import AxisResult
    from ..results.results import Results

FILE_DIGITS = 6
"""Number of significant digits in a file. Rounding errors are far smaller than 95 % intervals."""

REFUSED = ('gyro_unit', 'accel_unit', 'accel_scale', *UNSUITABLE)
"""Ids of findings with which no file is written without `--force`: the samples are not in SI units,
or the recording does not show the noise of the sensor."""

DEFAULT_TOPIC = '/imu0'
"""Topic that is written if the recording has no topic; from the examples of Kalibr."""


class Notation(NamedTuple):
    """Form of N or K in a configuration file: the number (level / factor)^power f^rate_power.

    The level is N or K in SI, and f is the rate of the state estimator in Hz. For example, a state
    estimator may expect the standard deviation s = N sqrt(f) of a sample. In a step of 1/f s, noise
    of this size adds (s / f)^2 = N^2/f to the variance of the integral.
    """

    # templates for the header of a file: {term} is N or K; {density}, {std} and {bias} are the
    # units of the term, of the standard deviation per sample, and of the bias
    formula: str
    unit: str
    power: float = 1.0
    rate_power: float = 0.0
    factor: float = 1.0  # SI value of one unit of the number

    def number(self, level: float, rate: float) -> float:
        """Return the number in the file, given N or K in SI (``level``) and the rate in Hz."""
        return float((level / self.factor) ** self.power * rate**self.rate_power)

    def level(self, number: float, rate: float) -> float:
        """Return N or K in SI, given the number in the file and the rate in Hz."""
        return float((number / rate**self.rate_power) ** (1.0 / self.power) * self.factor)


NOTATIONS = {
    'density': Notation('', '{density}'),
    'std': Notation('{term} sqrt(f)', '{std}', 1.0, 0.5),
    'variance': Notation('{term}^2 f', '({std})^2', 2.0, 1.0),
    'step_std': Notation('{term} / sqrt(f)', '{bias}', 1.0, -0.5),
    'covariance': Notation('{term}^2', '({density})^2', 2.0),
}
"""Name -> notation in which a state estimator expects N or K; `Key.unit` may be such a name."""


def notation_of(key: Key) -> Notation:
    """Return the notation in which N or K is written under a key."""
    return NOTATIONS.get(key.unit) or Notation('', key.unit, factor=UNITS[key.unit].factor)


def rounded(value: Any, digits: int = FILE_DIGITS) -> Any:
    """Return a number, or nested lists of numbers, rounded to ``digits`` significant digits."""
    if isinstance(value, (list, tuple)):
        return [rounded(each, digits) for each in value]
    return float(f'{value:.{digits}g}')


def noise_factors(results: Results, options: ExportOptions) -> Mapping[str, Mapping[str, float]]:
    """Return the factors by which N and K in a file are multiplied: sensor -> 'N' or 'K' -> factor.

    With ``options.motion``, these are the measured factors in motion, but at least 1. Otherwise,
    they are the factors in ``options.inflate``.

    Raises
    ------
    AllanError
        If ``options.motion`` is set and the results have no factors in motion.
    """
    if not options.motion:
        return {sensor: dict.fromkeys('NK', f) for sensor, f in options.factors.items()}
    if results.motion is None:
        raise AllanError(
            'motion: these results have no factor in motion; analyze a recording with at least '
            f'{LEAST_DRIVES} drives between rests',
            tuple(f for f in results.findings if f.id == 'motion_not_measured'),
        )
    factors = {sensor: {'N': 1.0, 'K': 1.0} for sensor in SENSORS}
    for sensor, sensor_in_motion in results.motion.sensors.items():
        factors[sensor] |= {
            term: max(f.value or 1.0, 1.0) for term, f in sensor_in_motion.term_factors.items()
        }
    return factors


class FilterNoise:
    """The noise of one IMU in the convention of one target, with one set of options.

    The constructor raises AllanError if the results have no sample rate, or if ``options.motion``
    is set and the results have no factors in motion. Unless ``options.force`` is set, it also
    raises AllanError if a finding in `REFUSED` is present. `rows` raises AllanError if the results
    lack an axis or a number that the file needs.

    Attributes
    ----------
    rate : float
        Rate of the state estimator in Hz.
    horizon : float
        Longest integration time in s over which N and K describe the error growth.
    bias : mapping of axis name to float
        Bias at rest in SI of each axis whose bias is known.
    factors : mapping of sensor to mapping of term to float
        'gyro' or 'accel' -> 'N' or 'K' -> factor by which the noise is multiplied. The factor of
        'K' also applies to R and to the other processes of the drift.
    used : dict of axis name to Reduction
        Reduced-order model with a random walk, of each axis for which it was computed.
    """

    def __init__(
        self,
        results: Results,
        options: ExportOptions,
        target: Target,
        bias: Mapping[str, float] = {},
    ) -> None:
        if not 0.0 < results.tau0 < math.inf:
            raise AllanError('these results have no sample rate: record longer, or analyze again')
        refused_findings = [each for each in results.findings if each.id in REFUSED]
        if refused_findings and not options.force:
            raise AllanError(
                'the numbers are wrong, so only `allan export --force`, or force=True in Python, '
                'writes them:',
                (refused_findings[0],),
            )
        self.results = results
        self.options = options
        self.target = target
        self.bias = bias
        self.rate, self.rate_words = rounded(results.rate_hz), 'the rate of the recording'
        if results.method == FROM_DATASHEET:
            self.rate_words = 'assumed: state it with --filter-rate'
        if options.filter_rate:
            self.rate, self.rate_words = options.filter_rate, 'given as the rate of the filter'
        elif target.rate_hz:
            self.rate, self.rate_words = rounded(target.rate_hz), 'the fixed rate of the filter'
        self.horizon = options.horizon or target.horizon_s
        self.factors = noise_factors(results, options)
        self.used: dict[str, Reduction] = {}

    def rows(self) -> list[Row]:
        """Return the rows of the exported file: each key with its value."""
        target = self.target
        rows = [self.row(key) for key in target.keys]
        rows += [Row((*target.parent, key), value) for key, value in target.fixed.items()]
        return rows + list(target.rows(self) if target.rows else ())

    def row(self, key: Key) -> Row:
        """Return the row of one key of the target."""
        path = (*self.target.parent, key.name)
        if key.what in ('N', 'K'):
            sensors = SENSORS if key.sensor == '-' else (key.sensor,)
            rows = [self.level_row(path, sensor, key.what, notation_of(key)) for sensor in sensors]
            row = max(rows, key=lambda each: max(each.values))
            return row if key.limits is None else clamped(row, *key.limits)
        if key.what == 'rate':
            return Row(path, self.rate)
        if key.what == 'topic':
            topics = (source.topic for source in self.results.provenance.sources)
            recorded = next((topic for topic in topics if topic), DEFAULT_TOPIC)
            return Row(path, self.options.topic or recorded)
        if key.what == 'common_tau':
            words = '[h]: one correlation time for all axes'
            return Row(path, rounded(self.common_tau / HOUR), words, 'h')
        return self._process_row(path, key)

    def level_row(self, path: tuple[str, ...], sensor: str, term: str, notation: Notation) -> Row:
        """Return the row of N, K or R of a sensor.

        The value of the row is the largest number of the three axes or, if the file has a number
        for each axis, the list of x, y and z.
        """
        units, factor = SI_UNITS[sensor], self.factors[sensor]['N' if term == 'N' else 'K']
        levels = [self.level(axis, term) for axis in self.axes_of(sensor)]
        if not self.target.three:
            levels = [max(levels, key=lambda level: level.value)]
        std_unit = units['B' if term == 'N' else 'R']
        unit = notation.unit.format(density=units[term], std=std_unit, bias=units['B'])
        formula = notation.formula.format(term=term)
        words = (
            f'[{unit}]{f" = {formula}" if formula else ""}: {"; ".join(map(level_words, levels))}'
        )
        values = [rounded(notation.number(factor * level.value, self.rate)) for level in levels]
        intervals = (level.interval for level in levels)
        widest_interval = max(
            intervals, key=lambda ends: ends[1] / ends[0] if ends[0] else math.inf
        )
        low, high = (notation.number(factor * end, self.rate) for end in widest_interval)
        value = values if self.target.three else values[0]
        return Row(path, value, words, unit, (low, high), tuple(levels))

    def level(self, axis: str, term: str) -> FilterLevel:
        """Return the noise level of a term of one axis that is written to the file.

        K, and N if the target models a random walk, come from the reduced-order model, unless the
        fidelity is 'coefficients'.
        """
        is_adjusted = term == 'K' or (term == 'N' and self.target.walk)
        if self.options.fidelity == 'coefficients' or not is_adjusted:
            return axis_level(axis, self.results.axes[axis].fit, term)
        return self.reduction(axis).levels[term]

    def _process_row(self, path: tuple[str, ...], key: Key) -> Row:
        """Return the row of a parameter of the Gauss-Markov processes of x, y and z.

        The parameter is sigma, tau or the driving density. The process of an axis replaces the
        drift of the axis, with a similar error growth up to the horizon (`closest_process`). If all
        axes have one correlation time, only sigma is chosen.
        """
        axes = self.axes_of(key.sensor)
        has_common_tau = any(other.what == 'common_tau' for other in self.target.keys)
        tau = self.common_tau if has_common_tau else None
        # axis whose model has no correlation time -> K from which the process is computed
        walk_levels, sigmas_and_taus = {}, []
        for name, axis in axes.items():
            model = axis.fit.model
            if not any(map(has_correlation_time, model.parts)):
                reduction = self.reduction(name, 'processes')
                model, walk_levels[name] = reduction.model, reduction.levels['K']
            pair = closest_process(model, GaussMarkov, self.horizon, tau, self.target.bound)
            assert pair is not None  # a process is found for every model with drift
            sigmas_and_taus.append(pair)
        taus = [pair[1] for pair in sigmas_and_taus]
        if key.what == 'tau':
            return Row(path, rounded(taus), '[s]', key.unit)
        factor = self.factors[key.sensor]['K'] / UNITS[key.unit].factor
        values = [factor * sigma for sigma, _ in sigmas_and_taus]
        formula = ''
        if key.what == 'driving':
            formula = ' = sigma sqrt(2 / tau)'
            values = [
                value * math.sqrt(2.0 / correlation_time)
                for value, correlation_time in zip(values, taus)
            ]
        si = SI_UNITS[key.sensor]['B']
        axis_texts = '; '.join(
            f'{name} {significant(s, VALUE_DIGITS)} {si}, {t:.4g} s{_origin(walk_levels.get(name))}'
            for name, (s, t) in zip(axes, sigmas_and_taus)
        )
        words = (
            f'[{key.unit}]{formula}: sigma and correlation time of the process whose error growth '
            f'{"bounds" if self.target.bound else "follows"} the growth of the model: {axis_texts}'
        )
        note = finding(
            'export_no_gauss_markov', tuple(walk_levels), horizons=horizon_text(self.horizon)
        )
        return Row(
            path,
            rounded(values),
            words,
            key.unit,
            levels=tuple(walk_levels.values()),
            findings=(note,) if walk_levels else (),
        )

    def axes_of(self, sensor: str) -> Mapping[str, AxisResult]:
        """Return axis -> result for the axes of a sensor; raise AllanError if one is missing."""
        names = AXES[SENSORS[sensor]]
        missing_axes = [name for name in names if name not in self.results.axes]
        if missing_axes:
            missing_text = sensor if len(missing_axes) == len(names) else ', '.join(missing_axes)
            raise AllanError(f'no {missing_text} in these results: this file needs gyro and accel')
        return {name: self.results.axes[name] for name in names}

    def reduction(self, axis: str, states: States = 'walk') -> Reduction:
        """Return the reduced-order model of one axis for a state estimator with bias ``states``."""
        reduced = reduce_axis(axis, self.results.axes[axis].fit, states, self.horizon)
        if states == 'walk':
            self.used[axis] = reduced
        return reduced

    def findings(self) -> list[Finding]:
        """Return a list with a warning if N and K cannot describe the error growth of some axis.

        Otherwise, the list is empty.
        """
        fits = {axis: self.results.axes[axis].fit for axis in self.used}
        poor_ratios = {
            axis: reduced.ratio[1]
            for axis, reduced in self.used.items()
            if reduced.poor or any(map(has_correlation_time, fits[axis].model.parts))
        }
        if not poor_ratios:
            return []
        horizons, largest_ratio = horizon_text(self.horizon), max(poor_ratios.values())
        return [
            finding(
                'export_two_numbers', tuple(poor_ratios), horizons=horizons, ratio=largest_ratio
            )
        ]

    @cached_property
    def common_tau(self) -> float:
        """Geometric mean, over the axes, of the correlation time in s that fits the drift best."""
        models = [self.reduction(name, 'processes').model for name in self.results.axes]
        sigmas_and_taus = (closest_process(model, GaussMarkov, self.horizon) for model in models)
        taus = [pair[1] for pair in sigmas_and_taus if pair]
        return math.exp(sum(math.log(tau) for tau in taus) / len(taus))


def has_correlation_time(part: Part) -> bool:
    """Return whether a part of a model is drift with a correlation time, unlike a random walk."""
    return bool(part.process.parameters) and part.process.is_drift and not part.process.is_line


def level_words(level: FilterLevel) -> str:
    """Return the term, axis, value and 95 % interval of a noise level as text, in SI."""
    estimate = level.estimate
    unit = SI_UNITS[sensor_of(estimate.axis)][estimate.name]
    words = f'{estimate.name} of {estimate.axis}'
    if level.is_limit:
        limit = significant(level.raised_from or level.value, LIMIT_DIGITS)
        words += f' not resolved, 95 % upper limit {limit} {unit}'
        return f'{words}, raised to cover the error growth' if level.raised_from else words
    words += f' {significant(level.value, VALUE_DIGITS)} {unit}'
    if estimate.ci95 is not None:
        low, high = (significant(end, VALUE_DIGITS) for end in estimate.ci95)
        words += f', 95 % interval {low}..{high}'
    elif level.raised_from is None:
        words += ', no 95 % interval'
    if level.raised_from:
        measured_text = significant(level.raised_from, VALUE_DIGITS)
        words += f', raised from {measured_text} to cover the error growth of the other terms'
    elif level.raised_from is not None:
        words += ', not resolved, set to cover the error growth of the other terms'
    return words


def _origin(walk: FilterLevel | None) -> str:
    """Return a note for a K that is an upper limit or has no interval; '' for any other K."""
    if walk is None or not (walk.is_limit or walk.no_interval):
        return ''
    return f' from {"the 95 % upper limit of K" if walk.is_limit else "K without an interval"}'


def clamped(row: Row, low: float, high: float) -> Row:
    """Return the row with its number limited to [low, high], and a finding if it was outside."""
    value = min(max(row.value, low), high)
    if value == row.value:
        return row
    numbers = {'value': row.value, 'low': low, 'high': high, 'written': value}
    note = finding('export_clamped', key=row.key, **numbers)
    words = f'{row.words}; {row.value:g} lies outside [{low:g}, {high:g}]'
    return replace(row, value=value, words=words, findings=(*row.findings, note))
