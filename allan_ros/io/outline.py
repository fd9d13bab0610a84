# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The raw signal of all recordings on one axis of time, and which of it is no evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.batch import AXES
from ..core.health import Span
from .envelope import SignalEnvelope

Floats = NDArray[np.float64]

GAP = 3.0
"""A span that takes so many times the usual one holds a gap."""

LEAST_SHARE = 1e-3
"""What is left out or missing for less than this share of the whole is not marked: it would be
narrower than a line."""


@dataclass(frozen=True)
class Outline:
    """Signals one after the other.

    Attributes
    ----------
    time_s : (bins,) float64 array
        Start of each span since the first sample of the first recording, recordings joined.
    low, high : (bins, 6) float64 arrays
        Lowest and highest sample, SI; NaN where a recording begins, and where a sensor is absent.
    middle : (6,) float64 array
        Median of the signal.
    left_out, gaps : tuples of (start, end)
        In s: samples that are no evidence (motion, warm-up), and times without samples.
    starts : tuple of float
        Where each recording begins, in s.
    """

    time_s: Floats
    low: Floats
    high: Floats
    middle: Floats
    left_out: tuple[tuple[float, float], ...]
    gaps: tuple[tuple[float, float], ...]
    starts: tuple[float, ...]


def outline_of(
    signals: Sequence[SignalEnvelope], spans: Sequence[Span], bins: int
) -> Outline | None:
    """Return the outline of the signals, or None when none has two spans.

    Parameters
    ----------
    signals : sequence of SignalEnvelope
        One a recording.
    spans : sequence of Span
        The segments that count as evidence.
    bins : int
        About how many spans are wanted of all.
    """
    some = [signal for signal in signals if signal.bins > 1]
    if not some:
        return None
    times: list[Floats] = []
    lows: list[Floats] = []
    highs: list[Floats] = []
    left_out: list[tuple[float, float]] = []
    gaps: list[tuple[float, float]] = []
    starts: list[float] = []
    offset = 0.0
    for signal in some:
        step = max(1, round(sum(s.bins for s in some) / bins))
        time, low, high = _reduced(signal, step)
        length = float(time[-1] + np.median(np.diff(time)))
        holes = _holes(time)
        counted = _counted(spans, int(signal.start_ns[0]), length)
        least = LEAST_SHARE * length
        gaps += [_moved(span, offset) for span in holes if span[1] - span[0] > least]
        if counted:
            outside = _without(_without([(0.0, length)], counted), holes)
            left_out += [_moved(span, offset) for span in outside if span[1] - span[0] > least]
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
    return Outline(
        np.concatenate(times), low, high, middle, tuple(left_out), tuple(gaps), tuple(starts)
    )


def _reduced(signal: SignalEnvelope, step: int) -> tuple[Floats, Floats, Floats]:
    """Return start, lowest and highest of every so many spans."""
    starts = np.arange(0, signal.bins, step)
    low = np.fmin.reduceat(signal.low, starts)
    high = np.fmax.reduceat(signal.high, starts)
    return signal.time_s[starts], low, high


def _holes(time: Floats) -> list[tuple[float, float]]:
    """Return where spans of as many samples take far longer than the others."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    return [
        (float(time[i] + usual), float(time[i + 1])) for i in np.flatnonzero(steps > GAP * usual)
    ]


def _counted(spans: Sequence[Span], first_ns: int, length: float) -> list[tuple[float, float]]:
    """Return the segments of one recording, in s since its first sample."""
    seconds = [((s.start_ns - first_ns) * 1e-9, s.duration_s) for s in spans]
    return [(start, start + of) for start, of in seconds if start < length and start + of > 0.0]


def _without(
    spans: Sequence[tuple[float, float]], others: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return what is left of spans where the others are taken out."""
    left = list(spans)
    for low, high in others:
        left = [
            part
            for start, end in left
            for part in ((start, min(end, low)), (max(start, high), end))
            if part[1] > part[0]
        ]
    return left


def _moved(span: tuple[float, float], by: float) -> tuple[float, float]:
    return span[0] + by, span[1] + by
