# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a comparison says in words: the verdict first."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ..core.differences import Difference
from .datasheet_comparison import DatasheetComparison
from .run_comparison import Pair, RunComparison
from .shown import significant

VERDICT_TEXT = {
    'higher': 'higher',
    'lower': 'lower',
    'alike': 'alike',
    'open': 'cannot be told',
}
"""Verdict on the second run -> how tables say it."""

RATIO_DIGITS = 3
"""Significant digits of a ratio and of the ends of its interval."""


def headline(comparison: RunComparison) -> Iterator[str]:
    """Yield one sentence a pair and a datasheet: what differs most, or that nothing does."""
    for pair in comparison.pairs:
        yield _of_pair(pair, comparison.family_error)
    for label, beside in comparison.beside:
        yield _of_datasheet(label, beside)


def ratio_text(difference: Difference) -> str:
    """Return the ratio with its 95 % interval, or the bound that is known of it; '' for neither."""
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
    """Return the verdict as tables say it."""
    return VERDICT_TEXT[difference.verdict]


def quantity_text(difference: Difference) -> str:
    """Return which quantity of which axis it is of."""
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
            return f'{pair.second} and {pair.first} show nothing that could be compared'
        return (
            f'{pair.second} and {pair.first} differ by no more than chance: {terms} coefficients '
            f'and {deviations} deviations compared at a level of {family_error:.0%} for all'
        )
    # Coefficients name what differs; deviations speak where no coefficient does.
    named = [d for d in beyond if d.tau is None] or list(beyond)
    most = max(named, key=_surely)
    said = f'{pair.second} is {_by(most)} {pair.first} in {quantity_text(most)} {_interval(most)}'
    others = len(beyond) - 1
    opposite = sum(d.verdict != most.verdict for d in beyond)
    if others:
        said += f', and differs in {others} more of {len(pair.differences)} comparisons'
    if opposite:
        said += f' ({opposite} of them the other way)'
    return said


def _surely(difference: Difference) -> float:
    """Return by how much it surely differs: the end of the interval nearest to 1, as a log."""
    low, high = difference.ci95 or (1.0, 1.0)
    return math.log(low) if difference.verdict == 'higher' else -math.log(high)


def _by(difference: Difference) -> str:
    noisier = difference.verdict == 'higher'
    word = 'noisier' if noisier else 'quieter'
    if difference.ratio is None:
        return f'{word} than'
    factor = difference.ratio if noisier else 1.0 / difference.ratio
    return f'{significant(factor, RATIO_DIGITS)}x {word} than'


def _interval(difference: Difference) -> str:
    low, high = difference.ci95 or (1.0, 1.0)
    if difference.verdict == 'lower':
        low, high = (1.0 / high, math.inf if low == 0.0 else 1.0 / low)
    if math.isinf(high):
        return f'(at least {significant(low, RATIO_DIGITS)}x)'
    return f'({significant(low, RATIO_DIGITS)}..{significant(high, RATIO_DIGITS)})'


def _of_datasheet(label: str, beside: DatasheetComparison) -> str:
    name = beside.datasheet.name
    if not beside.held:
        return f'the datasheet of {name} states nothing of what {label} measured'
    beyond = [h for h in beside.held if h.verdict == 'beyond']
    if beyond:
        what = ', '.join(f'{h.axis.replace("_", " ")} {h.term}' for h in beyond)
        return f'{label} is beyond the datasheet of {name} in {what}'
    still = sum(h.verdict == 'open' for h in beside.held)
    rest = f'; {still} of {len(beside.held)} are not settled yet' if still else ''
    return f'{label} keeps the datasheet of {name}{rest}'
