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

from ..findings import Finding
from ..imu import Flags, Floats, ImuBatch, joined
from ..settings import SegmenterSettings
from .disturbances import SPIKE_NEIGHBORS, without_spikes
from .floor_counts import Excluded, FloorCounts
from .health import Counts, Event, Longest, State, are_degrees
from .noise_floor import EXAMINED, LEAST_WINDOW, NoiseFloor, WindowClass, Windows, is_stuck
from .present_faults import present_faults
from .rest_filter import Change, RestFilter, count_samples

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short compared with a motion."""

BLOCK_WINDOWS = 32
"""Number of windows from which the noise floor is learned, and after which it is updated. All of
them are buffered: 0.15 MB of six axes at 200 Hz, 15 MB at 20 kHz."""

MOST_WINDOW = 1 << 15
"""Longest window in samples, above 65 kHz: 50 MB of buffered samples."""

LEAST_CHANGED = BLOCK_WINDOWS // 4
"""Number of windows with another noise after which another noise floor may be tried."""

INCREASE_BLOCKS = 2
"""Number of consecutive blocks (together about 30 s) after which noise that exceeds the limits is
classified as increased noise instead of motion."""

LEAST_FAULTY = 4
"""Number of latest windows, all not at rest, in which a known fault is searched for."""

MOST_FILLED = 0.1
"""Largest share of interpolated samples in a window that is searched for outliers."""


class _Part(NamedTuple):
    """Consecutive windows of the current block: samples, statistics and classification."""

    samples: ImuBatch
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


class _Other(NamedTuple):
    """A noise floor whose sums are set aside, because the noise changed later.

    It may be the noise of the IMU still: then its sums continue.
    """

    floor: NoiseFloor
    left_ns: int  # when the noise changed
    change: Excluded  # how it changed
    tried: bool = True  # whether the present noise floor is only tried


class NoiseRatios:
    """Ratios of the noise at rest to the noise floor: extremes of each axis, and the present one.

    ``increase``, (axes,), is the present ratio, or None if the noise has not increased.
    """

    def __init__(self, axes: int) -> None:
        self.increase: Floats | None = None
        self.largest, self.smallest = np.ones(axes), np.ones(axes)
        self._noisy_blocks = self._noisy = 0  # blocks and their samples, one after another

    def forget(self) -> None:
        """Forget the extremes: they were ratios to another noise floor."""
        self.largest[:] = self.smallest[:] = 1.0

    def add_block(self, ratio: Floats | None, samples: int) -> int:
        """Add a block whose noise increased to a ratio, (axes,), or did not (None).

        ``samples`` is the number of its samples with this noise. Returns the number of samples that
        become increased noise instead of motion.
        """
        before = self._noisy
        self._noisy_blocks = 0 if ratio is None else self._noisy_blocks + 1
        self._noisy = 0 if ratio is None else before + samples
        self.increase = ratio if self._noisy_blocks >= INCREASE_BLOCKS else None
        if self.increase is None:
            return 0
        self.largest = np.maximum(self.largest, self.increase)
        return self._noisy if self._noisy_blocks == INCREASE_BLOCKS else samples

    def add_decrease(self, variance: Floats, decreased: Flags, floor: Floats) -> None:
        """Add windows with decreased noise: variances and flags, (axes, k), and the floor."""
        some = decreased.any(axis=1)
        level = np.where(decreased, variance, np.nan)[some]
        ratio = np.sqrt(np.nanmean(level, axis=1) / floor[some])
        self.smallest[some] = np.minimum(self.smallest[some], ratio)


class MotionGate:
    """Detects motion, and keeps only the samples at rest.

    It divides the samples into windows, removes spikes, and learns the noise floor, with which
    `RestFilter` decides about each window. After each block of windows, the noise floor is updated,
    or replaced by another one that fits better.
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
        self._axes, self._settings, self._events = axes, settings, events
        self._counts = FloorCounts(counts)
        self._rest = RestFilter(self.size, period_ns * 1e-9, axes, self._counts, events)
        self._ratios = NoiseRatios(len(axes))
        self._other: _Other | None = None
        self._learning: list[ImuBatch] = []  # buffered until the noise floor is known
        # buffered until they fill a window, with their look-ahead
        self._pending = ImuBatch.empty(len(axes))
        self._before = self._pending.rows  # the last samples before them
        self._block: list[_Part] = []
        self._recent: list[_Part] = []  # the latest windows, `LEAST_CHANGED` or more

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Known faults of the latest samples; empty while samples are at rest."""
        floor, recent = self._rest.floor, _last_windows(self._recent, LEAST_FAULTY)
        parts = [part for part in recent if not part.still.any()]
        if floor is None or sum(len(part.still) for part in parts) < LEAST_FAULTY:
            return ()
        rows = np.concatenate([part.samples.rows for part in parts], axis=1)
        windows = Windows.joined(part.windows for part in parts)
        latest = parts[-1].samples.stamps_ns[-1]
        motion = self._rest.motion
        began = motion.began_ns if motion is not None else parts[0].samples.stamps_ns[0]
        return present_faults(self._axes, floor, rows, windows, float(latest - began) * 1e-9)

    @property
    def noise(self) -> dict[str, float]:
        """Axis -> present standard deviation of the white noise; empty if the IMU moves.

        It is computed from the differences of neighboring samples in the latest windows. These are
        at rest, or have larger noise without a motion.
        """
        floor, recent = self._rest.floor, _last_windows(self._recent, LEAST_CHANGED)
        still = np.array([flag for part in recent for flag in part.still])
        if floor is None or len(still) < LEAST_CHANGED or (still.any() and not still.all()):
            return {}
        rows = np.concatenate([part.samples.rows for part in recent], axis=1)
        windows = Windows.joined(part.windows for part in recent)
        foreign = any(part.found.foreign.any() for part in recent)
        if not still.all() and (foreign or floor.increase(rows, windows) is None):
            return {}
        deviation = np.sqrt(0.5 * np.mean(np.diff(rows, axis=1) ** 2, axis=1))
        return dict(zip(self._axes, deviation.tolist()))

    @property
    def increases(self) -> dict[str, float]:
        """Axis -> largest ratio of its noise at rest to the noise floor; empty if none."""
        largest = self._ratios.largest
        return dict(zip(self._axes, largest.tolist())) if (largest > 1.0).any() else {}

    @property
    def decreases(self) -> dict[str, float]:
        """Axis -> smallest ratio of its decreased noise to the noise floor; empty if none."""
        smallest = zip(self._axes, self._ratios.smallest.tolist())
        return {axis: ratio for axis, ratio in smallest if ratio < 1.0}

    @property
    def stuck(self) -> tuple[str, ...]:
        """Axes that repeated one value."""
        return tuple(axis for axis, stuck in zip(self._axes, self._rest.stuck) if stuck)

    @property
    def heavy_tails(self) -> dict[str, float]:
        """Axes with heavy tails, and the share of their samples that are outliers."""
        floor = self._rest.floor
        if floor is None or not floor.heavy.any():
            return {}
        share = floor.outliers / floor.examined
        return {axis: float(share[i]) for i, axis in enumerate(self._axes) if floor.heavy[i]}

    @property
    def state(self) -> State:
        """Current state; 'learning' until the noise floor is known or a motion is found."""
        if self._ratios.increase is not None:
            return 'noise_increased'
        if self._rest.motion is not None:
            return 'noise_decreased' if self._rest.motion.kind == 'noise_decreased' else 'moving'
        if self._other is not None and self._other.tried:
            return self._other.change
        return 'learning' if self._rest.floor is None else 'at_rest'

    def feed(self, blocks: list[ImuBatch]) -> list[ImuBatch]:
        """Add consecutive blocks, and return the samples that are confirmed to be at rest."""
        for block in blocks:
            while self._rest.floor is None and len(block):
                room = BLOCK_WINDOWS * self.size - count_samples(self._learning)
                self._learning.append(block.part(slice(room), block.cut))
                if len(block) >= room:
                    self._learn()
                block = block.part(slice(room, None))
            if len(block):
                self._add(block)
        return self._rest.take()

    def flush(self) -> list[ImuBatch]:
        """Return the buffered blocks that are at rest, at the end of the input."""
        if self._learning:
            self._learn()
        self._flush_pending()
        return self._rest.take()

    # --- learning ---------------------------------------------------------------------------------

    def _learn(self) -> None:
        """Learn the noise floor from the first windows, or drop these if the IMU moved."""
        parts, self._learning = _without_gaps(self._learning), []
        floor = self._learned_floor(parts)
        if not floor.is_plausible():
            self._rest.drop(parts, 'motion')
            return
        for part in parts:
            windows = Windows.of(part.rows, self.size)
            found = floor.classify(part.rows, windows, None, self.size)
            floor = floor.with_outliers(_usable(part, self.size, ~found.moving))
        self._rest.floor = floor
        self._rest.log_motion()
        for part in parts:
            self._add(part)

    def _learned_floor(self, parts: Iterable[ImuBatch]) -> NoiseFloor:
        """Return the noise floor of some windows; there may be a gap between two parts."""
        gyro = np.array([axis.startswith('gyro') for axis in self._axes])
        rows = [part.rows for part in _without_gaps(parts)]
        return NoiseFloor.learned(rows, self.size, gyro, self._settings)

    # --- windows ----------------------------------------------------------------------------------

    def _add(self, block: ImuBatch) -> None:
        """Classify the complete windows of the buffered samples and the next block."""
        if block.cut:
            self._flush_pending()
        have = joined([self._pending, block])
        ready = max(0, len(have) - SPIKE_NEIGHBORS) // self.size * self.size
        self._classify(have, ready, self.size)
        self._pending = have.part(slice(ready, None), '' if ready else have.cut).copy()

    def _flush_pending(self) -> None:
        """Classify the buffered samples before a gap, and pass on all that are at rest."""
        rest, self._pending = self._pending, self._pending.part(slice(0))
        while len(rest) and self._rest.floor is not None:
            size = min(len(rest), self.size)
            self._classify(rest, size, size)
            rest = rest.part(slice(size, None))
        self._before = self._before[:, :0]
        self._rest.end_segment()

    def _classify(self, have: ImuBatch, samples: int, size: int) -> None:
        """Classify the first ``samples`` samples, in windows of ``size``."""
        at = 0
        while at < samples:
            assert self._rest.floor is not None
            # up to the end of a block, after which the noise floor is another one
            in_block = sum(len(part.still) for part in self._block)
            k = min((samples - at) // size, BLOCK_WINDOWS - in_block)
            end = at + k * size
            block = have.part(slice(at, end), '' if at else have.cut)
            after = have.rows[:, end : end + SPIKE_NEIGHBORS]
            before, self._before = self._before, block.rows[:, -SPIKE_NEIGHBORS:].copy()
            block, windows, spikes = without_spikes(block, size, before, after, self._rest.floor)
            self._counts.total.spikes += spikes
            self._pass(block, windows, size)
            at = end
            if size == self.size and in_block + k == BLOCK_WINDOWS:
                self._end_block()

    def _pass(self, block: ImuBatch, windows: Windows, size: int) -> None:
        """Pass windows through the filter, and add complete ones to the block of windows."""
        if not self._block:
            self._counts.begin_block(self._rest.held)
        still, found = self._rest.add(block, windows, size)
        if size == self.size:
            part = _Part(block, windows, still, found)
            self._block.append(part)
            self._recent = [*_last_windows(self._recent, LEAST_CHANGED - 1), part]

    # --- the noise floor --------------------------------------------------------------------------

    def _end_block(self) -> None:
        """Update the noise floor after a block, or change it if another one fits better."""
        floor = self._rest.floor
        assert floor is not None
        block, self._block = self._block, []
        windows = Windows.joined(part.windows for part in block)
        still = np.concatenate([part.still for part in block])
        samples = joined([part.samples for part in block])
        if self._change_floor(block, windows, still, samples):
            return
        rotating = all(part.found.rotating.all() for part in block)
        updated = floor.updated(windows, still, rotating)
        if updated.is_plausible():
            examined = still & (np.arange(len(still)) % EXAMINED == 0)
            self._rest.floor = updated.with_outliers(_usable(samples, self.size, examined))
        self._find_increase(block, still)

    def _find_increase(self, block: list[_Part], still: Flags) -> None:
        """Set the sums aside if the noise has been larger than the noise floor for long enough."""
        floor, last = self._rest.floor, _ending(still)
        assert floor is not None
        noisy = _last_windows(block, last)
        normal = any((part.found.decreased | part.found.foreign).any() for part in noisy)
        ratio = None
        if last >= LEAST_CHANGED and not normal:
            samples = joined([part.samples for part in noisy])
            ratio = floor.increase(samples.rows, Windows.joined(part.windows for part in noisy))
        confirmed = self._ratios.add_block(ratio, last * self.size)
        self._counts.move('moving', 'noise_increased', confirmed)
        if not confirmed:
            return
        if self._rest.motion is not None:
            self._rest.motion.kind = 'noise_increased'
        assert ratio is not None
        if not are_degrees(ratio[floor.gyro]):  # a known fault teaches no noise floor
            self._counts.move('noise_increased', 'moving', last * self.size)
            learned = self._learned_floor(part.samples for part in noisy)
            self._try(noisy, learned, 'noise_increased')

    def _change_floor(
        self, block: list[_Part], windows: Windows, still: Flags, samples: ImuBatch
    ) -> bool:
        """Change the noise floor after a block if another one fits better; return whether it did.

        Noise that decreased is either that of the IMU, or of a fault. If the noise before was that
        of a motion, the new noise floor replaces the other one. Otherwise, the noise that lasts
        longer is regarded as normal: sums of the changed noise are kept apart until then. The
        other sums are kept, and continue when their noise returns.
        """
        floor, other = self._rest.floor, self._other
        assert floor is not None
        if other is not None:
            nearer = other.floor.distance(windows) < floor.distance(windows)
            if nearer and other.floor.rest(windows).mean() > 0.5:
                self._resume(block, other, floor)
                return True
            if self._counts.lasts_longer:
                self._accept(samples)
        if (revived := floor.revived(samples.rows)).any():
            self._rest.stuck |= revived
            self._discard(block, 'revived')
            return True
        last = _ending(still)
        if last >= LEAST_CHANGED and self._is_corrected(block):
            self._discard(block, 'corrected', LEAST_CHANGED)
            return True
        decreased = floor.decreased(windows)
        if not decreased.any():
            return False
        foreign = np.concatenate([part.found.foreign for part in block])
        explained = is_stuck(samples.rows, self.size) | foreign
        unexplained = (decreased & ~explained)[:, len(still) - last :]
        axes = np.count_nonzero(unexplained, axis=1) >= LEAST_CHANGED
        if axes.any():
            quiet = _last_windows(block, last)
            learned = self._learned_floor(part.samples for part in quiet)
            if learned.shows_motion(floor, axes):
                self._discard(block, 'relearned')
                return True
            self._try(quiet, learned, 'noise_decreased')
        if axes.any() or self._counts.decreased:
            self._ratios.add_decrease(windows.variance, decreased, floor.variance)
        return bool(axes.any())

    def _is_corrected(self, block: list[_Part]) -> bool:
        """Return whether the last windows are at rest in the right unit, unlike the noise floor."""
        floor, quiet = self._rest.floor, _last_windows(block, LEAST_CHANGED)
        assert floor is not None
        learned = self._learned_floor(part.samples for part in quiet)
        windows = Windows.joined(part.windows for part in quiet)
        rows = np.concatenate([part.samples.rows for part in quiet], axis=1)
        at_rest = learned.rest(windows) & ~learned.foreign(rows, windows, self.size)
        return learned.is_plausible() and bool(at_rest.all()) and floor.has_wrong_unit(learned)

    def _discard(
        self,
        block: list[_Part],
        change: Literal['relearned', 'revived', 'corrected'],
        number: int = BLOCK_WINDOWS,
    ) -> None:
        """Discard all earlier data, and classify the block again with a new noise floor.

        The noise floor is learned from this number of the last windows.
        """
        self._rest.end_segment()
        self._counts.remove_block()
        self._counts.discard('stuck' if change == 'revived' else 'moving')
        self._ratios.forget()
        if self._other is not None and not self._other.tried:
            self._other = None
        learned = self._learned_floor(part.samples for part in _last_windows(block, number))
        self._again(block, change, learned, 'motion')

    def _try(self, block: list[_Part], learned: NoiseFloor, change: Excluded) -> None:
        """Set the sums aside, and classify windows of another noise with their noise floor."""
        motion, floor = self._rest.motion, self._rest.floor
        assert floor is not None
        began_ns = motion.began_ns if motion is not None else int(block[0].samples.stamps_ns[0])
        self._rest.end_segment()
        stuck = self.size * sum(int(part.found.stuck.sum()) for part in block)
        decreased = self.size * sum(int(part.found.decreased.sum()) for part in block) - stuck
        moving = count_samples(part.samples for part in block) - stuck - decreased
        self._counts.remove('stuck', stuck)
        self._counts.remove('noise_decreased', decreased)
        self._counts.remove('moving', moving)
        self._counts.set_aside(change)
        if self._other is None or not self._other.tried:
            self._other = _Other(floor, began_ns, change)
        self._again(block, 'set_aside', learned, change)

    def _resume(self, block: list[_Part], other: _Other, present: NoiseFloor) -> None:
        """Continue with the noise floor and the sums that were set aside.

        The data at the present noise floor are discarded if it was only tried, else set aside.
        """
        self._rest.end_segment()
        self._counts.remove_block()
        self._counts.resume()
        now_ns = int(block[0].samples.stamps_ns[0])
        if other.tried:
            seconds = (now_ns - other.left_ns) * 1e-9
            self._events.add(seconds, Event(other.change, other.left_ns, seconds))
            self._other = None
        else:
            self._other = _Other(present, now_ns, other.change, tried=False)
        self._again(block, 'resumed', other.floor, other.change)

    def _accept(self, samples: ImuBatch) -> None:
        """Regard the changed noise as normal, and set the data before it aside."""
        assert self._other is not None
        self._other = self._other._replace(tried=False)
        self._rest.mark('accepted', samples)
        self._counts.accept()
        self._ratios.forget()

    def _again(self, block: list[_Part], change: Change, floor: NoiseFloor, cut: str) -> None:
        """Classify windows again with another noise floor, for other sums."""
        self._ratios.add_block(None, 0)
        self._rest.change_floor(floor, change, block[0].samples, cut)
        for part in block:
            self._pass(part.samples, part.windows, self.size)
        self._block = []


def _ending(still: Flags) -> int:
    """Return the number of windows at the end that are not at rest; ``still`` is (k,)."""
    return int(np.argmax(still[::-1])) if still.any() else len(still)


def _last_windows(parts: list[_Part], number: int) -> list[_Part]:
    """Return the last windows of consecutive parts."""
    out: list[_Part] = []
    for part in reversed(parts):
        if number <= 0:
            break
        out.insert(0, part.last(min(number, len(part.still))))
        number -= len(part.still)
    return out


def _without_gaps(blocks: Iterable[ImuBatch]) -> list[ImuBatch]:
    """Join the blocks that have no gap between them."""
    groups: list[list[ImuBatch]] = []
    for block in blocks:
        if block.cut or not groups:
            groups.append([])
        groups[-1].append(block)
    return [joined(group) for group in groups]


def _usable(block: ImuBatch, size: int, chosen: Flags) -> Floats:
    """Return the chosen windows that do not contain many interpolated samples."""
    samples = len(chosen) * size
    cube = block.rows[:, :samples].reshape(len(block.rows), -1, size)
    if block.filled is not None:
        filled = block.filled[:, :samples].reshape(cube.shape) > 0
        share = filled.mean(axis=2).max(axis=0)
        chosen = chosen & (share <= MOST_FILLED)
    return cube[:, chosen].reshape(len(cube), -1)
