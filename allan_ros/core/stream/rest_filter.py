# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Passes on the windows of an IMU at rest, drops the others with a margin, and replaces shocks.

A motion begins with a window above the limits of the noise floor, and ends after some windows below
lower limits. Until then, its windows are held if they may be a shock.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np

from ..imu import Flags, Floats, ImuBatch
from .disturbances import LEAST_LEVEL, LONGEST_SHOCK_S, Level, Motion
from .floor_counts import FloorCounts
from .health import Event, Longest
from .noise_floor import NoiseFloor, WindowClass, Windows, is_stuck

MARGIN_BEFORE, MARGIN_AFTER_S = 1, 2.0
"""What is dropped of the data at rest next to a motion: one window before it, and windows of at
least 2 s after it."""

Change = Literal['relearned', 'revived', 'corrected', 'set_aside', 'resumed', 'accepted']
"""What happens to the sums when the noise floor changes. 'relearned': the present sums are
discarded, because the IMU moved. 'revived': they are discarded, because an axis was stuck.
'corrected': they are discarded, because their unit of measurement was wrong.
'set_aside': they are kept, and sums of a decreased noise begin. 'resumed': these are discarded, and
the sums that were kept continue. 'accepted': the sums that were kept are discarded."""


class RestFilter:
    """Passes on windows at rest, and drops or replaces the others.

    ``size`` is the number of samples in a window, and ``floor`` the present noise floor. ``motion``
    is the present motion, if any, and ``stuck``, (axes,), flags axes that repeated one value.
    ``counts`` and ``events`` are changed in place.
    """

    def __init__(
        self,
        size: int,
        period_s: float,
        axes: tuple[str, ...],
        counts: FloorCounts,
        events: Longest[Event],
    ) -> None:
        self.floor: NoiseFloor | None = None
        self.motion: Motion | None = None
        self.stuck = np.zeros(len(axes), bool)
        self._size, self._period_s, self._axes = size, period_s, axes
        self._counts, self._events = counts, events
        self._level, self._last_mean = Level(), np.full(len(axes), np.nan)
        self._cut = ''  # reason for the gap before the next still block
        # the last still window, because a motion may follow, and the windows of a possible shock
        self._held: list[ImuBatch] = []
        self._out: list[ImuBatch] = []  # confirmed to be at rest

    @property
    def held(self) -> int:
        """Number of samples that are neither passed on nor dropped yet."""
        return count_samples(self._held)

    def take(self) -> list[ImuBatch]:
        """Return the samples that were confirmed to be at rest since the last call."""
        out, self._out = self._out, []
        return out

    def add(self, block: ImuBatch, windows: Windows, size: int) -> tuple[Flags, WindowClass]:
        """Pass on or drop windows of ``size`` samples; return which are at rest, and their class.

        ``block`` contains their samples, and ``windows`` their statistics.
        """
        assert self.floor is not None
        if block.cut:
            self._pass_held()
            self._forget_level()
            if self.motion is not None:
                self.motion.before = self.motion.before[:0]
            self._cut = self._cut or block.cut
        known = np.isfinite(self._last_mean).all()
        found = self.floor.classify(block.rows, windows, self._last_mean if known else None, size)
        if found.stuck.any():
            stuck = self.floor.decreased(windows) & is_stuck(block.rows, size)
            self.stuck |= stuck.any(axis=1)
        still = ~found.moving
        if self.motion is None and still.all():
            self._release(block, windows.mean, size)
        else:
            for i in range(len(still)):
                window = block.part(slice(i * size, (i + 1) * size))
                self._step(window, windows.mean[:, i], WindowClass(*(v[i] for v in found)))
                still[i] = self.motion is None
        self._last_mean = windows.mean[:, -1]
        return still, found

    def end_segment(self) -> None:
        """Decide about the windows that are held, because a gap follows."""
        self.drop_shock()
        self._pass_held()

    def drop(self, samples: list[ImuBatch], cut: str) -> None:
        """Drop samples of a motion before a noise floor is known."""
        self._counts.add('moving', count_samples(samples))
        if self.motion is None:
            self.motion = Motion(cut, int(samples[0].stamps_ns[0]))
            self._counts.total.splits[cut] += 1
        self.motion.ended_ns = int(samples[-1].stamps_ns[-1])
        self._cut = cut

    def change_floor(self, floor: NoiseFloor, change: Change, first: ImuBatch, cut: str) -> None:
        """Continue with another noise floor and other sums; ``first`` is the next block."""
        self.floor, self._cut = floor, cut
        self._forget_level()
        self.mark(change, first)
        self.motion = Motion(cut, int(first.stamps_ns[0])) if cut == 'motion' else None

    def mark(self, change: Change, block: ImuBatch) -> None:
        """Tell `SensorStream` what to do with the sums before the next samples."""
        self._pass_held()
        self._out.append(block.part(slice(0), change))

    def drop_shock(self) -> None:
        """Drop the windows of the present motion, which is no shock."""
        motion = self.motion
        if motion is not None and motion.level is not None:
            self._counts.add('moving', self.held)
            self._counts.total.splits[motion.kind] += 1
            self._cut = self._cut or motion.kind
            motion.level, self._held = None, []

    def log_motion(self) -> None:
        """Add the motion that just ended, if any, to the list of events."""
        motion, floor, self.motion = self.motion, self.floor, None
        if motion is not None and floor is not None:
            changes = zip(self._axes, motion.change(floor).tolist())
            seconds = (motion.ended_ns - motion.began_ns) * 1e-9 + self._period_s
            changed = {axis: change for axis, change in changes if abs(change) > 0.0}
            self._events.add(seconds, Event(motion.kind, motion.began_ns, seconds, changed))

    def _step(self, window: ImuBatch, mean: Floats, found: WindowClass) -> None:
        """Update the state from one window and its class, and keep it if it is at rest."""
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
            self._counts.add('stuck' if found.stuck else 'noise_decreased', len(window))
        elif motion.level is None:
            self._counts.add('moving', len(window))
        else:
            self._held.append(window)
        motion.add(window, mean, bool(found.quiet))
        window_s = self._size * self._period_s
        if motion.windows - motion.quiet > int(LONGEST_SHOCK_S / window_s):
            self.drop_shock()
        if motion.quiet >= max(LEAST_LEVEL, round(MARGIN_AFTER_S / window_s)):
            self._end_motion(motion)

    def _end_motion(self, motion: Motion) -> None:
        """Pass on the windows of the motion that just ended if it was a shock, else split."""
        assert self.floor is not None
        kept = motion.replaced(self._held, self.floor, self._period_s)
        if kept:
            motion.kind = 'shock'
            self._counts.add('shocks', 1)
            self._counts.add('replaced', len(kept[0]))
            self._held = []
        else:
            self.drop_shock()
        self.log_motion()
        self._pass_on(kept[:1])
        for window in kept[1:]:
            self._release(window, window.rows.mean(axis=1)[:, None], len(window))

    def _release(self, block: ImuBatch, means: Floats, size: int) -> None:
        """Pass on still windows except for the last one, because a motion may follow.

        ``means``, (axes, k), are the means of the windows of ``size`` samples.
        """
        self._level.add(means, size)
        self._pass_held()
        split = max(0, len(block) - MARGIN_BEFORE * self._size)
        cut, self._cut = self._cut, ''
        if split:
            self._pass_on([block.part(slice(split), cut)])
            cut = ''
        self._held = [block.part(slice(split, None), cut)]

    def _pass_held(self) -> None:
        self._pass_on(self._held)
        self._held = []

    def _pass_on(self, blocks: list[ImuBatch]) -> None:
        self._out += blocks
        self._counts.add('used', count_samples(blocks))

    def _forget_level(self) -> None:
        self._level, self._last_mean = Level(), np.full(len(self._axes), np.nan)


def count_samples(blocks: Iterable[ImuBatch]) -> int:
    """Return the number of samples of all blocks."""
    return sum(map(len, blocks))
