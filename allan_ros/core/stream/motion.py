# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion detection: keeps the samples of an IMU at rest and drops the others.

The stream is classified in windows of about half a second. A window is moving if its variance, its
largest deviation, the step of its mean or its mean rate exceeds a limit that is derived from the
noise floor, the noise of the sensor at rest. A window of white noise is classified as moving with a
probability below 1e-12, so N has no bias. Motion begins at higher limits than it ends (hysteresis).
Some windows before and after a motion are dropped, too. The samples of a shock, a short motion
that changes no mean, are replaced instead.

First, isolated spikes are replaced by the mean of their neighbors. If the noise has heavy tails,
they are noise: they stay in the data and are not regarded as motion. If the noise increases
while the IMU stays at rest, the samples are dropped and counted separately.

The noise floor is learned from the first windows in which the IMU can be at rest, and then updated
from the quietest quarter of each block of windows. Windows are counted from the start of the
stream or the last gap, so the decisions do not depend on how the samples are divided into batches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .health import Counts, Event, EventLog, State
from .noise_floor import EXAMINED, LEAST_WINDOW, NoiseFloor, RestLimits, Windows
from .shocks import LONGEST_SHOCK, LONGEST_SHOCK_S, Level, Motion
from .timing import Block, Flags
from .windows import SPIKE_NEIGHBORS, Saturation, WindowClass, classify_windows, without_spikes

