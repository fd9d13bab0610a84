# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion detection: keeps the samples of an IMU at rest and excludes the others.

Method
------
The stream is classified in windows of about half a second, or of 16 samples if these last longer. A
window is moving if its variance, its largest deviation, the step of its mean or its mean angular
rate exceeds a limit, if its noise is much smaller than the noise floor (the noise of the IMU at
rest), or if its samples are not plausible. The limits are derived from the settings and the noise
floor. A window of white noise is classified as moving with a probability below 1e-8 (at 50 Hz and
above, 1e-11), so the exclusion of windows does not bias N. The variance at which a motion begins is
larger than the variance at which the motion ends (hysteresis). Some windows before and after a
motion are also excluded.

First, isolated spikes are replaced. On an axis whose noise has heavy tails, isolated large values
are noise: they stay in the data and are not regarded as motion. The samples of a shock are also
replaced.

The noise floor is learned from the first windows in which the IMU can be at rest, and then updated
from the windows at rest in each block of windows. If the noise remains different while the IMU is
at rest, or if the clipped axes change, another noise level begins. Windows are counted
from the start of the stream or the last gap. Therefore, the decisions do not depend on how the
samples are divided into batches.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, cast, get_args

import numpy as np

from ..findings import Finding, finding
from ..imu import Flags, Floats, ImuBatch, joined
from ..settings import SegmenterSettings
from .health import Counts, Event, Longest, State
from .noise_floor import (
    EXAMINED,
    LEAST_WINDOW,
    MOVING_AXES,
    SHAKEN_RATIO,
    NoiseFloor,
)
from .noise_levels import Change, NoiseLevels
from .present_faults import present_faults
from .rest_filter import SPIKE_NEIGHBORS, RestFilter, without_spikes
from .sensors import clipped_shares
from .windows import RecentWindows, WindowPart, Windows, is_stuck

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short compared with a motion. At low rates,
windows are longer (`LEAST_WINDOW`), and at very high rates shorter (`MOST_WINDOW`)."""

BLOCK_WINDOWS = 32
"""Number of windows in a block. The noise floor is learned from a block, and updated after each
block. Another noise level begins if the noise is increased in all windows of a block. One block is
buffered: 0.15 MB for six axes at 200 Hz, 15 MB at 20 kHz."""

MOST_WINDOW = 1 << 15
"""Largest number of samples in a window. It is reached at 65 kHz; 50 MB are then buffered."""

CHECKED_WINDOWS = BLOCK_WINDOWS // 4
"""Smallest number of windows between two checks. A check decides whether the present noise level
continues, a new noise level begins, or the other stored noise level continues."""

ESTABLISHED_S = 45.0
"""A noise level with less than this time in s at rest, or with clipped samples, is not established.
If the noise increases after such a level, the low noise is attributed to a fault or to another
setting of the low-pass filter at the start. The increased noise then counts as normal at once,
unless it exceeds the noise floor by more than `SHAKEN_RATIO` on at least `MOVING_AXES` axes."""

FAULTY_S = 600.0
"""Time in s for which decreased noise is regarded as a fault, even if the decreased noise has
lasted longer than the earlier noise."""

LEAST_FAULTY = 4
"""Number of latest windows that are searched for known faults if none of them is at rest."""

MOST_FILLED = 0.1
"""Largest share of interpolated or replaced samples, on any axis, in a window that is searched for
outliers."""


class MotionGate:
    """Detects motion, and keeps only the samples at rest.

    The gate divides the samples into windows, removes spikes, and learns the noise floor, with
    which `RestFilter` decides whether a window is at rest. ``settings`` determine the largest noise
    and the largest change of the angular rate at rest (`NoiseFloor.limits_of`). At regular checks,
    the gate decides whether the present noise level continues, a new noise level begins, or the
    other stored noise level continues. ``period_ns`` is the sample period in ns. ``levels``,
    ``events``, and the numbers of spikes and splits in ``counts`` are changed in place.
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
        samples_per_window = round(WINDOW_S * 1e9 / period_ns)
        self.size = int(np.clip(samples_per_window, LEAST_WINDOW, MOST_WINDOW))
        self._axes, self._settings, self._events = axes, settings, events
        self._levels, self._counts = levels, counts
        self._period_s = period_ns * 1e-9
        self._rest = RestFilter(self.size, self._period_s, axes, levels, events, counts.splits)
        self._learning: list[ImuBatch] = []  # samples before the noise floor is known

        # samples after the last window whose look-ahead is complete
        self._pending = ImuBatch.empty(len(axes))
        self._before = self._pending.rows  # the last samples before `_pending`

        # the latest windows at the present noise level, at most `BLOCK_WINDOWS`
        self._recent = RecentWindows()
        self._former_noise: dict[str, float] = {}  # `noise` when the present level began
        self._number = 0  # number of complete windows in the present block

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Known faults of the latest samples; of samples at rest, only clipping is reported."""
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
        """Findings about axes that are clipped now, but were not when the published level began."""
        floor, published_floor = self._levels.present.floor, self._levels.published.floor
        if floor is None or published_floor is None:
            return ()
        recent, shares = self._recent.last(CHECKED_WINDOWS), floor.clipped
        if len(recent) == CHECKED_WINDOWS:  # otherwise, the noise level has just begun
            shares = clipped_shares(recent.rows)
        return tuple(
            finding('clipped', (axis,), share=share)
            for axis, share, published_share in zip(
                self._axes, shares.tolist(), published_floor.clipped
            )
            if share and not published_share
        )

    @property
    def noise(self) -> dict[str, float]:
        """Axis -> present standard deviation of the white noise, in the unit of the samples.

        The noise is computed from the differences of neighboring samples in the latest
        `CHECKED_WINDOWS` windows. The result is empty unless all these windows are at rest, or
        have larger noise without a motion. While the first noise level has fewer windows, the
        result is empty. While a later noise level has fewer windows, the noise at the start of this
        level is returned.
        """
        recent = self._recent.last(CHECKED_WINDOWS)
        if len(recent) < CHECKED_WINDOWS:  # the noise level has just begun
            return self._former_noise
        if not recent.still.all():
            floor = self._rest.floor
            has_other_windows = recent.still.any() or recent.found.foreign.any()
            if has_other_windows or floor.increase(recent.rows, recent.windows) is None:
                return {}
        return dict(zip(self._axes, recent.white_noise.tolist()))

    @property
    def increases(self) -> dict[str, float]:
        """Axis -> largest ratio of its noise at rest to the noise floor.

        The ratios of all axes are computed when the noise of any axis has increased. Only ratios
        above 1 are included. The ratios are reset when changed noise counts as normal
        (`NoiseLevels.accept`), or when the samples of the present noise level turn out to be
        unusable (`NoiseLevels.replace_present`).
        """
        return self._named(self._levels.largest_ratio)

    @property
    def decreases(self) -> dict[str, float]:
        """Axis with decreased noise -> smallest ratio of its noise to the noise floor.

        Decreased noise that now counts as normal is not included.
        """
        return self._named(self._levels.smallest_ratio)

    def _named(self, ratios: Floats) -> dict[str, float]:
        return {axis: float(r) for axis, r in zip(self._axes, ratios) if r != 1.0}

    @property
    def stuck(self) -> tuple[str, ...]:
        """Axes that repeated one value for some time, but changed before or after this time."""
        return tuple(
            axis for axis, repeats_value in zip(self._axes, self._rest.stuck) if repeats_value
        )

    @property
    def heavy_tails(self) -> dict[str, float]:
        """Axis with heavy tails -> share of its examined samples that are outliers."""
        floor = self._levels.present.floor
        if floor is None or not floor.examined:
            return {}
        shares = floor.outliers / floor.examined
        return {axis: float(shares[i]) for i, axis in enumerate(self._axes) if floor.heavy[i]}

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
                number_missing = BLOCK_WINDOWS * self.size - sum(map(len, self._learning))
                self._learning.append(block.part(slice(number_missing), block.cut))
                if len(block) >= number_missing:
                    self._learn()
                block = block.part(slice(number_missing, None))
            if len(block):
                self._add(block)
        return self._rest.take()

    def flush(self) -> list[ImuBatch]:
        """Process all buffered samples at the end of the input, and return the samples at rest."""
        if self._learning:
            self._learn()
        self._flush_pending()
        return self._rest.take()

    # --- learning ---------------------------------------------------------------------------------

    def _learn(self) -> None:
        """Learn the noise floor from buffered samples, or exclude them if the IMU moved."""
        parts, self._learning = _without_gaps(self._learning), []
        floor = self._learned_floor(parts)
        if not floor.is_plausible():
            self._rest.drop(parts, 'motion')
            return
        for part in parts:
            windows = Windows.of(part.rows, self.size)
            classes = floor.classify(part.rows, windows, None, self.size)
            floor = floor.with_outliers(_usable(part, self.size, ~classes.moving))
        self._levels.present.floor = floor
        self._rest.log_motion()
        for part in parts:
            self._add(part)

    def _learned_floor(self, parts: Iterable[ImuBatch]) -> NoiseFloor:
        """Return the noise floor of consecutive batches, between which gaps are possible."""
        gyro = np.array([axis.startswith('gyro') for axis in self._axes])
        rows = [part.rows for part in _without_gaps(parts)]
        return NoiseFloor.learned(rows, self.size, gyro, self._settings)

    # --- windows ----------------------------------------------------------------------------------

    def _add(self, block: ImuBatch) -> None:
        """Add a block, and classify the windows that are followed by `SPIKE_NEIGHBORS` samples."""
        if block.cut:
            self._flush_pending()
        buffered = joined([self._pending, block])
        ready = max(0, len(buffered) - SPIKE_NEIGHBORS) // self.size * self.size
        self._classify(buffered, ready, self.size)
        self._pending = buffered.part(slice(ready, None), '' if ready else buffered.cut).copy()

    def _flush_pending(self) -> None:
        """Classify all buffered samples before a gap or the end, and pass on samples at rest."""
        remaining, self._pending = self._pending, self._pending.part(slice(0))
        while len(remaining) and self._levels.present.floor is not None:
            size = min(len(remaining), self.size)
            self._classify(remaining, size, size)
            remaining = remaining.part(slice(size, None))
        self._before = self._before[:, :0]
        self._rest.end_segment()

    def _classify(self, buffered: ImuBatch, end: int, size: int) -> None:
        """Classify the samples before the index ``end``, in windows of ``size`` samples.

        If no other noise level can fit the windows better, and if all of them up to the end of the
        block (`BLOCK_WINDOWS`) are at rest, they are classified together. Otherwise, only the
        windows up to the next check of the noise are classified together, because this check may
        begin another noise level.
        """
        position = 0
        while position < end:
            ready_window_count = (end - position) // size
            window_count = min(ready_window_count, CHECKED_WINDOWS - self._number % CHECKED_WINDOWS)
            joint_window_count = min(ready_window_count, BLOCK_WINDOWS - self._number)
            is_unchanged = (
                joint_window_count > window_count
                and self._is_settled
                and self._pass(buffered, position, joint_window_count, size, only_at_rest=True)
            )
            if is_unchanged:
                window_count = joint_window_count
            else:
                self._pass(buffered, position, window_count, size)
            position += window_count * size
            if size == self.size:
                self._number += window_count
                if self._number % CHECKED_WINDOWS == 0:
                    self._check(is_unchanged)

    @property
    def _is_settled(self) -> bool:
        """Whether no motion is present, only one noise level is stored, and each axis has noise."""
        is_only_level = self._levels.other is None and bool(self._rest.floor.variance.all())
        return is_only_level and self._rest.motion is None

    def _pass(
        self, buffered: ImuBatch, begin: int, number: int, size: int, only_at_rest: bool = False
    ) -> bool:
        """Pass ``number`` windows, which begin at sample ``begin``, to `RestFilter`.

        Returns whether the windows were passed. With ``only_at_rest``, nothing is done if a motion
        has not ended, if one of the windows is not at rest, or if the clipped axes change.
        """
        end = begin + number * size
        block = buffered.part(slice(begin, end), '' if begin else buffered.cut)
        next_rows = buffered.rows[:, end : end + SPIKE_NEIGHBORS]
        cleaned, windows, spikes = without_spikes(
            block, size, self._before, next_rows, self._rest.floor
        )
        if only_at_rest and self._clipping_changes(cleaned.rows):
            return False
        result = self._rest.add(cleaned, windows, size, only_at_rest)
        if result is None:
            return False
        self._before = block.rows[:, -SPIKE_NEIGHBORS:].copy()
        self._counts.spikes += spikes
        if size == self.size:
            part = WindowPart(cleaned, windows, *result)
            self._recent = self._recent.with_part(part, BLOCK_WINDOWS)
        return True

    def _clipping_changes(self, rows: Floats) -> bool:
        """Return whether the set of clipped axes changes in ``rows``, the next samples.

        ``rows`` is (axes, n). The samples since the last check are prepended to the next samples.
        Each complete group of `CHECKED_WINDOWS` windows is compared with the noise floor.
        """
        recent = self._recent.last(self._number % CHECKED_WINDOWS)
        rows = np.concatenate([recent.rows, rows], axis=1) if len(recent) else rows
        size = CHECKED_WINDOWS * self.size
        groups = rows[:, : rows.shape[1] // size * size].reshape(len(rows), -1, size)
        return not self._rest.floor.has_same_clipping(groups)

    # --- the noise level --------------------------------------------------------------------------

    def _check(self, is_unchanged: bool) -> None:
        """Change the noise level if another one fits the latest windows better; update the floor.

        ``is_unchanged`` tells whether the present level is known to fit best.

        Changed noise may be the noise of the IMU from now on, or be due to a fault. A noise level
        on trial is accepted if it has more samples than the earlier level, and, if the noise
        decreased, has lasted for at least `FAULTY_S`.
        """
        levels = self._levels
        is_fault = levels.change == 'noise_decreased'
        shortest_s = FAULTY_S if is_fault else 0.0
        if levels.lasts_longer and levels.present.samples * self._period_s >= shortest_s:
            levels.accept()
        if not is_unchanged:
            if self._change_level():
                return
            self._find_unit_change()
        if self._number == BLOCK_WINDOWS:
            self._update_floor()
            self._number = 0

    def _update_floor(self) -> None:
        """Update the noise floor from the latest block of windows, if the result is plausible."""
        block, is_still = self._recent, self._recent.still
        updated = self._rest.floor.updated(block.windows, is_still, block.is_steady)
        if updated.is_plausible():
            is_examined = is_still & (np.arange(len(is_still)) % EXAMINED == 0)
            usable = _usable(joined(block.samples), self.size, is_examined)
            self._levels.present.floor = updated.with_outliers(usable)

    def _change_level(self) -> bool:
        """Change the level if another one fits the latest windows; return whether it changed."""
        floor, other = self._rest.floor, self._levels.other
        recent = self._recent.last(CHECKED_WINDOWS)
        rows, windows = recent.rows, recent.windows
        if other is not None and other.floor is not None:
            is_nearer = other.floor.is_nearer(floor, rows, windows)
            if is_nearer and other.floor.rest(windows).mean() > 0.5:
                self._resume()
                return True
        if (revived := floor.revived(rows)).any():
            self._rest.stuck |= revived
            self._replace('stuck', self._learned_floor(recent.samples))
            return True
        if recent.still.any():
            if recent.still.all() and not floor.has_same_clipping(rows):
                self._change_clipping(recent)
                return True
            return False
        learned = self._learned_floor(recent.samples)
        is_at_rest = learned.rest(windows) & ~learned.foreign(rows, windows, self.size)
        if learned.is_plausible() and is_at_rest.all() and floor.has_wrong_unit(learned):
            self._replace('moving', learned)
            return True
        return self._decreases_to(learned, recent) or self._has_increased()

    def _change_clipping(self, recent: RecentWindows) -> None:
        """Begin another level, because the clipped axes have changed in the latest windows."""
        floor, learned = self._rest.floor, self._learned_floor(recent.samples)
        is_newly_clipped, variance = floor.newly_clipped(recent.rows), recent.windows.variance
        if is_newly_clipped.any():
            flags = np.broadcast_to(is_newly_clipped[:, None], variance.shape)
            self._levels.add_decrease(variance, flags, floor.variance)
            self._try_other_level(learned, 'noise_decreased')
        else:  # an axis that was clipped before is not clipped in the latest windows
            self._replace('moving', learned)

    def _decreases_to(self, learned: NoiseFloor, recent: RecentWindows) -> bool:
        """Begin another level if the noise decreased for no known reason; return whether it began.

        ``learned`` is the noise floor of the latest windows. If the earlier noise was due to a
        motion, the present level is discarded.
        """
        floor = self._rest.floor
        has_decreased = floor.decreased(recent.windows)
        is_explained = is_stuck(recent.rows, self.size) | recent.found.foreign
        decreased_axes = np.asarray((has_decreased & ~is_explained).all(axis=1))
        if decreased_axes.any() and learned.shows_motion(floor, decreased_axes):
            self._replace('moving', learned)
            return True
        if has_decreased.any() and (
            decreased_axes.any() or self._levels.present.counts.noise_decreased
        ):
            self._levels.add_decrease(recent.windows.variance, has_decreased, floor.variance)
        if decreased_axes.any():
            self._try_other_level(learned, 'noise_decreased')
        return bool(decreased_axes.any())

    def _has_increased(self) -> bool:
        """Begin another level if the noise increased in the last block; return whether it began.

        If the unit of the gyro changed, no level begins.
        """
        block, floor = self._recent, self._rest.floor
        if len(block) < BLOCK_WINDOWS or not block.can_be_larger_noise:
            return False
        ratio = floor.increase(block.rows, block.windows)
        # no noise floor is learned from samples in another unit
        if ratio is None or floor.changed_unit(ratio):
            return False
        self._levels.add_increase(ratio)
        self._rest.name_motion('noise_increased', BLOCK_WINDOWS * self.size)
        published = self._levels.published
        is_shaken = np.count_nonzero(ratio > SHAKEN_RATIO) >= MOVING_AXES
        is_established = (
            published.samples * self._period_s >= ESTABLISHED_S and not published.clipped
        )
        self._try_other_level(self._learned_floor(block.samples), 'noise_increased')
        if not (is_established or is_shaken):
            self._levels.accept()
        return True

    def _find_unit_change(self) -> None:
        """Count the latest windows as increased noise if the unit of the gyro has changed."""
        recent, floor = self._recent.last(CHECKED_WINDOWS), self._rest.floor
        if not recent.can_be_larger_noise:
            return
        ratio = floor.increase(recent.rows, recent.windows)
        if ratio is None or not floor.changed_unit(ratio):
            return
        self._levels.add_increase(ratio)
        self._rest.name_motion('noise_increased', CHECKED_WINDOWS * self.size)

    def _replace(self, reason: Literal['moving', 'stuck'], floor: NoiseFloor) -> None:
        """Discard the present noise level, and begin another noise level."""
        self._rest.end_segment()
        self._levels.replace_present(floor, reason)
        self._begin_level('motion' if reason == 'moving' else 'stuck')

    def _try_other_level(self, floor: NoiseFloor, change: Change) -> None:
        """Begin another noise level on trial; its Allan sums are not published yet."""
        motion = self._rest.motion
        began_ns = motion.began_ns if motion is not None else self._recent.latest_ns
        self._rest.end_segment()
        self._levels.try_another(floor, change, began_ns)
        self._begin_level(change)

    def _resume(self) -> None:
        """Continue the other stored noise level, because the noise is at that level again."""
        self._rest.end_segment()
        change = self._levels.change
        began_ns = self._levels.resume()
        if began_ns is not None:
            seconds = (self._recent.latest_ns - began_ns) * 1e-9
            self._events.add(seconds, Event(change, began_ns, seconds))
        self._begin_level(change)

    def _begin_level(self, split_reason: str) -> None:
        self._rest.begin_level(split_reason)
        noise = self._recent.last(CHECKED_WINDOWS).white_noise
        self._former_noise = dict(zip(self._axes, noise.tolist()))
        self._recent, self._number = RecentWindows(), 0


def _without_gaps(blocks: Iterable[ImuBatch]) -> list[ImuBatch]:
    """Return the blocks; successive blocks without a gap between them are joined."""
    groups: list[list[ImuBatch]] = []
    for block in blocks:
        if block.cut or not groups:
            groups.append([])
        groups[-1].append(block)
    return [joined(group) for group in groups]


def _usable(block: ImuBatch, size: int, chosen: Flags) -> Floats:
    """Return the samples, (axes, k * size), of the chosen windows with few replaced samples."""
    end = len(chosen) * size
    windows = block.rows[:, :end].reshape(len(block.rows), -1, size)
    if block.filled is not None:
        is_replaced = block.filled[:, :end].reshape(windows.shape) > 0
        replaced_shares = is_replaced.mean(axis=2).max(axis=0)
        chosen = chosen & (replaced_shares <= MOST_FILLED)
    return windows[:, chosen].reshape(len(windows), -1)
