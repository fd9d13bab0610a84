# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Documents of a valid schema with absurd values: used, or rejected in one line."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Iterator
from typing import Any

import pytest

from allan_ros.api.classes import Results
from allan_ros.cli.result_lines import results_lines
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.errors import AllanError
from allan_ros.export import make_export
from allan_ros.readers.files import to_json
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.comparison import (
    compare_runs,
    comparison_document,
)
from allan_ros.results.documents import (
    results_from_document,
    results_to_document,
    sums_file_from_document,
    sums_file_to_document,
)
from allan_ros.view.verdict_text import verdict_of

ABSURD = [0, -1, 1, 1e-300, 1e12, 1e150, -1e150, 2**61, None, '\x1b[31m', [], {}, True]

TRIED = 15
"""Places of each document that are changed, drawn with a fixed seed."""

Place = tuple[Any, ...]


def places(value: object, above: Place = ()) -> Iterator[Place]:
    """Yield the place of every value of a document."""
    if above:
        yield above
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*above, key))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from places(item, (*above, i))


def changes(document: dict[str, Any], seed: int) -> Iterator[dict[str, Any]]:
    """Yield the document with one absurd value, at places of every kind."""
    rng = random.Random(seed)
    kinds: dict[Place, list[Place]] = {}
    for place in places(document):
        kinds.setdefault(tuple(k for k in place if isinstance(k, str)), []).append(place)
    for kind in rng.sample(sorted(kinds), min(TRIED, len(kinds))):
        place = rng.choice(kinds[kind])
        changed = copy.deepcopy(document)
        home = changed
        for key in place[:-1]:
            home = home[key]
        home[place[-1]] = rng.choice(ABSURD)
        yield changed


def use_results(results: Results) -> None:
    for text in (repr(results), *results_lines(results, verdict_of(results), 'deg/h', 100)):
        assert '\x1b' not in text
    Results.of(results).table()
    to_json(results_to_document(results))
    for target in ('kalibr', 'px4'):
        make_export(results, target)


@pytest.mark.parametrize('seed', range(2))
def test_results_are_used_or_rejected(seed: int, small_results: Results) -> None:
    document = json.loads(to_json(results_to_document(small_results)))
    used = 0
    for changed in changes(document, seed):
        try:
            results = results_from_document(changed)
            used += 1
            use_results(results)
            comparison = compare_runs({'a': small_results, 'b': results})
            to_json(comparison_document(comparison))
        except AllanError:
            continue
    assert used


def test_sums_are_used_or_rejected(small_run: tuple[AllanSums, Provenance]) -> None:
    sums, provenance = small_run
    document = json.loads(to_json(sums_file_to_document([sums], provenance)))
    used = 0
    for changed in changes(document, 2):
        try:
            read, its_provenance = sums_file_from_document(changed)
            used += 1
            repr(analyze_sums(read, its_provenance, 'paper'))
            analyze_sums([sums + each for each in read], its_provenance, 'paper')
        except AllanError:
            continue
    assert used
