# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of recordings with each other, with datasheets, and with motors off and on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..core.compare import FAMILY_ERROR, Check, differences
from ..core.errors import AllanError, one_line
from ..core.fields import plain
from ..core.filters.noise_parameters import TermInflation
from ..core.filters.reductions import horizon_text, shortest_horizon
from ..core.imu import SI_UNITS, sensor_of
from ..core.number_text import significant
from .datasheets import Datasheet, DatasheetComparison, comparison_to_document
from .documents import results_to_document
from .measured import against_measured
from .results import Results

SCHEMA = 'allan_ros/comparison/2'


@dataclass(frozen=True)
class Subject:
    """The results of one recording and its label, in which control characters are escaped."""

    label: str
    results: Results

    def __post_init__(self) -> None:
        object.__setattr__(self, 'label', one_line(self.label))


@dataclass(frozen=True)
class Pair:
    """The differences between the first recording and another one, with the labels of both."""

    first: str
    second: str
    differences: tuple[Check, ...]

    @property
    def significant(self) -> tuple[Check, ...]:
        """The significant differences."""
        return tuple(d for d in self.differences if d.significant)

    def of(self, axis: str, quantity: str) -> Check | None:
        """Return the difference of a coefficient such as 'N', or None if an axis is missing."""
        known = (d for d in self.differences if (d.axis, d.quantity) == (axis, quantity))
        return next(known, None)


class Checked(NamedTuple):
    """The comparison of a recording with a datasheet, and with measured units of the sensor."""

    label: str
    datasheet: DatasheetComparison
    measured: Sequence[Check]


@dataclass(frozen=True)
class RunComparison:
    """Several recordings, their differences from the first one, and comparisons with datasheets.

    ``pairs`` has one element for each recording after the first. ``family_error`` is the
    probability of any significant difference if all recordings have equal noise. Printed, it is a
    sentence for each pair, and a line for each comparison with a datasheet.
    """

    runs: tuple[Subject, ...]
    pairs: tuple[Pair, ...]
    checked: tuple[Checked, ...] = ()
    family_error: float = FAMILY_ERROR
    within: float = 0.0  # fraction for the tests of equivalence; 0 for none

    def __repr__(self) -> str:
        pairs = [_sentence(pair, self.family_error) for pair in self.pairs]
        if self.within:
            pairs += [_equivalence_sentence(pair, self.within) for pair in self.pairs]
        return '\n'.join([*pairs, *map(_datasheet_sentence, self.checked)])

    @property
    def equivalent(self) -> bool:
        """Whether N of all axes is the same up to ``within``, and no other term is different."""
        results = (
            (d.quantity, d.equivalence(self.within))
            for pair in self.pairs
            for d in pair.differences
            if d.tau is None
        )
        return all(r == 'same' or (r == 'undecided' and term != 'N') for term, r in results)

    @property
    def differs(self) -> bool:
        """Whether any difference is significant, or a limit of a datasheet is exceeded.

        With ``within``, equality up to this fraction is required instead.
        """
        if any(one.datasheet.verdict == 'exceeds' for one in self.checked):
            return True
        return not self.equivalent if self.within else any(p.significant for p in self.pairs)


def compare_runs(
    runs: Sequence[Subject],
    datasheets: Sequence[Datasheet] = (),
    margin: float = 0.0,
    within: float = 0.0,
) -> RunComparison:
    """Compare each recording with the first one, and every recording with each datasheet.

    With ``within``, the comparison also tests whether the coefficients are the same up to this
    fraction. A limit of a datasheet is exceeded if the 95 % interval is completely above
    limit * (1 + ``margin``). Raises AllanError when two recordings have no common axis.
    """
    first, *others = runs
    for other in others:
        if not set(first.results.axes) & set(other.results.axes):
            raise AllanError(
                f'no common axis: {other.label} has {", ".join(other.results.axes)}, '
                f'{first.label} has {", ".join(first.results.axes)}'
            )
    found = differences(
        (first.label, first.results.measured, other.results.measured) for other in others
    )
    pairs = (Pair(first.label, other.label, changes) for other, changes in zip(others, found))
    checked = (
        Checked(run.label, known, against_measured(sheet, run.results))
        for sheet in datasheets
        for run in runs
        if (known := run.results.against_datasheet(sheet, margin).datasheet)
    )
    return RunComparison(tuple(runs), tuple(pairs), tuple(checked), within=within)


