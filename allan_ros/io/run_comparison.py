# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs side by side: against the first of them, and against datasheets."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.batch import AXES
from ..core.differences import (
    FAMILY_ERROR,
    DeviationCurve,
    Difference,
    coefficient_differences,
    curve_differences,
    settle,
)
from ..core.errors import AllanError
from .datasheet_comparison import (
    DatasheetComparison,
    against_datasheet,
    comparison_to_document,
)
from .documents import (
    SUMS_SCHEMA,
    read_json,
    results_from_document,
    results_to_document,
    sums_file_from_document,
)
from .results import AxisCurve, Results, analyse_sums
from .sensors import Datasheet

SCHEMA = 'allan_ros/comparison/1'

DOCUMENTS = ('results.json', 'sums.json')
"""What is read of a folder of results, the first that is there."""


@dataclass(frozen=True)
class Subject:
    """One run under the name it is shown by."""

    label: str
    results: Results


@dataclass(frozen=True)
class Pair:
    """How one run differs from the first.

    Attributes
    ----------
    first, second : str
        Labels of the two.
    differences : tuple of Difference
        By axis: the five terms, then the deviations at common averaging times.
    """

    first: str
    second: str
    differences: tuple[Difference, ...]

    @property
    def beyond(self) -> tuple[Difference, ...]:
        """Those that are more than chance."""
        return tuple(d for d in self.differences if d.verdict in ('higher', 'lower'))

    def of(self, axis: str, quantity: str) -> Difference | None:
        """Return the difference of a term of an axis, where both runs have it."""
        of_axis = (d for d in self.differences if d.axis == axis)
        return next((d for d in of_axis if d.quantity == quantity), None)


@dataclass(frozen=True)
class RunComparison:
    """Several runs, what tells them apart, and how they stand to datasheets.

    Attributes
    ----------
    runs : tuple of Subject
        The first is what the others are compared with.
    pairs : tuple of Pair
        One for each other run.
    beside : tuple of (label, DatasheetComparison)
        Every run beside every datasheet.
    family_error : float
        Probability that any of all differences is called one by chance.
    """

    runs: tuple[Subject, ...]
    pairs: tuple[Pair, ...]
    beside: tuple[tuple[str, DatasheetComparison], ...]
    family_error: float = FAMILY_ERROR

    @property
    def differs(self) -> bool:
        """Whether anything differs by more than chance, or is beyond a datasheet."""
        return any(pair.beyond for pair in self.pairs) or any(
            comparison.verdict == 'beyond' for _, comparison in self.beside
        )


def compare_runs(
    runs: Sequence[Subject], datasheets: Sequence[Datasheet] = (), margin: float = 0.0
) -> RunComparison:
    """Return each run against the first, and each beside each datasheet.

    Raises
    ------
    AllanError
        When there is nothing to compare, or two runs share no axis.
    """
    if len(runs) + len(datasheets) < 2 or not runs:
        raise AllanError('give two runs, or one and a datasheet: there is nothing to compare')
    first, *others = runs
    found = [(other.label, d) for other in others for d in _differences(first, other)]
    settled = settle([d for _, d in found])
    by_label = [(label, d) for (label, _), d in zip(found, settled)]
    return RunComparison(
        tuple(runs),
        tuple(
            Pair(first.label, o.label, tuple(d for label, d in by_label if label == o.label))
            for o in others
        ),
        tuple(
            (run.label, against_datasheet(_noise(run.results), datasheet, margin))
            for datasheet in datasheets
            for run in runs
        ),
    )


def read_run(path: str | os.PathLike[str], method: str = 'gls') -> Results | None:
    """Return the results of a results.json, a sums.json or a folder of results.

    None where it is none of these: a recording, perhaps.

    Raises
    ------
    AllanError
        When it is one of these and cannot be read.
    """
    place = Path(path)
    if place.is_dir():
        place = next((place / name for name in DOCUMENTS if (place / name).is_file()), place)
    if place.suffix.lower() != '.json':
        return None
    document = read_json(place)
    if isinstance(document, dict) and document.get('schema') == SUMS_SCHEMA:
        return analyse_sums(*sums_file_from_document(document, str(place)), method)
    return results_from_document(document, str(place))


def labels_of(paths: Sequence[str]) -> list[str]:
    """Return a short name for each path: its folder or stem where that tells them apart."""
    short = [
        Path(path).resolve().parent.name if Path(path).name in DOCUMENTS else Path(path).stem
        for path in paths
    ]
    unique = len(set(short)) == len(short) and all(short)
    return short if unique else [str(path) for path in paths]


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
                'differences': [_difference_document(d) for d in pair.differences],
            }
            for pair in comparison.pairs
        ],
        'datasheets': [
            {'run': label, **comparison_to_document(beside)} for label, beside in comparison.beside
        ],
    }


def _difference_document(difference: Difference) -> dict[str, Any]:
    ci95 = difference.ci95
    return {
        'axis': difference.axis,
        'quantity': difference.quantity,
        'tau_s': difference.tau,
        'ratio': difference.ratio,
        'ci95': ci95 and [end if math.isfinite(end) else None for end in ci95],
        'p': difference.p,
        'verdict': difference.verdict,
    }


def _differences(first: Subject, second: Subject) -> Iterator[Difference]:
    axes = [a for a in AXES if a in first.results.axes and a in second.results.axes]
    if not axes:
        raise AllanError(
            f'{second.label} has {", ".join(second.results.axes)} where {first.label} has '
            f'{", ".join(first.results.axes)}: they share no axis to compare'
        )
    for axis in axes:
        a, b = first.results.axes[axis], second.results.axes[axis]
        yield from coefficient_differences(axis, a.fit.noise, b.fit.noise)
        if a.curve is not None and b.curve is not None:
            yield from curve_differences(axis, _deviations(a.curve), _deviations(b.curve))


def _deviations(curve: AxisCurve) -> DeviationCurve:
    return DeviationCurve(curve.tau, curve.adev, curve.ci_low, curve.ci_high)


def _noise(results: Results) -> dict[str, Any]:
    return {axis: result.fit.noise for axis, result in results.axes.items()}
