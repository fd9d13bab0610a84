# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory for large arrays that are written often.

A processor writes 64 bytes at once. Writing takes up to three times as long if these bytes are in
two lines of the processor cache. numpy aligns arrays only to 16 bytes.
"""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

LINE = 64
"""Number of bytes in a line of the processor cache."""

KNOWN = 32
"""Largest number of combinations of shapes whose arrays are kept for the next request."""


def aligned(shape: tuple[int, ...], kind: str = 'f8') -> NDArray[Any]:
    """Return an array of undefined values that begins at the start of a cache line.

    ``kind`` is the dtype of the array.

    >>> aligned((3, 8)).__array_interface__['data'][0] % 64
    0
    """
    size = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.empty(size + LINE, np.uint8)
    start = -memory.__array_interface__['data'][0] % LINE
    return memory[start : start + size].view(kind).reshape(shape)


class WorkMemory(threading.local):
    """Memory of a thread that is reused for temporary arrays.

    New arrays of some 100 kB would cause a page fault for every 4 kB. The memory grows to the size
    of the largest request and never shrinks, so the requested arrays must be of limited size.
    """

    def __init__(self) -> None:
        self._memory = aligned((0,), 'u1')
        self._known: dict[tuple[object, ...], list[NDArray[Any]]] = {}

    def arrays(self, kind: str, *shapes: tuple[int, ...]) -> list[NDArray[Any]]:
        """Return an aligned array of undefined values for each shape, valid until the next call.

        ``kind`` is the dtype of all arrays.
        """
        key = (kind, *shapes)
        if key in self._known:
            return self._known[key]
        sizes = [math.prod(shape) * np.dtype(kind).itemsize for shape in shapes]
        begins = [0]
        for size in sizes:
            begins.append(begins[-1] + size + -size % LINE)
        if self._memory.nbytes < begins[-1]:
            self._memory = aligned((begins[-1],), 'u1')
            self._known.clear()
        elif len(self._known) >= KNOWN:
            self._known.clear()
        parts = (self._memory[begin : begin + size] for begin, size in zip(begins, sizes))
        found = [part.view(kind).reshape(shape) for part, shape in zip(parts, shapes)]
        self._known[key] = found
        return found
