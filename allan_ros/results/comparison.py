# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of recordings with each other, with datasheets, and with motors off and on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.compare import FAMILY_ERROR, Check, differences, worst_verdict
from ..core.errors import AllanError, one_line
from ..core.fields import plain
from ..core.filters.reductions import horizon_text, shortest_horizon
from ..core.imu import SI_UNITS, sensor_of
from ..core.number_text import significant
from .datasheets import Datasheet, sheet_to_document
from .documents import results_to_document
from .measured import against_measured
from .results import Results

SCHEMA = 'allan_ros/comparison/2'


@dataclass(frozen=True)
class RunComparison:
    """Several recordings, their differences from the first one, and comparisons with datasheets.

    Printed, it is a sentence for each recording but the first, and a line for each comparison with
    a datasheet.

    Attributes
    ----------
    runs : mapping of label to Results
        In the labels, control characters are escaped.
    differences : mapping of label to tuple of Check
        For each recording but the first one, the comparisons with the first one.
    checked : tuple of (label, Results)
        Each recording, compared with each datasheet that has limits for it.
    family_error : float
        Probability of any significant difference if all recordings have equal noise.
    within : float
        Fraction for the tests of equivalence; 0 for none.
    """

    runs: Mapping[str, Results]
    differences: Mapping[str, tuple[Check, ...]]
    checked: tuple[tuple[str, Results], ...] = ()
    family_error: float = FAMILY_ERROR
    within: float = 0.0

    def __repr__(self) -> str:
        found = [_sentence(self, *each) for each in self.differences.items()]
        if self.within:
            found += [_equivalence_sentence(self, *each) for each in self.differences.items()]
        return '\n'.join([*found, *(_datasheet_sentence(*each) for each in self.checked)])

    @property
    def first(self) -> str:
        """Label of the recording with which the others are compared."""
        return next(iter(self.runs))

    @property
    def equivalent(self) -> bool:
        """Whether N of all axes is the same up to ``within``, and no other term is different."""
        results = (
            (d.quantity, d.equivalence(self.within))
            for checks in self.differences.values()
            for d in checks
            if d.tau is None
        )
        return all(r == 'same' or (r == 'undecided' and term != 'N') for term, r in results)

    @property
    def differs(self) -> bool:
        """Whether any difference is significant, or a limit of a datasheet is exceeded.

        With ``within``, equality up to this fraction is required instead.
        """
        if any(worst_verdict(one.datasheet_checks) == 'exceeds' for _, one in self.checked):
            return True
        if self.within:
            return not self.equivalent
        return any(significant_of(checks) for checks in self.differences.values())


def significant_of(checks: Iterable[Check]) -> list[Check]:
    """Return the significant differences of two recordings."""
    return [d for d in checks if d.significant]


def compare_runs(
    runs: Mapping[str, Results],
    datasheets: Sequence[Datasheet] = (),
    margin: float = 0.0,
    within: float = 0.0,
) -> RunComparison:
    """Compare each recording with the first one, and every recording with each datasheet.

    ``runs`` has their results by label. With ``within``, the comparison also tests whether the
    coefficients are the same up to this fraction. A limit of a datasheet is exceeded if the 95 %
    interval is completely above limit * (1 + ``margin``). Raises AllanError when two recordings
    have no common axis.
    """
    runs = {one_line(label): results for label, results in runs.items()}
    (first, known), *others = runs.items()
    for label, other in others:
        if not set(known.axes) & set(other.axes):
            raise AllanError(
                f'no common axis: {label} has {", ".join(other.axes)}, '
                f'{first} has {", ".join(known.axes)}'
            )
    found = differences((first, known.measured, other.measured) for _, other in others)
    checked = (
        (label, results.against_datasheet(sheet, margin))
        for sheet in datasheets
        for label, results in runs.items()
    )
    return RunComparison(
        runs,
        {label: changes for (label, _), changes in zip(others, found)},
        tuple(checked),
        within=within,
    )


