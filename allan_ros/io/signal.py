# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raw signal as a picture needs it: its lowest and highest value in each of many spans.

Drawn so, a day at 1 kHz shows every knock and takes the memory of a few thousand numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.imu import AXES, LARGEST, ImuBatch

MAX_BINS = 2048
"""More spans than a plot has pixels across; when they are full, neighbours are joined."""


class SignalEnvelope:
    """Lowest and highest sample of every axis in spans of equal count, in constant memory.

    The spans are counted in samples, so chunking changes nothing. NaN is passed over; a span with
    nothing else is NaN.
    """

    def __init__(self) -> None:
        self._step = 1
        self._samples = 0
        self._low = np.empty((MAX_BINS, len(AXES)))
        self._high = np.empty((MAX_BINS, len(AXES)))
        self._start_ns = np.empty((MAX_BINS, 2), np.int64)

    def update(self, batch: ImuBatch) -> None:
        """Take in the next samples."""
        while len(batch):
            room = MAX_BINS * self._step - self._samples
            if not room:
                self._join_neighbours()
                continue
            self._put(batch[:room])
            batch = batch[room:]

    @property
    def bins(self) -> int:
        """How many spans there are."""
        return -(-self._samples // self._step)

    @property
    def low(self) -> NDArray[np.float64]:
        """Lowest sample of each span, (bins, 6), SI."""
        return self._low[: self.bins]

    @property
    def high(self) -> NDArray[np.float64]:
        """Highest sample of each span, (bins, 6), SI."""
        return self._high[: self.bins]

    @property
    def start_ns(self) -> NDArray[np.int64]:
        """Stamp of the first sample of each span, (bins,).

        By the header, or by the time of recording where the header's does not advance.
        """
        header, record = self._start_ns[: self.bins].T
        stamps: NDArray[np.int64] = header if np.ptp(header) > 0 else record
        return stamps

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Start of each bin since the first sample in s, (bins,), never decreasing."""
        stamps = self.start_ns.astype(float)  # int64 may overflow when subtracted
        return np.asarray(np.maximum.accumulate((stamps - stamps[:1]) * 1e-9), float)

    def _put(self, batch: ImuBatch) -> None:
        """Add samples that fit into the spans there are."""
        first = self._samples
        spans = (first + np.arange(len(batch))) // self._step
        starts = np.flatnonzero(np.diff(spans, prepend=-1))
        # no picture shows what no IMU measures, nor do the sums contain it
        samples = np.where(np.abs(batch.samples) <= LARGEST, batch.samples, np.nan)
        low = np.fmin.reduceat(samples, starts)
        high = np.fmax.reduceat(samples, starts)
        record = batch.stamps_ns if batch.record_ns is None else batch.record_ns
        start_ns = np.stack([batch.stamps_ns[starts], record[starts]], axis=1)
        at = int(spans[0])
        if first % self._step:  # the first span had begun before
            low[0] = np.fmin(low[0], self._low[at])
            high[0] = np.fmax(high[0], self._high[at])
            start_ns[0] = self._start_ns[at]
        filled = slice(at, at + len(starts))
        self._low[filled], self._high[filled], self._start_ns[filled] = low, high, start_ns
        self._samples += len(batch)

    def _join_neighbours(self) -> None:
        half = MAX_BINS // 2
        self._low[:half] = np.fmin(self._low[::2], self._low[1::2])
        self._high[:half] = np.fmax(self._high[::2], self._high[1::2])
        self._start_ns[:half] = self._start_ns[::2]
        self._step *= 2


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


class Decimated(Generic[Item]):
    """Every so many of a stream, evenly, in constant memory.

    Examples
    --------
    >>> kept = Decimated(most=4)
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
