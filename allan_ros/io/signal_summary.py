# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raw signal of all recordings on one axis of time, which samples are not used, and why."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.imu import AXES
from ..core.stream.health import Segment
from .signal import SignalEnvelope, TemperatureTrace

Floats = NDArray[np.float64]


GAP = 3.0
"""A bin that lasts this many times the usual duration contains a gap."""


LEAST_SHARE = 1e-3
"""A part that is missing, or left out for several reasons, and shorter than this share of the whole
is not marked: it would be narrower than a line."""


REASONS = ('motion', 'stuck')
"""Cuts that leave samples out; other cuts only separate two segments."""


class LeftOut(NamedTuple):
    """Samples that are not used, from ``start`` to ``end`` in s.

    ``why`` is 'motion', 'stuck', or '' (warm-up, another rate, or several reasons).
    """

    start: float
    end: float
    why: str = ''


@dataclass(frozen=True)
class SignalTemperature:
    """Temperature over time.

    Attributes
    ----------
    source : str
        Topic or column; several, where recordings differ.
    time_s, celsius : (n,) float64 arrays
        Times as in the summary; NaN separates recordings.
    """

    source: str
    time_s: Floats
    celsius: Floats


@dataclass(frozen=True)
class SignalSummary:
    """Signals one after the other.

    Attributes
    ----------
    time_s : (bins,) float64 array
        Start of each bin since the first sample of the first recording, recordings joined.
    low, high : (bins, 6) float64 arrays
        Lowest and highest sample, SI; NaN where a recording begins, and where a sensor is absent.
    used : (bins,) bool array
        Whether all samples of the bin are used.
    middle : (6,) float64 array
        Median of the signal.
    left_out : tuple of LeftOut
    gaps : tuple of (start, end)
        In s: times without samples.
    starts : tuple of float
        Where each recording begins, in s.
    temperature : SignalTemperature or None
        None where no recording contains it.
    first_ns : tuple of int
        Stamp of the first sample of each recording.
    """

    time_s: Floats
    low: Floats
    high: Floats
    used: NDArray[np.bool_]
    middle: Floats
    left_out: tuple[LeftOut, ...]
    gaps: tuple[tuple[float, float], ...]
    starts: tuple[float, ...]
    temperature: SignalTemperature | None = None
    first_ns: tuple[int, ...] = ()

    @property
    def reach(self) -> Floats:
        """Largest distance of used samples from their middle, (6,), SI; 1 where there are none.

        A knock that was left out does not count: it may exceed the plot.
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
    cuts: Mapping[str, int] | None = None,
    temperatures: Sequence[TemperatureTrace | None] = (),
) -> SignalSummary | None:
    """Return the summary of the signals, or None if none has two bins.

    Parameters
    ----------
    signals : sequence of SignalEnvelope
        One a recording.
    segments : sequence of Segment
        The segments of static data.
    bins : int
        Approximate number of bins in the summary.
    cuts : mapping of str to int
        How often a segment ended for which reason: it tells what ended the last one.
    temperatures : sequence of TemperatureTrace or None
        One a signal; empty for none.
    """
    temperatures = temperatures or [None] * len(signals)
    some = [(s, t) for s, t in zip(signals, temperatures) if s.bins > 1]
    if not some:
        return None
    times: list[Floats] = []
    lows: list[Floats] = []
    highs: list[Floats] = []
    used: list[NDArray[np.bool_]] = []
    left_out: list[LeftOut] = []
    gaps: list[tuple[float, float]] = []
    starts: list[float] = []
    warm: list[SignalTemperature] = []
    offset = 0.0
    step = max(1, round(sum(signal.bins for signal, _ in some) / bins))
    for signal, trace in some:
        time, low, high = _reduced(signal, step)
        length = float(time[-1] + np.median(np.diff(time)))
        holes = _holes(time)
        counted = _counted(segments, int(signal.start_ns[0]), length)
        least = LEAST_SHARE * length
        gaps += [_moved(hole, offset) for hole in holes if hole[1] - hole[0] > least]
        outside = list(_left_out(counted, holes, length, cuts or {}))
        left_out += [
            out._replace(start=out.start + offset, end=out.end + offset)
            for out in outside
            if out.why or out.end - out.start > least
        ]
        used.append(_untouched(time, length, outside))
        if trace is not None:
            warm += _temperatures(trace, int(signal.start_ns[0]), length, offset)
        starts.append(offset)
        if times:
            low[0] = high[0] = np.nan  # no line from the recording before
        times.append(time + offset)
        lows.append(low)
        highs.append(high)
        offset += length
    low, high = np.concatenate(lows), np.concatenate(highs)
    middle = np.full(len(AXES), np.nan)
    there = ~np.all(np.isnan(low), axis=0)
    middle[there] = np.nanmedian(low[:, there] + high[:, there], axis=0) / 2.0
    return SignalSummary(
        np.concatenate(times),
        low,
        high,
        np.concatenate(used),
        middle,
        tuple(left_out),
        tuple(gaps),
        tuple(starts),
        _joined(warm),
        tuple(int(signal.start_ns[0]) for signal, _ in some),
    )


def _left_out(
    counted: Sequence[tuple[float, float, str]],
    holes: Sequence[tuple[float, float]],
    length: float,
    cuts: Mapping[str, int],
) -> Iterator[LeftOut]:
    """Yield the parts between the segments of one recording that are not gaps, with the reason."""
    if not counted:
        return
    ends = {reason for reason in REASONS if cuts.get(reason)}
    last = ends.pop() if len(ends) == 1 else ''
    before = 0.0
    for start, end, cut in [*sorted(counted), (length, length, last)]:
        for part in _without([(before, start)], holes) if start > before else ():
            yield LeftOut(*part, cut if cut in REASONS else '')
        before = max(before, end)


def _untouched(time: Floats, length: float, outside: Sequence[LeftOut]) -> NDArray[np.bool_]:
    """Return for each bin whether all its samples are used."""
    ends = np.append(time[1:], length)
    untouched = np.ones(len(time), bool)
    for out in outside:
        untouched &= (time >= out.end) | (ends <= out.start)
    return untouched


def _temperatures(
    trace: TemperatureTrace, first_ns: int, length: float, offset: float
) -> Iterator[SignalTemperature]:
    """Yield the readings taken during one recording, by the first of its clocks that fits."""
    for stamps in (trace.header_ns, trace.record_ns):
        time = np.asarray((stamps - first_ns) * 1e-9, float)
        inside = (time >= 0.0) & (time <= length)
        if inside.sum() > 1:
            order = np.argsort(time[inside], kind='stable')
            yield SignalTemperature(
                trace.source, time[inside][order] + offset, trace.celsius[inside][order]
            )
            return


def _joined(parts: Sequence[SignalTemperature]) -> SignalTemperature | None:
    """Return the temperatures of all recordings as one, with a break between two."""
    if not parts:
        return None
    times: list[Floats] = []
    values: list[Floats] = []
    for part in parts:
        if times:
            times.append(part.time_s[:1])
            values.append(np.array([np.nan]))
        times.append(part.time_s)
        values.append(part.celsius)
    source = ', '.join(dict.fromkeys(part.source for part in parts))
    return SignalTemperature(source, np.concatenate(times), np.concatenate(values))


def _reduced(signal: SignalEnvelope, step: int) -> tuple[Floats, Floats, Floats]:
    """Return start, lowest and highest value of groups of bins."""
    starts = np.arange(0, signal.bins, step)
    low = np.fmin.reduceat(signal.low, starts)
    high = np.fmax.reduceat(signal.high, starts)
    return signal.time_s[starts], low, high


def _holes(time: Floats) -> list[tuple[float, float]]:
    """Return the gaps: bins of equal sample count that last far longer than the others."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    return [
        (float(time[i] + usual), float(time[i + 1])) for i in np.flatnonzero(steps > GAP * usual)
    ]


def _counted(
    segments: Sequence[Segment], first_ns: int, length: float
) -> list[tuple[float, float, str]]:
    """Return start, end and cut of the segments of one recording, in s since its first sample."""
    seconds = [((s.start_ns - first_ns) * 1e-9, s.duration_s, s.cut) for s in segments]
    return [
        (start, start + of, cut)
        for start, of, cut in seconds
        if start < length and start + of > 0.0
    ]


def _without(
    intervals: Sequence[tuple[float, float]], others: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return the intervals without the parts that others cover."""
    left = list(intervals)
    for low, high in others:
        left = [
            part
            for start, end in left
            for part in ((start, min(end, low)), (max(start, high), end))
            if part[1] > part[0]
        ]
    return left


def _moved(interval: tuple[float, float], by: float) -> tuple[float, float]:
    return interval[0] + by, interval[1] + by
