# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sample clock: finds gaps in the stamps and interpolates short ones.

An IMU samples evenly, but its stamps scatter. A silence that is followed by a burst of late samples
has lost nothing; any other silence is a gap. The two are distinguished by the earliest arrivals
(the lower envelope of stamp minus index times period) before and after the silence, with a fixed
look-ahead in samples.

Decisions are taken on blocks counted from the first sample, so they do not depend on the chunking.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .health import RATE_CHANGE, Counts
from .period import CLOCK_BLOCK, LATTICE_TRACKING, LEARN, Clock, Stamps, lattice_period

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Block:
    """Evenly spaced samples: stamps in ns, (n,), and rows, (axes, n).

    They follow the previous block directly, unless ``cut`` states why not. ``filled``, (axes, n),
    flags interpolated values; None if no value is interpolated.
    """

    stamps: Stamps
    rows: Floats
    cut: str = ''
    filled: Flags | None = None

    def __len__(self) -> int:
        return len(self.stamps)

    def part(self, which: slice, cut: str = '') -> Block:
        """Return some of the samples as a separate block (views)."""
        filled = None if self.filled is None else self.filled[:, which]
        return Block(self.stamps[which], self.rows[:, which], cut, filled)

    def copy(self) -> Block:
        """Return a block that shares no memory with this one."""
        filled = None if self.filled is None else self.filled.copy()
        return Block(self.stamps.copy(), self.rows.copy(), self.cut, filled)

    @classmethod
    def joined(cls, parts: list[Block]) -> Block:
        """Return the samples of all parts as one block, with the cut of the first."""
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
"""Blocks after which the working period is updated."""

RATE_CHANGE_STEP = 1.45
"""Median step, relative to the previous one, that indicates another rate and not a loss at every
step."""

RATE_CHANGE_BURSTY = 0.10
"""Change of the period over `TRACK_BLOCKS` that indicates another rate if stamps are bursty."""

BRIDGED_SHARE = 0.5
"""Largest number of interpolated samples per received sample in a block; if more samples are lost,
the data are split."""