def comparison_document(comparison: RunComparison) -> dict[str, Any]:
    """Return the comparison as a JSON object of the schema ``allan_ros/comparison/2``, in SI."""
    within = comparison.within

    def document(check: Check) -> dict[str, Any]:
        tested = {'equivalence': check.equivalence(within)} if within else {}
        return {**plain(check), **tested}

    return {
        'schema': SCHEMA,
        'family_error': comparison.family_error,
        'within': within or None,
        'differs': comparison.differs,
        'runs': [
            {'label': label, 'results': results_to_document(results, curves=False)}
            for label, results in comparison.runs.items()
        ],
        'pairs': [
            {'first': comparison.first, 'second': label, 'differences': [*map(document, checks)]}
            for label, checks in comparison.differences.items()
        ],
        'datasheets': [
            {
                'run': label,
                **sheet_to_document(results.datasheet, results.datasheet_checks, results.margin),
                'measured': plain(against_measured(results.datasheet, results)),
            }
            for label, results in comparison.checked
            if results.datasheet is not None
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


def _sentence(comparison: RunComparison, label: str, checks: Sequence[Check]) -> str:
    first, found = comparison.first, significant_of(checks)
    if not found:
        terms = sum(d.tau is None and d.verdict == 'alike' for d in checks)
        deviations = sum(d.tau is not None and d.verdict == 'alike' for d in checks)
        if not terms + deviations:
            return f'{label} and {first} have nothing that can be compared'
        return (
            f'{label} and {first} do not differ significantly in {terms} coefficients '
            f'and {deviations} deviations '
            f'({100.0 * comparison.family_error:g} % false alarms overall)'
        )
    # Coefficients take precedence, and a ratio of two measured values comes before a bound.
    named = [d for d in found if d.tau is None] or found
    largest = max(named, key=lambda d: (d.ratio.value is not None, _size(d)))
    return (
        f'{label} differs from {first} in {len(found)} of {len(checks)} comparisons, most in '
        f'{quantity_text(largest)}: {ratio_text(largest)} times'
    )


def _equivalence_sentence(comparison: RunComparison, label: str, checks: Sequence[Check]) -> str:
    found: dict[str, dict[str, list[str]]] = {'same': {}, 'different': {}, 'undecided': {}}
    for d in checks:
        if d.tau is None and d.p is not None:
            terms = found[d.equivalence(comparison.within)]
            terms.setdefault(d.quantity, []).append(d.axis.replace('_', ' '))
    texts = (
        '; '.join(f'{term} of {", ".join(axes)}' for term, axes in terms.items())
        for terms in found.values()
    )
    same, different, undecided = (text or 'no term' for text in texts)
    return (
        f'{label} is the same as {comparison.first} to {100.0 * comparison.within:g} % in {same}; '
        f'it differs by more in {different}; undecided, because the intervals are too wide: '
        f'{undecided}'
    )


def _size(difference: Check) -> float:
    """Return how far the 95 % interval of a significant ratio is from 1, as a logarithm."""
    low, high = difference.ratio.ci95 or (1.0, 1.0)
    return math.log(low) if low > 1.0 else -math.log(high)


def _datasheet_sentence(label: str, results: Results) -> str:
    name, checks = results.datasheet.name if results.datasheet else '', results.datasheet_checks
    beyond = [f'{c.axis.replace("_", " ")} {c.quantity}' for c in checks if c.verdict == 'exceeds']
    if beyond:
        return f'{label} exceeds the datasheet of {name} in {", ".join(beyond)}'
    unsettled = sum(c.verdict == 'undecided' for c in checks)
    if unsettled == len(checks):
        return f'{label} cannot be judged by the datasheet of {name}'
    note = f'; {unsettled} of {len(checks)} are undecided' if unsettled else ''
    return f'{label} is within the datasheet of {name}{note}'


REST, RUNNING = 'at rest', 'at rest, motors on'
"""Labels of the recordings with motors off and on."""

SHOWN_TAU_S = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Averaging times in s of the table of ratios."""


@dataclass(frozen=True)
class Inflation:
    """Ratio of the noise of an IMU at rest with motors on to its noise with motors off.

    Attributes
    ----------
    axes : mapping of axis to term to Check
        N and K for a filter with motors on, compared with those with motors off (``limit``). They
        bound the growth of the integrated error up to ``horizon``.
    comparison : RunComparison
        The ratios of the Allan deviations with intervals.
    horizon : float
        Longest time in s for which the filter integrates without a correction.
    """

    axes: Mapping[str, Mapping[str, Check]]
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
        (checks,) = self.comparison.differences.values()
        return [d for d in checks if d.axis == axis and d.tau is not None]


def use_of(check: Check) -> float:
    """Return the value for a filter: the larger one of those with motors off and on."""
    return max(check.limit, check.measured.value or 0.0)


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
                    term: {
                        'rest': c.limit,
                        'running': c.measured.value,
                        'factor': c.factor,
                        'use': use_of(c),
                    }
                    for term, c in axis.items()
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
        n, k = (f'{significant(use_of(c), 4)} {units[term]:16}' for term, c in axis.items())
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