def comparison_document(comparison: RunComparison) -> dict[str, Any]:
    """Return the comparison as a JSON object of the schema ``allan_ros/comparison/2``, in SI."""
    pairs = plain(comparison.pairs)
    for pair, found in zip(comparison.pairs, pairs) if comparison.within else ():
        for d, one in zip(pair.differences, found['differences']):
            one['equivalence'] = d.equivalence(comparison.within)
    return {
        'schema': SCHEMA,
        'family_error': comparison.family_error,
        'within': comparison.within or None,
        'differs': comparison.differs,
        'runs': [
            {'label': run.label, 'results': results_to_document(run.results, curves=False)}
            for run in comparison.runs
        ],
        'pairs': pairs,
        'datasheets': [
            {
                'run': one.label,
                **comparison_to_document(one.datasheet),
                'measured': plain(one.measured),
            }
            for one in comparison.checked
        ],
    }


RATIO_DIGITS = 3
"""Significant digits of a ratio and of the ends of its interval."""


def ratio_text(difference: Check) -> str:
    """Return the ratio with its 95 % interval, or a bound on the ratio, as text; '' if unknown."""
    if difference.ratio.ci95 is None:
        return ''
    low, high = difference.ratio.ci95
    if difference.ratio.value is not None:
        ends = '..'.join(significant(end, RATIO_DIGITS) for end in (low, high))
        return f'{significant(difference.ratio.value, RATIO_DIGITS)} ({ends})'
    if math.isinf(high):
        return f'> {significant(low, RATIO_DIGITS)}'
    return f'< {significant(high, RATIO_DIGITS)}'


def verdict_text(difference: Check) -> str:
    """Return 'alike', 'higher' or 'lower' for the second recording, or 'not comparable'."""
    return 'not comparable' if difference.verdict == 'undecided' else difference.verdict


def quantity_text(difference: Check) -> str:
    """Return the axis and the quantity as text: 'gyro x N', 'gyro x deviation at 1.0 s'."""
    axis = difference.axis.replace('_', ' ')
    if difference.tau is None:
        return f'{axis} {difference.quantity}'
    return f'{axis} deviation at {significant(difference.tau, 2)} s'


def _sentence(pair: Pair, family_error: float) -> str:
    found = pair.significant
    if not found:
        terms = sum(d.tau is None and d.verdict == 'alike' for d in pair.differences)
        deviations = sum(d.tau is not None and d.verdict == 'alike' for d in pair.differences)
        if not terms + deviations:
            return f'{pair.second} and {pair.first} have nothing that can be compared'
        return (
            f'{pair.second} and {pair.first} do not differ significantly in {terms} coefficients '
            f'and {deviations} deviations ({100.0 * family_error:g} % false alarms overall)'
        )
    # Coefficients take precedence, and a ratio of two measured values comes before a bound.
    named = [d for d in found if d.tau is None] or found
    largest = max(named, key=lambda d: (d.ratio.value is not None, _size(d)))
    return (
        f'{pair.second} differs from {pair.first} in {len(found)} of {len(pair.differences)} '
        f'comparisons, most in {quantity_text(largest)}: {ratio_text(largest)} times'
    )


def _equivalence_sentence(pair: Pair, within: float) -> str:
    found: dict[str, dict[str, list[str]]] = {'same': {}, 'different': {}, 'undecided': {}}
    for d in pair.differences:
        if d.tau is None and d.p is not None:
            terms = found[d.equivalence(within)]
            terms.setdefault(d.quantity, []).append(d.axis.replace('_', ' '))
    texts = (
        '; '.join(f'{term} of {", ".join(axes)}' for term, axes in terms.items())
        for terms in found.values()
    )
    same, different, undecided = (text or 'no term' for text in texts)
    return (
        f'{pair.second} is the same as {pair.first} to {100.0 * within:g} % in {same}; it differs '
        f'by more in {different}; undecided, because the intervals are too wide: {undecided}'
    )


def _size(difference: Check) -> float:
    """Return how far the 95 % interval of a significant ratio is from 1, as a logarithm."""
    low, high = difference.ratio.ci95 or (1.0, 1.0)
    return math.log(low) if low > 1.0 else -math.log(high)


def _datasheet_sentence(checked: Checked) -> str:
    name, checks = checked.datasheet.datasheet.name, checked.datasheet.comparisons
    beyond = [f'{c.axis.replace("_", " ")} {c.quantity}' for c in checks if c.verdict == 'exceeds']
    if beyond:
        return f'{checked.label} exceeds the datasheet of {name} in {", ".join(beyond)}'
    unsettled = sum(c.verdict == 'undecided' for c in checks)
    if unsettled == len(checks):
        return f'{checked.label} cannot be judged by the datasheet of {name}'
    note = f'; {unsettled} of {len(checks)} are undecided' if unsettled else ''
    return f'{checked.label} is within the datasheet of {name}{note}'


