# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The temperature recorded beside an IMU, as a picture needs it: a few thousand readings.

It explains much of a slow drift and enters no number: it is only shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Item = TypeVar('Item')

MOST_READINGS = 2048
"""More than a plot has pixels across; when they are full, every second one goes."""

ABSOLUTE_ZERO = -273.15
"""degC in K 0."""

HOTTEST = 1000.0
"""degC: no IMU lives to tell of more; such a reading, or one below 0 K, is none."""


@dataclass(frozen=True)
class TemperatureTrace:
    """Readings of one thermometer.

    Attributes
    ----------
    source : str
        The topic or the column.
    header_ns, record_ns : (n,) int64 arrays
        When it was measured, and when it was recorded; equal where only one is known.
    celsius : (n,) float64 array
    """

    source: str
    header_ns: NDArray[np.int64]
    record_ns: NDArray[np.int64]
    celsius: NDArray[np.float64]


def trace_of(source: str, readings: Iterable[tuple[int, int, float]]) -> TemperatureTrace | None:
    """Return readings (header ns, record ns, degC) as a trace, or None where none is sound."""
    sound = [r for r in readings if ABSOLUTE_ZERO < r[2] < HOTTEST]  # false for NaN too
    if not sound:
        return None
    header, record, celsius = zip(*sound)
    return TemperatureTrace(
        source, np.array(header, np.int64), np.array(record, np.int64), np.array(celsius, float)
    )


class Thinned(Generic[Item]):
    """Every so many of a stream, evenly, in constant memory.

    Examples
    --------
    >>> kept = Thinned(most=4)
    >>> for i in range(9):
    ...     kept.add(i)
    >>> list(kept)
    [0, 4, 8]
    """

    def __init__(self, most: int = MOST_READINGS) -> None:
        self._most = most
        self._step = 1
        self._seen = 0
        self._items: list[Item] = []

    def add(self, item: Item) -> None:
        """Take the next one."""
        if self._seen % self._step == 0:
            if len(self._items) == self._most:
                self._items = self._items[::2]
                self._step *= 2
            if self._seen % self._step == 0:
                self._items.append(item)
        self._seen += 1

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)
