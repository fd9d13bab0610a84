# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Short disturbances, whose samples are replaced: isolated spikes and shocks.

An isolated spike is replaced by the mean of its neighbors. A shock is a short motion after which
all means are as before. The samples of a shock are replaced by a line between these means and
flagged, so the segment continues. Flagged samples only contribute to long averages.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ..imu import Flags, Floats, ImuBatch, joined
from .noise_floor import LEAST_WINDOW, MAD_TO_SIGMA, NoiseFloor, WindowClass, Windows

SPIKE_SIGMAS = 7.0
"""An isolated sample is a spike if it deviates from the mean of its window by more than this number
of standard deviations of the noise floor. This holds for 1e-10 of the samples of white noise, so
the variance of white noise changes by less than 1e-8."""

SPIKE_NEIGHBORS, NEIGHBOR_RATIO = 4, 0.6
"""Number of samples before and after a spike that are examined. The spike is isolated if its direct
neighbors, and all others except one, deviate less than this fraction of the smallest possible
spike. After a shock, in contrast, several samples deviate."""

LONGEST_SHOCK_S = 10.0
"""Longest shock in s."""

LEVEL_WINDOWS, LEAST_LEVEL = 4, 2
"""Number of windows before and after a motion whose means are compared, and the smallest number."""

LEVEL_SIGMAS = 5.0
"""Smallest change of a mean, in standard deviations, that is not due to noise."""

TURNED = 0.035
"""Largest angle in rad (2 degrees) by which an IMU turns during a shock."""

CHANGED_DIRECTION, NO_ROTATION = np.radians(30.0), np.radians(6.0)
"""Smallest angle by which gravity turns, and largest angle by which the gyro turns meanwhile, if
the axes of the sensors have changed."""

REPLACED_SHOCK_SHARE = 0.5
"""Largest ratio of replaced samples to samples at rest in a segment."""


def without_spikes(
    block: ImuBatch, size: int, before: Floats, after: Floats, floor: NoiseFloor
) -> tuple[ImuBatch, Windows, int]:
    """Replace isolated spikes by the mean of the two samples next to them.

    ``size`` is the number of samples in a window. ``before`` and ``after``, (axes, n), are up to
    `SPIKE_NEIGHBORS` samples on either side of the block. Returns the block, the statistics of its
    windows, and the number of replaced values. On axes with heavy tails, spikes are only removed
    from the statistics, and the block keeps them.
    """
    rows = block.rows
    windows = Windows.of(rows, size)
    threshold = SPIKE_SIGMAS * np.sqrt(floor.scale)
    flagged = (windows.peak > threshold[:, None]) & (threshold > 0.0)[:, None]
    if not flagged.any() or size < LEAST_WINDOW:
        return block, windows, 0
    axes, at = np.nonzero(flagged)
    cube = rows.reshape(len(rows), -1, size)[axes, at]
    level = np.median(cube, axis=1)
    sigma = MAD_TO_SIGMA * np.median(np.abs(cube - level[:, None]), axis=1)
    # a higher threshold if the noise exceeds its floor by more than the error of sigma
    increased = SPIKE_SIGMAS * sigma > (1.0 + 5.0 / np.sqrt(size)) * threshold[axes]
    height = np.where(increased, SPIKE_SIGMAS * sigma, threshold[axes])
    far = np.abs(cube - level[:, None]) > height[:, None]
    few = np.count_nonzero(far, axis=1) <= 1 + size // LEAST_WINDOW  # more than this are a motion
    around = np.concatenate([before, rows, after], axis=1)
    without = rows.copy()
    found = np.zeros(rows.shape, bool)
    for n, k in zip(*np.nonzero(far & few[:, None])):
        axis, i = axes[n], at[n] * size + k
        x, j = around[axis], i + before.shape[1]
        first = max(0, j - SPIKE_NEIGHBORS)
        near = np.abs(x[first : j + SPIKE_NEIGHBORS + 1] - level[n])
        if _is_isolated(near > NEIGHBOR_RATIO * height[n], j - first):
            without[axis, i] = 0.5 * (x[j - 1] + x[j + 1])
            found[axis, i] = True
    changed = found.any(axis=0).reshape(-1, size).any(axis=1)
    if not changed.any():
        return block, windows, 0
    some = without.reshape(len(rows), -1, size)[:, changed].reshape(len(rows), -1)
    windows.values[:, :, changed] = Windows.of(some, size).values
    found[floor.heavy] = False
    known = 0 if block.filled is None else block.filled
    filled = np.where(found, 1, known).astype(np.int32)
    replaced = np.where(found, without, rows)
    block = ImuBatch.of_rows(block.stamps_ns, replaced, block.cut, filled)
    return block, windows, int(np.count_nonzero(found))


