# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Divides samples into evenly spaced blocks: learns the period, and interpolates short gaps.

Lost and late samples
---------------------
An IMU samples evenly, but its stamps scatter. After a pause of several periods, the samples were
either lost, or are late and follow in a burst. The delay of a sample is its stamp minus its index
times the period. Lost samples increase the smallest delay, but late samples do not. Therefore, the
smallest delays before and after the pause are compared, over a fixed number of samples.

All decisions are made for blocks counted from the first sample. They do not depend on how the
samples are divided into batches.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..imu import Flags, Floats, ImuBatch, Stamps, joined
from ..settings import SegmenterSettings
from .health import RATE_CHANGE, Counts
from .sensors import are_interleaved

Ints = NDArray[np.int64]

LEARN_S, LEAST_LEARN, LEARN = 11.0, 256, 1024
"""Time in s, and smallest and largest number of samples, from which the sample period is learned.
At 93 Hz and above, the largest number is used. At the end of the input, fewer samples suffice."""

CLOCK_BLOCK = 256
"""Number of samples in a block. Unless stamps are bursty, the blocks are searched for a change of
the rate."""

LOOK_AHEAD = 64
"""Delays are compared over at most this number of samples on each side of a pause. The number may
be larger if stamps are bursty (`BURST_LOOK_AHEAD`)."""

BURST_LOOK_AHEAD_S, BURST_LOOK_AHEAD = 4.0, 1 << 18
"""If stamps are bursty, delays are compared over up to `BURST_LOOK_AHEAD_S` seconds on each side of
a pause. At low rates, this time is extended to `LOOK_AHEAD` samples. Above 65 kHz, it is limited to
`BURST_LOOK_AHEAD` samples."""

BURST_PAUSE_S = 0.25
"""If stamps are bursty, samples count as lost only in a pause of more than this time in s. The
smallest delay after the pause must also exceed the smallest delay before the pause by more than
this time. Smaller increases occur without a loss, because the smallest delay of bursty stamps
varies by several sample periods."""

LATE = 1.5
"""Unless stamps are bursty, a step longer than this many periods is a pause."""

REGULAR_SHARE = 0.6
"""Stamps are regular if at least this share of the steps is within 50 % of the median step, and if
the mean of these steps is at least this share of the mean step of the stream."""

POLLED_SHARE = 0.95
"""Polled samples are evenly spaced on average if at least this share of the steps between their
stamps is between 0.4 and 2.2 times the mean step."""

FEWEST_STEPS = 8
"""A period is learned from the first stamps if at least this number of their steps are above 0. If
there are fewer steps, all of them must be above 0. In long bursts of equal stamps, too few steps
are above 0, and the period would depend on where the last burst begins."""

EVEN_SHARE, EVEN = 0.9, 0.15
"""Stamps have evenly spaced runs if at least 90 % of the steps between them differ from the median
step by at most 15 %, and if at least two steps are longer than `LATE` median steps. At most
1 - `POLLED_SHARE` of the steps may be neither even nor late."""

UNEVEN = 2.0
"""The mean step is computed over each pause together with the evenly spaced stamps up to the next
pause. If the largest mean step exceeds the smallest by more than this factor, the samples are not
late. Late samples have nearly the same mean step in each burst."""

DECLARED_RANGE = 0.25
"""The declared rate is used for bursty stamps if the mean step differs from the declared period by
less than this fraction of the declared period."""

MANY, EXACT = 0.2, 0.15
"""Samples are missing regularly if at least 20 % of the steps are one sample period, and at least
20 % are a larger multiple of the period. At least `POLLED_SHARE` of the steps must differ from a
multiple by at most 15 % of a period."""

JITTER_SHARE = 0.01
"""Stamps have jitter if more than this share of the steps is shorter than half the period."""

PERIOD_RANGE, PERIOD_TRACKING = 0.05, 0.003
"""Largest relative change of the sample rate by `rayleigh_period` when the period is learned, and
when the period is updated."""

PHASE_GAP = 16.0
"""Longest pause, in periods, after which the phase of the samples is assumed to continue."""

