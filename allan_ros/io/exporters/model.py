# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise of one IMU in the convention of one target, and the header comment of the file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from ... import __version__
from ...core.errors import AllanError, one_line
from ...core.filters.noise_parameters import (
    NOTATIONS,
    Notation,
    axis_level,
    reduce_axis,
    sensor_levels,
)
from ...core.filters.reductions import (
    Horizons,
    Level,
    Reduction,
    States,
    closest_process,
    common_correlation_time,
)
from ...core.findings import Finding, duration_text, finding
from ...core.imu import AXES, HOUR, SENSORS, SI_UNITS, UNITS, sensor_of
from ...core.noise import ProcessModel
from ..format import LIMIT_DIGITS, VALUE_DIGITS, significant
from . import AXIS_RULE, FROM_DATASHEET, ExportOptions, Key, Row, Target

if TYPE_CHECKING:
    from ..axis_result import AxisResult
    from ..results import Results

DIGITS = 6
"""Significant digits of numbers in a file, more than any interval justifies."""

UNITS_S = {'s': 1.0, 'h': HOUR}

WRONG_UNITS = ('gyro_unit', 'accel_unit', 'accel_scale')
"""Findings that the samples are not in SI units: no file is written without `--force`."""

DEFAULT_TOPIC = '/imu0'
"""Topic in files of recordings without a topic, as in the examples of Kalibr."""


