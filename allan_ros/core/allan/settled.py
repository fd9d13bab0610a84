# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`settled_sums`: the sums of a recording without its early part, from its sums by age."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from .history import AgeBin, History, add_padded, edge_age
from .sums import AllanSums, LengthClass, SegmentRecord, counts, grid_for

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAST_STEPS = 8
"""A segment of which fewer phase steps remain is left out."""


def settled_sums(sums: AllanSums, age: int) -> AllanSums:
    """Return the sums of all second differences that start at an age or later.

    Segments that begin earlier are shortened to begin at the next point of their phase record.
    Where this is no start of a factor's differences, or pooled segments are divided, the sum of
    squares is that of nearly the same differences, scaled to their exact number.

    Parameters
    ----------
    sums : AllanSums
    age : int
        In samples, one of ``sums.history.ages``.

    Returns
    -------
    AllanSums
        Without groups that do not overlap and without a history.

    Raises
    ------
    AllanError
        When the age is not an edge of the history.
    """
    if age not in sums.history.ages:
        raise AllanError(f'age {age} is no edge of the sums by age: {sums.history.ages}')
    late = [b for b in sums.history.bins if edge_age(b.index) >= age]
    early = [b for b in sums.history.bins if edge_age(b.index) < age]
    m, stride = sums.m, sums.stride
    sum_sq, number = np.zeros_like(sums.sum_sq), np.zeros_like(sums.count)
    for each in late:
        sum_sq[: len(each.count)] += each.sum_sq
        number[: len(each.count)] += each.count
    tau0 = sums.tau0 or 0.0
    segments = []
    for segment in sums.segments:
        shorter = segment if segment.age >= age else _shortened(segment, age, tau0)
        if shorter is None:
            continue
        segments.append(shorter)
        if shorter is not segment:
            _replace_long_factors(segment, shorter, age, m, stride, sum_sq, number)
    classes = _settled_classes(sums.classes, early)
    exact, kept = np.zeros_like(number), np.zeros_like(number)
    for segment in segments:
        exact += counts(segment.samples, m, stride)
    for segment in sums.segments:
        kept += counts(segment.samples, m, stride)
    pooled = sum(c.samples for c in sums.classes)
    share = sum(c.samples for c in classes) / pooled if pooled else 0.0
    exact += np.rint((sums.count - kept) * share).astype(np.int64)
    exact[number == 0] = 0
    some = int(np.flatnonzero(exact)[-1]) + 1 if exact.any() else 0
    sum_sq[:some] *= (exact[:some] / np.maximum(number[:some], 1))[:, None]
    samples = sum(s.samples for s in segments) + sum(c.samples for c in classes)
    intervals = samples - len(segments) - sum(c.count for c in classes)
    elapsed = round(sums.elapsed_ns * intervals / sums.intervals) if sums.intervals else 0
    return replace(
        sums,
        count=exact[:some],
        sum_sq=np.maximum(sum_sq[:some], 0.0),
        group_count=np.zeros(some, np.int64),
        group_sum_sq=np.zeros((some, len(sums.axes))),
        segments=tuple(sorted(segments, key=lambda s: s.order)),
        classes=classes,
        elapsed_ns=elapsed,
        intervals=intervals,
        history=History(),
        filled=np.rint(sums.filled * (samples / max(sums.samples, 1))).astype(np.int64),
    )


def _shortened(segment: SegmentRecord, age: int, tau0: float) -> SegmentRecord | None:
    """Return a segment without what is younger than an age; None if too little remains."""
    step = segment.phase_step
    points = -((segment.age - age) // step)
    if segment.samples // step - points < LEAST_STEPS:
        return None
    samples = segment.samples - points * step
    m, stride = grid_for(samples)
    phase = segment.phase[points:] - segment.phase[points]
    return replace(
        segment,
        start_ns=segment.start_ns + round(points * step * tau0 * 1e9),
        samples=samples,
        phase=phase,
        signed=_signed_sums(phase, step, m, stride, counts(samples, m, stride)),
        age=segment.age + points * step,
    )


def _signed_sums(phase: Floats, step: int, m: Ints, stride: Ints, count: Ints) -> Floats:
    """Return the sums of d of a segment from its phase record, (factors, axes).

    The sum telescopes to sums of the phase near both ends; between two points of the record the
    phase is interpolated, which for white noise is its expectation given the points.
    """
    out = np.empty((len(m), phase.shape[1]))
    for i, (lag, gap, number) in enumerate(zip(m, stride, count)):
        starts = np.arange(lag // gap) * gap
        head, tail = starts, starts + number * gap
        at = np.concatenate([tail + lag, tail, head + lag, head])
        low = np.minimum(at // step, len(phase) - 2)
        part = (at / step - low)[:, None]
        theta = (phase[low] * (1.0 - part) + phase[low + 1] * part).reshape(4, len(starts), -1)
        a, b, c, d = theta.sum(axis=1)
        out[i] = a - b - c + d
    return out


def _replace_long_factors(
    segment: SegmentRecord,
    shorter: SegmentRecord,
    age: int,
    m: Ints,
    stride: Ints,
    sum_sq: Floats,
    number: Ints,
) -> None:
    """Recompute, in place, the differences of a shortened segment whose stride is a phase step.

    Their starts counted from the new beginning of the segment may be others than before.
    """
    step = segment.phase_step
    for i in np.flatnonzero(stride % step == 0):
        lag, gap = int(m[i]) // step, int(stride[i]) // step
        first = -((segment.age - age) // int(stride[i])) * gap
        before = _differences(segment.phase, lag)[first::gap]
        after = _differences(shorter.phase, lag)[::gap]
        sum_sq[i] += (after**2).sum(axis=0) - (before**2).sum(axis=0)
        number[i] += len(after) - len(before)


def _differences(phase: Floats, lag: int) -> Floats:
    if len(phase) <= 2 * lag:
        return phase[:0]
    d: Floats = phase[2 * lag :] - 2.0 * phase[lag:-lag] + phase[: -2 * lag]
    return d


def _settled_classes(
    classes: tuple[LengthClass, ...], early: list[AgeBin]
) -> tuple[LengthClass, ...]:
    """Return the length classes without the segments that begin in the early bins.

    The ramp corrections of those are taken from the longest class: only their sum matters.
    """
    gone: dict[int, tuple[int, int]] = {}
    ramp = np.zeros((0, 0))
    for each in early:
        for index, count, samples in each.pooled:
            have = gone.get(index, (0, 0))
            gone[index] = (have[0] + count, have[1] + samples)
        if len(each.ramp):
            ramp = add_padded(each.ramp, ramp) if ramp.size else each.ramp
    rest = []
    for c in classes:
        count, samples = gone.get(c.index, (0, 0))
        if c.count > count:
            rest.append(replace(c, count=c.count - count, samples=c.samples - samples))
        else:
            ramp = add_padded(ramp, -c.ramp_correction) if ramp.size else -c.ramp_correction
    if rest and ramp.size:
        rest[-1] = replace(rest[-1], ramp_correction=add_padded(rest[-1].ramp_correction, -ramp))
    return tuple(rest)
