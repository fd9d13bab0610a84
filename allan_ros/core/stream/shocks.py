# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distinguishes shocks from motion, and replaces the samples of shocks.

A shock is a short motion after which all means are as before. Its samples are replaced by a line
between these means and flagged, so that the segment continues: the flagged samples are excluded
from short averages and only contribute to long ones.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from .noise_floor import NoiseFloor
from .timing import Block

Floats = NDArray[np.float64]

LONGEST_SHOCK_S, LONGEST_SHOCK = 10.0, 20
"""Longest shock, in s and in windows."""

LEVEL_WINDOWS, LEAST_LEVEL = 4, 2
"""Number of windows before and after a motion whose means are compared, and the smallest number."""

LEVEL_SIGMAS = 5.0
"""Smallest change of a mean, in standard deviations, that is not due to noise."""

TURNED = 0.035
"""Angle in rad (2 degrees) by which an IMU does not turn during a shock."""

REPLACED_SHARE = 0.5
"""Largest ratio of replaced samples to samples at rest in a segment."""


class Level:
    """Mean over the last windows at rest, and number of samples at rest, in a segment."""

    def __init__(self) -> None:
        self.rest = self.replaced = 0  # samples
        # one more than needed: the last window before a motion is not used
        self._means: deque[Floats] = deque(maxlen=LEVEL_WINDOWS + 1)

    def add(self, means: Floats, size: int) -> None:
        """Add the means, (axes, k), of windows of ``size`` samples at rest."""
        self.rest += means.shape[1] * size
        self._means.extend(means[:, -LEVEL_WINDOWS - 1 :].T)

    def before(self) -> Floats:
        """Return the means of the windows before a motion that begins now, (k, axes)."""
        return np.array(list(self._means)[:-1])


class Motion:
    """A motion; its windows are kept in ``held`` while it may be a shock.

    ``level`` is that of the segment before it, or None if no shock is possible.
    """

    def __init__(self, kind: str, began_ns: int, level: Level | None, margin: list[Block]) -> None:
        self.kind = kind  # 'motion', 'stuck' or 'noise_increased'
        self.began_ns, self.ended_ns = began_ns, began_ns
        self.level = level
        self.held: list[Block] | None = None if level is None else margin
        self.quiet = 0  # number of quiet windows at the end
        # means of the last windows before it
        self.before = level.before() if level is not None else np.empty((0, 0))
        self._after: deque[Floats] = deque(maxlen=LEVEL_WINDOWS)
        self._number = self._samples = 0
        self._total: float | Floats = 0.0  # sum of the samples

    def add(self, window: Block, mean: Floats, quiet: bool) -> None:
        """Add the next window and its mean, (axes,)."""
        if self.held is not None:
            self.held.append(window)
        self.quiet = self.quiet + 1 if quiet else 0
        if not quiet:
            self.ended_ns = int(window.stamps[-1])
        self._after.append(mean)
        self._number += 1
        self._samples += len(window)
        self._total = self._total + len(window) * mean

    def is_longer(self, windows: int) -> bool:
        """Return whether it lasts longer than a number of windows, without the quiet ones."""
        return self._number - self.quiet > windows

    def abandon(self) -> list[Block]:
        """Return the windows kept so far, because it is no shock."""
        held, self.held = self.held or [], None
        return held

    def change(self, floor: NoiseFloor) -> Floats:
        """Return the change of the mean of each axis, (axes,): 0 if noise explains it.

        It is NaN if the mean before or after the motion is not known.
        """
        counts = len(self.before), min(self.quiet, len(self._after))
        if min(counts) < LEAST_LEVEL:
            return np.full(len(floor.mean), np.nan)
        after = np.array(list(self._after)[-counts[1] :]).mean(axis=0)
        step = np.maximum(np.sqrt(2.0 / floor.size * floor.scale), floor.step)
        limit = LEVEL_SIGMAS * np.sqrt(0.5 / counts[0] + 0.5 / counts[1]) * step
        limit += np.where(floor.variance < 0.25 * floor.lsb**2, floor.lsb, 0.0)
        change = after - self.before.mean(axis=0)
        return np.asarray(np.where(np.abs(change) > limit, change, 0.0))

    def replaced(self, floor: NoiseFloor, period_s: float) -> list[Block]:
        """Return the windows with the samples of the shock replaced; empty if it is no shock.

        All windows are replaced except the last quiet ones.
        """
        if self.held is None or self.level is None or self.change(floor).any():
            return []
        first, last = self.before.mean(axis=0), np.mean(self._after, axis=0)
        turned = (self._total - self._samples * first)[~floor.limits.gravity] * period_s
        block = Block.joined(self.held[: 1 - self.quiet])
        n = len(block)
        allowed = REPLACED_SHARE * self.level.rest - self.level.replaced
        if np.linalg.norm(turned) > TURNED or n > allowed:
            return []
        share = (np.arange(n) + 0.5) / n
        rows = first[:, None] + (last - first)[:, None] * share
        self.level.replaced += n
        flagged = np.ones(rows.shape, bool)
        return [Block(block.stamps, rows, block.cut, flagged), *self.held[1 - self.quiet :]]
