# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of recordings as sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from ..core.check import Check
from ..core.estimate import significant
from ..core.findings import grouped
from ..results.comparison import RunComparison, significant_of
from ..results.results import UNSUITABLE, WRONG_UNITS, Results
from .finding_text import texts_of

RATIO_DIGITS = 3
"""Significant digits of a ratio and of the ends of its interval."""


def ratio_text(difference: Check) -> str:
    """Return a ratio with its 95 % interval, or a limit of the ratio, as text; '' if unknown."""
    if difference.ratio.ci95 is None:
        return ''
    low, high = difference.ratio.ci95
    if difference.ratio.value is not None:
        interval = '..'.join(significant(end, RATIO_DIGITS) for end in (low, high))
        return f'{significant(difference.ratio.value, RATIO_DIGITS)} ({interval})'
    if math.isinf(high):
        return f'> {significant(low, RATIO_DIGITS)}'
    return f'< {significant(high, RATIO_DIGITS)}'


def verdict_text(difference: Check) -> str:
    """Return the verdict on the second of two recordings: 'alike', 'higher' or 'lower'.

    If the quantity cannot be compared, the text is 'not comparable'.
    """
    return 'not comparable' if difference.verdict == 'undecided' else difference.verdict


def quantity_text(difference: Check) -> str:
    """Return the axis and the quantity of a comparison, such as 'gyro x deviation at 1.0 s'.

    For a coefficient, the text is, for example, 'gyro x N'.
    """
    axis = difference.axis.replace('_', ' ')
    if difference.tau is None:
        return f'{axis} {difference.quantity}'
    return f'{axis} deviation at {significant(difference.tau, 2)} s'


def _sentence(comparison: RunComparison, label: str, checks: Sequence[Check]) -> str:
    first_label, differing = comparison.first, significant_of(checks)
    if not differing:
        n_terms = sum(d.tau is None and d.verdict == 'alike' for d in checks)
        n_deviations = sum(d.tau is not None and d.verdict == 'alike' for d in checks)
        if not n_terms + n_deviations:
            return f'{label} and {first_label} have no quantity that can be compared'
        return (
            f'{label} and {first_label} do not differ significantly in {n_terms} coefficients '
            f'and {n_deviations} deviations '
            f'({100.0 * comparison.family_error:g} % false alarms overall)'
        )
    # Coefficients take precedence over Allan deviations.
    candidates = [d for d in differing if d.tau is None] or differing
    largest_ratio = max(candidates, key=_size)
    return (
        f'{label} differs from {first_label} in {len(differing)} of {len(checks)} comparisons, '
        f'most in {quantity_text(largest_ratio)}: {ratio_text(largest_ratio)} times'
    )


def _equivalence_sentence(comparison: RunComparison, label: str, checks: Sequence[Check]) -> str:
    terms_by_result: dict[str, dict[str, list[str]]] = {
        'same': {},
        'different': {},
        'undecided': {},
    }
    for d in checks:
        if d.tau is None and d.p is not None:
            terms = terms_by_result[d.equivalence(comparison.within)]
            terms.setdefault(d.quantity, []).append(d.axis.replace('_', ' '))
    texts = (
        '; '.join(f'{term} of {", ".join(axes)}' for term, axes in terms.items())
        for terms in terms_by_result.values()
    )
    same_terms, different_terms, undecided_terms = (text or 'no term' for text in texts)
    return (
        f'{label} is the same as {comparison.first} to {100.0 * comparison.within:g} % in '
        f'{same_terms}; it differs by more in {different_terms}; undecided, because the intervals '
        f'are too wide: {undecided_terms}'
    )


def _size(difference: Check) -> float:
    """Return the distance from 1 to the 95 % interval of a significant ratio, as a logarithm."""
    low, high = difference.ratio.ci95 or (1.0, 1.0)
    return math.log(low) if low > 1.0 else -math.log(high)


def _datasheet_sentence(label: str, results: Results) -> str:
    name, checks = results.datasheet.name if results.datasheet else '', results.datasheet_checks
    exceeded = [
        f'{c.axis.replace("_", " ")} {c.quantity}' for c in checks if c.verdict == 'exceeds'
    ]
    if exceeded:
        return f'{label} exceeds the datasheet of {name} in {", ".join(exceeded)}'
    n_undecided = sum(c.verdict == 'undecided' for c in checks)
    if n_undecided == len(checks):
        return f'{label} cannot be judged by the datasheet of {name}'
    note = f'; {n_undecided} of {len(checks)} are undecided' if n_undecided else ''
    return f'{label} is within the datasheet of {name}{note}'


def sentences(comparison: RunComparison) -> Iterator[str]:
    """Yield the results of a comparison as sentences.

    The first sentences name recordings whose coefficients do not describe the sensor, for example
    because it moved. Then one sentence for each further recording compares it with the first
    recording. If ``comparison.within`` is set, further sentences state the results of the tests of
    equivalence with the first recording. The last sentences judge the recordings with datasheets.
    """
    for label, results in comparison.runs.items():
        for finding in grouped(results.findings):
            if finding.id in (*WRONG_UNITS, *UNSUITABLE):
                yield f'{label}: {texts_of(finding).message.rstrip(".")}'
    for each in comparison.differences.items():
        yield _sentence(comparison, *each)
    for each in comparison.differences.items() if comparison.within else ():
        yield _equivalence_sentence(comparison, *each)
    for label, results in comparison.checked:
        yield _datasheet_sentence(label, results)