class SensorProcess(NamedTuple):
    """First-order Gauss-Markov processes that model the bias of the axes x, y, z."""

    sigma: tuple[float, ...]  # standard deviations in SI, with the inflation
    tau: tuple[float, ...]  # correlation times in s
    words: str  # their origin, for the header comment
    findings: tuple[Finding, ...]
    # K of the axes without a fitted process, from which the process is computed
    levels: tuple[Level, ...]

    @property
    def driving(self) -> tuple[float, ...]:
        """Density sigma sqrt(2/tau) of the white noise that drives each process, in SI."""
        return tuple(sigma * math.sqrt(2.0 / tau) for sigma, tau in zip(self.sigma, self.tau))


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Return a number, or nested lists of numbers, rounded to ``digits`` significant digits."""
    if isinstance(value, (list, tuple)):
        return [rounded(each, digits) for each in value]
    return float(f'{value:.{digits}g}')


class FilterNoise:
    """The noise of one IMU in the convention of one target, with one set of options.

    The constructor raises AllanError if an option does not apply to the target. Every method raises
    it if a sensor is absent, or an axis has neither a value nor a limit.

    Attributes
    ----------
    rule : str
        How the axes of a sensor are combined: 'worst', 'mean' or 'each'.
    rate : float
        Rate of the filter in Hz.
    horizons : Horizons
        Integration times in s over which N and K describe the error growth.
    bias : mapping of axis name to float
        Bias at rest in SI, of axes of which it is known.
    """

    def __init__(
        self,
        results: Results,
        options: ExportOptions,
        target: Target,
        bias: Mapping[str, float] = {},
    ) -> None:
        if options.axis == 'each' and not target.three:
            raise AllanError('this file takes one number per sensor: choose --axis worst or mean')
        if not 0.0 < results.tau0 < math.inf:
            raise AllanError('these results have no sample rate: record longer, or analyze again')
        wrong = [each for each in results.findings if each.id in WRONG_UNITS]
        if wrong and not options.force:
            raise AllanError(
                f'{wrong[0]} Then analyze again; --force writes these numbers nevertheless.'
            )
        self.results = results
        self.options = options
        self.target = target
        self.bias = bias
        self.rule = options.axis or ('each' if target.three else AXIS_RULE)
        self.rate, self.rate_words = rounded(results.rate_hz), 'the rate of the recording'
        if results.method == FROM_DATASHEET:
            self.rate_words = 'assumed: state it with --filter-rate'
        if options.filter_rate:
            self.rate, self.rate_words = options.filter_rate, 'given as the rate of the filter'
        elif target.rate_hz:
            self.rate, self.rate_words = rounded(target.rate_hz), "the filter's own step"
        self.horizons = Horizons.up_to(options.horizon or target.horizon_s)
        self._reductions: dict[tuple[str, States], Reduction] = {}

    def rows(self) -> list[Row]:
        """Return the rows of the file."""
        target = self.target
        found = [self.row(key) for key in target.keys]
        found += [Row((*target.parent, key), value) for key, value in target.fixed.items()]
        return found + list(target.rows(self) if target.rows else ())

    def row(self, key: Key) -> Row:
        """Return the row of one key of the target."""
        path = (*self.target.parent, key.name)
        if key.what in ('N', 'K'):
            sensors = SENSORS if key.sensor == '-' else (key.sensor,)
            rows = [self.level_row(path, sensor, key.what, notation_of(key)) for sensor in sensors]
            row = max(rows, key=lambda one: max(one.values))
            return row if key.limits is None else clamped(row, *key.limits)
        if key.what == 'rate':
            return Row(path, self.rate)
        if key.what == 'topic':
            topics = (source.topic for source in self.results.provenance.sources)
            recorded = next((topic for topic in topics if topic), DEFAULT_TOPIC)
            return Row(path, self.options.topic or recorded)
        if key.what == 'common_tau':
            words = f'[{key.unit}]: one correlation time for all axes'
            return Row(path, rounded(self.common_tau / UNITS_S[key.unit]), words, key.unit)
        return self._process_row(path, key)

    def level_row(self, path: tuple[str, ...], sensor: str, term: str, notation: Notation) -> Row:
        """Return the row of N, K or R of a sensor, combined over its axes by `rule`."""
        units, inflate = SI_UNITS[sensor], self.options.inflate
        measured = [self.level(axis, term) for axis in self.axes_of(sensor)]
        levels = sensor_levels(measured, self.rule)
        named = measured if self.rule == 'mean' else levels
        std = units['B' if term == 'N' else 'R']
        unit = notation.unit.format(density=units[term], std=std, bias=units['B'])
        formula = notation.formula.format(term=term)
        words = (
            f'[{unit}]{f" = {formula}" if formula else ""}: {"; ".join(map(level_words, named))}'
        )
        values = [rounded(notation.number(inflate * one.value, self.rate)) for one in levels]
        values *= 3 // len(values) if self.target.three else 1
        widest = max((one.interval for one in levels), key=_width)
        low, high = (notation.number(inflate * end, self.rate) for end in widest)
        value = values if self.target.three else values[0]
        return Row(path, value, words, unit, (low, high), tuple(named))

    def level(self, axis: str, term: str) -> Level:
        """Return the noise level of a term of one axis.

        K, and N if the target models a random walk, are adjusted to the error growth of the
        complete model, unless `ExportOptions.fidelity` is 'coefficients'.
        """
        reduces = term == 'K' or (term == 'N' and self.target.walk)
        if self.options.fidelity == 'coefficients' or not reduces:
            return axis_level(axis, self.results.axes[axis].fit, term, self.options.strict)
        return self.reduction(axis).levels[term]

    def _process_row(self, path: tuple[str, ...], key: Key) -> Row:
        """Return the row of sigma, tau or the driving density of the Gauss-Markov bias."""
        bias = self.process(key.sensor)
        words, values = '[s]', bias.tau
        if key.what != 'tau':
            equals = ' = sigma sqrt(2 / tau)' if key.what == 'driving' else ''
            words = f'[{key.unit}]{equals}: {bias.words}'
            sigmas = bias.driving if equals else bias.sigma
            values = tuple(sigma / UNITS[key.unit].factor for sigma in sigmas)
        value = rounded(values if self.target.three else values[0])
        levels = () if key.what == 'tau' else bias.levels
        return Row(path, value, words, key.unit, levels=levels, findings=bias.findings)

    def axes_of(self, sensor: str) -> Mapping[str, AxisResult]:
        """Return axis -> result of a sensor; raise AllanError if one of the three is missing."""
        names = AXES[SENSORS[sensor]]
        missing = [name for name in names if name not in self.results.axes]
        if missing:
            what = sensor if len(missing) == len(names) else ', '.join(missing)
            raise AllanError(f'no {what} in these results: this file needs gyro and accel')
        return {name: self.results.axes[name] for name in names}

    def reduction(self, axis: str, states: States = 'walk') -> Reduction:
        """Return the noise model of one axis, reduced to the states of a filter.

        ``states`` is the model of the bias in the filter: 'none', 'walk', 'gauss_markov' or
        'processes'.
        """
        key, fit = (axis, states), self.results.axes[axis].fit
        if key not in self._reductions:
            self._reductions[key] = reduce_axis(
                axis, fit, states, self.horizons, self.options.strict
            )
        return self._reductions[key]

    @property
    def _used(self) -> dict[str, Reduction]:
        """Axis -> reduction whose N and K are written to the file."""
        return {axis: r for (axis, states), r in self._reductions.items() if states == 'walk'}

    def process(self, sensor: str) -> SensorProcess:
        """Return the Gauss-Markov processes that approximate the drift of a sensor."""
        names = list(self.axes_of(sensor))
        common = any(key.what == 'common_tau' for key in self.target.keys)
        tau = self.common_tau if common or self.rule != 'each' else None
        pairs = [self._closest(name, tau) for name in names]
        levels = [Level(name, 'sigma', sigma) for name, (sigma, _) in zip(names, pairs)]
        sigma = [self.options.inflate * one.value for one in sensor_levels(levels, self.rule)]
        sigma *= 3 // len(sigma)
        unit = SI_UNITS[sensor]['B']
        axes = self.results.axes
        others = tuple(name for name in names if not axes[name].fit.model.gauss_markov)
        walks = {name: self.reduction(name, 'processes').levels['K'] for name in others}
        described = '; '.join(
            f'{name} {significant(s, VALUE_DIGITS)} {unit}, {t:.4g} s{_origin(walks.get(name))}'
            for name, (s, t) in zip(names, pairs)
        )
        bounds = 'bounds' if self.target.bound else 'follows'
        words = (
            f'sigma and correlation time whose growth {bounds} the growth of the model: {described}'
        )
        note = finding('export_no_gauss_markov', others, horizons=self.horizons)
        taus = tuple(tau for _, tau in pairs)
        return SensorProcess(
            tuple(sigma), taus, words, (note,) if others else (), tuple(walks.values())
        )

    @cached_property
    def common_tau(self) -> float:
        """Geometric mean in s of the correlation times that describe the drift of all axes."""
        models = [self._drifting(name) for name in self.results.axes]
        return common_correlation_time(models, self.horizons)

    def _drifting(self, axis: str) -> ProcessModel:
        return self.reduction(axis, 'processes').model()

    def _closest(self, axis: str, tau: float | None) -> tuple[float, float]:
        model = self.results.axes[axis].fit.model
        model = model if model.gauss_markov else self._drifting(axis)
        pair = closest_process(model, self.horizons, tau, self.target.bound)
        assert pair is not None  # both sensors drift
        return pair

    def reduction_lines(self) -> list[str]:
        """Return the lines of the header comment on how N and K were computed."""
        if self.options.fidelity == 'coefficients':
            return ['fidelity: bare coefficients; N and K alone underestimate flicker and drift']
        if not self._used:
            return []
        ratios = [one.ratio for one in self._used.values()]
        low, high = min(r[0] for r in ratios), max(r[1] for r in ratios)
        return [
            f'reduction: N and K bound the error growth of the complete model over '
            f'{self.horizons}; predicted over model growth {low:.2f} to {high:.2f}'
        ]

    def reduction_findings(self) -> list[Finding]:
        """Return a warning that names the axes whose error growth N and K cannot describe."""
        poor = {
            axis: one.ratio[1]
            for axis, one in self._used.items()
            if one.poor or self.results.axes[axis].fit.model.gauss_markov
        }
        worst = max(poor.values(), default=0.0)
        note = finding('export_two_numbers', tuple(poor), horizons=self.horizons, ratio=worst)
        return [note] if poor else []


def notation_of(key: Key) -> Notation:
    """Return the notation of a key for N or K."""
    return NOTATIONS.get(key.unit) or Notation('', key.unit, factor=UNITS[key.unit].factor)


def level_words(level: Level) -> str:
    """Return the term, axis, value and 95 % interval of a noise level as text, in SI."""
    unit = SI_UNITS[sensor_of(level.axis)]['B' if level.term == 'sigma' else level.term]
    words = f'{level.term} of {level.axis}'
    if level.is_limit:
        limit = significant(level.raised_from or level.value, LIMIT_DIGITS)
        words += f' not observable, 95 % upper limit {limit} {unit}'
        return f'{words}, raised to cover the error growth' if level.raised_from else words
    words += f' {significant(level.value, VALUE_DIGITS)} {unit}'
    if level.ci95 is not None:
        low, high = (significant(end, VALUE_DIGITS) for end in level.ci95)
        words += f', 95 % interval {low}..{high}'
    elif level.raised_from is None:
        words += ', no 95 % interval'
    if level.raised_from:
        measured = significant(level.raised_from, VALUE_DIGITS)
        words += f', raised from {measured} to cover the error growth of the other terms'
    elif level.raised_from is not None:
        words += ', not in the model, set to cover the error growth of the other terms'
    return words


def _origin(walk: Level | None) -> str:
    """Return a note if the process is computed from an uncertain K, else ''."""
    if walk is None or not (walk.is_limit or walk.no_interval):
        return ''
    return f' from {"the 95 % upper limit of K" if walk.is_limit else "K without an interval"}'


def _width(interval: tuple[float, float]) -> float:
    return interval[1] / interval[0] if interval[0] else math.inf


def clamped(row: Row, low: float, high: float) -> Row:
    """Return the row with its number within [low, high], and a finding if it was outside."""
    value = min(max(row.value, low), high)
    if value == row.value:
        return row
    numbers = {'value': row.value, 'low': low, 'high': high, 'written': value}
    note = finding('export_clamped', key=row.key, **numbers)
    words = f'{row.words}; {row.value:g} lies outside [{low:g}, {high:g}]'
    return replace(row, value=value, words=words, clamped=True, findings=(*row.findings, note))


NAMED_SOURCES = 3
"""Largest number of recordings that the header comment names; others are counted."""

EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
FIRST_DATE = datetime(2000, 1, 1, tzinfo=timezone.utc)
"""Earlier stamps are not dates, but count from the start of a machine or a simulation."""

RULE_WORDS = {
    'worst': 'worst (the largest of x, y, z)',
    'mean': 'mean (root mean square of x, y, z)',
    'each': 'each (x, y, z)',
}


def header_lines(name: str, noise: FilterNoise, rows: Sequence[Row]) -> list[str]:
    """Return the lines of the header comment, without comment marks.

    They state source, date, convention, units, rate, axes, intervals and warnings. ``name`` is the
    target, ``rows`` are the keys of the file.
    """
    results, target, inflate = noise.results, noise.target, noise.options.inflate
    limits = dict.fromkeys(row.key for row in rows if row.is_limit)
    unsure = dict.fromkeys(row.key for row in rows if row.no_interval)
    first = (*WRONG_UNITS, 'from_datasheet')
    wrong = [f'warning: {note}' for note in results.findings if note.id in first]
    others = [
        f'warning: {", ".join(note.axes)}{": " if note.axes else ""}{note.message}'
        for note in results.findings
        if note.severity != 'info' and note.id not in first
    ]
    title = [
        f'IMU noise for {name}, measured by allan_ros {__version__} (method {results.method})',
        f'source: {_sources(results)}; {duration_text(results.duration_s, 3)} at rest, '
        f'{significant(results.rate_hz, 5)} Hz',
        f'date: {_recorded(results)}',
    ]
    if results.method == FROM_DATASHEET:
        title = [
            f'IMU noise for {name}, from the datasheet of {results.identity.frame_id} and not '
            f'measured (allan_ros {__version__})',
            *(f'source: {source.path}' for source in results.provenance.sources),
        ]
    lines = [
        *wrong,
        *title,
        f'convention: {target.convention}',
        f'rate: f = {noise.rate:g} Hz, {noise.rate_words}',
        f'axis rule: {RULE_WORDS[noise.rule]}; inflation: {_inflation(inflate)}',
        *noise.reduction_lines(),
        *(f'{row.key} {row.words}' for row in rows if row.words),
        f'upper limits instead of measurements: {", ".join(limits) or "none"}',
        *([f'values without a 95 % interval: {", ".join(unsure)}'] if unsure else []),
        *(f'note: {note}' for note in target.notes),
        *dict.fromkeys(f'note: {note}' for row in rows for note in row.findings),
        *(f'warning: {note}' for note in noise.reduction_findings()),
        *others,
    ]
    return [one_line(line) for line in lines]


def _inflation(factor: float) -> str:
    if factor == 1.0:
        return 'none'
    return f'x{factor:g} on every N, K and bias; the levels below are without it'


def _sources(results: Results) -> str:
    sources = [f'{s.path} {s.topic}'.strip() for s in results.provenance.sources]
    more = len(sources) - NAMED_SOURCES
    named = ', '.join(sources[:NAMED_SOURCES]) + (f' and {more} more' if more > 0 else '')
    return named or 'sums without a recording'


def _recorded(results: Results) -> str:
    starts = [s.start_ns for s in results.provenance.segments]
    if not starts:
        return 'not known'
    try:
        start = EPOCH + timedelta(microseconds=min(starts) // 1000)
    except OverflowError:
        return 'unknown: the stamps are not dates'
    if start < FIRST_DATE:
        return 'unknown: the stamps do not count from 1970'
    return f'recorded from {start:%Y-%m-%d %H:%M:%S} UTC on'
