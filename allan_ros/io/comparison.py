# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of recordings with the first one, with datasheets, and of motors off and on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.compare import FAMILY_ERROR, Difference, differences
from ..core.errors import AllanError, one_line
from ..core.fields import plain
from ..core.filters.noise_parameters import AxisInflation, measure_inflation
from ..core.filters.reductions import Horizons
from ..core.imu import SI_UNITS, sensor_of
from .datasheets import (
    Datasheet,
    DatasheetComparison,
    check_margin,
    comparison_to_document,
)
from .documents import results_to_document
from .format import significant
from .results import Results

SCHEMA = 'allan_ros/comparison/1'


@dataclass(frozen=True)
class Subject:
    """One recording and its label, which is safe to print in a terminal and in tables."""

    label: str
    results: Results

    def __post_init__(self) -> None:
        object.__setattr__(self, 'label', one_line(self.label))


@dataclass(frozen=True)
class Pair:
    """Differences of a recording from the first one, and their labels."""

    first: str
    second: str
    differences: tuple[Difference, ...]

    @property
    def beyond(self) -> tuple[Difference, ...]:
        """The significant differences."""
        return tuple(d for d in self.differences if d.significant)

    def of(self, axis: str, quantity: str) -> Difference | None:
        """Return the difference of a term of an axis, if both recordings have it."""
        of_axis = (d for d in self.differences if d.axis == axis)
        return next((d for d in of_axis if d.quantity == quantity), None)


@dataclass(frozen=True)
class RunComparison:
    """Several recordings, their differences from the first one, and comparisons with datasheets.

    ``family_error`` is the probability of any false detection among all differences.
    """

    runs: tuple[Subject, ...]
    pairs: tuple[Pair, ...]
    datasheets: tuple[tuple[str, DatasheetComparison], ...]
    family_error: float = FAMILY_ERROR

    def __repr__(self) -> str:
        return '\n'.join(comparison_headline(self))

    @property
    def differs(self) -> bool:
        """Whether any difference is significant, or a limit of a datasheet is exceeded."""
        return any(pair.beyond for pair in self.pairs) or any(
            comparison.verdict == 'beyond' for _, comparison in self.datasheets
        )


def compare_runs(
    runs: Sequence[Subject], datasheets: Sequence[Datasheet] = (), margin: float = 0.0
) -> RunComparison:
    """Compare each recording with the first one, and with each datasheet."""
    check_margin(margin)
    if len(runs) + len(datasheets) < 2 or not runs:
        raise AllanError('nothing to compare: give two recordings, or one and a datasheet')
    first, *others = runs
    for other in others:
        if not set(first.results.axes) & set(other.results.axes):
            raise AllanError(
                f'{other.label} has {", ".join(other.results.axes)} where {first.label} has '
                f'{", ".join(first.results.axes)}: they share no axis to compare'
            )
    found = differences((first.results.measured, other.results.measured) for other in others)
    return RunComparison(
        tuple(runs),
        tuple(Pair(first.label, other.label, of) for other, of in zip(others, found)),
        tuple(
            (run.label, checked)
            for datasheet in datasheets
            for run in runs
            if (checked := run.results.against_datasheet(datasheet, margin).datasheet)
        ),
    )


def comparison_document(comparison: RunComparison) -> dict[str, Any]:
    """Return the comparison as ``allan_ros/comparison/1``, in SI."""
    return {
        'schema': SCHEMA,
        'family_error': comparison.family_error,
        'differs': comparison.differs,
        'runs': [
            {'label': run.label, 'results': results_to_document(run.results, curves=False)}
            for run in comparison.runs
        ],
        'pairs': [
            {
                'first': pair.first,
                'second': pair.second,
                'differences': [
                    {
                        'axis': d.axis,
                        'quantity': d.quantity,
                        'tau_s': d.tau,
                        'ratio': d.ratio,
                        'ci95': plain(d.ci95),
                        'p': d.p,
                        'verdict': d.verdict,
                    }
                    for d in pair.differences
                ],
            }
            for pair in comparison.pairs
        ],
        'datasheets': [
            {'run': label, **comparison_to_document(of_run)}
            for label, of_run in comparison.datasheets
        ],
    }


RATIO_DIGITS = 3
"""Significant digits of a ratio and of the ends of its interval."""


def comparison_headline(comparison: RunComparison) -> Iterator[str]:
    """Yield one sentence per pair and datasheet: the largest difference, or that none is
    significant."""
    for pair in comparison.pairs:
        yield _of_pair(pair, comparison.family_error)
    for label, of_run in comparison.datasheets:
        yield _of_datasheet(label, of_run)