def _is_isolated(far: Flags, at: int) -> bool:
    """Return whether the neighbors of ``far[at]`` are not set, and at most one other flag is."""
    inside = 0 < at < len(far) - 1
    return inside and not far[at - 1] and not far[at + 1] and int(np.count_nonzero(far)) <= 2


class RestLevel:
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
    """A motion that begins at a time in ns.

    ``level`` is the level of the segment before a shock, or None if it is no shock.
    """

    def __init__(self, kind: str, began_ns: int, level: RestLevel | None = None) -> None:
        self.kind = kind  # as in `Event`
        self.began_ns, self.ended_ns = began_ns, began_ns
        self.level = level
        self.windows = self.quiet = 0  # number of windows, and of quiet ones at the end
        self.steady = 0  # number of windows at the end that are quiet or only rotating
        self.axes_changed = False  # of the accelerometer, or their signs
        # means of the last windows before it
        self.before = level.before() if level is not None else np.empty((0, 0))
        self._after: deque[Floats] = deque(maxlen=LEVEL_WINDOWS)
        self._samples = 0
        self._total: float | Floats = 0.0  # sum of the samples

    def add(self, window: ImuBatch, mean: Floats, found: WindowClass) -> None:
        """Add the next window, its mean, (axes,), and its class."""
        self.quiet = self.quiet + 1 if found.quiet else 0
        self.steady = self.steady + 1 if found.quiet or found.rotating else 0
        if not found.quiet:
            self.ended_ns = int(window.stamps_ns[-1])
        self._after.append(mean)
        self.windows += 1
        self._samples += len(window)
        self._total = self._total + len(window) * mean

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

    def finds_other_axes(self, floor: NoiseFloor, period_s: float) -> bool:
        """Return whether the axes changed, when this is found for the first time.

        They changed if gravity has another direction in the steady windows at the end, although the
        gyro measured no rotation since the motion began.
        """
        gyro, counts = floor.gyro, (len(self.before), min(self.steady, len(self._after)))
        if self.axes_changed or min(counts) < LEAST_LEVEL:
            return False
        if np.count_nonzero(gyro) < 3 or np.count_nonzero(~gyro) < 3:
            return False
        before = self.before.mean(axis=0)
        after = np.array(list(self._after)[-counts[1] :]).mean(axis=0)
        turned = np.linalg.norm((self._total - self._samples * before)[gyro]) * period_s
        norms = np.linalg.norm(before[~gyro]) * np.linalg.norm(after[~gyro])
        cosine = before[~gyro] @ after[~gyro] / norms if norms else 1.0
        self.axes_changed = bool(turned < NO_ROTATION and cosine < np.cos(CHANGED_DIRECTION))
        return self.axes_changed

    def replaced(self, held: list[ImuBatch], floor: NoiseFloor, period_s: float) -> list[ImuBatch]:
        """Return the windows with the samples of the shock replaced; empty if it is no shock.

        ``held`` are its windows and the one before it. All are replaced except the last quiet ones.
        """
        if self.level is None or self.change(floor).any():
            return []
        kept = list(self._after)[1 - self.quiet :]  # windows that are not replaced
        level = min(len(self.before), len(kept))
        first, last = (np.mean(w, axis=0) for w in (self.before[-level:], kept[:level]))
        turned = (self._total - self._samples * first)[floor.gyro] * period_s
        block = joined(held[: 1 - self.quiet])
        n = len(block)
        allowed = REPLACED_SHOCK_SHARE * self.level.rest - self.level.replaced
        if np.linalg.norm(turned) > TURNED or n > allowed:
            return []
        share = np.arange(1, n + 1) / (n + 1)
        rows = first[:, None] + (last - first)[:, None] * share
        self.level.replaced += n
        levels = np.full(rows.shape, level * floor.size, np.int32)
        return [ImuBatch.of_rows(block.stamps_ns, rows, block.cut, levels), *held[1 - self.quiet :]]
