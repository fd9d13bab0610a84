# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Strategies that draw odd numbers and texts, and damage bytes and the numbers in them."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

_POWERS = (1, 2, 8, 12, 16, 24, 31, 32, 62, 63, 64)

ODD_INTEGERS = (0, *(2**power for power in _POWERS[:-1]), *(2**power - 1 for power in _POWERS))
"""Lengths, counts and offsets at which programs often fail."""

ODD_FLOATS = (0.0, -0.0, 5e-324, 1e-310, 1e-160, 1e-9, 1e18, 1e154, 1e300, 1.8e308, math.nan)

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
ODD_TEXTS += ('=1+1', '<script>', 'a' * 2000, '𝄞' * 50, "'; DROP TABLE topics; --")

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


def any_bytes(seeds: Sequence[bytes]) -> SearchStrategy[bytes]:
    """Draw damaged seeds, and sometimes random bytes."""
    return damaged(seeds) | damaged(seeds) | damaged(seeds) | st.binary(max_size=600)
