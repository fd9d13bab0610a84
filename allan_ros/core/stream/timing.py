# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Divides samples into evenly spaced blocks: detects gaps, and interpolates short ones.

An IMU samples evenly, but its stamps scatter. After a pause of several periods, the samples were
either lost, or are late and follow in a burst. The delay of a sample is its stamp minus its index
times the period. Lost samples increase the smallest delay, late samples do not. So the smallest
delays before and after the pause are compared, over a fixed number of samples.

All decisions are made for blocks counted from the first sample, so they do not depend on how the
samples are divided into batches.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .clock import CLOCK_BLOCK, LEARN, PERIOD_TRACKING, Clock, Floats, Stamps, rayleigh_period
from .health import RATE_CHANGE, Counts

Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Block:
    """Evenly spaced samples: stamps in ns, (n,), and values, (axes, n).

    ``cut`` is '' if the block directly follows the previous one, else the reason for the gap
    between them. ``filled``, (axes, n), flags interpolated values; None if there are none.
    """

    stamps: Stamps
    rows: Floats
    cut: str = ''
    filled: Flags | None = None

    def __len__(self) -> int:
        return len(self.stamps)

    def part(self, which: slice, cut: str = '') -> Block:
        """Return a slice of the samples as views; ``cut`` is the reason for a gap before it."""
        filled = None if self.filled is None else self.filled[:, which]
        return Block(self.stamps[which], self.rows[:, which], cut, filled)

    def copy(self) -> Block:
        """Return a block that shares no memory with this one."""
        filled = None if self.filled is None else self.filled.copy()
        return Block(self.stamps.copy(), self.rows.copy(), self.cut, filled)

    @classmethod
    def joined(cls, parts: list[Block]) -> Block:
        """Concatenate consecutive blocks, at least one; the result has the ``cut`` of the first."""
        parts = [part for part in parts if len(part)] or parts[:1]
        if len(parts) == 1:
            return parts[0]
        filled = None
        if any(part.filled is not None for part in parts):
            none = [np.zeros(p.rows.shape, bool) if p.filled is None else p.filled for p in parts]
            filled = np.concatenate(none, axis=1)
        return cls(
            np.concatenate([part.stamps for part in parts]),
            np.concatenate([part.rows for part in parts], axis=1),
            parts[0].cut,
            filled,
        )


TRACK_BLOCKS = 16
"""Number of blocks after which the estimated period is updated."""

RATE_CHANGE_STEP = 1.45
"""Ratio of the median step of a block to that learned at the start above which the rate has
changed. Single losses do not change the median."""

RATE_CHANGE_BURSTY = 0.10
"""Relative change of the period over `TRACK_BLOCKS` above which a bursty stream has a new rate."""

BRIDGED_SHARE = 0.5
"""Largest ratio of interpolated to received samples in a block; above it, the data are split."""


