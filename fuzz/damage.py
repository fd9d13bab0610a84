# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Strategies that damage bytes, the numbers in them, JSON and text."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

ODD_INTEGERS: tuple[int, ...] = (
    0,
    1,
    2,
    127,
    255,
    256,
    4096,
    65535,
    2**24,
    2**31 - 1,
    2**31,
    2**32 - 1,
)
ODD_INTEGERS += (2**62, 2**63 - 1, 2**63, 2**64 - 1)
"""Lengths, counts and offsets at which programs often fail."""

ODD_FLOATS: tuple[float, ...] = (
    0.0,
    -0.0,
    5e-324,
    1e-310,
    1e-160,
    1e-9,
    9.80665,
    1e18,
    1e154,
    1e300,
    1.8e308,
)
ODD_FLOATS += (math.inf, math.nan)

ODD_TEXTS: tuple[str, ...] = (
    '',
    '/',
    '..',
    '../../x',
    '\0',
    'a\nb',
    '\x1b[2J',
    '\u202e',
    '\ud800',
    'é',
    '{}',
    '%s',
)
ODD_TEXTS += ('a' * 2000, '𝄞' * 50, '=1+1', '<script>', "'; DROP TABLE topics; --")

integers = st.sampled_from(ODD_INTEGERS) | st.integers(0, 2**64 - 1) | st.integers(0, 300)
signed = integers | integers.map(lambda value: -value)
floats = st.sampled_from(ODD_FLOATS).flatmap(lambda f: st.sampled_from((f, -f))) | st.floats()
texts = st.sampled_from(ODD_TEXTS) | st.text(max_size=20)

WIDTHS = {1: '<B', 2: '<H', 4: '<I', 8: '<Q'}
"""Size of a little-endian number -> format of struct."""


@st.composite
def damaged(draw: Any, seeds: Sequence[bytes], most: int = 4) -> bytes:
    """Draw one of the seeds with some bytes or numbers changed, removed, repeated or cut off."""
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(1, most))):
        if not data:
            break
        at = draw(st.integers(0, len(data) - 1))
        match draw(st.sampled_from(['number', 'byte', 'cut', 'delete', 'double', 'insert'])):
            case 'number':
                width = draw(st.sampled_from(list(WIDTHS)))
                value = draw(integers) % (1 << (8 * width))
                data[at : at + width] = struct.pack(WIDTHS[width], value)
            case 'byte':
                data[at] ^= 1 << draw(st.integers(0, 7))
            case 'cut':
                del data[at:]
            case 'delete':
                del data[at : at + draw(st.integers(1, 64))]
            case 'double':
                part = data[at : at + draw(st.integers(1, 256))]
                data[at:at] = part
            case 'insert':
                data[at:at] = draw(st.binary(min_size=1, max_size=32))
    return bytes(data)


HUGE = 'HUGE'
"""Placeholder for 1e400, which is a valid number in JSON and too large for a float."""

scalars = (
    st.none()
    | st.booleans()
    | signed
    | floats
    | texts
    | st.sampled_from([10**400, -(10**30), HUGE])
)


def _nested(depth: int) -> Any:
    value: Any = 0
    for _ in range(depth):
        value = [value]
    return value


json_values = (
    scalars
    | st.lists(scalars, max_size=3)
    | st.dictionaries(texts, scalars, max_size=3)
    | st.sampled_from([_nested(50), _nested(500), [0.0] * 5000, {'axes': {}}])
)


@st.composite
def damaged_json(draw: Any, seeds: Sequence[Any], most: int = 3) -> str:
    """Draw one of the documents as text, with fields replaced, removed, repeated or added."""
    document = json.loads(json.dumps(draw(st.sampled_from(seeds))))
    doubled = ''
    for _ in range(draw(st.integers(0, most))):
        parent, key = _somewhere(draw, document)
        if parent is None:
            document = draw(json_values)
            continue
        match draw(
            st.sampled_from(['replace', 'replace', 'replace', 'remove', 'rename', 'grow', 'double'])
        ):
            case 'replace':
                parent[key] = draw(json_values)
            case 'remove':
                del parent[key]
            case 'rename' if isinstance(parent, dict):
                parent[draw(texts)] = parent.pop(key)
            case 'grow' if isinstance(parent, list):
                parent *= draw(st.integers(0, 5))
            case 'double' if isinstance(document, dict) and document:
                doubled = json.dumps({draw(st.sampled_from(list(document))): draw(json_values)})
    text = json.dumps(document, ensure_ascii=draw(st.booleans()))
    if doubled and text.endswith('}'):
        text = f'{text[:-1]}, {doubled[1:]}'  # the same key twice
    return text.replace(f'"{HUGE}"', '1e400')


def _somewhere(draw: Any, document: Any) -> tuple[Any, Any]:
    """Return a container in the document and a key of it; (None, None) for the document itself."""
    parent = key = None
    here = document
    while isinstance(here, (dict, list)) and here:
        if parent is not None and draw(st.integers(0, 5)) == 0:
            break
        parent = here
        key = (
            draw(st.sampled_from(list(here)))
            if isinstance(here, dict)
            else draw(st.integers(0, len(here) - 1))
        )
        here = here[key]
    return parent, key


def as_utf8(text: str) -> bytes:
    """Return the text as UTF-8, lone surrogates included."""
    return text.encode('utf-8', 'surrogatepass')


def any_bytes(seeds: Sequence[bytes]) -> SearchStrategy[bytes]:
    """Draw damaged seeds, and sometimes random bytes."""
    return damaged(seeds) | damaged(seeds) | damaged(seeds) | st.binary(max_size=600)
