# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Documents with a valid schema and absurd values: right types, impossible numbers."""

from __future__ import annotations

import copy
import json
from typing import Any

from hypothesis import strategies as st

from .damage import as_utf8
from .documents_target import FITTED, check, seeds
from .harness import Target

INTEGERS = (0, 1, 2, 3, 10, 1000, 2**31, 2**53, 2**62, 2**63 - 1)
FLOATS = (0.0, 5e-324, 1e-300, 1e-160, 1e-30, 1.0, 1e30, 1e100, 1e150, 1e154, 1e200, 1.7e308)


@st.composite
def _documents(draw: Any) -> tuple[str, bytes, int]:
    """Draw a document in which one to four numbers, or complete lists of them, are absurd."""
    sums, results = seeds()
    kind = draw(st.sampled_from(['sums', 'sums', 'sums', 'results', 'checkpoint']))
    document = copy.deepcopy(results if kind == 'results' else sums)
    for _ in range(draw(st.integers(1, 4))):
        places = list(_places(document))
        parent, key = places[draw(st.integers(0, len(places) - 1))]
        parent[key] = _absurd(draw, parent[key])
    choice = draw(st.integers(0, 99))
    return kind, as_utf8(json.dumps(document)), choice - choice % FITTED  # always fitted


def _places(value: Any) -> Any:
    """Yield container and key of every number and every list of numbers."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        if _is_number(inner):
            yield value, key
        elif isinstance(inner, (dict, list)):
            if isinstance(inner, list) and inner and all(map(_is_number, inner)):
                yield value, key
                if len(inner) > 8:
                    continue  # so that long lists do not displace all other values
            yield from _places(inner)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _absurd(draw: Any, value: Any) -> Any:
    if isinstance(value, list):
        match draw(st.sampled_from(['all', 'one', 'shorter', 'longer', 'reversed'])):
            case 'all':
                return [_absurd(draw, value[0])] * len(value)
            case 'one':
                at = draw(st.integers(0, len(value) - 1))
                return [*value[:at], _absurd(draw, value[at]), *value[at + 1 :]]
            case 'shorter':
                return value[:-1]
            case 'longer':
                return [*value, value[-1]]
        return value[::-1]
    sign = draw(st.sampled_from([1, 1, 1, -1]))
    if isinstance(value, int):
        return sign * draw(st.sampled_from(INTEGERS))
    return sign * draw(st.sampled_from(FLOATS))


TARGET = Target('absurd', _documents(), check)