PHASE_STEP = 0.25
"""`rayleigh_period` tries periods in steps that change the number of cycles between the first and
the last stamp by this value."""


@dataclass(frozen=True)
class Clock:
    """Sample period of a stream, typical step between its stamps, and quality of the stamps.

    ``step_ns`` is in most cases the median step of the first stamps. The steps of ``bursty`` stamps
    are too uneven to be regular (`REGULAR_SHARE`), as when samples arrive together. With
    ``jitter``, the stamps are assumed to scatter so much that the loss of a single sample may look
    like scatter.
    """

    period_ns: float
    step_ns: float
    bursty: bool
    jitter: bool = False
    # shortest frequent step between stamps in ns, if it differs from the period because samples are
    # missing regularly; else 0
    base_ns: float = 0.0

    @property
    def look_ahead(self) -> int:
        """Largest number of samples on each side of a pause over which delays are compared."""
        if not self.bursty:
            return LOOK_AHEAD
        samples = BURST_LOOK_AHEAD_S * 1e9 / self.period_ns
        return int(min(max(samples, LOOK_AHEAD), BURST_LOOK_AHEAD))

    @property
    def pause_ns(self) -> float:
        """Step between two stamps, in ns, above which samples may have been lost."""
        late_ns = LATE * self.period_ns
        return max(late_ns, BURST_PAUSE_S * 1e9) if self.bursty else late_ns

    @property
    def smallest_loss(self) -> float:
        """Increase of the smallest delay, in periods, up to which no sample counts as lost.

        The smallest delay before a pause is compared with the smallest delay after the pause.
        """
        return max(0.5, BURST_PAUSE_S * 1e9 / self.period_ns) if self.bursty else 0.5


def learned_from(stamps: Stamps) -> int:
    """Return how many stamps at the start are used to learn the period; 0 for too few stamps.

    ``stamps``, (n,), are the first stamps in ns.

    >>> import numpy as np
    >>> [learned_from(np.arange(2000) * 10**9 // rate) for rate in (20, 50, 100, 1000)]
    [256, 551, 1024, 1024]
    """
    end_indices = np.flatnonzero(stamps[:LEARN] - stamps[:1] >= LEARN_S * 1e9)
    number = max(int(end_indices[0]) + 1, LEAST_LEARN) if len(end_indices) else LEARN
    return number if len(stamps) >= number else 0


def learn_clock(stamps: Stamps, polled: bool = False, declared: float = 0.0) -> Clock | None:
    """Estimate the sample period of a stream from its first stamps, (n,), in ns.

    Backward stamps are ignored. If ``polled`` is set, the messages repeat the samples of a slower
    sensor, and ``stamps`` are the stamps of the messages with a new sample. The steps between these
    stamps are multiples of the period of the messages. If these steps are uneven, but close to
    their average (`POLLED_SHARE`), the average is the sample period.

    If samples of a sensor that is not polled are missing so regularly that the shortest steps are
    not the period, their mean is stored in ``base_ns``, or used as the period if it agrees with the
    ``declared`` rate in Hz. Returns None if too few stamps differ (`FEWEST_STEPS`).
    """
    if not has_time(stamps):
        return None
    stamps = _without_backward(stamps)
    steps = np.diff(stamps).astype(float)
    clock = _clock_of(steps, stamps, polled, declared)
    base = 0.0 if polled else _common_step(steps)
    if not base or abs(base / clock.period_ns - 1.0) < RATE_CHANGE:
        return clock
    if abs(declared * base * 1e-9 - 1.0) < RATE_CHANGE:
        return Clock(base, 1.5 * base, bursty=False)
    return replace(clock, base_ns=base)


def has_time(stamps: Stamps) -> bool:
    """Return whether the first stamps of a stream, (n,), advance often enough to show a period."""
    steps = np.diff(_without_backward(stamps))
    return bool(len(steps) > 0 and np.count_nonzero(steps) >= min(FEWEST_STEPS, len(steps)))


