# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Classifies windows as at rest or moving; finds isolated spikes and saturated samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .clock import Floats
from .noise_floor import LEAST_WINDOW, MAD_TO_SIGMA, NoiseFloor, Windows
from .timing import Block, Flags

LEAVE_RATIO = 0.8
"""A motion ends when the standard deviation is below this fraction of the limit for its start."""

KNOCK_SIGMAS = 20.0
"""A sample that deviates from the mean of its window by this many standard deviations of the noise
floor is a mechanical knock."""

STEP_SIGMAS = 8.0
"""Means of neighboring windows that differ by this many standard deviations of the difference
indicate motion."""

SPIKE_SIGMAS = 7.0
"""An isolated sample is a spike if it deviates from the mean of its window by more than this number
of standard deviations of the noise floor. This holds for 1e-10 of the samples of white noise, so
the variance of white noise changes by less than 1e-8."""

SPIKE_NEIGHBORS, NEIGHBOR_RATIO = 4, 0.6
"""Number of samples before and after a spike that are examined. The spike is isolated if its direct
neighbors, and all others except one, deviate less than this fraction of the smallest possible
spike. After a mechanical knock, in contrast, several samples deviate."""


MIN_PLATEAU, PLATEAU_STEP_LSB = 3, 4.0
"""An axis may be saturated if this number of consecutive samples has its largest value, and the
step to them is at least this many resolutions. (At a coarse resolution, a slow motion has equal
samples at its peak, too.)"""

LEAST_SATURATED = 10
"""Smallest number of such samples at the same value, which is never exceeded."""


class WindowClass(NamedTuple):
    """Classification of k windows: arrays of flags, (k,) each."""

    moving: Flags  # in motion, or an axis is stuck
    quiet: Flags  # below the limits at which a motion ends
    stuck: Flags  # an axis repeats one value
    rotating: Flags  # only the mean angular rate differs from the noise floor


def classify_windows(
    windows: Windows,
    previous_mean: Floats | None,
    size: int,
    floor: NoiseFloor,
    motion_ratio: float,
) -> WindowClass:
    """Classify windows of ``size`` samples by comparing them with the noise floor.

    A standard deviation above ``motion_ratio`` times the noise floor is motion. ``previous_mean``,
    (axes,), is the mean of the window before the first, or None if there is none.
    """
    # (axes, 1) each; the limits are infinite for an axis without noise
    scale, lsb = floor.scale[:, None], floor.lsb[:, None]
    unknown = np.where(scale > 0.0, 0.0, np.inf)
    sigma = np.sqrt(scale)
    step_sigma = np.maximum(np.sqrt(2.0 / size) * sigma, floor.step[:, None])
    # the variance of few samples is uncertain, so short windows are classified by their peak
    uncertain = unknown if size >= LEAST_WINDOW else np.full_like(unknown, np.inf)
    max_variance = motion_ratio**2 * scale + uncertain
    max_peak = np.maximum(KNOCK_SIGMAS * sigma, 2.5 * lsb) + unknown
    max_step = STEP_SIGMAS * step_sigma + lsb + uncertain
    max_rate = np.maximum(floor.limits.rate[:, None], STEP_SIGMAS * step_sigma)
    previous = windows.mean[:, :1] if previous_mean is None else previous_mean[:, None]
    means = np.concatenate([previous, windows.mean], axis=1)
    step = np.abs(means[:, 1:] - means[:, :-1])
    noisy = windows.variance > LEAVE_RATIO**2 * max_variance
    knocked = (windows.peak > max_peak) | (step > max_step)
    rotating = np.abs(windows.mean - floor.mean[:, None]) > max_rate
    none = np.zeros(windows.mean.shape[1], bool)
    if windows.variance.all() and not (noisy | knocked | rotating).any():
        return WindowClass(none, ~none, none, none)  # the common case: an IMU at rest
    has_noise = (floor.variance > floor.lsb**2)[:, None] & (size >= LEAST_WINDOW)
    stuck = ((windows.variance == 0.0) & has_noise).any(axis=0)
    moving = ((windows.variance > max_variance) | knocked | rotating).any(axis=0) | stuck
    disturbed = (noisy | knocked).any(axis=0) | stuck
    return WindowClass(moving, ~(moving | disturbed), stuck, rotating.any(axis=0) & ~disturbed)


def without_spikes(
    block: Block, size: int, before: Floats, after: Floats, floor: NoiseFloor
) -> tuple[Block, Windows, int]:
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
    filled = found if block.filled is None else block.filled | found
    replaced = np.where(found, without, rows)
    return Block(block.stamps, replaced, block.cut, filled), windows, int(np.count_nonzero(found))


def _is_isolated(far: NDArray[np.bool_], at: int) -> bool:
    """Return whether the neighbors of ``far[at]`` are not set, and at most one other flag is."""
    inside = 0 < at < len(far) - 1
    return inside and not far[at - 1] and not far[at + 1] and int(np.count_nonzero(far)) <= 2


class Saturation:
    """Counts the samples in motion at the limit of the measurement range, ``count``.

    These are consecutive samples with the largest absolute value of an axis so far that a large
    step precedes or follows. A larger value later shows that this was not the limit.
    """

    def __init__(self, axes: int) -> None:
        self._largest = np.zeros(axes)  # absolute value
        self._at_limit = np.zeros(axes, np.int64)  # number of samples with this value

    @property
    def count(self) -> int:
        """Number of saturated samples, counted per axis."""
        return int(self._at_limit[self._at_limit >= LEAST_SATURATED].sum())

    def add(self, rows: Floats, lsb: Floats) -> None:
        """Add a moving window, (axes, n); ``lsb``, (axes,), are the resolutions."""
        size = np.abs(rows)
        largest = size.max(axis=1)
        self._at_limit[largest > self._largest] = 0
        self._largest = np.maximum(self._largest, largest)
        top = size >= self._largest[:, None]
        for axis in np.flatnonzero(np.count_nonzero(top, axis=1) >= MIN_PLATEAU):
            edges = np.flatnonzero(np.diff(top[axis], prepend=False, append=False))
            for a, b in edges.reshape(-1, 2):
                outside = [rows[axis, i] for i in (a - 1, b) if 0 <= i < rows.shape[1]]
                step = max((abs(rows[axis, a] - x) for x in outside), default=0.0)
                if b - a >= MIN_PLATEAU and step >= PLATEAU_STEP_LSB * lsb[axis] > 0:
                    self._at_limit[axis] += b - a
