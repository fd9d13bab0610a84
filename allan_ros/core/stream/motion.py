# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion detection: keeps the samples of an IMU at rest and excludes the others.

Method
------
The stream is classified in windows of about half a second. A window is moving if its variance, its
largest deviation, the step of its mean or its mean rate exceeds a limit that is derived from the
noise floor, the noise of the sensor at rest. A window of white noise is classified as moving with a
probability below 1e-12, so N has no bias. Motion begins at higher limits than it ends (hysteresis).
Some windows before and after a motion are excluded, too.

First, isolated spikes are replaced. If the noise has heavy tails, they are noise: they stay in the
data and are not regarded as motion. The samples of a shock are replaced, too.

The noise floor is learned from the first windows in which the IMU can be at rest, and then updated
from the quietest quarter of each block of windows. If the noise remains different while the IMU is
at rest, or if an axis begins to be clipped, another noise level begins. Windows are counted from
the start of the stream or the last gap, so the decisions do not depend on how the samples are
divided into batches.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, cast, get_args

import numpy as np

from ..findings import Finding, finding
from ..imu import Flags, Floats, ImuBatch, joined
from ..settings import SegmenterSettings
from .disturbances import SPIKE_NEIGHBORS, without_spikes
from .health import Counts, Event, Longest, State
from .noise_floor import (
    EXAMINED,
    LEAST_WINDOW,
    MOVING_AXES,
    SHAKEN_RATIO,
    NoiseFloor,
    Windows,
    is_stuck,
)
from .noise_levels import Change, NoiseLevels, NoiseRatios
from .present_faults import present_faults
from .recent_windows import RecentWindows, WindowPart
from .rest_filter import RestFilter, count_samples
from .sensors import clipped_shares

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short compared with a motion."""

BLOCK_WINDOWS = 32
"""Number of windows from which the noise floor is learned, after which it is updated, and in which
noise must be increased to begin another level. All of them are buffered: 0.15 MB of six axes at 200
Hz, 15 MB at 20 kHz."""

MOST_WINDOW = 1 << 15
"""Longest window in samples, above 65 kHz: 50 MB of buffered samples."""

CHECKED_WINDOWS = BLOCK_WINDOWS // 4
"""Number of windows with other noise after which another noise level may begin or continue."""

ESTABLISHED_S = 45.0
"""Time in s at rest below which a noise level is not established. If the noise then increases on
few axes or by less than `SHAKEN_RATIO`, the noise before was due to a fault or to another filter
setting at the start, and the increased noise is normal at once. A level with clipped samples is
never established."""

FAULTY_S = 600.0
"""Time in s for which decreased noise is regarded as a fault, although it has lasted longer than
the noise before."""

LEAST_FAULTY = 4
"""Number of latest windows, all not at rest, in which a known fault is searched for."""

MOST_FILLED = 0.1
"""Largest share of interpolated samples in a window that is searched for outliers."""


class MotionGate:
    """Detects motion, and keeps only the samples at rest.

    It divides the samples into windows, removes spikes, and learns the noise floor, with which
    `RestFilter` decides about each window. After each `CHECKED_WINDOWS`, another noise level begins
    or continues if it fits better.
    ``period_ns`` is the sample period. A window is moving if its standard deviation is more than
    ``settings.motion_ratio`` times the noise floor, or if its mean rate differs from the rate
    at rest by more than ``settings.rate_limit``. ``levels``, ``counts`` (of spikes and splits) and
    ``events`` are changed in place.
    """

    def __init__(
        self,
        period_ns: float,
        axes: tuple[str, ...],
        levels: NoiseLevels,
        counts: Counts,
        events: Longest[Event],
        settings: SegmenterSettings,
    ) -> None:
        wanted = round(WINDOW_S * 1e9 / period_ns)
        self.size = int(np.clip(wanted, LEAST_WINDOW, MOST_WINDOW))
        self._axes, self._settings, self._events = axes, settings, events
        self._levels, self._counts = levels, counts
        self._period_s = period_ns * 1e-9
        self._rest = RestFilter(self.size, self._period_s, axes, levels, events, counts.splits)
        self._ratios = NoiseRatios(len(axes))
        self._learning: list[ImuBatch] = []  # buffered until the noise floor is known
        # buffered until they fill a window, with their look-ahead
        self._pending = ImuBatch.empty(len(axes))
        self._before = self._pending.rows  # the last samples before them
        self._recent = RecentWindows()  # the latest at this level, at most `BLOCK_WINDOWS`
        self._former_noise: dict[str, float] = {}  # when this level began
        self._number = 0  # of windows since the noise floor was learned or updated

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Known faults of the latest samples; those at rest can only be clipped."""
        recent, motion = self._recent.last(LEAST_FAULTY), self._rest.motion
        clipped = self._clipped
        if len(recent) < LEAST_FAULTY or recent.still.any():
            return clipped
        began_ns = recent.began_ns if motion is None else motion.began_ns
        seconds = (recent.latest_ns - began_ns) * 1e-9
        found = present_faults(self._axes, self._rest.floor, recent.rows, recent.windows, seconds)
        return *clipped, *found

    @property
    def _clipped(self) -> tuple[Finding, ...]:
        """A finding for each axis that is clipped now, but not in the result."""
        present, published = self._levels.present.floor, self._levels.published.floor
        if present is None or published is None:
            return ()
        recent, shares = self._recent.last(CHECKED_WINDOWS), present.clipped
        if len(recent) == CHECKED_WINDOWS:  # else the level has just begun
            shares = clipped_shares(recent.rows)
        return tuple(
            finding('clipped', (axis,), share=share)
            for axis, share, known in zip(self._axes, shares.tolist(), published.clipped)
            if share and not known
        )

    @property
    def noise(self) -> dict[str, float]:
        """Axis -> present standard deviation of the white noise; empty if the IMU moves.

        It is computed from the differences of neighboring samples in the latest windows. These are
        at rest, or have larger noise without a motion.
        """
        recent = self._recent.last(CHECKED_WINDOWS)
        if len(recent) < CHECKED_WINDOWS:  # the level has just begun
            return self._former_noise
        if not recent.still.all():
            floor = self._rest.floor
            foreign = recent.still.any() or recent.found.foreign.any()
            if foreign or floor.increase(recent.rows, recent.windows) is None:
                return {}
        return dict(zip(self._axes, recent.white_noise.tolist()))

    @property
    def increases(self) -> dict[str, float]:
        """Axis -> largest ratio of its noise at rest to the noise floor; empty if none."""
        return self._named(self._ratios.largest)

    @property
    def decreases(self) -> dict[str, float]:
        """Axis -> smallest ratio of its noise to the noise floor; empty if none decreased."""
        return self._named(self._ratios.smallest)

    def _named(self, ratios: Floats) -> dict[str, float]:
        return {axis: float(r) for axis, r in zip(self._axes, ratios) if r != 1.0}

    @property
    def stuck(self) -> tuple[str, ...]:
        """Axes that repeated one value."""
        return tuple(axis for axis, flag in zip(self._axes, self._rest.stuck) if flag)

    @property
    def heavy_tails(self) -> dict[str, float]:
        """Axis with heavy tails -> share of its samples that are outliers."""
        floor = self._levels.present.floor
        if floor is None or not floor.examined:
            return {}
        share = floor.outliers / floor.examined
        return {axis: float(share[i]) for i, axis in enumerate(self._axes) if floor.heavy[i]}

    @property
    def state(self) -> State:
        """Current state; 'learning' until the noise floor is known or a motion is found."""
        if self._rest.motion is not None:
            kind = self._rest.motion.kind
            return cast(Change, kind) if kind in get_args(Change) else 'moving'
        if self._levels.is_tried:
            return self._levels.change
        return 'learning' if self._levels.present.floor is None else 'at_rest'

    def feed(self, blocks: list[ImuBatch]) -> list[ImuBatch]:
        """Add consecutive blocks, and return the samples that are confirmed to be at rest."""
        for block in blocks:
            while self._levels.present.floor is None and len(block):
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
        self._levels.present.floor = floor
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
        while len(rest) and self._levels.present.floor is not None:
            size = min(len(rest), self.size)
            self._classify(rest, size, size)
            rest = rest.part(slice(size, None))
        self._before = self._before[:, :0]
        self._rest.end_segment()

    def _classify(self, have: ImuBatch, samples: int, size: int) -> None:
        """Classify the first ``samples`` samples, in windows of ``size``.

        All windows up to the end of a block are classified together if they can only be at rest at
        this level, else those up to the next check, after which the level may be another one.
        """
        at = 0
        while at < samples:
            ready = (samples - at) // size
            number = min(ready, CHECKED_WINDOWS - self._number % CHECKED_WINDOWS)
            calm = min(ready, BLOCK_WINDOWS - self._number) if self._is_settled else number
            if self._rest.motion is not None or not self._pass(have, at, calm, size, calm > number):
                self._pass(have, at, number, size)
                calm = number
            at += calm * size
            if size == self.size:
                self._number += calm
                if self._number % CHECKED_WINDOWS == 0:
                    self._check()

    @property
    def _is_settled(self) -> bool:
        """Whether windows at rest belong to the present level, without a look at another one."""
        return self._levels.other is None and bool(self._rest.floor.variance.all())

    def _pass(
        self, have: ImuBatch, at: int, number: int, size: int, only_at_rest: bool = False
    ) -> bool:
        """Pass windows from sample ``at`` on through the filter.

        With ``only_at_rest``, nothing happens and False is returned if some are not at rest, or if
        other axes are clipped at a check.
        """
        end = at + number * size
        block = have.part(slice(at, end), '' if at else have.cut)
        after = have.rows[:, end : end + SPIKE_NEIGHBORS]
        clean, windows, spikes = without_spikes(block, size, self._before, after, self._rest.floor)
        if only_at_rest and self._clipping_changes(clean.rows):
            return False
        result = self._rest.add(clean, windows, size, only_at_rest)
        if result is None:
            return False
        self._before = block.rows[:, -SPIKE_NEIGHBORS:].copy()
        self._counts.spikes += spikes
        if size == self.size:
            part = WindowPart(clean, windows, *result)
            self._recent = self._recent.with_part(part, BLOCK_WINDOWS)
        return True

    def _clipping_changes(self, rows: Floats) -> bool:
        """Return whether other axes are clipped at a check after some of the next samples.

        ``rows``, (axes, n), are these samples.
        """
        before = self._recent.last(self._number % CHECKED_WINDOWS)
        rows = np.concatenate([before.rows, rows], axis=1) if len(before) else rows
        step = CHECKED_WINDOWS * self.size
        checked = (rows[:, end - step : end] for end in range(step, rows.shape[1] + 1, step))
        return not all(map(self._rest.floor.has_clipping, checked))

    # --- the noise level --------------------------------------------------------------------------

    def _check(self) -> None:
        """Begin or continue another level if it fits the latest windows better; update the floor.

        Changed noise may be the noise of the IMU from now on, or be due to a fault. So it becomes
        normal when it has lasted longer than the noise before, and, if it decreased, for
        `FAULTY_S`.
        """
        levels = self._levels
        is_fault = levels.change == 'noise_decreased'
        shortest = FAULTY_S if is_fault else 0.0
        if levels.lasts_longer and levels.present.samples * self._period_s >= shortest:
            self._accept()
        if not self._change_level():
            self._find_unit_change()
            if self._number == BLOCK_WINDOWS:
                self._update_floor()
        self._number %= BLOCK_WINDOWS

    def _update_floor(self) -> None:
        """Update the noise floor from the latest block of windows."""
        block, still = self._recent, self._recent.still
        updated = self._rest.floor.updated(block.windows, still, block.is_steady)
        if updated.is_plausible():
            examined = still & (np.arange(len(still)) % EXAMINED == 0)
            usable = _usable(joined(block.samples), self.size, examined)
            self._levels.present.floor = updated.with_outliers(usable)

    def _change_level(self) -> bool:
        """Change the noise level if the latest windows fit another one; return whether it did."""
        floor, other = self._rest.floor, self._levels.other
        recent = self._recent.last(CHECKED_WINDOWS)
        rows, windows = recent.rows, recent.windows
        if other is not None and other.floor is not None:
            nearer = other.floor.is_nearer(floor, rows, windows)
            if nearer and other.floor.rest(windows).mean() > 0.5:
                self._resume()
                return True
        if (revived := floor.revived(rows)).any():
            self._rest.stuck |= revived
            self._replace('stuck', self._learned_floor(recent.samples))
            return True
        if recent.still.any():
            if recent.still.all() and not floor.has_clipping(rows):
                self._change_clipping(recent)
                return True
            return False
        learned = self._learned_floor(recent.samples)
        at_rest = learned.rest(windows) & ~learned.foreign(rows, windows, self.size)
        if learned.is_plausible() and at_rest.all() and floor.has_wrong_unit(learned):
            self._replace('moving', learned)
            return True
        return self._decreases_to(learned, recent) or self._has_increased()

    def _change_clipping(self, recent: RecentWindows) -> None:
        """Begin another level, because other axes are clipped in the latest windows."""
        floor, learned = self._rest.floor, self._learned_floor(recent.samples)
        clipped, variance = floor.newly_clipped(recent.rows), recent.windows.variance
        if clipped.any():
            flags = np.broadcast_to(clipped[:, None], variance.shape)
            self._ratios.add_decrease(variance, flags, floor.variance)
            self._try(learned, 'noise_decreased')
        else:  # the samples before were clipped
            self._replace('moving', learned)

    def _decreases_to(self, learned: NoiseFloor, recent: RecentWindows) -> bool:
        """Begin another level if the noise decreased to a floor without a known fault.

        If the noise before was due to a motion, the level before is discarded.
        """
        floor = self._rest.floor
        decreased = floor.decreased(recent.windows)
        explained = is_stuck(recent.rows, self.size) | recent.found.foreign
        axes = np.asarray((decreased & ~explained).all(axis=1))
        if axes.any() and learned.shows_motion(floor, axes):
            self._replace('moving', learned)
            return True
        if decreased.any() and (axes.any() or self._levels.present.counts.noise_decreased):
            self._ratios.add_decrease(recent.windows.variance, decreased, floor.variance)
        if axes.any():
            self._try(learned, 'noise_decreased')
        return bool(axes.any())

    def _has_increased(self) -> bool:
        """Begin another level if the noise has been larger for a block of windows."""
        block, floor = self._recent, self._rest.floor
        if len(block) < BLOCK_WINDOWS or not block.can_be_larger_noise:
            return False
        ratio = floor.increase(block.rows, block.windows)
        # a known fault teaches no noise floor
        if ratio is None or floor.changed_unit(ratio):
            return False
        self._ratios.add(ratio)
        self._rest.name_motion('noise_increased', BLOCK_WINDOWS * self.size)
        before = self._levels.published
        shaken = np.count_nonzero(ratio > SHAKEN_RATIO) >= MOVING_AXES
        lasted = before.samples * self._period_s >= ESTABLISHED_S and not before.clipped
        self._try(self._learned_floor(block.samples), 'noise_increased')
        if not (lasted or shaken):
            self._accept()
        return True

    def _find_unit_change(self) -> None:
        """Count windows as increased noise if the gyro changed to another unit."""
        recent, floor = self._recent.last(CHECKED_WINDOWS), self._rest.floor
        if not recent.can_be_larger_noise:
            return
        ratio = floor.increase(recent.rows, recent.windows)
        if ratio is None or not floor.changed_unit(ratio):
            return
        self._ratios.add(ratio)
        self._rest.name_motion('noise_increased', CHECKED_WINDOWS * self.size)

    def _replace(self, reason: Literal['moving', 'stuck'], floor: NoiseFloor) -> None:
        """Drop the present level, and begin another one."""
        self._rest.end_segment()
        self._levels.replace_present(floor, reason)
        self._ratios.forget()
        self._begin_level('motion' if reason == 'moving' else 'stuck')

    def _try(self, floor: NoiseFloor, change: Change) -> None:
        """Begin another level, whose sums are kept apart."""
        motion = self._rest.motion
        began_ns = motion.began_ns if motion is not None else self._recent.latest_ns
        self._rest.end_segment()
        self._levels.try_another(floor, change, began_ns)
        self._begin_level(change)

    def _resume(self) -> None:
        """Continue the other level."""
        self._rest.end_segment()
        change = self._levels.change
        began_ns = self._levels.resume()
        if began_ns is not None:
            seconds = (self._recent.latest_ns - began_ns) * 1e-9
            self._events.add(seconds, Event(change, began_ns, seconds))
        self._begin_level(change)

    def _accept(self) -> None:
        """Regard the changed noise as normal."""
        self._levels.accept()
        self._ratios.forget()

    def _begin_level(self, cut: str) -> None:
        self._rest.begin_level(cut)
        noise = self._recent.last(CHECKED_WINDOWS).white_noise
        self._former_noise = dict(zip(self._axes, noise.tolist()))
        self._recent, self._number = RecentWindows(), 0


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
