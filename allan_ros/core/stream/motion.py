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
from typing import Literal, NamedTuple

import numpy as np

from ..imu import Block, Flags, Floats
from ..settings import SegmenterSettings
from .disturbances import (
    LEAST_LEVEL,
    LONGEST_SHOCK_S,
    SPIKE_NEIGHBORS,
    Level,
    Motion,
    without_spikes,
)
from .health import Counts, Event, Longest, State
from .noise_floor import EXAMINED, LEAST_WINDOW, NoiseFloor, WindowClass, Windows, is_stuck

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short compared with a motion."""

BLOCK_WINDOWS = 32
"""Number of windows from which the noise floor is learned, and after which it is updated. All of
them are buffered: 0.15 MB of six axes at 200 Hz, 15 MB at 20 kHz."""

MOST_WINDOW = 1 << 15
"""Longest window in samples, above 65 kHz: 50 MB of buffered samples."""

MARGIN_BEFORE, MARGIN_AFTER_S = 1, 2.0
"""What is dropped of the data at rest next to a motion: one window before it, and windows of at
least 2 s after it."""

LEAST_DECREASED = BLOCK_WINDOWS // 4
"""Number of windows with less noise after which another noise floor is tried."""

Change = Literal['relearned', 'revived', 'set_aside', 'resumed', 'accepted']
"""What happens to the sums when the noise floor changes. 'relearned': the present sums are
discarded, because the IMU moved. 'revived': they are discarded, because an axis was stuck.
'set_aside': they are kept, and sums of a decreased noise begin. 'resumed': these are discarded, and
the sums that were kept continue. 'accepted': the sums that were kept are discarded."""

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

    def last(self, number: int) -> _Part:
        """Return the last windows; the number is at most that of all windows."""
        first = len(self.still) - number
        size = len(self.samples) // len(self.still)
        return _Part(
            self.samples.part(slice(first * size, None), '' if first else self.samples.cut),
            Windows(self.windows.values[:, :, first:]),
            self.still[first:],
            WindowClass(*(flags[first:] for flags in self.found)),
        )


class _Former(NamedTuple):
    """A noise floor that may be that of the IMU still, although the noise decreased later."""

    floor: NoiseFloor
    at_rest: int  # number of samples at rest
    decreased_ns: int  # when the noise decreased
    shocks: tuple[int, int]


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
        self._margin_after = max(LEAST_LEVEL, round(MARGIN_AFTER_S / (self.size * self._period_s)))
        self._longest_shock = int(LONGEST_SHOCK_S / (self.size * self._period_s))
        self._shocks_before = counts.shocks, counts.replaced
        self._former: _Former | None = None  # while the noise is decreased
        self._at_rest = 0  # number of samples at rest since the noise floor was learned
        # of the current block of windows: first stamp, number of samples that were passed on since
        # it began, and of those that were held before it began
        self._block_ns = self._passed_on = self._carried = 0
        self._decreased = 0  # number of samples that were dropped because the noise decreased
        self._smallest = np.ones(len(axes))  # ratio of decreased noise to the noise floor
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
    def decreases(self) -> dict[str, float]:
        """Axis -> smallest ratio of its decreased noise to the noise floor; empty if none."""
        smallest = zip(self._axes, self._smallest.tolist())
        return {axis: ratio for axis, ratio in smallest if ratio < 1.0}

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
            return 'noise_decreased' if self._motion.kind == 'noise_decreased' else 'moving'
        if self._former is not None:
            return 'noise_decreased'
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
            found = floor.classify(part.rows, windows, None, self.size)
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
        if not self._block:
            self._block_ns = int(block.stamps[0])
            self._passed_on, self._carried = 0, _samples(self._held)
        if block.cut:
            self._pass_held()
            self._last_mean, self._level = None, Level()
            if self._motion is not None:
                self._motion.before = self._motion.before[:0]
            self._cut = self._cut or block.cut
        found = self._floor.classify(block.rows, windows, self._last_mean, size)
        still = ~found.moving
        if self._motion is None and still.all():
            self._release(block, windows.mean, size)
        else:
            for i in range(len(still)):
                window = block.part(slice(i * size, (i + 1) * size))
                self._step(window, windows.mean[:, i], WindowClass(*(v[i] for v in found)))
                still[i] = self._motion is None
        self._last_mean = windows.mean[:, -1]
        if size == self.size:
            self._block.append(_Part(block, windows, still, found))

    def _step(self, window: Block, mean: Floats, found: WindowClass) -> None:
        """Update the state from one window and its class, and keep it if it is at rest."""
        if self._motion is None and not found.moving:
            self._release(window, mean[:, None], len(window))
            return
        if self._motion is None:
            kind = 'noise_decreased' if found.decreased else 'motion'
            kind = 'stuck' if found.stuck else kind
            self._motion = Motion(kind, int(window.stamps[0]), self._level)
        motion = self._motion
        if found.decreased:
            self._no_shock()
            if found.stuck:
                self._counts.stuck += len(window)
            else:
                self._counts.noise_decreased += len(window)
                self._decreased += len(window)
        elif motion.level is None:
            self._counts.moving += len(window)
        else:
            self._held.append(window)
        motion.add(window, mean, bool(found.quiet))
        if motion.windows - motion.quiet > self._longest_shock:
            self._no_shock()
        if motion.quiet >= self._margin_after:
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
        self._pass_on(kept[:1])
        for window in kept[1:]:
            self._release(window, window.rows.mean(axis=1)[:, None], len(window))

    def _no_shock(self) -> None:
        """Drop the windows of the present motion, which is no shock."""
        motion = self._motion
        if motion is not None and motion.level is not None:
            self._counts.moving += _samples(self._held)
            if self._held and self._held[0].stamps[0] < self._block_ns:
                self._carried = 0
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
            self._pass_on([block.part(slice(split), cut)])
            cut = ''
        self._held = [block.part(slice(split, None), cut)]

    def _pass_held(self) -> None:
        self._pass_on(self._held)
        self._held = []

    def _pass_on(self, blocks: list[Block]) -> None:
        self._out += blocks
        self._passed_on += _samples(blocks)

    # --- the noise floor --------------------------------------------------------------------------

    def _end_block(self) -> None:
        """Update the noise floor after a block, or change it if another one fits better."""
        floor = self._floor
        assert floor is not None
        block, self._block = self._block, []
        windows = Windows.joined(part.windows for part in block)
        still = np.concatenate([part.still for part in block])
        samples = Block.joined([part.samples for part in block])
        self._at_rest += self.size * int(np.count_nonzero(still))
        if self._change_floor(block, windows, still, samples):
            return
        rotating = all(part.found.rotating.all() for part in block)
        updated = floor.updated(windows, still, rotating)
        if updated.is_plausible():
            examined = still & (np.arange(len(still)) % EXAMINED == 0)
            floor = self._floor = updated.with_outliers(_usable(samples, self.size, examined))
        decreased = any(part.found.decreased.any() for part in block)
        moving = not (still.any() or decreased)
        self._count_increased(floor.increase(samples.rows, windows) if moving else None)

    def _change_floor(
        self, block: list[_Part], windows: Windows, still: Flags, samples: Block
    ) -> bool:
        """Change the noise floor after a block if another one fits better; return whether it did.

        Noise that decreased is either that of the IMU, or of a fault. If the noise before was that
        of a motion, the new noise floor replaces the former one. Otherwise, that noise which lasts
        longer is regarded as normal: sums of the decreased noise are kept apart until then.
        """
        floor, former = self._floor, self._former
        assert floor is not None
        if former is not None:
            if former.floor.rest(windows).mean() > 0.5:
                self._resume(block, former)
                return True
            if self._at_rest > former.at_rest:
                self._former = None
                self._mark('accepted', samples)
                self._forget_decrease()
        if floor.revived(samples.rows).any():
            self._discard(block, 'revived')
            return True
        decreased = floor.decreased(windows)
        if not decreased.any():
            return False
        last = int(np.argmax(still[::-1])) if still.any() else len(still)
        unexplained = (decreased & ~is_stuck(samples.rows, self.size))[:, len(still) - last :]
        axes = np.count_nonzero(unexplained, axis=1) >= LEAST_DECREASED
        if axes.any():
            quiet = _last_windows(block, last)
            learned = self._learned_floor(_without_gaps([part.samples for part in quiet]))
            if learned.shows_motion(floor, axes):
                self._discard(block, 'relearned')
                return True
            self._try(quiet, learned)
        if axes.any() or self._decreased:
            some = decreased.any(axis=1)
            level = np.where(decreased, windows.variance, np.nan)[some]
            ratio = np.sqrt(np.nanmean(level, axis=1) / floor.variance[some])
            self._smallest[some] = np.minimum(self._smallest[some], ratio)
        return bool(axes.any())

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

    def _discard(self, block: list[_Part], change: Change) -> None:
        """Discard all earlier data, and classify the block again with a new noise floor."""
        samples = [part.samples for part in block]
        released = self._take_back(block)
        # `SensorStream` counts the samples that were already released
        if change == 'revived':
            self._counts.stuck -= released
        else:
            self._counts.moving -= released
        self._counts.shocks, self._counts.replaced = self._shocks_before
        self._forget_decrease()
        self._restart(block, change, self._learned_floor(_without_gaps(samples)), 'motion')
        self._at_rest = 0

    def _try(self, quiet: list[_Part], learned: NoiseFloor) -> None:
        """Set the sums aside, and classify windows of decreased noise with their noise floor."""
        assert self._floor is not None
        motion = self._motion
        began_ns = motion.began_ns if motion is not None else int(quiet[0].samples.stamps[0])
        released = self._take_back(quiet)
        assert not released
        if self._former is None:
            shocks = self._counts.shocks, self._counts.replaced
            self._former = _Former(self._floor, self._at_rest, began_ns, shocks)
        self._motion = None
        self._restart(quiet, 'set_aside', learned, 'noise_decreased')
        self._at_rest = 0

    def _resume(self, block: list[_Part], former: _Former) -> None:
        """Discard the data of decreased noise, and continue with the former noise floor."""
        self._counts.noise_decreased -= self._take_back(block)
        self._counts.shocks, self._counts.replaced = former.shocks
        seconds = (int(block[0].samples.stamps[0]) - former.decreased_ns) * 1e-9
        self._events.add(seconds, Event('noise_decreased', former.decreased_ns, seconds))
        self._former, self._motion = None, None
        self._restart(block, 'resumed', former.floor, 'noise_decreased')
        self._at_rest += former.at_rest

    def _take_back(self, windows: list[_Part]) -> int:
        """Remove the last windows of the current block from the counts.

        They are either all windows of the block, or none of them is at rest. Returns the number of
        samples that were passed on.
        """
        self._no_shock()
        self._pass_held()
        at_rest = any(part.still.any() for part in windows)
        released = self._passed_on - self._carried if at_rest else 0
        stuck = self.size * sum(int(part.found.stuck.sum()) for part in windows)
        decreased = self.size * sum(int(part.found.decreased.sum()) for part in windows) - stuck
        samples = _samples(part.samples for part in windows)
        self._counts.stuck -= stuck
        self._counts.noise_decreased -= decreased
        self._decreased -= decreased
        self._counts.moving -= samples - stuck - decreased - released
        return released

    def _forget_decrease(self) -> None:
        """Count samples of decreased noise as motion: the noise was higher because of a motion."""
        self._counts.moving += self._decreased
        self._counts.noise_decreased -= self._decreased
        self._decreased, self._smallest = 0, np.ones(len(self._axes))

    def _restart(self, block: list[_Part], change: Change, floor: NoiseFloor, cut: str) -> None:
        """Classify windows again with another noise floor, for other sums."""
        self._floor = floor
        self._last_mean, self._level = None, Level()
        self._noisy_blocks, self._increase = 0, None
        self._mark(change, block[0].samples)
        self._cut = cut
        if cut == 'motion':
            self._motion = Motion('motion', int(block[0].samples.stamps[0]))
        for part in block:
            self._keep_still(part.samples, self.size, part.windows)
        self._block = []

    def _mark(self, change: Change, samples: Block) -> None:
        """Tell `SensorStream` what to do with the sums before the next samples."""
        self._pass_held()
        self._out.append(samples.part(slice(0), change))


def _last_windows(parts: list[_Part], number: int) -> list[_Part]:
    """Return the last windows of consecutive parts."""
    out: list[_Part] = []
    for part in reversed(parts):
        if number <= 0:
            break
        out.insert(0, part.last(min(number, len(part.still))))
        number -= len(part.still)
    return out


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