class SampleClock:
    """Turns samples into evenly spaced blocks; at most one block and the look-ahead are buffered.

    The working period of its ``clock`` follows the stamps. Gaps of up to ``max_bridge`` samples
    are interpolated, and ``counts`` is changed in place. Once ``rate_changed`` is set, `waiting`
    contains the samples from the change on, and no more samples are accepted.
    """

    def __init__(self, clock: Clock, axes: int, max_bridge: int, counts: Counts) -> None:
        self.clock = clock
        self.rate_changed = False
        self._max_bridge = max_bridge
        self._counts = counts
        self._reach = clock.look_ahead
        # buffered samples, after up to `_reach` that are already processed (`_past` of them)
        self._stamps: Stamps = np.empty(0, np.int64)
        self._rows: Floats = np.empty((axes, 0))
        self._jumped: Flags = np.empty(0, bool)
        self._past = 0
        self._index: NDArray[np.int64] = np.empty(0, np.int64)  # of the past samples
        self._since_cut = 0  # past samples since the last cut, at most `_reach`
        self._blocks = 0
        self._suspect = False  # whether the last block seemed to have another rate
        self._track_start: tuple[int, int] | None = None  # stamp and index; None after a gap

    @property
    def waiting(self) -> tuple[Stamps, Floats]:
        """Samples that are not processed yet: stamps (n,) and rows (axes, n)."""
        return self._stamps[self._past :], self._rows[:, self._past :]

    def feed(self, stamps: Stamps, rows: Floats, jumped: Flags) -> list[Block]:
        """Add samples, and return the complete blocks."""
        if rows.strides[1] != rows.itemsize:
            # axis by axis, in any memory layout. Only the seam between buffered and new samples is
            # copied: up to the end of the block after which all samples of the look-back are new.
            rows = np.ascontiguousarray(rows)
        waiting = len(self._stamps) - self._past
        seam = -(-(waiting + self._reach) // CLOCK_BLOCK) * CLOCK_BLOCK - waiting + self._reach
        self._append(stamps[:seam], rows[:, :seam], jumped[:seam])
        done = self._judge_ready()
        if len(stamps) > seam:
            if self.rate_changed:
                self._append(stamps[seam:], rows[:, seam:], jumped[seam:])
                return done
            rest = slice(seam - len(self._stamps), None)
            self._stamps, self._rows, self._jumped = stamps[rest], rows[:, rest], jumped[rest]
            done += self._judge_ready()
            # a copy, which does not keep the others in memory
            self._append(stamps[:0], rows[:, :0], jumped[:0])
        return done

    def _append(self, stamps: Stamps, rows: Floats, jumped: Flags) -> None:
        self._stamps = np.concatenate([self._stamps, stamps])
        self._rows = np.concatenate([self._rows, rows], axis=1)
        self._jumped = np.concatenate([self._jumped, jumped])

    def _judge_ready(self) -> list[Block]:
        """Process the complete blocks whose look-ahead is available."""
        done: list[Block] = []
        first = self._past  # of samples without a gap: they are passed on as one block
        while not self.rate_changed:
            ready = (len(self._stamps) - self._past - self._reach) // CLOCK_BLOCK
            count = min(ready, TRACK_BLOCKS - self._blocks % TRACK_BLOCKS)
            if count < 1:
                break
            if self._are_even(count * CLOCK_BLOCK):
                self._suspect = False
                self._step_forward(count * CLOCK_BLOCK)
                continue
            done += self._view(first)
            done += self._judge(count * CLOCK_BLOCK)
            first = self._past
        done += self._view(first)
        self._release()
        return done

    def _view(self, first: int) -> list[Block]:
        """Return the processed samples from an index on."""
        passed = slice(first, self._past)
        return [Block(self._stamps[passed], self._rows[:, passed])] if first < self._past else []

    def flush(self) -> list[Block]:
        """Return the blocks of all buffered samples at the end of the input."""
        done: list[Block] = []
        while not self.rate_changed and len(self._stamps) > self._past:
            left = len(self._stamps) - self._past
            room = (TRACK_BLOCKS - self._blocks % TRACK_BLOCKS) * CLOCK_BLOCK
            done += self._judge(min(left, room))
            self._release()
        return done

    def _are_even(self, n: int) -> bool:
        """Return whether the next n samples have no gap and the same rate, which is the common
        case.
        """
        begin = self._past
        if begin == 0 or self._jumped[begin : begin + n].any():
            return False
        stamps = self._stamps[begin - 1 : begin + n]
        clock, longest = self.clock, int((stamps[1:] - stamps[:-1]).max())
        if clock.bursty or longest > clock.silence_ns:
            return longest <= clock.silence_ns
        period = np.diff(stamps[::CLOCK_BLOCK]) / CLOCK_BLOCK
        return longest <= RATE_CHANGE_STEP * clock.step_ns and bool(
            np.all(np.abs(period / clock.period_ns - 1.0) <= RATE_CHANGE)
        )

    def _judge(self, n: int) -> list[Block]:
        """Process the next n samples (complete blocks, or the last ones)."""
        begin = self._past
        stamps, jumped = (a[begin : begin + n] for a in (self._stamps, self._jumped))
        before = stamps[0] - round(self.clock.period_ns) if begin == 0 else self._stamps[begin - 1]
        step = np.diff(stamps, prepend=before)
        advance = np.where(jumped, 0, 1)  # index steps; 0 means a gap
        missing = np.zeros(n, np.int64)
        bridged = np.zeros(-(-n // CLOCK_BLOCK), np.int64)
        for j in np.flatnonzero((step > self.clock.silence_ns) & ~jumped):
            missing[j] = lost = self._lost(begin + int(j), int(j), advance)
            block = j // CLOCK_BLOCK
            if lost > self._max_bridge or bridged[block] + lost > BRIDGED_SHARE * CLOCK_BLOCK:
                advance[j] = 0
            else:
                bridged[block] += lost
                advance[j] = 1 + lost
        same = self._same_rate(step, advance)
        if same < n:
            self.rate_changed = True
            if same == 0:
                return []
        advance = advance[:same]
        self._counts.lost += int(missing[:same].sum())
        self._counts.bridged += int((advance[advance > 1] - 1).sum())
        jumps = int(np.count_nonzero(jumped[:same]))
        gaps = int(np.count_nonzero(advance == 0)) - jumps
        self._counts.cuts += Counter({'clock jump': jumps, 'gap': gaps})
        blocks = self._blocks_of(begin, advance)
        self._step_forward(same, advance)
        return blocks

    def _same_rate(self, step: Stamps, advance: NDArray[np.int64]) -> int:
        """Return how many of the samples come before a change of the rate.

        The steps of a block show whether the rate changed, the first unusual step shows where. With
        jitter, two blocks are needed, because one block may have several losses that were not
        detected. The samples from which the period was learned are exempt, so that every clock
        makes progress.
        """
        if self.clock.bursty:
            return len(step)
        usual = self.clock.step_ns
        for at in range(max(0, LEARN - self._blocks * CLOCK_BLOCK), len(step), CLOCK_BLOCK):
            steps, indices = step[at : at + CLOCK_BLOCK], advance[at : at + CLOCK_BLOCK]
            if len(steps) < CLOCK_BLOCK // 4:
                break
            counted = indices > 0
            period = steps[counted].sum() / max(1, indices.sum())
            before = self._suspect
            self._suspect = abs(period / self.clock.period_ns - 1.0) > RATE_CHANGE
            if float(np.median(steps)) > RATE_CHANGE_STEP * usual or (
                self._suspect and (before or not self.clock.jitter)
            ):
                odd = (steps > RATE_CHANGE_STEP * usual) | (RATE_CHANGE_STEP * steps < usual)
                return at + int(np.argmax(odd))
        return len(step)

    def _lost(self, at: int, j: int, advance: NDArray[np.int64]) -> int:
        """Return how many samples are missing before a sample, by the lower envelope.

        The sample has index ``at`` in the buffer and ``j`` among those being processed, with steps
        ``advance``.
        """
        period, reach = self.clock.period_ns, self._reach
        judged = self._since_cut + j
        cuts = np.flatnonzero(advance[:j] == 0)
        if len(cuts):
            judged = j - int(cuts[-1])
        past = min(reach, judged)
        if past == 0:
            return 0
        origin = self._stamps[at - 1]
        steps = np.concatenate([np.diff(self._index, prepend=0), advance[:j]])
        back = -np.cumsum(steps[::-1])[: past - 1]
        index = np.concatenate([[0], back])[::-1]
        envelope_before = ((self._stamps[at - past : at] - origin) - period * index).min()
        after = self._stamps[at : at + reach]
        jumps = np.flatnonzero(self._jumped[at + 1 : at + reach])
        if len(jumps):
            after = after[: jumps[0] + 1]
        late = (after - origin) - period * np.arange(1, len(after) + 1)
        shift = (float(late.min()) - float(envelope_before)) / period
        silence = (self._stamps[at] - origin) / period - 1.0
        least = max(0.5 * silence, self.clock.least_loss)
        return round(shift) if shift > least else 0

    def _blocks_of(self, begin: int, advance: NDArray[np.int64]) -> list[Block]:
        """Return the processed samples as blocks, short gaps interpolated."""
        n = len(advance)
        judged = Block(self._stamps[begin : begin + n], self._rows[:, begin : begin + n])
        blocks: list[Block] = []
        parts: list[Block] = []
        cut, at = '', 0
        for j in (*np.flatnonzero(advance != 1).tolist(), n):
            if j > at:
                parts.append(judged.part(slice(at, j), cut))
            at = j
            if j == n:
                break
            if advance[j] == 0:
                if parts:
                    blocks.append(Block.joined(parts))
                parts, cut = [], 'clock jump' if self._jumped[begin + j] else 'gap'
                continue
            left, right = begin + j - 1, begin + j
            share = np.arange(1, advance[j]) / advance[j]
            gap_ns = self._stamps[right] - self._stamps[left]
            step = (self._rows[:, right] - self._rows[:, left])[:, None]
            rows = self._rows[:, left][:, None] + share * step
            stamps = self._stamps[left] + np.rint(share * gap_ns).astype(np.int64)
            parts.append(Block(stamps, rows, cut, np.ones(rows.shape, bool)))
        if parts:
            blocks.append(Block.joined(parts))
        return blocks

    def _step_forward(self, n: int, advance: NDArray[np.int64] | None = None) -> None:
        """Mark n samples as processed and follow the period; None if no sample is missing."""
        begin, end = self._past, self._past + n
        last = int(self._index[-1]) if len(self._index) else -1
        since_cut, cut = self._since_cut + n, False
        if advance is None:
            index = np.arange(last + 1, last + 1 + n)
        else:
            index = last + np.cumsum(advance)
            cuts = np.flatnonzero(advance == 0)
            if cut := bool(len(cuts)):
                since_cut = n - int(cuts[-1])
        self._since_cut = min(since_cut, self._reach)
        self._track(self._stamps[begin:end], index, cut)
        self._index = np.concatenate([self._index, index[-self._reach :]])[-self._reach :]
        self._past = end

    def _release(self) -> None:
        """Release processed samples that no later decision needs."""
        old = max(0, self._past - self._reach)
        self._stamps = self._stamps[old:]
        self._rows = self._rows[:, old:]
        self._jumped = self._jumped[old:]
        self._past -= old

    def _track(self, stamps: Stamps, index: NDArray[np.int64], cut: bool) -> None:
        """Update the working period after every `TRACK_BLOCKS` blocks without a gap."""
        fresh = self._blocks % TRACK_BLOCKS == 0
        if fresh:
            self._track_start = (int(stamps[0]), int(index[0]))
        if cut:
            self._track_start = None
        self._blocks += -(-len(stamps) // CLOCK_BLOCK)
        if self._blocks % TRACK_BLOCKS or self._track_start is None:
            return
        start_ns, start = self._track_start
        if self.clock.jitter:
            period = lattice_period(stamps, self.clock.period_ns, LATTICE_TRACKING)
        else:
            period = (int(stamps[-1]) - start_ns) / (int(index[-1]) - start)
        off = abs(period / self.clock.period_ns - 1.0)
        if self.clock.bursty:
            self.rate_changed = off > RATE_CHANGE_BURSTY
            # one silence shifts the mean of an interval as much as a real change of the period
            period = self.clock.period_ns + 0.25 * (period - self.clock.period_ns)
        if not self.rate_changed:
            self.clock = replace(self.clock, period_ns=period)
