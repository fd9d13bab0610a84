# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings as data: the catalog, documents, merging and order."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.findings import example

from allan_ros.core import findings
from allan_ros.core.estimate import duration_text, significant
from allan_ros.core.fields import Fields
from allan_ros.core.findings import (
    CATALOG,
    QUANTITIES,
    SEVERITIES,
    Finding,
    by_consequence,
    finding,
    grouped,
    is_note,
)
from allan_ros.results.documents import finding_from_document

PACKAGE = Path(findings.__file__).parents[1]


def test_every_kind_of_finding_has_a_severity_and_values():
    for id, kind in CATALOG.items():
        assert id.isidentifier() and kind.severity in SEVERITIES
        assert all(name.isidentifier() for name in kind.values)
        assert {*kind.values.values()} <= {'', *QUANTITIES}


def test_every_kind_of_finding_is_reported_somewhere():
    code = ''.join(path.read_text('utf-8') for path in PACKAGE.rglob('*.py'))
    named = {*re.findall(r'\w+', code)}  # some ids are names of counts
    assert set(CATALOG) <= named


def test_a_finding_without_one_of_its_values_is_refused():
    with pytest.raises(KeyError, match='vibration: amplitude'):
        finding('vibration', ('gyro_x',), frequency=3.0)


@pytest.mark.parametrize('id', CATALOG)
def test_a_document_gives_the_same_finding(id):
    found = example(id, number=0.25)
    document = json.loads(json.dumps(found.document(), allow_nan=False))
    read = finding_from_document(Fields(document, 'finding'))
    assert read == found and str(read) == str(found)


def test_a_finding_of_another_version_keeps_its_texts():
    words = {'message': 'A {brace} of 5 %.', 'remedy': 'Close it.'}
    document = {**example('vibration').document(), **words, 'id': 'unheard'}
    for changed in (document, {**document, 'id': 'vibration', 'values': {}}):
        read = finding_from_document(Fields(changed, 'finding'))
        assert read.stated == tuple(words.values())
        assert read.document() == {**document, 'id': changed['id'], 'values': {}}


@given(
    st.lists(st.sampled_from(['vibration', 'lack_of_fit', 'no_noise', 'gaps', 'held']), max_size=9)
)
def test_merging_loses_no_axis_and_keeps_different_findings_apart(ids):
    axes = ('gyro_x', 'gyro_y', 'accel_z')
    found = [example(id, i + 1.0, axes[i % 3]) for i, id in enumerate(ids)]
    merged = grouped(found)
    pairs = {(f.id, axis) for f in found for axis in f.axes}
    assert {(f.id, axis) for f in merged for axis in f.axes} == pairs
    assert grouped(merged) == merged
    kept = [Finding('x', 'info', values={'path': path}) for path in 'ab']
    assert set(grouped(kept)) == set(kept)


def test_findings_are_in_the_order_of_their_consequence():
    expected = [
        finding('no_noise', ('gyro_x',)),
        finding('gyro_unit', n=1.0, rate=1.0),
        Finding('unknown', 'error'),
        finding('bias_steps', ('gyro_x',), size=1.0, share=0.5, at='3 h'),
        finding('lack_of_fit', ('accel_x',), frequency=1.0, deviation=0.3),
        finding('vibration', ('gyro_x',), frequency=1.0, amplitude=1.0),
        finding('settling', ('gyro_x',), size=1.0, time=60.0),
        Finding('unknown', 'warning'),
        finding('lack_of_fit', ('accel_x',), frequency=1.0, deviation=0.01),
        finding('level_changes', ('gyro_x',), which='here', value=1.0, low=0.99, high=1.003),
        Finding('unknown', 'info'),
    ]
    assert by_consequence(expected) == tuple(expected)
    assert set(by_consequence(reversed(expected))[:5]) == set(expected[:5])
    assert [is_note(each) for each in expected] == [False] * 8 + [True] * 3


def test_the_order_names_only_findings_that_exist():
    listed = [*findings._FAULTS, *findings._NUMBERS]
    others = {*findings.LIVE, *findings.UNUSABLE, *findings.MINOR}
    assert {*listed, *others} <= set(CATALOG) and len(set(listed)) == len(listed)


@given(st.floats(1e-12, 1e12), st.integers(2, 6))
def test_shown_numbers_equal_the_values_to_their_digits(value, digits):
    expected = pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))
    assert float(significant(value, digits)) == expected


@pytest.mark.parametrize(
    'seconds, digits, text',
    [(34.5, 3, '34.5 s'), (34.5, 2, '34 s'), (655.0, 3, '10.9 min'), (7200.0, 3, '2 h'),
     (1e-3, 2, '0.001 s'), (0.0, 2, '0 s'), (864000.0, 3, '10 days')],
)  # fmt: skip
def test_durations(seconds, digits, text):
    assert duration_text(seconds, digits) == text
