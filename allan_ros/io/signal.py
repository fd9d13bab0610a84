# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raw signal for plots: its lowest and highest value in each of up to 2048 bins.

A day at 1 kHz drawn this way shows every knock and needs the memory of a few thousand numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.imu import AXES, LARGEST, ImuBatch

MAX_BINS = 2048
"""More bins than a plot has pixels across; when all are full, neighbours are joined."""


class SignalEnvelope:
    """Lowest and highest sample of every axis in bins of equal sample count, in constant memory.

    The result does not depend on the size of the batches. NaN is ignored; a bin with nothing else
    is NaN.
    """

    def __init__(self) -> None:
        self._step = 1
        self._samples = 0
        self._low = np.empty((MAX_BINS, len(AXES)))
        self._high = np.empty((MAX_BINS, len(AXES)))
        self._start_ns = np.empty((MAX_BINS, 2), np.int64)

    def update(self, batch: ImuBatch) -> None:
        """Add the next samples."""
        while len(batch):
            room = MAX_BINS * self._step - self._samples
            if not room:
                self._join_neighbours()
                continue
            self._put(batch[:room])
            batch = batch[room:]

    @property
    def bins(self) -> int:
        """Number of bins."""
        return -(-self._samples // self._step)

    @property
    def low(self) -> NDArray[np.float64]:
        """Lowest sample of each bin, (bins, 6), SI."""
        return self._low[: self.bins]

    @property
    def high(self) -> NDArray[np.float64]:
        """Highest sample of each bin, (bins, 6), SI."""
        return self._high[: self.bins]

    @property
    def start_ns(self) -> NDArray[np.int64]:
        """Stamp of the first sample of each bin, (bins,).

        The header stamp, or the record time where header stamps do not advance.
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
        """Add samples that fit into the bins."""
        first = self._samples
        bins = (first + np.arange(len(batch))) // self._step
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        # values that no IMU measures are excluded here and in the sums
        samples = np.where(np.abs(batch.samples) <= LARGEST, batch.samples, np.nan)
        low = np.fmin.reduceat(samples, starts)
        high = np.fmax.reduceat(samples, starts)
        record = batch.stamps_ns if batch.record_ns is None else batch.record_ns
        start_ns = np.stack([batch.stamps_ns[starts], record[starts]], axis=1)
        at = int(bins[0])
        if first % self._step:  # the first bin has samples already
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
"""More than a plot has pixels across; when reached, every second item is removed."""


ABSOLUTE_ZERO = -273.15
"""0 K in degC."""


HOTTEST = 1000.0
"""degC; readings above it, or below 0 K, are ignored."""


@dataclass(frozen=True)
class TemperatureTrace:
    """Readings of one thermometer.

    Attributes
    ----------
    source : str
        The topic or the column.
    header_ns, record_ns : (n,) int64 arrays
        Times of measurement and of recording; equal where only one is known.
    celsius : (n,) float64 array
    """

    source: str
    header_ns: NDArray[np.int64]
    record_ns: NDArray[np.int64]
    celsius: NDArray[np.float64]


def trace_of(source: str, readings: Iterable[tuple[int, int, float]]) -> TemperatureTrace | None:
    """Return readings (header ns, record ns, degC) as a trace, or None if none is plausible."""
    valid = [r for r in readings if ABSOLUTE_ZERO < r[2] < HOTTEST]  # false for NaN too
    if not valid:
        return None
    header, record, celsius = zip(*valid)
    return TemperatureTrace(
        source, np.array(header, np.int64), np.array(record, np.int64), np.array(celsius, float)
    )


class Decimated(Generic[Item]):
    """Every n-th item of a stream, in constant memory; n doubles when the memory is full.

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
        self._added = 0
        self._items: list[Item] = []

    def add(self, item: Item) -> None:
        """Add the next item."""
        if self._added % self._step == 0:
            if len(self._items) == self._most:
                self._items = self._items[::2]
                self._step *= 2
            if self._added % self._step == 0:
                self._items.append(item)
        self._added += 1

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)