REST, RUNNING = 'at rest', 'at rest, motors on'
"""Labels of the recordings with motors off and on."""

SHOWN_TAU_S = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Averaging times in s of the table of ratios."""


@dataclass(frozen=True)
class Inflation:
    """Ratio of the noise of an IMU at rest with motors on to its noise with motors off.

    ``axes`` has N and K for a filter with motors off and on, and their ratios. These N and K bound
    the growth of the integrated error up to ``horizon`` (s). ``comparison`` has the ratios of the
    Allan deviations with intervals.
    """

    axes: dict[str, dict[str, TermInflation]]
    comparison: RunComparison
    horizon: float

    def __repr__(self) -> str:
        return '\n'.join(inflation_lines(self))

    @property
    def factor(self) -> float:
        """Largest factor for N of all axes."""
        return max(axis['N'].factor for axis in self.axes.values())

    @property
    def option(self) -> str:
        """The largest factor for N of each sensor, as the value of ``allan export --inflate``."""
        factors = {sensor_of(name): 1.0 for name in self.axes}
        for name, axis in self.axes.items():
            factors[sensor_of(name)] = max(factors[sensor_of(name)], axis['N'].factor)
        return ','.join(f'{sensor}={significant(f, 3)}' for sensor, f in factors.items())

    def ratios(self, axis: str) -> list[Check]:
        """Return the ratios of the Allan deviations of an axis, one for each averaging time."""
        (pair,) = self.comparison.pairs
        return [d for d in pair.differences if d.axis == axis and d.tau is not None]


def inflation_document(inflation: Inflation) -> dict[str, Any]:
    """Return the result as a JSON object of the schema ``allan_ros/inflation/2``, in SI."""
    return {
        'schema': 'allan_ros/inflation/2',
        'horizon_s': [shortest_horizon(inflation.horizon), inflation.horizon],
        'factor': inflation.factor,
        'inflate': inflation.option,
        'axes': {
            name: {
                **{
                    term: {'rest': t.rest, 'running': t.running, 'factor': t.factor, 'use': t.use}
                    for term, t in axis.items()
                },
                'deviation': [
                    {'tau_s': d.tau, 'ratio': plain(d.ratio.value), 'ci95': plain(d.ratio.ci95)}
                    for d in inflation.ratios(name)
                ],
            }
            for name, axis in inflation.axes.items()
        },
    }


def inflation_lines(inflation: Inflation) -> Iterator[str]:
    """Yield the lines of two tables: N and K for a filter, and ratios of Allan deviations."""
    yield f'N and K for a filter, over {horizon_text(inflation.horizon)}'
    yield f'{"":9}{"N to use":>34}  {"factor":>6}{"K to use":>36}  {"factor":>6}'
    for name, axis in inflation.axes.items():
        units = SI_UNITS[sensor_of(name)]
        n, k = (f'{significant(t.use, 4)} {units[term]:16}' for term, t in axis.items())
        factors = axis['N'].factor, axis['K'].factor
        yield f'{name:9}{n:>34}  {factors[0]:6.2f}{k:>36}  {factors[1]:6.2f}'.rstrip()
    yield ''
    yield 'Allan deviation with motors on over motors off, 95 % interval'
    for name in inflation.axes:
        ratios = inflation.ratios(name)
        nearest = {d.tau: d for tau in SHOWN_TAU_S if (d := _nearest(ratios, tau)) is not None}
        cells = [f'{tau:g} s: {_ratio(d)}' for tau, d in nearest.items()]
        yield f'{name:9}{"  ".join(cells)}'
    yield ''
    yield f'For `allan export`: --inflate {inflation.option}'


def _nearest(ratios: list[Check], tau: float) -> Check | None:
    """Return the ratio closest to ``tau``; None if none is within a factor of 1.5."""
    close = [d for d in ratios if d.tau is not None and tau / 1.5 < d.tau < 1.5 * tau]
    return min(close, key=lambda d: abs((d.tau or 0.0) - tau), default=None)


def _ratio(d: Check) -> str:
    if d.ratio.value is None or d.ratio.ci95 is None:
        return 'not known'
    return f'{d.ratio.value:.2f} ({d.ratio.ci95[0]:.2f} to {d.ratio.ci95[1]:.2f})'
