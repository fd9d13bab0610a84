# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory for large arrays that are written often.

A processor writes 64 bytes at once. Writing takes up to three times as long if these bytes lie in
two cache lines. numpy arrays begin at any multiple of 16 bytes; the arrays of this module begin at
the start of a cache line.
"""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

LINE = 64
"""Size of a line of the processor cache in bytes."""

KNOWN = 32
"""Largest number of requests (each a dtype and several shapes) whose work arrays are kept."""


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

    New arrays of some 100 kB would cause a page fault for every 4 kB. The reused memory grows to
    the size of the largest request and never shrinks, so the size of requests must be limited.
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
        starts = [0]
        for size in sizes:
            starts.append(starts[-1] + size + -size % LINE)
        if self._memory.nbytes < starts[-1]:
            self._memory = aligned((starts[-1],), 'u1')
            self._known.clear()
        elif len(self._known) >= KNOWN:
            self._known.clear()
        parts = (self._memory[start : start + size] for start, size in zip(starts, sizes))
        arrays_of_shapes = [part.view(kind).reshape(shape) for part, shape in zip(parts, shapes)]
        self._known[key] = arrays_of_shapes
        return arrays_of_shapes