def _without_backward(stamps: Stamps) -> Stamps:
    """Return the stamps, (n,), that are not before an earlier one of them."""
    return stamps[stamps >= np.maximum.accumulate(stamps)]


def _period_of_runs(steps: Floats) -> float:
    """Return the period of evenly stamped runs with pauses between them.

    The result is 0 if there are no such runs, or if the samples are late. If a logger records in
    runs with gaps between them, the steps in each run are the period. If samples arrive late
    together, the steps in a burst are not the period. Such bursts are short, and the period is the
    mean step over a pause together with the burst after the pause.
    """
    median = float(np.median(steps))
    is_near_median = np.abs(steps - median) <= EVEN * median
    pauses = np.flatnonzero(steps > LATE * median)
    if not median or len(pauses) < 2 or is_near_median.mean() < EVEN_SHARE:
        return 0.0
    if np.count_nonzero(is_near_median) + len(pauses) < POLLED_SHARE * len(steps):
        return 0.0
    period = float(steps[is_near_median].mean())
    mean_steps = np.add.reduceat(steps, pauses)[:-1] / np.diff(pauses)
    has_long_runs = float(np.median(np.diff(pauses))) * period >= BURST_PAUSE_S * 1e9
    is_uneven = len(mean_steps) > 1 and mean_steps.max() > UNEVEN * mean_steps.min()
    return period if has_long_runs or is_uneven else 0.0


def _common_step(steps: Floats) -> float:
    """Return the mean of the shortest steps if samples are missing regularly, else 0.

    Samples are missing regularly if almost all ``steps``, (n,), are multiples of the shortest
    step, and many steps are longer.
    """
    shortest = float(np.sort(steps)[int(MANY * len(steps))])
    near_shortest = steps[np.abs(steps - shortest) <= EXACT * shortest]
    base = float(near_shortest.mean())
    multiple = np.rint(steps / base) if base else steps
    is_multiple = (np.abs(steps - multiple * base) <= EXACT * base) & (multiple > 0)
    has_many_longer = min(np.mean(multiple == 1), np.mean(multiple > 1)) >= MANY if base else False
    return base if has_many_longer and is_multiple.mean() >= POLLED_SHARE else 0.0


