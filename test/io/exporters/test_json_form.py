# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging into a user's JSON: new numbers in, every other value as it was."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.io.exporters import Entry
from allan_ros.io.exporters.forms import HEADER_KEY, JsonForm

ENTRIES = [Entry(('value0', 'rate'), 200.0), Entry(('value0', 'noise'), [1e-3, 2e-3, 3e-3])]
NEW = {'rate': 200.0, 'noise': [1e-3, 2e-3, 3e-3]}

trees = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(-1e9, 1e9), st.text(max_size=5)),
    lambda tree: st.one_of(
        st.lists(tree, max_size=3), st.dictionaries(st.text(max_size=4), tree, max_size=3)
    ),
    max_leaves=8,
)


@given(
    cameras=trees,
    value0=st.dictionaries(st.text(max_size=4), trees, max_size=3),
    again=st.integers(1, 3),
)
def test_all_else_stays(cameras: object, value0: dict, again: int) -> None:
    text = json.dumps({'value0': value0, 'cameras': cameras})
    for _ in range(again):
        text = JsonForm().merge(text, ENTRIES, ['first', 'second'])
    assert json.loads(text) == {
        'value0': {**value0, **NEW},
        'cameras': cameras,
        HEADER_KEY: ['first', 'second'],
    }


def test_what_is_no_measurement_is_left_alone() -> None:
    kept = [Entry(('value0', 'rate'), 200.0, keep=True)]
    text = JsonForm().merge('{"value0": {"rate": 5}}', kept, [])
    assert json.loads(text)['value0'] == {'rate': 5}


@pytest.mark.parametrize(
    ('mine', 'said'),
    [
        ('', 'not JSON'),
        ('{"value0": NaN}', 'NaN is not a JSON number'),
        ('[1]', 'not a JSON object'),
        ('{"value0": 1}', 'value0 of the file to merge into is not a JSON object'),
        ('[' * 100_000, 'not JSON'),
    ],
)
def test_what_cannot_be_merged_into_is_refused(mine: str, said: str) -> None:
    with pytest.raises(AllanError, match=said):
        JsonForm().merge(mine, ENTRIES, [])
