# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of recordings from their sums by age: the part after the warm-up, recent and earlier data.

Recent noise: if the noise level of an axis changed within the recent window, the data before the
first change are compared with the data after the last change. Otherwise the window is compared with
all earlier data. Changes are located by the likelihood ratio of two levels to one. The estimate of
a variance is assumed to be chi-squared distributed, with its equivalent degrees of freedom (NIST SP
1065 section 5.3.1).
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from .curve import AllanCurve, chi_squared_limits, edf, noise_types_of_avar
from .history import AgeBin, History, Recording, add_padded, edge_age
from .sums import LEVEL_FACTORS, AllanSums, LengthClass, SegmentRecord, counts, grid_for

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MIN_STEPS = 8
"""Smallest length, in steps of the phase record, of a shortened segment that is kept."""


def settled_sums(sums: AllanSums, age: int) -> AllanSums:
    """Return the sums without the first ``age`` sample periods of each recording.

    A segment that begins earlier is shortened to begin at the next stored phase point. The sums of
    squares at short averaging factors, and of pooled segments, cannot be recomputed from the stored
    phase. For these, the sums by age are used and scaled to the number of remaining differences.
    The result has no non-overlapping sums and no history.

    Raises
    ------
    AllanError
        If the age is not one of ``sums.history.ages``.
    """
    if age not in sums.history.ages:
        raise AllanError(f'age {age} is not the start of an age bin: {sums.history.ages}')
    late = [b for b in sums.history.bins if edge_age(b.index) >= age]
    early = [b for b in sums.history.bins if edge_age(b.index) < age]
    m, stride, none = sums.m, sums.stride, np.zeros_like(sums.count)
    sum_sq = reduce(add_padded, (b.sum_sq for b in late), np.zeros_like(sums.sum_sq))
    number = reduce(add_padded, (b.count for b in late), none)
    tau0 = sums.tau0 or 0.0
    segments = []
    for segment in sums.segments:
        shorter = segment if segment.age >= age else _shortened(segment, age, tau0)
        if shorter is None:
            continue
        segments.append(shorter)
        if shorter is not segment:
            _recompute_long_factors(segment, shorter, age, m, stride, sum_sq, number)
    classes = _settled_classes(sums.classes, early)
    exact, kept = (
        sum((counts(s.samples, m, stride) for s in some), none)
        for some in (segments, sums.segments)
    )
    pooled = sum(c.samples for c in sums.classes)
    share = sum(c.samples for c in classes) / pooled if pooled else 0.0
    exact = exact + np.rint((sums.count - kept) * share).astype(np.int64)
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
    """Return a segment without the samples before an age, or None if too few remain."""
    step = segment.phase_step
    points = -((segment.age - age) // step)
    if segment.samples // step - points < MIN_STEPS:
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
    """Return the sums of the second differences of a segment, (factors, axes), from its phase.

    The phase is stored every ``step`` samples and interpolated linearly, which gives its expected
    value for white noise. A sum of differences telescopes to sums of the phase near both ends.
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


def _recompute_long_factors(
    segment: SegmentRecord,
    shorter: SegmentRecord,
    age: int,
    m: Ints,
    stride: Ints,
    sum_sq: Floats,
    number: Ints,
) -> None:
    """Replace the differences of ``segment`` by those of ``shorter`` in ``sum_sq`` and ``number``.

    Only factors whose stride is a multiple of the phase step are changed: for them, the phase is
    stored at all points of the differences.
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
    """Return the length classes without the segments that begin in the early bins."""
    removed = reduce(operator.add, early)
    pooled = {index: (count, samples) for index, count, samples in removed.pooled}
    ramp, kept = removed.ramp, []
    for c in classes:
        count, samples = pooled.get(c.index, (0, 0))
        if c.count > count:
            kept.append(replace(c, count=c.count - count, samples=c.samples - samples))
        else:
            ramp = add_padded(ramp, -c.ramp_correction)
    if kept:  # only the sum of the ramp corrections over the classes is used
        kept[-1] = replace(kept[-1], ramp_correction=add_padded(kept[-1].ramp_correction, -ramp))
    return tuple(kept)


# --- recent against earlier noise ----------------------------------------------------------------

LONGEST_TAU_SHARE = 0.25
"""Longest averaging time that is compared, as a fraction of the window."""

MIN_EDF = 30.0
"""Smallest number of degrees of freedom before and after a step; the ratio of the variances is then
accurate to 30 %."""

LIKELIHOOD_RATIO = 30.0
"""Smallest significant value of twice the log likelihood ratio of a step. By chance, chi-squared
with one degree of freedom exceeds it once in 2e7, so many times and axes can be tested."""


@dataclass(frozen=True)
class RecentNoise:
    """Allan deviation of one axis in recent and in earlier data."""

    before: AllanCurve  # curve of the earlier data, of this axis only
    recent: AllanCurve  # curve of the recent data, at the same averaging times
    since_s: float | None  # time since the last step of the noise level in s; None without a step
    # averaging time in s at which the first step is most significant; None without a step
    tau: float | None


def recent_noise(sums: AllanSums, window_s: float) -> dict[str, RecentNoise]:
    """Return the recent and the earlier noise of each axis, or {} if there are too few data.

    The recent window of ``window_s`` seconds ends at the end of the latest recording.

    Raises
    ------
    AllanError
        If the window is not above 0.
    """
    if not window_s > 0.0:
        raise AllanError(f'a recent window of {window_s} s is invalid: give a positive number')
    recordings = sums.history.recordings
    if not recordings or not sums.tau0:
        return {}
    latest = max(recordings, key=lambda r: (r.start_ns, r.length))
    start = latest.length - window_s / sums.tau0
    levels = int(np.count_nonzero(latest.level_m * sums.tau0 <= LONGEST_TAU_SHARE * window_s))
    count, sum_sq, begins = _earlier_and_recent(recordings, latest, start, levels)
    if len(begins) < 2 or not levels:
        return {}
    m = latest.level_m[:levels]
    total = np.maximum(count.sum(axis=0), 1)
    avar = sum_sq.sum(axis=0) / (2.0 * (m * m * total).astype(float))[:, None]
    types = noise_types_of_avar(m, np.where(avar > 0.0, avar, np.nan), sums.samples)
    found = {}
    for i, axis in enumerate(sums.axes):
        share = _edf_per_difference(types[:, i], m, total)
        first, last, level = _noise_steps(count * share, sum_sq[:, :, i])
        sides = (slice(0, first), slice(last, None))
        before, recent = (
            _curve(axis, m, sums.tau0, count[rows], sum_sq[rows, :, i], share, types[:, i])
            for rows in sides
        )
        since = tau = None
        if level is not None:
            since = (latest.length - int(begins[last])) * sums.tau0
            tau = float(m[level] * sums.tau0)
        found[axis] = RecentNoise(before, recent, since, tau)
    return found


def _earlier_and_recent(
    recordings: tuple[Recording, ...], latest: Recording, start: float, levels: int
) -> tuple[Ints, Floats, Ints]:
    """Return number of differences, sum of squares and age of the earlier data and recent periods.

    Row 0 contains all earlier data, or the first period if there are none. The other rows are the
    periods of ``latest`` that begin at the age ``start`` or later. ``levels`` is the number of
    averaging factors.
    """
    begins, count, sum_sq = latest.period_begin, latest.level_count, latest.level_sum_sq
    first = int(np.searchsorted(begins, start))
    counts, squares = count[:first, :levels].sum(axis=0), sum_sq[:first, :levels].sum(axis=0)
    for other in recordings:
        if other is not latest:
            some = min(levels, other.level_count.shape[1])
            counts[:some] += other.level_count[:, :some].sum(axis=0)
            squares[:some] += other.level_sum_sq[:, :some].sum(axis=0)
    if not counts.any():
        return count[:, :levels], sum_sq[:, :levels], begins
    return (
        np.concatenate([counts[None], count[first:, :levels]]),
        np.concatenate([squares[None], sum_sq[first:, :levels]]),
        np.concatenate([[0], begins[first:]]),
    )


def _edf_per_difference(types: Ints, m: Ints, total: Ints) -> Floats:
    """Return the degrees of freedom of the Allan variance, divided by the number of differences.

    The arguments and the result are (factors,): the noise types (exponent of the spectral density),
    the averaging factors and the numbers of second differences.
    """
    return np.array(
        [
            edf(int(alpha), int(factor), max(1, int(factor) // LEVEL_FACTORS[0]), int(n)) / int(n)
            for alpha, factor, n in zip(types, m, total)
        ]
    )


def _noise_steps(degrees: Floats, squares: Floats) -> tuple[int, int, int | None]:
    """Locate steps of the noise level; return (row after the first, row after the last, factor).

    The degrees of freedom and the sums of squares are (rows, factors). The first step is the most
    significant one of all factors; ``factor`` is the index of its factor, at which later steps are
    searched for. Without a significant step, the result is (1, 1, None).
    """
    degrees, squares = np.cumsum(degrees, axis=0), np.cumsum(squares, axis=0)
    ratio = _step_ratios(degrees, squares)
    at, level = np.unravel_index(int(ratio.argmax()), ratio.shape)
    if not ratio[at, level] > LIKELIHOOD_RATIO:
        return 1, 1, None
    first = last = int(at)
    while True:
        later = [a[last + 1 :, level] - a[last, level] for a in (degrees, squares)]
        ratio = _step_ratios(*later) if len(later[0]) else np.zeros(1)
        if not ratio.max() > LIKELIHOOD_RATIO:
            return first + 1, last + 1, int(level)
        last += 1 + int(ratio.argmax())


def _step_ratios(degrees: Floats, squares: Floats) -> Floats:
    """Return twice the log likelihood ratio of a step after each row, or -inf with too few data.

    ``degrees`` and ``squares`` are cumulative sums, (rows, ...).
    """
    nu = degrees, degrees[-1] - degrees, degrees[-1]
    sums = squares, squares[-1] - squares, squares[-1]
    with np.errstate(invalid='ignore', divide='ignore'):
        before, after, both = (n * np.log(p / n) for n, p in zip(nu, sums))
        gain = both - before - after
    enough = (nu[0] >= MIN_EDF) & (nu[1] >= MIN_EDF) & (sums[0] > 0.0) & (sums[1] > 0.0)
    return np.where(enough, gain, -np.inf)


def _curve(
    axis: str, m: Ints, tau0: float, count: Ints, sum_sq: Floats, share: Floats, types: Ints
) -> AllanCurve:
    """Return the curve of an axis; ``share`` is the degrees of freedom per second difference."""
    number = count.sum(axis=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        avar = sum_sq.sum(axis=0) / (2.0 * m.astype(float) ** 2 * number)
    degrees = np.where(number > 0, share * number, np.nan)
    low, high = chi_squared_limits(avar, degrees)
    columns = (np.sqrt(avar), low, high, degrees, types)
    adev, low, high, degrees, types = (np.asarray(a)[:, None] for a in columns)
    return AllanCurve(m, np.asarray(m * tau0), number, adev, low, high, (axis,), degrees, types)