def _clock_of(steps: Floats, stamps: Stamps, polled: bool, declared: float) -> Clock:
    """Estimate the period from ``stamps``, (n,), and the ``steps`` between them, (n - 1,), in ns.

    The ``declared`` rate in Hz, or 0 if unknown, helps to decide whether samples are late or lost,
    and may be used for bursty stamps (`DECLARED_RANGE`).
    """
    size = max(1, min(CLOCK_BLOCK, len(steps) // 4))
    # one long gap does not change the median of the means over groups of steps
    mean = float(np.median(steps[: len(steps) // size * size].reshape(-1, size).mean(axis=1)))
    mean = mean or float(steps.mean())
    median = float(np.median(steps))
    near_median = steps[np.abs(steps - median) <= 0.5 * median]
    if polled and len(near_median) < POLLED_SHARE * len(steps):
        number_near_mean = np.count_nonzero((steps > 0.4 * mean) & (steps < 2.2 * mean))
        if number_near_mean >= POLLED_SHARE * len(steps):
            return Clock(mean, mean, bursty=False)
    if median > 0.0 and len(near_median) >= REGULAR_SHARE * len(steps):
        period = float(near_median.mean())
        if period >= REGULAR_SHARE * mean:
            # jitter makes steps longer and shorter, lost samples only longer
            long_steps = np.count_nonzero(steps > LATE * period)
            short_steps = np.count_nonzero(steps < period / 2)
            if short_steps > JITTER_SHARE * len(steps):
                period = rayleigh_period(stamps, period, PERIOD_RANGE)
                return Clock(period, median, bursty=False, jitter=True)
            return Clock(mean if 2 * short_steps >= long_steps else period, median, bursty=False)
    expected_step = 1e9 / declared if declared else mean
    is_near_mean = abs(mean / expected_step - 1.0) < DECLARED_RANGE
    if (run_period := _period_of_runs(steps)) and not (declared and is_near_mean):
        return Clock(run_period, run_period, bursty=False)
    return Clock(expected_step if is_near_mean else mean, median, bursty=True)


def rayleigh_period(stamps: Stamps, period: float, relative_range: float) -> float:
    """Return the sample period in ns, near ``period``, that fits stamps with jitter best.

    ``stamps``, (n,), are in ns. The result maximizes the Rayleigh statistic of the phases of the
    stamps t, |sum exp(2 pi i t / p)|, over a grid of periods p for which 1/p differs from
    1/``period`` by at most the fraction ``relative_range`` (K. V. Mardia, P. E. Jupp, Directional
    Statistics, 2000, section 6.3). A few lost samples do not change the phases of the others. A
    step of more than `PHASE_GAP` periods counts as one period.
    """
    stamp_steps = np.diff(stamps) / period
    times = np.cumsum(np.where(stamp_steps > PHASE_GAP, 1.0, stamp_steps))
    times -= times[len(times) // 2]
    resolution = PHASE_STEP / max(float(times[-1] - times[0]), 1.0)
    grid_steps = int(relative_range / resolution)
    relative_rates = 1.0 + resolution * np.arange(-grid_steps, grid_steps + 1)
    statistic = np.array([abs(np.exp(2j * np.pi * r * times).sum()) for r in relative_rates])
    return float(period / relative_rates[np.argmax(statistic)])


TRACK_BLOCKS = 16
"""Number of blocks after which the estimated period is updated."""

RATE_CHANGE_STEP = 1.45
"""If stamps are not bursty, the rate has changed if the median step of a block exceeds
`Clock.step_ns` by more than this factor. Single losses do not change the median."""

RATE_CHANGE_BURSTY = 0.10
"""Relative change of the period over `TRACK_BLOCKS` blocks above which a bursty stream has a new
rate."""

BRIDGED_SHARE = 0.5
"""The data are split instead of interpolated if the interpolated samples of a block would exceed
this fraction of `CLOCK_BLOCK`."""


class SampleClock:
    """Converts samples to blocks of evenly spaced samples.

    After the period is learned, and until the rate changes, at most one block of samples, and the
    look-ahead before and after this block, are buffered.

    ``clock`` is None until the period is learned from the first samples. Later, the period is
    updated from the stamps, which decrease only where the clock was set back. ``polled`` tells
    whether a slower sensor is polled, as in `learn_clock`. ``counts`` is changed in place. When a
    change of the rate is found, ``rate_changed`` is set, and `pending` contains the later samples.
    """

    def __init__(
        self, axes: int, settings: SegmenterSettings, polled: bool, counts: Counts
    ) -> None:
        self.clock: Clock | None = None
        self.learned_ns = 0.0  # the period that was learned from the first samples
        self.is_interleaved = False  # whether the first samples seem to come from two IMUs
        self._learned = LEARN  # number of samples from which the period was learned
        self.rate_changed = False
        self._settings = settings
        self._polled = polled
        self._counts = counts
        self._reach = 0  # `Clock.look_ahead` of the present clock
        self._samples = ImuBatch.empty(axes)  # samples that are buffered

        # number of buffered samples that are already processed, at most `_reach`
        self._processed = 0
        # steps of the sample index at the last processed samples (see `_process`)
        self._steps: Ints = np.empty(0, np.int64)
        self._blocks = 0  # number of processed blocks

        # whether the mean step of the last block differed from the period of the clock
        self._other_period = False
        # stamps since the last update of the period, or None after the data were split; without
        # jitter, only the first and the last stamp of each call of `_track`
        self._tracked: list[Stamps] | None = None
        self._tracked_steps = 0  # sum of the index steps between the tracked stamps

    @property
    def pending(self) -> ImuBatch:
        """Samples that are not processed yet."""
        return self._samples.part(slice(self._processed, None))

    def feed(self, *parts: ImuBatch) -> list[ImuBatch]:
        """Add consecutive samples, and return the blocks whose look-ahead is complete.

        The blocks end at a change of the rate.
        """
        self._samples = joined([self._samples, *parts])
        while self.clock is None and (number := learned_from(self._samples.stamps_ns)):
            self._learn(number)
        return self._process_ready(self._reach)

    def flush(self) -> list[ImuBatch]:
        """Return the usable pending samples as blocks at the end of the input.

        If the sample rate changes, only blocks before the change are returned.
        """
        while self.clock is None and (number_buffered := len(self._samples)):
            self._learn(learned_from(self._samples.stamps_ns) or number_buffered)
        return self._process_ready(0)

    def _learn(self, number: int) -> None:
        """Learn the period from the first samples, or exclude samples that show no period."""
        first, self._learned = self._samples.stamps_ns[:number], number
        number_untimed = int(np.argmax(first != first[0])) or len(first)
        if number_untimed <= LEARN // FEWEST_STEPS:
            self.clock = learn_clock(first, self._polled, self._settings.declared_rate)
            number_untimed = len(first)
        if self.clock is None:
            self._counts.untimed += number_untimed
            self._processed = number_untimed
            self._release()
        else:
            first_rows = self._samples.rows[:, :number]
            self.is_interleaved = not self._polled and are_interleaved(first_rows)
            if self.is_interleaved:
                # with jitter instead of bursts, a stop of one of the two IMUs is found sooner
                period_ns = self.clock.period_ns
                self.clock = replace(self.clock, step_ns=period_ns, bursty=False, jitter=True)
            self.learned_ns, self._reach = self.clock.period_ns, self.clock.look_ahead

    def _process_ready(self, look_ahead: int) -> list[ImuBatch]:
        """Process complete blocks before the look-ahead, or all samples if the look-ahead is 0.

        Returns the processed samples as evenly spaced blocks. Processing ends at a change of the
        rate.
        """
        begin, steps = self._processed, [np.empty(0, np.int64)]
        while self.clock is not None and not self.rate_changed:
            ready_count = len(self._samples) - self._processed - look_ahead
            if look_ahead:
                ready_count -= ready_count % CLOCK_BLOCK
            count_to_update = (TRACK_BLOCKS - self._blocks % TRACK_BLOCKS) * CLOCK_BLOCK
            number = min(ready_count, count_to_update)
            if number < 1:
                break
            steps.append(self._process(number, self.clock))
        blocks = self._blocks_of(begin, np.concatenate(steps))
        self._release()
        return blocks

    def _release(self) -> None:
        """Remove the processed samples that are not needed to detect a later gap."""
        number_removed = max(0, self._processed - self._reach)
        self._samples = self._samples.part(slice(number_removed, None)).copy()
        self._processed -= number_removed

    def _process(self, n: int, clock: Clock) -> Ints:
        """Detect gaps and a change of the rate in the next n samples.

        Returns the steps of the sample index up to a change of the rate, (k,): above 1 where
        samples are interpolated, and 0 where the data are split.
        """
        begin, stamps = self._processed, self._samples.stamps_ns
        if begin:
            stamp_steps = stamps[begin : begin + n] - stamps[begin - 1 : begin + n - 1]
        else:
            stamp_steps = np.diff(stamps[:n], prepend=stamps[0] - round(clock.period_ns))
        index_steps = np.ones(n, np.int64)
        is_even = stamp_steps.min() >= 0 and stamp_steps.max() <= clock.pause_ns
        if not is_even:
            lost, is_split = self._find_gaps(stamp_steps, clock)
            index_steps = np.where(is_split, 0, 1 + lost)
        number = n if clock.bursty else self._count_same_rate(stamp_steps, index_steps, clock)
        self.rate_changed = number < n
        index_steps = index_steps[:number]
        if not is_even:
            lost, is_split = lost[:number], is_split[:number]
            self._counts.lost += int(lost.sum())
            self._counts.interpolated += int(lost[~is_split].sum())
            self._counts.splits += Counter(
                gap=int(np.count_nonzero(is_split & (stamp_steps[:number] >= 0)))
            )
        if number:
            self._track(stamps[begin : begin + number], index_steps, clock)
            self._steps = np.concatenate([self._steps, index_steps])[-self._reach :]
            self._processed += number
        return index_steps

    def _find_gaps(self, stamp_steps: Stamps, clock: Clock) -> tuple[Ints, Flags]:
        """Return how many samples were lost before each of the next n samples, and where to split.

        ``stamp_steps``, (n,), are the steps of the stamps in ns. Both results are (n,). The data
        are split where the stamps decrease, at gaps of more than ``max_bridge`` samples, and where
        more than `BRIDGED_SHARE` of a block would be interpolated. Other gaps are interpolated.
        """
        lost, is_split = np.zeros(len(stamp_steps), np.int64), stamp_steps < 0
        interpolated: Counter[int] = Counter()  # number of interpolated samples of each clock block
        for j in np.flatnonzero(stamp_steps > clock.pause_ns).tolist():
            lost[j] = number_lost = self._count_lost(np.where(is_split, 0, 1 + lost)[:j], clock)
            number = interpolated[j // CLOCK_BLOCK] + number_lost
            is_long = number_lost > self._settings.max_bridge
            is_split[j] = is_long or number > BRIDGED_SHARE * CLOCK_BLOCK
            if not is_split[j]:
                interpolated[j // CLOCK_BLOCK] = number
        return lost, is_split

    def _count_same_rate(self, stamp_steps: Stamps, index_steps: Ints, clock: Clock) -> int:
        """Return how many samples precede a change of the rate; all n if the rate does not change.

        ``stamp_steps``, (n,), are the steps of the stamps in ns. ``index_steps``, (n,), are the
        steps of the sample index (see `_process`).
        """
        # blocks with samples from which the period was learned are not tested; otherwise, learning
        # could repeat forever
        learned_blocks = -(-self._learned // CLOCK_BLOCK)
        first_tested = max(0, learned_blocks - self._blocks) * CLOCK_BLOCK
        begins = np.arange(first_tested, len(stamp_steps) - CLOCK_BLOCK // 4 + 1, CLOCK_BLOCK)
        if not len(begins):
            return len(stamp_steps)
        number, end = len(stamp_steps), int(begins[-1]) + CLOCK_BLOCK
        stamp_steps, index_steps = stamp_steps[:end], index_steps[:end]
        elapsed = np.add.reduceat(np.where(index_steps > 0, stamp_steps, 0), begins)
        period = elapsed / np.maximum(np.add.reduceat(index_steps, begins), 1)
        differs = np.abs(period / clock.period_ns - 1.0) > RATE_CHANGE
        # with jitter, a change needs two blocks: a single block may have several undetected losses
        differed_before = np.concatenate([[self._other_period], differs[:-1]])
        changed = differs & (differed_before | (not clock.jitter))
        long_step = RATE_CHANGE_STEP * clock.step_ns
        for i in np.flatnonzero(np.maximum.reduceat(stamp_steps, begins) > long_step):
            block_steps = stamp_steps[begins[i] : begins[i] + CLOCK_BLOCK]
            changed[i] |= float(np.median(block_steps)) > long_step
        block = int(np.argmax(changed)) if changed.any() else len(begins) - 1
        self._other_period = bool(differs[block])
        if not changed[block]:
            return number
        block_steps = stamp_steps[begins[block] : begins[block] + CLOCK_BLOCK]
        is_unusual = block_steps > long_step
        if not self.is_interleaved:  # with samples of two IMUs, some steps are always short
            is_unusual |= RATE_CHANGE_STEP * block_steps < clock.step_ns
        return int(begins[block]) + int(np.argmax(is_unusual))

    def _count_lost(self, index_steps: Ints, clock: Clock) -> int:
        """Return how many samples were lost in a pause, from the delays before and after the pause.

        ``index_steps``, (j,), are the steps of the sample index (see `_process`) at the j samples
        that are not processed yet and precede the pause.
        """
        begin = self._processed + len(index_steps)  # the first sample after the pause
        if begin == 0:
            return 0
        index_steps = np.concatenate([self._steps, index_steps])[-self._reach :]
        # index of each sample since the data were last split
        index = np.cumsum(index_steps[int(np.argmax(np.cumsum(index_steps == 0))) :])
        stamps = self._samples.stamps_ns
        stamps_after = stamps[begin : begin + self._reach]
        backward_steps = np.flatnonzero(np.diff(stamps_after) < 0)
        if len(backward_steps):
            stamps_after = stamps_after[: int(backward_steps[0]) + 1]
        period, origin = clock.period_ns, stamps[begin - 1]
        delay_before = (stamps[begin - len(index) : begin] - origin) - period * (index - index[-1])
        # delays of the samples after the pause, if no sample was lost in the pause
        delay_after = (stamps_after - origin) - period * np.arange(1, len(stamps_after) + 1)
        increase = (float(delay_after.min()) - float(delay_before.min())) / period
        pause = (stamps[begin] - origin) / period - 1.0
        return round(increase) if increase > max(0.5 * pause, clock.smallest_loss) else 0

    def _blocks_of(self, begin: int, index_steps: Ints) -> list[ImuBatch]:
        """Return n samples from buffer position ``begin`` on as blocks, with gaps interpolated.

        ``index_steps``, (n,), are the steps of the sample index (see `_process`).
        """
        n = len(index_steps)
        samples = self._samples.part(slice(begin, begin + n))
        groups: list[list[ImuBatch]] = []  # for each block, the parts that are joined to this block
        edges = sorted({0, *np.flatnonzero(index_steps != 1).tolist(), n})
        for first, last in itertools.pairwise(edges):
            cut = ''
            if index_steps[first] == 0:
                stamp_before, stamp = self._samples.stamps_ns[begin + first - 1 : begin + first + 1]
                cut = 'clock jump' if stamp < stamp_before else 'gap'
            if cut or not groups:
                groups.append([])
            if index_steps[first] > 1:
                groups[-1].append(self._interpolated(begin + first, int(index_steps[first])))
            groups[-1].append(samples.part(slice(first, last), cut))
        return [joined(parts) for parts in groups]

    def _interpolated(self, position: int, step: int) -> ImuBatch:
        """Return step - 1 interpolated samples before the sample at buffer ``position``."""
        fraction = np.arange(1, step) / step
        first, last = self._samples.stamps_ns[position - 1 : position + 1]
        stamps = first + np.rint(fraction * (last - first)).astype(np.int64)
        row_before, row_after = (
            self._samples.rows[:, position - 1, None],
            self._samples.rows[:, position, None],
        )
        rows = row_before + fraction * (row_after - row_before)
        return ImuBatch.of_rows(stamps, rows, filled=np.ones(rows.shape, np.int32))

    def _track(self, stamps: Stamps, index_steps: Ints, clock: Clock) -> None:
        """Every `TRACK_BLOCKS` blocks, update the period if these blocks contain no split.

        If the period of bursty stamps changed by more than `RATE_CHANGE_BURSTY`, ``rate_changed``
        is set. After a change of the rate, the period is not updated.
        """
        if self._blocks % TRACK_BLOCKS == 0:
            self._tracked, self._tracked_steps = [], -int(index_steps[0])
        self._blocks += -(-len(stamps) // CLOCK_BLOCK)
        self._tracked_steps += int(index_steps.sum())
        if self._tracked is None or not index_steps.all():
            self._tracked = None
            return
        self._tracked.append(stamps.copy() if clock.jitter else stamps[[0, -1]])
        if self._blocks % TRACK_BLOCKS:
            return
        tracked = np.concatenate(self._tracked)
        if clock.jitter:
            period = rayleigh_period(tracked, clock.period_ns, PERIOD_TRACKING)
        else:
            period = float(tracked[-1] - tracked[0]) / self._tracked_steps
        change = abs(period / clock.period_ns - 1.0)
        if clock.bursty:
            self.rate_changed = change > RATE_CHANGE_BURSTY
            # only a quarter of the change is applied, because a single pause changes the mean step
            # over the blocks as much as a real change of the period
            period = clock.period_ns + 0.25 * (period - clock.period_ns)
        if not self.rate_changed:
            self.clock = replace(clock, period_ns=period)
