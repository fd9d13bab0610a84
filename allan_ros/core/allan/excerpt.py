# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of the later periods of a recording: of its settled part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .periods import MIN_MEANS, BlockMeans, Recording, add_padded, nonzero_length
from .sums import AllanSums, Lengths, add_lengths

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def part(sums: AllanSums, first: int) -> AllanSums:
    """Return the sums of each recording from its period ``first`` on; it may be negative.

    Block means outside of these periods are removed, and the result has no non-overlapping
    differences. A block of a high level of the cascade is long, and belongs to the period in which
    it begins. Averaging factors at which more differences follow from the block means use those.
    """
    kept = [r for r in (_excerpt(r, sums.tau0, first) for r in sums.recordings) if r.periods]
    samples, most = sum(r.samples for r in kept), len(sums.count)
    count, sum_sq = np.zeros(most, np.int64), np.zeros((most, len(sums.axes)))
    for period in (p for r in kept for p in r.periods):
        count = add_padded(count, period.count)
        sum_sq = add_padded(sum_sq, period.sum_sq)
    for i, (m, stride) in enumerate(zip(sums.m.tolist(), sums.stride.tolist())):
        number, squares = _from_means(kept, m, stride)
        if number > count[i]:
            count[i], sum_sq[i] = number, squares
    some = nonzero_length(count)
    lengths = _lengths(sums.lengths, samples)
    intervals = samples - sum(number for _, number in lengths)
    return replace(
        sums,
        count=count[:some],
        sum_sq=sum_sq[:some],
        group_count=np.zeros(some, np.int64),
        group_sum_sq=np.zeros((some, len(sums.axes))),
        elapsed_ns=round(sums.elapsed_ns * intervals / sums.intervals) if sums.intervals else 0,
        intervals=intervals,
        recordings=tuple(kept),
        lengths=lengths,
        filled=np.rint(sums.filled * (samples / max(sums.samples, 1))).astype(np.int64),
    )


def _excerpt(recording: Recording, tau0: float | None, first: int) -> Recording:
    """Return a recording without its first periods, and the means in the others."""
    periods = recording.periods[first:]
    means: tuple[BlockMeans, ...] = ()
    if periods:
        clipped = (_clipped(m, tau0 or 0.0, periods[0].begin) for m in recording.means)
        means = tuple(m for m in clipped if len(m.values) >= MIN_MEANS)
    return replace(recording, periods=periods, means=means)


def _clipped(means: BlockMeans, tau0: float, begin: int) -> BlockMeans:
    """Return the means over blocks that start at the age ``begin`` or later."""
    step = means.step
    low = min(max(-((means.age - begin) // step), 0), len(means.values))
    return replace(
        means,
        age=means.age + low * step,
        start_ns=means.start_ns + round(low * step * tau0 * 1e9),
        samples=means.samples - low * step,
        values=means.values[low:],
    )


def _from_means(recordings: list[Recording], m: int, stride: int) -> tuple[int, Floats | float]:
    """Return number and sum of squares, (axes,), of the second differences from block means."""
    number, squares = 0, 0.0
    for means in (means for r in recordings for means in r.means):
        step = means.step
        if m % step or 2 * m > len(means.values) * step:
            continue
        phase = step * np.cumsum(np.vstack([0.0 * means.values[:1], means.values]), axis=0)
        lag = m // step
        d = (phase[2 * lag :] - 2.0 * phase[lag:-lag] + phase[: -2 * lag])[
            :: max(stride // step, 1)
        ]
        number += len(d)
        squares = squares + (d**2).sum(axis=0)
    return number, squares


def _lengths(lengths: Lengths, samples: int) -> Lengths:
    """Return lengths of segments that have ``samples`` in all, with similar shares of each class.

    The lengths of the segments in a part are not stored.
    """
    share = samples / max(sum(total for total, _ in lengths), 1)
    scaled = [(round(total * share), round(number * share)) for total, number in lengths]
    kept = [(total, number) for total, number in scaled if 0 < number <= total]
    if not kept:
        return ((samples, 1),) if samples else ()
    _, number = kept.pop()  # the longest get the rest
    rest = samples - sum(total for total, _ in kept)
    return add_lengths((), (*kept, (max(rest, number), number)))