def ratio_text(difference: Difference) -> str:
    """Return the ratio with its 95 % interval, or its bound; '' if neither is known."""
    if difference.ci95 is None:
        return ''
    low, high = difference.ci95
    if difference.ratio is not None:
        ends = '..'.join(significant(end, RATIO_DIGITS) for end in (low, high))
        return f'{significant(difference.ratio, RATIO_DIGITS)} ({ends})'
    if math.isinf(high):
        return f'> {significant(low, RATIO_DIGITS)}'
    return f'< {significant(high, RATIO_DIGITS)}'


def verdict_text(difference: Difference) -> str:
    """Return the text of the verdict for tables."""
    return 'not comparable' if difference.verdict == 'open' else difference.verdict


def quantity_text(difference: Difference) -> str:
    """Return the name of the quantity and of its axis."""
    axis = difference.axis.replace('_', ' ')
    if difference.tau is None:
        return f'{axis} {difference.quantity}'
    return f'{axis} deviation at {significant(difference.tau, 2)} s'


def _of_pair(pair: Pair, family_error: float) -> str:
    beyond = pair.beyond
    if not beyond:
        terms = sum(d.tau is None and d.verdict == 'alike' for d in pair.differences)
        deviations = sum(d.tau is not None and d.verdict == 'alike' for d in pair.differences)
        if not terms + deviations:
            return f'{pair.second} and {pair.first} have nothing that can be compared'
        return (
            f'{pair.second} and {pair.first} do not differ significantly: {terms} coefficients '
            f'and {deviations} deviations compared at a total level of {family_error:.0%}'
        )
    # Coefficients take precedence; deviations are named if no coefficient differs.
    named = [d for d in beyond if d.tau is None] or list(beyond)
    # a ratio of two measured values comes before a bound: "10x" before "at least 156x"
    most = max(named, key=lambda d: (d.ratio is not None, _noisier_over_quieter(d)[1]))
    ratio, low, high = (r and significant(r, RATIO_DIGITS) for r in _noisier_over_quieter(most))
    times = f'{ratio}x ' if ratio else ''
    word = 'noisier' if most.verdict == 'higher' else 'quieter'
    interval = f'at least {low}x' if high == 'inf' else f'{low}..{high}'
    said = f'{pair.second} is {times}{word} than {pair.first} in {quantity_text(most)} ({interval})'
    others = len(beyond) - 1
    opposite = sum(d.verdict != most.verdict for d in beyond)
    if others:
        said += f', and differs in {others} more of {len(pair.differences)} comparisons'
    if opposite:
        said += f' ({opposite} of them in the opposite direction)'
    return said


def _noisier_over_quieter(difference: Difference) -> tuple[float | None, float, float]:
    """Return the ratio of a significant difference, at least 1, and the ends of its interval."""
    (low, high), ratio = difference.ci95 or (1.0, 1.0), difference.ratio
    if difference.verdict == 'higher':
        return ratio, low, high
    return ratio and 1.0 / ratio, 1.0 / high, 1.0 / low if low else math.inf


def _of_datasheet(label: str, comparison: DatasheetComparison) -> str:
    name, checks = comparison.datasheet.name, comparison.comparisons
    if not checks:
        return f'the datasheet of {name} has no limit for the axes of {label}'
    beyond = [c for c in checks if c.verdict == 'beyond']
    if beyond:
        what = ', '.join(f'{c.axis.replace("_", " ")} {c.term}' for c in beyond)
        return f'{label} is beyond the datasheet of {name} in {what}'
    unsettled = sum(c.verdict == 'open' for c in checks)
    if unsettled == len(checks):
        return f'{label} cannot be judged by the datasheet of {name} yet: no number is settled'
    rest = f'; {unsettled} of {len(checks)} are not settled yet' if unsettled else ''
    return f'{label} is within the datasheet of {name}{rest}'


INFLATION_SCHEMA = 'allan_ros/inflation/1'

REST, RUNNING = 'at rest', 'at rest, motors on'
"""Labels of the two recordings."""