Floats = NDArray[np.float64]

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short compared with a motion."""

MOST_WINDOW = 1024
"""Longest window in samples."""

BLOCK_WINDOWS = 32
"""Number of windows from which the noise floor is learned, and after which it is updated."""

MARGIN_BEFORE, MARGIN_AFTER = 1, 4
"""Number of still windows that are dropped before and after a motion: 0.5 s and 2 s."""

RELEARNED = 'relearned'
"""Reason for a split after which all earlier sums are discarded: the IMU moved."""

INCREASE_BLOCKS = 2
"""Number of consecutive blocks (together about 30 s) after which noise that exceeds the limits is
classified as increased noise instead of motion."""

MOST_FILLED = 0.1
"""Largest share of interpolated samples in a window that is searched for outliers."""


class _Part(NamedTuple):
    """Consecutive windows of the current block: samples, statistics and classification."""

    samples: Block
    windows: Windows
    still: Flags
    found: WindowClass


class MotionGate:
    """Detects motion, and keeps only the samples at rest.

    ``period_ns`` is the sample period. A window is moving if its standard deviation is more than
    ``motion_ratio`` times that of the noise floor, or if its mean rate differs from that at rest by
    more than ``rate_limit`` in rad/s. ``counts`` and ``events`` are changed in place. The attribute
    ``increase`` is the ratio of the current noise at rest to the noise floor, (axes,), or None if
    the noise has not increased. ``largest_increase`` holds the largest ratios so far; 0 if it never
    increased.
    """

    def __init__(
        self,
        period_ns: float,
        axes: tuple[str, ...],
        counts: Counts,
        events: EventLog,
        motion_ratio: float,
        rate_limit: float,
    ) -> None:
        wanted = round(WINDOW_S * 1e9 / period_ns)
        self.size = int(np.clip(wanted, LEAST_WINDOW, MOST_WINDOW))
        self.increase: Floats | None = None
        self.largest_increase = np.zeros(len(axes))
        self._counts = counts
        self._events = events
        self._axes = axes
        self._period_s = period_ns * 1e-9
        longest = int(LONGEST_SHOCK_S / (self.size * self._period_s))
        self._longest_shock = min(longest, LONGEST_SHOCK)
        self._ratio = motion_ratio
        self._limits = RestLimits.of(axes, rate_limit)
        self._floor: NoiseFloor | None = None
        self._learning: list[Block] = []  # buffered until the noise floor is known
        # buffered until they fill a window, with their look-ahead
        self._pending = Block(np.empty(0, np.int64), np.empty((len(axes), 0)))
        self._before = np.empty((len(axes), 0))  # the last samples before them
        self._saturation = Saturation(len(axes))
        self._last_mean: Floats | None = None
        self._motion: Motion | None = None
        self._level = Level()
        self._shocks = self._replaced = 0  # shocks and their replaced samples
        self._cut = ''  # reason for the gap before the next still block
        self._margin: list[Block] = []  # still windows, dropped if a motion begins after them
        self._pending_cut = ''  # reason for the gap before the pending samples
        self._block: list[_Part] = []
        self._in_block = 0  # number of windows in it
        self._noisy_blocks = 0

    @property
    def moving(self) -> bool:
        """Whether the IMU moves, or an axis is stuck."""
        return self._motion is not None

    @property
    def heavy_tails(self) -> dict[str, float]:
        """Axes with heavy tails, and the share of their samples that are outliers."""
        floor = self._floor
        if floor is None or not floor.heavy.any():
            return {}
        share = floor.outliers / floor.examined
        return {axis: float(share[i]) for i, axis in enumerate(self._axes) if floor.heavy[i]}

    @property
    def state(self) -> State:
        """Current state; 'learning' until the noise floor is known or a motion is found."""
        if self._floor is None and not self.moving:
            return 'learning'
        if self.increase is not None:
            return 'noise_increased'
        return 'moving' if self.moving else 'at_rest'

    def feed(self, blocks: list[Block]) -> list[Block]:
        """Add consecutive blocks, and return the samples that are confirmed to be at rest."""
        out: list[Block] = []
        for contiguous in _contiguous(blocks):
            if self._floor is None:
                self._learning += contiguous
                needed = BLOCK_WINDOWS * self.size
                while self._floor is None and sum(map(len, self._learning)) >= needed:
                    out += self._learn()
            else:
                out += self._add(contiguous)
        return out

    def flush(self) -> list[Block]:
        """Return the buffered blocks that are at rest, at the end of the input."""
        out: list[Block] = []
        while self._floor is None and self._learning:
            out += self._learn()
        return out + self._flush_pending()

    # --- learning ---------------------------------------------------------------------------------

    def _learn(self) -> list[Block]:
        """Learn the noise floor from the first windows, or drop these if the IMU moved."""
        first, rest = _split(self._learning, BLOCK_WINDOWS * self.size)
        parts = [np.concatenate([b.rows for b in blocks], axis=1) for blocks in _contiguous(first)]
        floor = NoiseFloor.learned(parts, self.size, self._limits)
        if floor.is_plausible():
            for blocks in _contiguous(first):
                joined = Block.joined(blocks)
                joined = joined.part(slice(len(joined) // self.size * self.size))
                windows = Windows.of(joined.rows, self.size)
                found = classify_windows(windows, None, self.size, floor, self._ratio)
                floor = floor.with_outliers(_usable(joined, self.size, ~found.moving))
            self._floor = floor
            blocks, self._learning = self._learning, []
            self._log_motion()
            self._motion = None
            return self.feed(blocks)
        self._learning = rest
        self._counts.moving += sum(map(len, first))
        if self._motion is None:
            self._motion = Motion('motion', int(first[0].stamps[0]), None, [])
            self._counts.splits['motion'] += 1
        self._motion.ended_ns = int(first[-1].stamps[-1])
        self._cut = 'motion'
        return []

    # --- windows ----------------------------------------------------------------------------------

    def _add(self, blocks: list[Block]) -> list[Block]:
        """Classify blocks without a gap between them, and return the samples at rest."""
        out: list[Block] = []
        if blocks[0].cut:
            out += self._flush_pending()
        self._pending_cut = self._pending_cut or blocks[0].cut
        for block in blocks:
            # only the window that begins in the buffer is copied, with its look-ahead
            seam = -len(self._pending) % self.size + SPIKE_NEIGHBORS
            out += self._append(block.part(slice(None, seam)))
            if len(block) > seam:
                self._pending = self._pending.part(slice(0))
                out += self._append(block.part(slice(seam - SPIKE_NEIGHBORS, None)))
        return out

    def _append(self, block: Block) -> list[Block]:
        """Classify all windows whose look-ahead is complete, and buffer the other samples."""
        have = Block.joined([self._pending, block]) if len(self._pending) else block
        ready = max(0, len(have) - SPIKE_NEIGHBORS) // self.size * self.size
        out = self._classify(have, ready, self.size) if ready else []
        self._pending = have.part(slice(ready, None)).copy()
        return out

    def _flush_pending(self) -> list[Block]:
        """Classify the buffered samples before a gap, and return all that are at rest."""
        out: list[Block] = []
        rest, self._pending = self._pending, self._pending.part(slice(0))
        while len(rest) and self._floor is not None:
            size = min(len(rest), self.size)
            out += self._classify(rest, size, size)
            rest = rest.part(slice(size, None))
        self._before = self._before[:, :0]
        out += self._margin
        self._margin = []
        self._no_shock()
        return out

    def _classify(self, have: Block, samples: int, size: int) -> list[Block]:
        """Classify the first ``samples`` samples, in windows of ``size``; return those at rest."""
        assert self._floor is not None
        block, after = have.part(slice(samples)), have.rows[:, samples : samples + SPIKE_NEIGHBORS]
        before, self._before = self._before, block.rows[:, -SPIKE_NEIGHBORS:].copy()
        block, windows, spikes = without_spikes(block, size, before, after, self._floor)
        self._counts.spikes += spikes
        out: list[Block] = []
        at, number = 0, samples // size
        while at < number:
            k = min(number - at, BLOCK_WINDOWS - self._in_block)
            part = block.part(slice(at * size, (at + k) * size), self._pending_cut)
            self._pending_cut = ''
            out += self._keep_still(part, size, windows[at : at + k])
            at += k
            if size == self.size:
                self._in_block += k
                if self._in_block == BLOCK_WINDOWS:
                    out += self._end_block()
        return out

    # --- still or moving --------------------------------------------------------------------------

    def _keep_still(self, block: Block, size: int, windows: Windows) -> list[Block]:
        """Return the samples of a block that are at rest; each window has ``size`` samples."""
        out: list[Block] = []
        if block.cut:
            out, self._margin = self._margin, []
            self._last_mean, self._level = None, Level()
            if self._motion is not None:
                self._motion.before = self._motion.before[:0]
            self._cut = self._cut or block.cut
        assert self._floor is not None
        found = classify_windows(windows, self._last_mean, size, self._floor, self._ratio)
        still = ~found.moving
        if self.moving or found.moving.any():
            for i in range(len(still)):
                window = block.part(slice(i * size, (i + 1) * size))
                out += self._step(window, windows.mean[:, i], *(bool(v[i]) for v in found[:3]))
                still[i] = not self.moving
        else:
            self._level.add(windows.mean, size)
            out += self._release(block.part(slice(None)))
        self._last_mean = windows.mean[:, -1]
        if size == self.size:
            self._block.append(_Part(block, windows, still, found))
        return out

    def _step(
        self, window: Block, mean: Floats, moving: bool, quiet: bool, stuck: bool
    ) -> list[Block]:
        """Update the state from one window, and return samples confirmed to be at rest."""
        if self._motion is None and not moving:
            self._level.add(mean[:, None], len(window))
            return self._release(window)
        if self._motion is None:
            kind, margin = 'stuck' if stuck else 'motion', self._margin
            self._motion = Motion(kind, int(window.stamps[0]), self._level, margin)
            self._margin = []
        motion = self._motion
        if stuck:
            self._no_shock()
            self._counts.stuck += len(window)
        else:
            self._counts.moving += len(window) if motion.held is None else 0
            assert self._floor is not None
            before = self._saturation.count
            self._saturation.add(window.rows, self._floor.lsb)
            self._counts.saturated += self._saturation.count - before
        motion.add(window, mean, quiet)
        if motion.is_longer(self._longest_shock):
            self._no_shock()
        return self._end_motion() if motion.quiet >= MARGIN_AFTER else []

    def _end_motion(self) -> list[Block]:
        """Return the windows of the motion that just ended if it was a shock, else split."""
        assert self._floor is not None and self._motion is not None
        out: list[Block] = []
        kept = self._motion.replaced(self._floor, self._period_s)
        if kept:
            self._motion.kind = 'shock'
            self._count_shocks(1, len(kept[0]))
            out.append(kept[0])
        else:
            self._no_shock()
        self._log_motion()
        self._motion = None
        for window in kept[1:]:
            self._level.add(window.rows.mean(axis=1)[:, None], len(window))
            out += self._release(window)
        return out

    def _count_shocks(self, shocks: int, samples: int) -> None:
        self._shocks += shocks
        self._replaced += samples
        self._counts.shocks += shocks
        self._counts.replaced += samples

    def _no_shock(self) -> None:
        """Drop the windows of the present motion, which is no shock."""
        motion = self._motion
        if motion is not None and motion.held is not None:
            self._counts.moving += sum(map(len, motion.abandon()))
            self._counts.splits[motion.kind] += 1
            self._cut = self._cut or motion.kind

    def _log_motion(self) -> None:
        """Add the motion that just ended to the list of events."""
        motion, floor = self._motion, self._floor
        if motion is None or floor is None:
            return
        change = motion.change(floor)
        changed = {a: float(c) for a, c in zip(self._axes, change) if abs(c) > 0.0}
        seconds = (motion.ended_ns - motion.began_ns) * 1e-9 + self._period_s
        self._events.add(Event(motion.kind, motion.began_ns, seconds, changed))

    def _release(self, block: Block) -> list[Block]:
        """Buffer the last still window, because a motion may follow; return the samples before."""
        out = self._margin
        split = max(0, len(block) - MARGIN_BEFORE * self.size)
        cut, self._cut = self._cut, ''
        if split:
            out = [*out, block.part(slice(split), cut)]
            cut = ''
        self._margin = [block.part(slice(split, None), cut)]
        return out

    # --- the noise floor --------------------------------------------------------------------------

    def _end_block(self) -> list[Block]:
        """Update the noise floor after a block; start again if it was learned during a motion."""
        floor = self._floor
        assert floor is not None
        block, self._block, self._in_block = self._block, [], 0
        windows = Windows.joined(part.windows for part in block)
        lower = floor.replacement(windows)
        if lower is not None:
            self._floor = lower
            return self._restart(block)
        still = np.concatenate([part.still for part in block])
        rotating = all(part.found.rotating.all() for part in block)
        updated = floor.updated(windows, still, rotating)
        if updated.is_plausible():
            self._floor = updated.with_outliers(self._examined(block))
        self._count_increased(block, windows, still)
        return []

    def _examined(self, block: list[_Part]) -> Floats:
        """Return every `EXAMINED`-th window of a block if it is at rest, (axes, k * size)."""
        found, at = [], 0
        for part in block:
            chosen = part.still & (np.arange(at, at + len(part.still)) % EXAMINED == 0)
            found.append(_usable(part.samples, self.size, chosen))
            at += len(part.still)
        return np.concatenate(found, axis=1)

    def _count_increased(self, block: list[_Part], windows: Windows, still: Flags) -> None:
        """Count a block of moving windows as increased noise if the IMU did not move."""
        ratio = None
        if not still.any() and not any(part.found.stuck.any() for part in block):
            assert self._floor is not None
            rows = np.concatenate([part.samples.rows for part in block], axis=1)
            ratio = self._floor.increase(rows, windows)
        self._noisy_blocks = 0 if ratio is None else self._noisy_blocks + 1
        self.increase = ratio if self._noisy_blocks >= INCREASE_BLOCKS else None
        if self.increase is None:
            return
        blocks = INCREASE_BLOCKS if self._noisy_blocks == INCREASE_BLOCKS else 1
        samples = blocks * BLOCK_WINDOWS * self.size
        self._counts.moving -= samples
        self._counts.noise_increased += samples
        self.largest_increase = np.maximum(self.largest_increase, self.increase)
        if self._motion is not None:
            self._motion.kind = 'noise_increased'

    def _restart(self, block: list[_Part]) -> list[Block]:
        """Discard all earlier data, and classify the block again with the new noise floor."""
        # `SensorStream` counts the samples that were already released
        self._no_shock()
        self._count_shocks(-self._shocks, -self._replaced)
        self._counts.moving += sum(map(len, self._margin))
        samples = sum(len(part.samples) for part in block)
        stuck = self.size * sum(int(np.count_nonzero(part.found.stuck)) for part in block)
        self._counts.moving -= samples - stuck
        self._counts.stuck -= stuck
        self._margin = []
        self._last_mean, self._level = None, Level()
        self._noisy_blocks, self.increase = 0, None
        self._motion = Motion('motion', int(block[0].samples.stamps[0]), None, [])
        self._cut = 'motion'
        out = [block[0].samples.part(slice(0), RELEARNED)]
        for part in block:
            out += self._keep_still(part.samples, self.size, part.windows)
        self._block = []
        return out


def _contiguous(blocks: list[Block]) -> list[list[Block]]:
    """Group consecutive blocks that have no gap between them."""
    groups: list[list[Block]] = []
    for block in blocks:
        if block.cut or not groups:
            groups.append([])
        groups[-1].append(block)
    return groups


def _usable(block: Block, size: int, chosen: Flags) -> Floats:
    """Return the chosen windows without those that contain many interpolated samples."""
    cube = block.rows.reshape(len(block.rows), -1, size)
    if block.filled is not None:
        share = block.filled.reshape(cube.shape).mean(axis=2).max(axis=0)
        chosen = chosen & (share <= MOST_FILLED)
    return cube[:, chosen].reshape(len(cube), -1)


def _split(blocks: list[Block], samples: int) -> tuple[list[Block], list[Block]]:
    """Split consecutive blocks after a number of samples."""
    for i, block in enumerate(blocks):
        if len(block) > samples:
            before = [block.part(slice(samples), block.cut)] if samples else []
            after = block.part(slice(samples, None), '' if samples else block.cut)
            return [*blocks[:i], *before], [after, *blocks[i + 1 :]]
        samples -= len(block)
    return blocks, []
