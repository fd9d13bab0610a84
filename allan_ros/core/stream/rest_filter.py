# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Passes on the windows of an IMU at rest, excludes motions with a margin, and replaces shocks.

A motion begins with a window above the limits of the noise floor, and ends after some windows below
lower limits. The windows of a motion that may be a shock are held until the motion ends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from ..imu import Flags, Floats, ImuBatch
from .disturbances import LEAST_LEVEL, LONGEST_SHOCK_S, Motion, RestLevel
from .health import Counts, Event, Longest
from .noise_floor import NoiseFloor, WindowClass, Windows, is_stuck
from .noise_levels import Change, NoiseLevels

MARGIN_BEFORE, MARGIN_AFTER_S = 1, 2.0
"""Number of windows at rest before a motion, and time in s at rest after a motion, that are
excluded."""


class RestFilter:
    """Passes on windows at rest, and excludes or replaces the others.

    Windows at rest are added to the present noise level of ``levels``. The noise floor of this
    level decides which windows are at rest. ``size`` is the number of samples in a window.
    ``motion`` is the present motion or None, and ``stuck``, (axes,), flags axes that repeated one
    value. ``levels``, ``events`` and ``splits`` (number of splits by reason) are changed in place.
    """

    def __init__(
        self,
        size: int,
        period_s: float,
        axes: tuple[str, ...],
        levels: NoiseLevels,
        events: Longest[Event],
        splits: Counter[str],
    ) -> None:
        self.motion: Motion | None = None
        self.stuck = np.zeros(len(axes), bool)
        self._size, self._period_s, self._axes = size, period_s, axes
        self._levels, self._events, self._splits = levels, events, splits
        self._level, self._last_mean = RestLevel(), np.full(len(axes), np.nan)
        self._cut = ''  # reason for the split before the next block at rest

        # the last window at rest, because a motion may follow, and the windows of a possible shock
        self._held: list[ImuBatch] = []
        self._out: list[ImuBatch] = []  # blocks that are confirmed to be at rest

    @property
    def floor(self) -> NoiseFloor:
        """The present noise floor, which must be known."""
        floor = self._levels.present.floor
        assert floor is not None
        return floor

    @property
    def _counts(self) -> Counts:
        return self._levels.present.counts

    def take(self) -> list[ImuBatch]:
        """Return the samples that were confirmed to be at rest since the last call."""
        released, self._out = self._out, []
        return released

    def add(
        self, block: ImuBatch, windows: Windows, size: int, only_at_rest: bool = False
    ) -> tuple[Flags, WindowClass] | None:
        """Pass on or exclude k windows of ``size`` samples; return which are passed on as at rest.

        Returns flags, (k,), that are True for the windows at rest, and the classification of the
        windows. ``block`` contains the samples of the windows, and ``windows`` their statistics.
        With ``only_at_rest``, nothing happens and None is returned if some of the windows are not
        at rest.
        """
        has_previous = np.isfinite(self._last_mean).all() and not block.cut
        floor, previous_mean = self.floor, self._last_mean if has_previous else None
        found = floor.classify(block.rows, windows, previous_mean, size)
        is_at_rest = ~found.moving
        all_at_rest = self.motion is None and bool(is_at_rest.all())
        if only_at_rest and not all_at_rest:
            return None
        if block.cut:
            self._pass_held()
            self._forget_level()
            if self.motion is not None:
                self.motion.before = self.motion.before[:0]
            self._cut = self._cut or block.cut
        if found.stuck.any():
            is_axis_stuck = floor.decreased(windows) & is_stuck(block.rows, size)
            self.stuck |= is_axis_stuck.any(axis=1)
        if all_at_rest:
            self._release(block, windows.mean, size)
        else:
            for i in range(len(is_at_rest)):
                window = block.part(slice(i * size, (i + 1) * size))
                self._step(window, windows.mean[:, i], WindowClass(*(v[i] for v in found)))
                is_at_rest[i] = self.motion is None
        self._last_mean = windows.mean[:, -1]
        return is_at_rest, found

    def end_segment(self) -> None:
        """Pass on or exclude the windows that are held, because a gap follows."""
        self.drop_shock()
        self._pass_held()

    def drop(self, samples: list[ImuBatch], cut: str) -> None:
        """Exclude samples of a motion before a noise floor is known."""
        self._counts.moving += count_samples(samples)
        if self.motion is None:
            self.motion = Motion(cut, int(samples[0].stamps_ns[0]))
            self._splits[cut] += 1
        self.motion.ended_ns = int(samples[-1].stamps_ns[-1])
        self._cut = cut

    def begin_level(self, cut: str) -> None:
        """Continue with another noise level; ``cut`` is the reason for the split."""
        self._forget_level()
        self.motion, self._cut = None, cut

    def drop_shock(self) -> None:
        """Exclude the windows of the present motion, if any, because it is no shock."""
        motion = self.motion
        if motion is not None and motion.level is not None:
            self._counts.moving += count_samples(self._held)
            self._splits[motion.kind] += 1
            self._cut = self._cut or motion.kind
            motion.level, self._held = None, []

    def name_motion(self, kind: Change, samples: int) -> None:
        """Count ``samples`` samples of the present motion as a change of the noise of this kind.

        The present motion, if any, gets this kind, and is no shock.
        """
        self.drop_shock()
        counts = self._counts
        counts.moving -= samples
        setattr(counts, kind, getattr(counts, kind) + samples)
        if self.motion is not None:
            self.motion.kind = kind

    def log_motion(self) -> None:
        """Add the motion that just ended, if any, to the list of events."""
        motion, self.motion = self.motion, None
        if motion is not None:
            changes = zip(self._axes, motion.change(self.floor).tolist())
            seconds = (motion.ended_ns - motion.began_ns) * 1e-9 + self._period_s
            changed = {axis: change for axis, change in changes if abs(change) > 0.0}
            self._events.add(seconds, Event(motion.kind, motion.began_ns, seconds, changed))

    def _step(self, window: ImuBatch, mean: Floats, found: WindowClass) -> None:
        """Update the state from one window and its flags; pass on the window if it is at rest."""
        if self.motion is None and not found.moving:
            self._release(window, mean[:, None], len(window))
            return
        if self.motion is None:
            kind = 'noise_decreased' if found.decreased else 'motion'
            kind = 'stuck' if found.stuck else kind
            self.motion = Motion(kind, int(window.stamps_ns[0]), self._level)
        motion = self.motion
        if found.decreased:
            self.drop_shock()
            excluded_as = 'stuck' if found.stuck else 'noise_decreased'
            setattr(self._counts, excluded_as, getattr(self._counts, excluded_as) + len(window))
        elif motion.level is None:
            self._counts.moving += len(window)
        else:
            self._held.append(window)
        motion.add(window, mean, found)
        window_s = self._size * self._period_s
        margin_windows = max(LEAST_LEVEL, round(MARGIN_AFTER_S / window_s))
        # tested before the motion ends, because a changed bias of the gyro may prolong the motion
        if motion.steady == margin_windows and motion.finds_other_axes(self.floor, self._period_s):
            self._splits['axes changed'] += 1
        if motion.windows - motion.quiet > int(LONGEST_SHOCK_S / window_s):
            self.drop_shock()
        if motion.quiet >= margin_windows:
            self._end_motion(motion)

    def _end_motion(self, motion: Motion) -> None:
        """End a motion: replace the samples of a shock and pass them on, or else split the data."""
        shock_blocks = motion.replaced(self._held, self.floor, self._period_s)
        if shock_blocks:
            motion.kind = 'shock'
            self._counts.shocks += 1
            self._counts.replaced += len(shock_blocks[0])
            self._held = []
        else:
            self.drop_shock()
        self.log_motion()
        self._pass_on(shock_blocks[:1])
        for window in shock_blocks[1:]:
            self._release(window, window.rows.mean(axis=1)[:, None], len(window))

    def _release(self, block: ImuBatch, means: Floats, size: int) -> None:
        """Pass on windows at rest, except for the last one, because a motion may follow.

        ``means``, (axes, k), are the means of the windows of ``size`` samples.
        """
        self._level.add(means, size)
        self._pass_held()
        number_released = max(0, len(block) - MARGIN_BEFORE * self._size)
        cut, self._cut = self._cut, ''
        if number_released:
            self._pass_on([block.part(slice(number_released), cut)])
            cut = ''
        self._held = [block.part(slice(number_released, None), cut)]

    def _pass_held(self) -> None:
        self._pass_on(self._held)
        self._held = []

    def _pass_on(self, blocks: list[ImuBatch]) -> None:
        self._out += blocks
        for block in blocks:
            self._levels.present.add(block)

    def _forget_level(self) -> None:
        self._level, self._last_mean = RestLevel(), np.full(len(self._axes), np.nan)


def count_samples(blocks: Iterable[ImuBatch]) -> int:
    """Return the number of samples of all blocks."""
    return sum(map(len, blocks))
