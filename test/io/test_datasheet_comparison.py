# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison with a datasheet, its findings, and how it is stored."""

from __future__ import annotations

import json

import pytest

from allan_ros.core.fit import Coefficient
from allan_ros.io.datasheets import Datasheet, Limit, Source
from allan_ros.io.documents import results_from_document, results_to_document
from allan_ros.io.results import Results


def sheet_of(**limits: float) -> Datasheet:
    """Return a datasheet that states limits of gyro_x, in SI."""
    stated = {term: Limit(value, f'{value:g} SI') for term, value in limits.items()}
    return Datasheet('X-1', 'Maker', {'a': Source('X-1', 'Rev. A')}, {'gyro_x': stated}, {})


def held(results: Results, **limits: float) -> Results:
    return results.against_datasheet(sheet_of(**limits), 0.2)


@pytest.mark.parametrize('share, verdict', [(1.0, 'within'), (0.9, 'within'), (0.5, 'exceeds')])
def test_the_complete_interval_decides(small_results: Results, share: float, verdict: str) -> None:
    n: Coefficient = small_results.axes['gyro_x'].fit.noise['N']
    assert n.value is not None
    against = held(small_results, N=n.value * share)
    assert against.datasheet is not None
    assert against.datasheet.verdict == verdict
    [entry] = against.datasheet.comparisons
    assert (entry.axis, entry.term, entry.verdict) == ('gyro_x', 'N', verdict)
    new = against.findings[len(small_results.findings) :]
    assert [f.id for f in new] == ['exceeds_limit'] * (verdict == 'exceeds')
    assert all(f.axes == ('gyro_x',) and 'of X-1' in f.message for f in new)


def test_the_worst_verdict_is_that_of_all(small_results: Results) -> None:
    against = held(small_results, N=1e-9, B=1.0).datasheet
    assert against is not None
    assert [c.verdict for c in against.comparisons] == ['exceeds', 'within']
    assert against.verdict == 'exceeds'
    nothing = held(small_results).datasheet
    assert nothing is not None
    assert nothing.verdict is None


def test_a_second_datasheet_replaces_the_findings_of_the_first(small_results: Results) -> None:
    beyond = held(small_results, N=1e-9)
    assert held(beyond, N=1e-9).findings == beyond.findings
    assert held(beyond, N=1.0).findings == small_results.findings


def test_the_round_trip_of_the_document_is_complete(small_results: Results) -> None:
    against = held(small_results, N=1e-9, B=1.0)
    document = json.loads(json.dumps(results_to_document(against), allow_nan=False))
    assert document['datasheet']['axes']['gyro_x']['N']['verdict'] == 'exceeds'
    assert document['datasheet']['axes']['gyro_x']['N']['unit'] == 'rad/s/sqrt(Hz)'
    again = results_from_document(document)
    assert again.datasheet == against.datasheet
    before = json.loads(json.dumps(results_to_document(small_results)))
    assert results_from_document(before).datasheet is None
