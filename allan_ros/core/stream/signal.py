# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Summary of the raw signal for charts, in memory that does not depend on the recording length.

`SignalEnvelope` stores the range, mean and noise of the samples in each of up to 2048 bins, so that
a chart shows every shock. `SignalSummary` places all recordings on one time axis, with the excluded
times and the reasons for their exclusion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from ..imu import AXES, LARGEST, Flags, Floats, ImuBatch, Stamps
from .health import Event, Segment

MAX_BINS = 2048
"""Largest number of bins, which exceeds the width of a chart in pixels. When all bins are full,
pairs of bins are joined."""


BIN_STATISTICS: dict[str, Any] = {
    'low': np.fmin,
    'high': np.fmax,
    'total': np.add,
    'count': np.add,
    'square': np.add,
    'pairs': np.add,
}
"""Statistics of a bin, and the function that joins two bins: lowest and highest sample; sum and
number of samples; sum of squared differences of successive samples, and number of differences."""


class SignalEnvelope:
    """Range, mean and noise of every axis in bins of equal sample count, in constant memory.

    The last bin may have fewer samples. Except for rounding errors, the result does not depend on
    the size of the batches. NaN and values of a magnitude above `LARGEST` are ignored; the range of
    a bin without other values is NaN.
    """

    def __init__(self) -> None:
        self._step = 1
        self._samples = 0
        self._bins = {name: np.empty((MAX_BINS, len(AXES))) for name in BIN_STATISTICS}
        self._start_ns = np.empty((MAX_BINS, 2), np.int64)
        self._last = np.full((1, len(AXES)), np.nan)

    def update(self, batch: ImuBatch) -> None:
        """Add the next samples."""
        while len(batch):
            number_free = MAX_BINS * self._step - self._samples
            if not number_free:
                half = MAX_BINS // 2
                for name, join in BIN_STATISTICS.items():
                    values = self._bins[name]
                    values[:half] = join(values[::2], values[1::2])
                self._start_ns[:half] = self._start_ns[::2]
                self._step *= 2
                continue
            self._add_to_bins(batch[:number_free])
            batch = batch[number_free:]

    def with_accel(self, other: SignalEnvelope) -> SignalEnvelope:
        """Return a copy to which the accelerometer of another topic is added, in the same bins.

        The other topic must have samples.
        """
        joined = deepcopy(self)
        accel_columns = slice(len(AXES) // 2, None)
        # the bins of the other topic that cover the time of a bin are joined
        starts = np.searchsorted(other.start_ns[1:], self.start_ns, side='right')
        starts[:1] = 0
        for name, join in BIN_STATISTICS.items():
            values = other._bins[name][: other.bins, accel_columns]
            joined._bins[name][: self.bins, accel_columns] = join.reduceat(values, starts)
        return joined

    @property
    def bins(self) -> int:
        """Number of bins that contain samples."""
        return -(-self._samples // self._step)

    def statistics(self, step: int = 1) -> dict[str, Floats]:
        """Return name -> statistic of the samples in each group of ``step`` bins, (groups, 6).

        The samples are in SI.
        The last group may have fewer bins. `BIN_STATISTICS` lists the names of the statistics.
        """
        starts = np.arange(0, self.bins, step)
        return {
            name: join.reduceat(self._bins[name][: self.bins], starts)
            for name, join in BIN_STATISTICS.items()
        }

    @property
    def start_ns(self) -> Stamps:
        """Stamp of the first sample of each bin, (bins,), in ns.

        It is the header stamp, or the record time if the header stamps of all bins are equal.
        """
        header, record = self._start_ns[: self.bins].T
        stamps: Stamps = header if (header != header[:1]).any() else record
        return stamps

    @property
    def time_s(self) -> Floats:
        """Start of each bin, (bins,), in s since the first sample; the starts never decrease."""
        stamps = self.start_ns.astype(float)  # int64 may overflow when subtracted
        return np.asarray(np.maximum.accumulate((stamps - stamps[:1]) * 1e-9), float)

    def _add_to_bins(self, batch: ImuBatch) -> None:
        first = self._samples
        bins = (first + np.arange(len(batch))) // self._step
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        # values that no IMU measures are excluded, as from the Allan sums
        samples = np.where(np.abs(batch.samples) <= LARGEST, batch.samples, np.nan)
        squares = np.diff(np.concatenate([self._last, samples]), axis=0) ** 2
        self._last = samples[-1:]
        statistics = {'low': samples, 'high': samples}
        for name_of_number, name_of_sum, values in (
            ('count', 'total', samples),
            ('pairs', 'square', squares),
        ):
            is_finite = np.isfinite(values)
            statistics |= {
                name_of_sum: np.where(is_finite, values, 0.0),
                name_of_number: is_finite.astype(float),
            }
        record = batch.stamps_ns if batch.record_ns is None else batch.record_ns
        start_ns = np.stack([batch.stamps_ns[starts], record[starts]], axis=1)
        first_bin = int(bins[0])
        bin_slice = slice(first_bin, first_bin + len(starts))
        is_begun = bool(first % self._step)  # whether the first bin already contains samples
        if is_begun:
            start_ns[0] = self._start_ns[first_bin]
        self._start_ns[bin_slice] = start_ns
        for name, join in BIN_STATISTICS.items():
            joined = join.reduceat(statistics[name], starts)
            if is_begun:
                joined[0] = join(joined[0], self._bins[name][first_bin])
            self._bins[name][bin_slice] = joined
        self._samples += len(batch)


Item = TypeVar('Item')

ABSOLUTE_ZERO, HOTTEST = -273.15, 1000.0
"""Plausible range of a temperature in degC; readings outside of it are ignored."""

HOTTEST_IMU = 200.0
"""If the median of readings that are declared as degC is above this value, the readings are taken
as K. IMUs are specified up to 175 degC, and 200 K is below the lower limit of every IMU."""


@dataclass(frozen=True)
class TemperatureTrace:
    """Temperature readings of one sensor in a recording."""

    source: str  # topic or column of the readings
    header_ns: Stamps  # (n,) times of measurement
    record_ns: Stamps  # (n,) times of recording; equal to header_ns if unknown
    celsius: Floats  # (n,) temperatures in degC


def trace_of(source: str, readings: Iterable[tuple[int, int, float]]) -> TemperatureTrace | None:
    """Return the plausible readings of a temperature sensor; None if no reading is plausible.

    ``source`` is the topic or column of the readings, and a reading is (header stamp in ns, record
    time in ns, degC). If the median of the plausible readings is above `HOTTEST_IMU`, they are
    converted from K to degC.
    """
    plausible = [r for r in readings if ABSOLUTE_ZERO < r[2] < HOTTEST]  # NaN is not in the range
    if not plausible:
        return None
    header, record, values = zip(*plausible)
    celsius = np.array(values, float)
    if np.median(celsius) > HOTTEST_IMU:
        celsius += ABSOLUTE_ZERO
    return TemperatureTrace(source, np.array(header, np.int64), np.array(record, np.int64), celsius)


class Decimated(Generic[Item]):
    """Every n-th item of a stream; n doubles when more than ``most`` items would be kept.

    Examples
    --------
    >>> kept = Decimated(most=4)
    >>> for i in range(9):
    ...     kept.add(i)
    >>> list(kept)
    [0, 4, 8]
    """

    def __init__(self, most: int = MAX_BINS) -> None:
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


GAP_BINS = 3.0
"""A bin contains a gap if its duration exceeds the median duration by more than this factor."""


class Excluded(NamedTuple):
    """A period from ``start`` to ``end`` in s whose samples are excluded or, in a shock, replaced.

    ``why`` is the kind of an `Event`, or '' for another reason, such as warm-up.
    """

    start: float
    end: float
    why: str = ''


@dataclass(frozen=True)
class SignalTemperature:
    """Temperature over the time axis of a `SignalSummary`; NaN separates recordings."""

    source: str  # topic or column; several names if the recordings have different sources
    time_s: Floats  # (n,) times in s on the time axis of the summary
    celsius: Floats  # (n,) temperatures in degC


@dataclass(frozen=True)
class SignalSummary:
    """Signals of all recordings, one directly after the other on a common time axis."""

    time_s: Floats  # (bins,) start of each bin in s since the first sample of the first recording

    # (bins, 6) lowest sample in SI; NaN in the first bin of each recording after the first, and in
    # bins without data of the axis
    low: Floats
    high: Floats  # (bins, 6) highest sample in SI; NaN where `low` is NaN
    mean: Floats  # (bins, 6) mean of the samples in SI

    # (bins, 6) root mean square of the differences of successive samples / sqrt(2), in SI
    noise: Floats
    # (bins,) False for a bin that overlaps an excluded period or a shock. In a recording without
    # used samples, no period counts as excluded.
    used: Flags
    # (6,) median over the bins of (low + high) / 2, in SI; NaN for an axis without data
    middle: Floats
    # excluded periods; a period without a kind is contained only if it is longer than 0.1 % of the
    # recording
    excluded: tuple[Excluded, ...]

    # (start, end) in s of times without samples that are longer than 0.1 % of the recording
    gaps: tuple[tuple[float, float], ...]
    starts: tuple[float, ...]  # start of each recording in s
    temperature: SignalTemperature | None = None

    @property
    def reach(self) -> Floats:
        """Largest distance of ``low`` or ``high`` from ``middle`` in the used bins, (6,), in SI.

        If no axis has a distance above 0 in the used bins, all bins are examined. The result is 1
        for an axis without a distance above 0 in the examined bins.
        """
        sizes = np.fmax(np.abs(self.low - self.middle), np.abs(self.high - self.middle))
        for rows in (sizes[self.used], sizes):
            largest = np.fmax.reduce(rows, axis=0, initial=0.0)
            if largest.any():
                return np.where(largest > 0.0, largest, 1.0)
        return np.ones(len(AXES))


def summarize_signal(
    signals: Sequence[SignalEnvelope],
    segments: Sequence[Segment],
    bins: int,
    events: Sequence[Event] = (),
    temperatures: Sequence[TemperatureTrace | None] = (),
) -> SignalSummary | None:
    """Return the summary of all recordings, whose bins are joined to about ``bins`` bins in total.

    If the recordings have fewer bins, no bins are joined. Each recording keeps at least two bins,
    and recordings with fewer than two bins are omitted. Returns None if all recordings are
    omitted.

    ``signals`` are the signals of the recordings. ``temperatures`` contains the temperature or None
    for each recording. ``segments`` are the used parts of all recordings. ``events`` are the shocks
    in these parts, and the reasons why other parts are not used.
    """
    temperatures = temperatures or [None] * len(signals)
    recordings = [(s, t) for s, t in zip(signals, temperatures) if s.bins > 1]
    if not recordings:
        return None
    step = max(1, round(sum(signal.bins for signal, _ in recordings) / bins))
    parts: list[SignalSummary] = []
    offset = 0.0
    for signal, trace in recordings:
        # at least two groups of bins: the length of a group is computed from the starts of two
        part, length = _recording(
            signal, trace, segments, min(step, signal.bins // 2), events, offset
        )
        parts.append(part)
        offset += length
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ('time_s', 'low', 'high', 'mean', 'noise', 'used')
    }
    low, high = joined['low'], joined['high']
    middle = np.full(len(AXES), np.nan)
    is_present = ~np.all(np.isnan(low), axis=0)
    middle[is_present] = np.nanmedian(low[:, is_present] + high[:, is_present], axis=0) / 2.0
    joined |= {
        name: tuple(item for part in parts for item in getattr(part, name))
        for name in ('excluded', 'gaps', 'starts')
    }
    temperature = _joined([part.temperature for part in parts if part.temperature])
    return SignalSummary(middle=middle, temperature=temperature, **joined)


def _recording(
    signal: SignalEnvelope,
    trace: TemperatureTrace | None,
    segments: Sequence[Segment],
    step: int,
    events: Sequence[Event],
    offset: float,
) -> tuple[SignalSummary, float]:
    """Return the summary of one recording that begins at ``offset`` in s, and its length in s."""
    starts = np.arange(0, signal.bins, step)  # index of the first bin of each group of bins
    times = signal.time_s[starts]
    statistics = signal.statistics(step)
    low, high = statistics['low'], statistics['high']
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = statistics['total'] / statistics['count']
        noise = np.sqrt(statistics['square'] / (2.0 * statistics['pairs']))
    steps = np.diff(times)
    median_step = float(np.median(steps))
    length = float(times[-1] + median_step)
    # all bins have the same number of samples, so a much longer bin contains a gap
    gap_bins = np.flatnonzero(steps > GAP_BINS * median_step)
    gaps = [(float(times[i] + median_step), float(times[i + 1])) for i in gap_bins]
    first_ns = int(signal.start_ns[0])
    excluded = list(_excluded(_times(segments, first_ns, length), gaps, length))
    for event in events:
        for start, end in _times([event], first_ns, length):
            excluded = _marked(excluded, Excluded(start, end, event.kind))
    used = np.ones(len(times), bool)
    for period in excluded:
        used &= (times >= period.end) | (np.append(times[1:], length) <= period.start)
    if offset:
        low[0] = high[0] = np.nan  # NaN separates the lines of two recordings in a chart
    shortest = 1e-3 * length  # shorter periods are narrower than a line of a chart
    summary = SignalSummary(
        time_s=times + offset,
        low=low,
        high=high,
        mean=mean,
        noise=noise,
        used=used,
        middle=np.empty(0),
        excluded=tuple(
            Excluded(period.start + offset, period.end + offset, period.why)
            for period in excluded
            if period.why or period.end - period.start > shortest
        ),
        gaps=tuple((start + offset, end + offset) for start, end in gaps if end - start > shortest),
        starts=(offset,),
        temperature=None if trace is None else _temperature(trace, first_ns, length, offset),
    )
    return summary, length


def _times(
    items: Sequence[Segment | Event], first_ns: int, length: float
) -> list[tuple[float, float]]:
    starts = [(item.start_ns - first_ns) * 1e-9 for item in items]
    periods = [(start, start + item.duration_s) for start, item in zip(starts, items)]
    return [(start, end) for start, end in periods if start < length and end > 0.0]


def _excluded(
    used: Sequence[tuple[float, float]], holes: Sequence[tuple[float, float]], length: float
) -> Iterator[Excluded]:
    """Yield the periods of one recording that are neither used nor in a gap (``holes``).

    No period is yielded if nothing is used.
    """
    previous_end = 0.0
    for start, end in sorted([*used, *holes, (length, length)]) if used else ():
        if start > previous_end:
            yield Excluded(previous_end, start)
        previous_end = max(previous_end, end)


def _marked(excluded: list[Excluded], event: Excluded) -> list[Excluded]:
    """Return the excluded periods; a period that ``event`` overlaps gets the kind of the event.

    A period of a shock keeps its kind. If ``event`` is a shock, it is added as a further period,
    and the other periods are unchanged.
    """
    if event.why == 'shock':
        return [*excluded, event]
    start, end = event.start, event.end
    return [
        period._replace(why=event.why)
        if period.why != 'shock' and period.start < end and start < period.end
        else period
        for period in excluded
    ]


def _temperature(
    trace: TemperatureTrace, first_ns: int, length: float, offset: float
) -> SignalTemperature | None:
    """Return the temperature during one recording; None for fewer than two readings within it.

    The header stamps are used, or the record times if fewer than two header stamps are within the
    recording.
    """
    for stamps in (trace.header_ns, trace.record_ns):
        times = np.asarray((stamps - first_ns) * 1e-9, float)
        is_inside = (times >= 0.0) & (times <= length)
        if is_inside.sum() > 1:
            order = np.argsort(times[is_inside], kind='stable')
            celsius = trace.celsius[is_inside][order]
            return SignalTemperature(trace.source, times[is_inside][order] + offset, celsius)
    return None


def _joined(parts: Sequence[SignalTemperature]) -> SignalTemperature | None:
    if not parts:
        return None
    times = [np.insert(p.time_s, 0, p.time_s[:1] if i else []) for i, p in enumerate(parts)]
    values = [np.insert(p.celsius, 0, [np.nan] if i else []) for i, p in enumerate(parts)]
    source = ', '.join(dict.fromkeys(part.source for part in parts))
    return SignalTemperature(source, np.concatenate(times), np.concatenate(values))