class SampleClock:
    """Converts samples to evenly spaced blocks; at most one block and the look-ahead are buffered.

    ``clock`` is the first estimate of the period, which is then updated from the stamps. Gaps of up
    to ``max_bridge`` samples are interpolated, and ``counts`` is changed in place. Once
    ``rate_changed`` is set, `pending` contains the samples from the change on, and no more samples
    are accepted.
    """

    def __init__(self, clock: Clock, axes: int, max_bridge: int, counts: Counts) -> None:
        self.clock = clock
        self.rate_changed = False
        self._max_bridge = max_bridge
        self._counts = counts
        self._reach = clock.look_ahead
        # the first `_past` samples, at most `_reach`, are already processed
        self._stamps: Stamps = np.empty(0, np.int64)
        self._rows: Floats = np.empty((axes, 0))
        self._jumped: Flags = np.empty(0, bool)
        self._past = 0
        # index of each sample in [0, _past), with lost samples counted; -1 before the first one
        self._index = np.array([-1])
        self._since_gap = 0  # processed samples since the last gap, at most `_reach`
        self._blocks = 0
        self._other_period = False  # whether the period of the last block differed
        self._track_start: tuple[int, int] | None = None  # stamp and index; None after a gap

    @property
    def pending(self) -> tuple[Stamps, Floats]:
        """Samples that are not processed yet: stamps (n,) in ns and values (axes, n)."""
        return self._stamps[self._past :], self._rows[:, self._past :]

    def feed(self, stamps: Stamps, rows: Floats, jumped: Flags) -> list[Block]:
        """Add samples, and return the blocks whose look-ahead is complete.

        ``stamps``, (n,), are in ns, and ``rows`` are the values, (axes, n). ``jumped``, (n,), is
        True where the clock was set back before the sample.
        """
        if rows.strides[1] != rows.itemsize:
            rows = np.ascontiguousarray(rows)
        # Only samples near the border between buffered and new samples are copied: up to the end of
        # the first block before which `_reach` samples are new.
        pending = len(self._stamps) - self._past
        seam = -(-(pending + self._reach) // CLOCK_BLOCK) * CLOCK_BLOCK - pending + self._reach
        self._append(stamps[:seam], rows[:, :seam], jumped[:seam])
        done = self._process_ready()
        if len(stamps) > seam:
            if self.rate_changed:
                self._append(stamps[seam:], rows[:, seam:], jumped[seam:])
                return done
            rest = slice(seam - len(self._stamps), None)
            self._stamps, self._rows, self._jumped = stamps[rest], rows[:, rest], jumped[rest]
            done += self._process_ready()
            # copies the buffer, so that the batch can be released
            self._append(stamps[:0], rows[:, :0], jumped[:0])
        return done

    def _append(self, stamps: Stamps, rows: Floats, jumped: Flags) -> None:
        self._stamps = np.concatenate([self._stamps, stamps])
        self._rows = np.concatenate([self._rows, rows], axis=1)
        self._jumped = np.concatenate([self._jumped, jumped])

    def _process_ready(self) -> list[Block]:
        """Process the complete blocks whose look-ahead is available."""
        done: list[Block] = []
        first = self._past  # of consecutive samples without a gap, which become one block
        while not self.rate_changed:
            ready = (len(self._stamps) - self._past - self._reach) // CLOCK_BLOCK
            count = min(ready, TRACK_BLOCKS - self._blocks % TRACK_BLOCKS)
            if count < 1:
                break
            if self._are_even(count * CLOCK_BLOCK):
                self._other_period = False
                self._advance(np.ones(count * CLOCK_BLOCK, np.int64))
                continue
            done += self._view(first)
            done += self._process(count * CLOCK_BLOCK)
            first = self._past
        done += self._view(first)
        self._release()
        return done

    def _view(self, first: int) -> list[Block]:
        """Return the processed samples from buffer position ``first`` on as a block."""
        which = slice(first, self._past)
        return [Block(self._stamps[which], self._rows[:, which])] if first < self._past else []

    def flush(self) -> list[Block]:
        """Return the blocks of all buffered samples at the end of the input."""
        done: list[Block] = []
        while not self.rate_changed and len(self._stamps) > self._past:
            room = (TRACK_BLOCKS - self._blocks % TRACK_BLOCKS) * CLOCK_BLOCK
            done += self._process(min(len(self._stamps) - self._past, room))
            self._release()
        return done

    def _are_even(self, n: int) -> bool:
        """Return whether the next n samples have no gap and no change of the rate."""
        begin = self._past
        if begin == 0 or self._jumped[begin : begin + n].any():
            return False
        stamps = self._stamps[begin - 1 : begin + n]
        clock, longest = self.clock, int((stamps[1:] - stamps[:-1]).max())
        if longest > clock.pause_ns:
            return False
        if clock.bursty:
            return True
        period = np.diff(stamps[::CLOCK_BLOCK]) / CLOCK_BLOCK
        return longest <= RATE_CHANGE_STEP * clock.step_ns and bool(
            np.all(np.abs(period / clock.period_ns - 1.0) <= RATE_CHANGE)
        )

    def _process(self, n: int) -> list[Block]:
        """Detect gaps and a change of the rate in the next n samples; return these as blocks."""
        begin = self._past
        before = self._stamps[begin - 1] if begin else self._stamps[0] - round(self.clock.period_ns)
        step = np.diff(self._stamps[begin : begin + n], prepend=before)
        lost, split = self._find_gaps(step)
        advance = np.where(split, 0, 1 + lost)
        same = self._count_same_rate(step, advance)
        self.rate_changed = same < n
        if same == 0:
            return []
        lost, split, advance = lost[:same], split[:same], advance[:same]
        jumps = int(np.count_nonzero(self._jumped[begin : begin + same]))
        self._counts.lost += int(lost.sum())
        self._counts.interpolated += int(lost[~split].sum())
        gaps = int(np.count_nonzero(split)) - jumps
        self._counts.splits += Counter({'clock jump': jumps, 'gap': gaps})
        blocks = self._blocks_of(advance)
        self._advance(advance)
        return blocks

    def _find_gaps(self, step: Stamps) -> tuple[Ints, Flags]:
        """Return the number of samples lost before each of the next n, and where to split them.

        ``step``, (n,), are the steps of the stamps in ns. Short gaps are interpolated, not split.
        """
        lost = np.zeros(len(step), np.int64)
        split = self._jumped[self._past : self._past + len(step)].copy()
        interpolated: Counter[int] = Counter()  # number of interpolated samples of each clock block
        for j in np.flatnonzero((step > self.clock.pause_ns) & ~split).tolist():
            lost[j] = number = self._count_lost(np.where(split, 0, 1 + lost)[:j])
            total = interpolated[j // CLOCK_BLOCK] + number
            split[j] = number > self._max_bridge or total > BRIDGED_SHARE * CLOCK_BLOCK
            if not split[j]:
                interpolated[j // CLOCK_BLOCK] = total
        return lost, split

    def _count_same_rate(self, step: Stamps, advance: Ints) -> int:
        """Return the number of samples before a change of the rate; all if it does not change.

        ``step``, (n,), are the steps of the stamps in ns, and ``advance``, (n,), those of the
        sample index, which counts lost samples, too.
        """
        if self.clock.bursty:
            return len(step)
        usual = self.clock.step_ns
        # excludes the samples from which the period was learned, or learning could repeat forever
        for at in range(max(0, LEARN - self._blocks * CLOCK_BLOCK), len(step), CLOCK_BLOCK):
            steps, indices = step[at : at + CLOCK_BLOCK], advance[at : at + CLOCK_BLOCK]
            if len(steps) < CLOCK_BLOCK // 4:
                break
            period = steps[indices > 0].sum() / max(1, indices.sum())
            # with jitter, two blocks must differ: one may have several undetected losses
            differed = self._other_period
            self._other_period = abs(period / self.clock.period_ns - 1.0) > RATE_CHANGE
            if float(np.median(steps)) > RATE_CHANGE_STEP * usual or (
                self._other_period and (differed or not self.clock.jitter)
            ):
                unusual = (steps > RATE_CHANGE_STEP * usual) | (RATE_CHANGE_STEP * steps < usual)
                return at + int(np.argmax(unusual))
        return len(step)

    def _count_lost(self, advance: Ints) -> int:
        """Return how many samples were lost in a pause, from the delays before and after it.

        ``advance``, (j,), are the index steps of the next j samples; the pause follows them.
        """
        at = self._past + len(advance)  # the first sample after the pause
        before = self._since_gap_after(advance)
        if before == 0:
            return 0
        jumps = np.flatnonzero(self._jumped[at + 1 : at + self._reach])
        after = self._stamps[at : at + (int(jumps[0]) + 1 if len(jumps) else self._reach)]
        index = self._index_after(advance)[-before:]
        period, origin = self.clock.period_ns, self._stamps[at - 1]
        delay = (self._stamps[at - before : at] - origin) - period * (index - index[-1])
        # as if no sample were lost
        delay_after = (after - origin) - period * np.arange(1, len(after) + 1)
        increase = (float(delay_after.min()) - float(delay.min())) / period
        pause = (self._stamps[at] - origin) / period - 1.0
        return round(increase) if increase > max(0.5 * pause, self.clock.smallest_loss) else 0

    def _index_after(self, advance: Ints) -> Ints:
        """Return `_index` continued by the next samples, whose index steps are ``advance``."""
        return np.concatenate([self._index, self._index[-1] + np.cumsum(advance)])

    def _since_gap_after(self, advance: Ints) -> int:
        """Return `_since_gap` after the next samples, whose index steps are ``advance``."""
        gaps = np.flatnonzero(advance == 0)
        return min(self._reach, len(advance) + (-int(gaps[-1]) if len(gaps) else self._since_gap))

    def _blocks_of(self, advance: Ints) -> list[Block]:
        """Return the next n samples as blocks, with gaps interpolated.

        ``advance``, (n,), are the index steps: above 1 where samples are interpolated, 0 where the
        data are split.
        """
        begin, n = self._past, len(advance)
        samples = Block(self._stamps[begin : begin + n], self._rows[:, begin : begin + n])
        groups: list[list[Block]] = []  # a list for each block, with the parts to be joined
        edges = sorted({0, *np.flatnonzero(advance != 1).tolist(), n})
        for first, last in itertools.pairwise(edges):
            cut = ''
            if advance[first] == 0:
                cut = 'clock jump' if self._jumped[begin + first] else 'gap'
            if cut or not groups:
                groups.append([])
            if advance[first] > 1:
                groups[-1].append(self._interpolated(begin + first, int(advance[first])))
            groups[-1].append(samples.part(slice(first, last), cut))
        return [Block.joined(parts) for parts in groups]

    def _interpolated(self, at: int, advance: int) -> Block:
        """Return the advance - 1 samples lost before the sample at buffer position ``at``."""
        fraction = np.arange(1, advance) / advance
        gap_ns = self._stamps[at] - self._stamps[at - 1]
        stamps = self._stamps[at - 1] + np.rint(fraction * gap_ns).astype(np.int64)
        left, right = self._rows[:, at - 1, None], self._rows[:, at, None]
        rows = left + fraction * (right - left)
        return Block(stamps, rows, filled=np.ones(rows.shape, bool))

    def _advance(self, advance: Ints) -> None:
        """Mark n samples as processed; ``advance``, (n,), are their index steps."""
        n = len(advance)
        index = self._index_after(advance)
        stamps = self._stamps[self._past : self._past + n]
        self._track(stamps, index[-n:], bool((advance == 0).any()))
        self._since_gap = self._since_gap_after(advance)
        self._index = index[-self._reach :]
        self._past += n

    def _release(self) -> None:
        """Drop processed samples that are not needed to detect a later gap."""
        old = max(0, self._past - self._reach)
        self._stamps = self._stamps[old:]
        self._rows = self._rows[:, old:]
        self._jumped = self._jumped[old:]
        self._past -= old

    def _track(self, stamps: Stamps, index: Ints, split: bool) -> None:
        """Update the sample period after every `TRACK_BLOCKS` blocks unless the data were split."""
        if self._blocks % TRACK_BLOCKS == 0:
            self._track_start = (int(stamps[0]), int(index[0]))
        if split:
            self._track_start = None
        self._blocks += -(-len(stamps) // CLOCK_BLOCK)
        if self._blocks % TRACK_BLOCKS or self._track_start is None:
            return
        start_ns, start = self._track_start
        if self.clock.jitter:
            period = rayleigh_period(stamps, self.clock.period_ns, PERIOD_TRACKING)
        else:
            period = (int(stamps[-1]) - start_ns) / (int(index[-1]) - start)
        off = abs(period / self.clock.period_ns - 1.0)
        if self.clock.bursty:
            self.rate_changed = off > RATE_CHANGE_BURSTY
            # a single pause changes the mean over the blocks as much as a real change of the period
            period = self.clock.period_ns + 0.25 * (period - self.clock.period_ns)
        if not self.rate_changed:
            self.clock = replace(self.clock, period_ns=period)