SHOWN_TAU_S = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Averaging times of the table in s."""


@dataclass(frozen=True)
class Inflation:
    """Ratio of the noise of an IMU at rest with motors on to its noise with motors off.

    For each axis, it contains N and K, which bound the growth of the error over the horizons, and
    their factors. The comparison contains the ratios of the Allan deviations with intervals.
    """

    axes: dict[str, AxisInflation]
    comparison: RunComparison
    horizons: Horizons

    def __repr__(self) -> str:
        return '\n'.join(inflation_lines(self))

    @property
    def factor(self) -> float:
        """The largest factor on N of any axis: a value for ``--inflate``."""
        return max(axis.white.factor for axis in self.axes.values())

    def ratios(self, axis: str) -> list[Difference]:
        """Return the ratio of the deviations of an axis at each common averaging time."""
        (pair,) = self.comparison.pairs
        return [d for d in pair.differences if d.axis == axis and d.tau is not None]


def inflate(rest: Results, running: Results, horizon: float = 30.0) -> Inflation:
    """Return the increase of the noise of a robot at rest due to running motors (see
    `api.inflate`)."""
    horizons = Horizons.up_to(horizon)
    fits = [{axis: r.fit for axis, r in results.axes.items()} for results in (rest, running)]
    axes = measure_inflation(fits[0], fits[1], horizons)
    comparison = compare_runs([Subject(REST, rest), Subject(RUNNING, running)])
    return Inflation(axes, comparison, horizons)


def inflation_document(inflation: Inflation) -> dict[str, Any]:
    """Return the document ``allan_ros/inflation/1``, in SI."""
    return {
        'schema': INFLATION_SCHEMA,
        'horizon_s': list(inflation.horizons),
        'factor': inflation.factor,
        'axes': {
            name: {
                **{
                    term: {'rest': t.rest, 'running': t.running, 'factor': t.factor, 'use': t.use}
                    for term, t in (('N', axis.white), ('K', axis.walk))
                },
                'deviation': [
                    {'tau_s': d.tau, 'ratio': d.ratio, 'ci95': d.ci95 and list(d.ci95)}
                    for d in inflation.ratios(name)
                ],
            }
            for name, axis in inflation.axes.items()
        },
    }


def inflation_facts(inflation: Inflation) -> Iterator[tuple[str, str]]:
    """Yield the factors on N and K of each axis, and the values to use, as lines of a report."""
    for name, axis in inflation.axes.items():
        (n, n_unit), (k, k_unit) = _to_use(name, axis)
        factors = axis.white.factor, axis.walk.factor
        text = f'N {n} {n_unit} (x{factors[0]:.2f}); K {k} {k_unit} (x{factors[1]:.2f})'
        yield f'{name}, motors on', f'{text} over {inflation.horizons}'


def inflation_lines(inflation: Inflation) -> Iterator[str]:
    """Yield a table of the N and K to use, then a table of the ratios of the deviations over
    tau."""
    yield f'N and K for a filter, over {inflation.horizons}'
    yield f'{"":9}{"N to use":>34}  {"factor":>6}{"K to use":>36}  {"factor":>6}'
    for name, axis in inflation.axes.items():
        n, k = (f'{value} {unit:16}' for value, unit in _to_use(name, axis))
        factors = axis.white.factor, axis.walk.factor
        yield f'{name:9}{n:>34}  {factors[0]:6.2f}{k:>36}  {factors[1]:6.2f}'.rstrip()
    yield ''
    yield 'Allan deviation with motors on over motors off, 95 % interval'
    for name in inflation.axes:
        ratios = inflation.ratios(name)
        nearest = {d.tau: d for tau in SHOWN_TAU_S if (d := _nearest(ratios, tau)) is not None}
        cells = [f'{tau:g} s: {_ratio(d)}' for tau, d in nearest.items()]
        yield f'{name:9}{"  ".join(cells)}'


def _to_use(name: str, axis: AxisInflation) -> list[tuple[str, str]]:
    """Return N and K for a filter, each with its unit."""
    units = SI_UNITS[sensor_of(name)]
    return [(significant(t.use, 4), units[k]) for k, t in (('N', axis.white), ('K', axis.walk))]


def _nearest(ratios: list[Difference], tau: float) -> Difference | None:
    """Return the ratio at the averaging time within a factor of 1.5 of ``tau``, or None."""
    close = [d for d in ratios if d.tau is not None and tau / 1.5 < d.tau < 1.5 * tau]
    return min(close, key=lambda d: abs((d.tau or 0.0) - tau), default=None)


def _ratio(d: Difference) -> str:
    if d.ratio is None or d.ci95 is None:
        return 'not known'
    return f'{d.ratio:.2f} ({d.ci95[0]:.2f} to {d.ci95[1]:.2f})'
