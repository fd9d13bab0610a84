# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion detection: keeps the samples of an IMU at rest and drops the others.

The stream is classified in windows of about half a second. A window is moving if its variance, its
largest deviation, the step of its mean or its mean rate exceeds a limit that is derived from the
noise floor, the noise of the sensor at rest. A window of white noise is classified as moving with a
probability below 1e-12, so N has no bias. Motion begins at higher limits than it ends (hysteresis).
Some windows before and after a motion are dropped, too.

First, isolated spikes are replaced. If the noise has heavy tails, they are noise: they stay in the
data and are not regarded as motion. The samples of a shock are replaced, too. If the noise
increases while the IMU stays at rest, the samples are dropped and counted separately.

The noise floor is learned from the first windows in which the IMU can be at rest, and then updated
from the quietest quarter of each block of windows. Windows are counted from the start of the
stream or the last gap, so the decisions do not depend on how the samples are divided into batches.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..imu import Block, Flags, Floats
from ..settings import SegmenterSettings
from .disturbances import (
    LONGEST_SHOCK,
    LONGEST_SHOCK_S,
    SPIKE_NEIGHBORS,
    Level,
    Motion,
    without_spikes,
)
from .health import Counts, Event, Longest, State
from .noise_floor import EXAMINED, LEAST_WINDOW, NoiseFloor, WindowClass, Windows

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
    ``settings.motion_ratio`` times the noise floor, or if its mean rate differs from the rate
    at rest by more than ``settings.rate_limit``. ``counts`` and ``events`` are changed in place.
    """

    def __init__(
        self,
        period_ns: float,
        axes: tuple[str, ...],
        counts: Counts,
        events: Longest[Event],
        settings: SegmenterSettings,
    ) -> None:
        wanted = round(WINDOW_S * 1e9 / period_ns)
        self.size = int(np.clip(wanted, LEAST_WINDOW, MOST_WINDOW))
        # ratio of the current noise at rest to the noise floor; None if it has not increased
        self._increase: Floats | None = None
        self._largest_increase = np.zeros(len(axes))
        self._counts = counts
        self._events = events
        self._axes = axes
        self._settings = settings
        self._period_s = period_ns * 1e-9
        longest = int(LONGEST_SHOCK_S / (self.size * self._period_s))
        self._longest_shock = min(longest, LONGEST_SHOCK)
        self._shocks_before = counts.shocks, counts.replaced
        self._floor: NoiseFloor | None = None
        self._learning: list[Block] = []  # buffered until the noise floor is known
        # buffered until they fill a window, with their look-ahead
        self._pending = Block.empty(len(axes))
        self._before = self._pending.rows  # the last samples before them
        self._last_mean: Floats | None = None
        self._motion: Motion | None = None
        self._level = Level()
        self._out: list[Block] = []  # confirmed to be at rest
        self._cut = ''  # reason for the gap before the next still block
        # the last still window, because a motion may follow, and the windows of a possible shock
        self._held: list[Block] = []
        self._block: list[_Part] = []
        self._noisy_blocks = 0

    @property
    def increases(self) -> dict[str, float]:
        """Axis -> largest ratio of its noise at rest to the noise floor; empty if none."""
        largest = self._largest_increase
        return dict(zip(self._axes, largest.tolist())) if largest.any() else {}

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
        if self._increase is not None:
            return 'noise_increased'
        if self._motion is not None:
            return 'moving'
        return 'learning' if self._floor is None else 'at_rest'

    def feed(self, blocks: list[Block]) -> list[Block]:
        """Add consecutive blocks, and return the samples that are confirmed to be at rest."""
        for block in blocks:
            while self._floor is None and len(block):
                room = BLOCK_WINDOWS * self.size - _samples(self._learning)
                self._learning.append(block.part(slice(room), block.cut))
                if len(block) >= room:
                    self._learn()
                block = block.part(slice(room, None))
            if len(block):
                self._add(block)
        out, self._out = self._out, []
        return out

    def flush(self) -> list[Block]:
        """Return the buffered blocks that are at rest, at the end of the input."""
        if self._learning:
            self._learn()
        self._flush_pending()
        return self.feed([])

    # --- learning ---------------------------------------------------------------------------------

    def _learn(self) -> None:
        """Learn the noise floor from the first windows, or drop these if the IMU moved."""
        parts, self._learning = _without_gaps(self._learning), []
        floor = self._learned_floor(parts)
        if not floor.is_plausible():
            self._counts.moving += _samples(parts)
            if self._motion is None:
                self._motion = Motion('motion', int(parts[0].stamps[0]))
                self._counts.splits['motion'] += 1
            self._motion.ended_ns = int(parts[-1].stamps[-1])
            self._cut = 'motion'
            return
        for part in parts:
            windows = Windows.of(part.rows, self.size)
            found = floor.classify(windows, None, self.size)
            floor = floor.with_outliers(_usable(part, self.size, ~found.moving))
        self._floor = floor
        self._log_motion()
        for part in parts:
            self._add(part)

    def _learned_floor(self, parts: list[Block]) -> NoiseFloor:
        """Return the noise floor of some windows; there is a gap between two parts."""
        gyro = np.array([axis.startswith('gyro') for axis in self._axes])
        return NoiseFloor.learned([part.rows for part in parts], self.size, gyro, self._settings)

    # --- windows ----------------------------------------------------------------------------------

    def _add(self, block: Block) -> None:
        """Classify the complete windows of the buffered samples and the next block."""
        if block.cut:
            self._flush_pending()
        have = Block.joined([self._pending, block])
        ready = max(0, len(have) - SPIKE_NEIGHBORS) // self.size * self.size
        self._classify(have, ready, self.size)
        self._pending = have.part(slice(ready, None), '' if ready else have.cut).copy()

    def _flush_pending(self) -> None:
        """Classify the buffered samples before a gap, and pass on all that are at rest."""
        rest, self._pending = self._pending, self._pending.part(slice(0))
        while len(rest) and self._floor is not None:
            size = min(len(rest), self.size)
            self._classify(rest, size, size)
            rest = rest.part(slice(size, None))
        self._before = self._before[:, :0]
        self._no_shock()
        self._pass_held()

    def _classify(self, have: Block, samples: int, size: int) -> None:
        """Classify the first ``samples`` samples, in windows of ``size``."""
        assert self._floor is not None
        at = 0
        while at < samples:
            # up to the end of a block, after which the noise floor is another one
            in_block = sum(len(part.still) for part in self._block)
            k = min((samples - at) // size, BLOCK_WINDOWS - in_block)
            end = at + k * size
            block = have.part(slice(at, end), '' if at else have.cut)
            after = have.rows[:, end : end + SPIKE_NEIGHBORS]
            before, self._before = self._before, block.rows[:, -SPIKE_NEIGHBORS:].copy()
            block, windows, spikes = without_spikes(block, size, before, after, self._floor)
            self._counts.spikes += spikes
            self._keep_still(block, size, windows)
            at = end
            if size == self.size and in_block + k == BLOCK_WINDOWS:
                self._end_block()

    # --- still or moving --------------------------------------------------------------------------

    def _keep_still(self, block: Block, size: int, windows: Windows) -> None:
        """Keep the samples of a block that are at rest; each window has ``size`` samples."""
        assert self._floor is not None
        if block.cut:
            self._pass_held()
            self._last_mean, self._level = None, Level()
            if self._motion is not None:
                self._motion.before = self._motion.before[:0]
            self._cut = self._cut or block.cut
        found = self._floor.classify(windows, self._last_mean, size)
        still = ~found.moving
        if self._motion is None and still.all():
            self._release(block, windows.mean, size)
        else:
            for i in range(len(still)):
                window = block.part(slice(i * size, (i + 1) * size))
                self._step(window, windows.mean[:, i], *(bool(v[i]) for v in found[:3]))
                still[i] = self._motion is None
        self._last_mean = windows.mean[:, -1]
        if size == self.size:
            self._block.append(_Part(block, windows, still, found))

    def _step(self, window: Block, mean: Floats, moving: bool, quiet: bool, stuck: bool) -> None:
        """Update the state from one window, and keep it if it is at rest."""
        if self._motion is None and not moving:
            self._release(window, mean[:, None], len(window))
            return
        if self._motion is None:
            kind = 'stuck' if stuck else 'motion'
            self._motion = Motion(kind, int(window.stamps[0]), self._level)
        motion = self._motion
        if stuck:
            self._no_shock()
            self._counts.stuck += len(window)
        elif motion.level is None:
            self._counts.moving += len(window)
        else:
            self._held.append(window)
        motion.add(window, mean, quiet)
        if motion.windows - motion.quiet > self._longest_shock:
            self._no_shock()
        if motion.quiet >= MARGIN_AFTER:
            self._end_motion(motion)

    def _end_motion(self, motion: Motion) -> None:
        """Pass on the windows of the motion that just ended if it was a shock, else split."""
        assert self._floor is not None
        kept = motion.replaced(self._held, self._floor, self._period_s)
        if kept:
            motion.kind = 'shock'
            self._counts.shocks += 1
            self._counts.replaced += len(kept[0])
            self._held = []
        else:
            self._no_shock()
        self._log_motion()
        self._out += kept[:1]
        for window in kept[1:]:
            self._release(window, window.rows.mean(axis=1)[:, None], len(window))

    def _no_shock(self) -> None:
        """Drop the windows of the present motion, which is no shock."""
        motion = self._motion
        if motion is not None and motion.level is not None:
            self._counts.moving += _samples(self._held)
            self._counts.splits[motion.kind] += 1
            self._cut = self._cut or motion.kind
            motion.level, self._held = None, []

    def _log_motion(self) -> None:
        """Add the motion that just ended, if any, to the list of events."""
        motion, floor, self._motion = self._motion, self._floor, None
        if motion is not None and floor is not None:
            changes = zip(self._axes, motion.change(floor).tolist())
            seconds = (motion.ended_ns - motion.began_ns) * 1e-9 + self._period_s
            changed = {axis: change for axis, change in changes if abs(change) > 0.0}
            self._events.add(seconds, Event(motion.kind, motion.began_ns, seconds, changed))

    def _release(self, block: Block, means: Floats, size: int) -> None:
        """Pass on still windows except for the last one, because a motion may follow.

        ``means``, (axes, k), are the means of the windows of ``size`` samples.
        """
        self._level.add(means, size)
        self._pass_held()
        split = max(0, len(block) - MARGIN_BEFORE * self.size)
        cut, self._cut = self._cut, ''
        if split:
            self._out.append(block.part(slice(split), cut))
            cut = ''
        self._held = [block.part(slice(split, None), cut)]

    def _pass_held(self) -> None:
        self._out += self._held
        self._held = []

    # --- the noise floor --------------------------------------------------------------------------

    def _end_block(self) -> None:
        """Update the noise floor after a block; start again if it was learned during a motion."""
        floor = self._floor
        assert floor is not None
        block, self._block = self._block, []
        windows = Windows.joined(part.windows for part in block)
        if floor.is_above(windows):
            self._floor = self._learned_floor(_without_gaps([part.samples for part in block]))
            self._restart(block)
            return
        samples = Block.joined([part.samples for part in block])
        still = np.concatenate([part.still for part in block])
        rotating = all(part.found.rotating.all() for part in block)
        updated = floor.updated(windows, still, rotating)
        if updated.is_plausible():
            examined = still & (np.arange(len(still)) % EXAMINED == 0)
            floor = self._floor = updated.with_outliers(_usable(samples, self.size, examined))
        stuck = any(part.found.stuck.any() for part in block)
        moving = not (still.any() or stuck)
        self._count_increased(floor.increase(samples.rows, windows) if moving else None)

    def _count_increased(self, ratio: Floats | None) -> None:
        """Count a block as increased noise; ``ratio`` is None if it is at rest or in motion."""
        self._noisy_blocks = 0 if ratio is None else self._noisy_blocks + 1
        self._increase = ratio if self._noisy_blocks >= INCREASE_BLOCKS else None
        if self._increase is None:
            return
        blocks = INCREASE_BLOCKS if self._noisy_blocks == INCREASE_BLOCKS else 1
        samples = blocks * BLOCK_WINDOWS * self.size
        self._counts.moving -= samples
        self._counts.noise_increased += samples
        self._largest_increase = np.maximum(self._largest_increase, self._increase)
        if self._motion is not None:
            self._motion.kind = 'noise_increased'

    def _restart(self, block: list[_Part]) -> None:
        """Discard all earlier data, and classify the block again with the new noise floor."""
        # `SensorStream` counts the samples that were already released
        self._no_shock()
        self._counts.shocks, self._counts.replaced = self._shocks_before
        self._counts.moving += _samples(self._held)
        stuck = self.size * sum(int(np.count_nonzero(part.found.stuck)) for part in block)
        self._counts.moving -= _samples(part.samples for part in block) - stuck
        self._counts.stuck -= stuck
        self._held = []
        self._last_mean, self._level = None, Level()
        self._noisy_blocks, self._increase = 0, None
        self._motion = Motion('motion', int(block[0].samples.stamps[0]))
        self._cut = 'motion'
        self._out.append(block[0].samples.part(slice(0), RELEARNED))
        for part in block:
            self._keep_still(part.samples, self.size, part.windows)
        self._block = []


def _without_gaps(blocks: Iterable[Block]) -> list[Block]:
    """Join the blocks that have no gap between them."""
    groups: list[list[Block]] = []
    for block in blocks:
        if block.cut or not groups:
            groups.append([])
        groups[-1].append(block)
    return [Block.joined(group) for group in groups]


def _samples(blocks: Iterable[Block]) -> int:
    return sum(map(len, blocks))


def _usable(block: Block, size: int, chosen: Flags) -> Floats:
    """Return the chosen windows that do not contain many interpolated samples."""
    samples = len(chosen) * size
    cube = block.rows[:, :samples].reshape(len(block.rows), -1, size)
    if block.filled is not None:
        filled = block.filled[:, :samples].reshape(cube.shape) > 0
        share = filled.mean(axis=2).max(axis=0)
        chosen = chosen & (share <= MOST_FILLED)
    return cube[:, chosen].reshape(len(cube), -1)
