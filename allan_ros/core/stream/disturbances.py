# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replaces the samples of short disturbances: isolated spikes and shocks.

An isolated spike is replaced by the mean of its neighbors. A shock is a short motion that does not
change the mean of any axis. Its samples are replaced by a line between the means before and after
it, so the segment continues. `ImuBatch.filled` flags replaced samples.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ..imu import Flags, Floats, ImuBatch, joined
from .noise_floor import LEAST_WINDOW, MAD_TO_SIGMA, NoiseFloor, WindowClass, Windows

SPIKE_SIGMAS = 7.0
"""An isolated sample is a spike if it deviates from the mean of its window by more than this number
of standard deviations of the noise floor. Only 1e-10 of the samples of white noise deviate that
much. If these are replaced, the variance changes by less than the fraction 1e-8."""

SPIKE_NEIGHBORS, NEIGHBOR_RATIO = 4, 0.6
"""Number of samples before and after a spike that are examined, and their largest deviation, as a
fraction of the smallest possible spike. A spike is isolated if neither of its two direct neighbors,
and at most one of the other examined samples, deviates more. In a shock, several samples do."""

LONGEST_SHOCK_S = 10.0
"""Longest shock in s."""

LEVEL_WINDOWS, LEAST_LEVEL = 4, 2
"""Largest and smallest number of windows on each side of a motion whose means are compared."""

LEVEL_SIGMAS = 5.0
"""Smallest difference between the means before and after a motion, in standard deviations of this
difference, that is not due to noise."""

TURNED = 0.035
"""Largest angle in rad (2 degrees) by which an IMU may turn during a shock."""

CHANGED_DIRECTION, NO_ROTATION = np.radians(30.0), np.radians(6.0)
"""Angles in rad. The axes of the sensors have changed if the measured direction of gravity changes
by more than the first angle, while the gyro measures a rotation by less than the second angle."""

REPLACED_SHOCK_SHARE = 0.5
"""Largest ratio of the replaced samples of shocks to the samples at rest in a segment."""


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
    has_peak = (windows.peak > threshold[:, None]) & (threshold > 0.0)[:, None]
    if not has_peak.any() or size < LEAST_WINDOW:
        return block, windows, 0
    axes, window_at = np.nonzero(has_peak)
    samples = rows.reshape(len(rows), -1, size)[axes, window_at]
    median = np.median(samples, axis=1)
    sigma = MAD_TO_SIGMA * np.median(np.abs(samples - median[:, None]), axis=1)
    # a higher threshold if the noise exceeds the noise floor by more than the error of sigma
    has_more_noise = SPIKE_SIGMAS * sigma > (1.0 + 5.0 / np.sqrt(size)) * threshold[axes]
    height = np.where(has_more_noise, SPIKE_SIGMAS * sigma, threshold[axes])
    deviates = np.abs(samples - median[:, None]) > height[:, None]
    are_few = np.count_nonzero(deviates, axis=1) <= 1 + size // LEAST_WINDOW  # else it is a motion
    around = np.concatenate([before, rows, after], axis=1)
    cleaned = rows.copy()
    is_spike = np.zeros(rows.shape, bool)
    for n, k in zip(*np.nonzero(deviates & are_few[:, None])):
        axis, i = axes[n], window_at[n] * size + k
        x, j = around[axis], i + before.shape[1]
        first = max(0, j - SPIKE_NEIGHBORS)
        distance = np.abs(x[first : j + SPIKE_NEIGHBORS + 1] - median[n])
        if _is_isolated(distance > NEIGHBOR_RATIO * height[n], j - first):
            cleaned[axis, i] = 0.5 * (x[j - 1] + x[j + 1])
            is_spike[axis, i] = True
    changed = is_spike.any(axis=0).reshape(-1, size).any(axis=1)
    if not changed.any():
        return block, windows, 0
    cleaned_windows = cleaned.reshape(len(rows), -1, size)[:, changed].reshape(len(rows), -1)
    windows.values[:, :, changed] = Windows.of(cleaned_windows, size).values
    is_spike[floor.heavy] = False
    levels = 0 if block.filled is None else block.filled
    filled = np.where(is_spike, 1, levels).astype(np.int32)
    replaced = np.where(is_spike, cleaned, rows)
    block = ImuBatch.of_rows(block.stamps_ns, replaced, block.cut, filled)
    return block, windows, int(np.count_nonzero(is_spike))


def _is_isolated(far: Flags, at: int) -> bool:
    """Return whether a spike is isolated.

    ``far``, (n,), flags samples that deviate, and ``at`` is the index of the spike. It is isolated
    if it has two direct neighbors, neither of them is flagged, and at most one other sample is
    flagged.
    """
    inside = 0 < at < len(far) - 1
    return inside and not far[at - 1] and not far[at + 1] and int(np.count_nonzero(far)) <= 2


class RestLevel:
    """Means of the last windows at rest in a segment, and numbers of samples in the segment."""

    def __init__(self) -> None:
        self.rest = self.replaced = 0  # numbers of samples at rest, and of replaced samples
        # one more window than is compared: the last window before a motion is not used
        self._means: deque[Floats] = deque(maxlen=LEVEL_WINDOWS + 1)

    def add(self, means: Floats, size: int) -> None:
        """Add the means, (axes, k), of windows of ``size`` samples at rest."""
        self.rest += means.shape[1] * size
        self._means.extend(means[:, -LEVEL_WINDOWS - 1 :].T)

    def before(self) -> Floats:
        """Return the means of the windows before a motion that begins now, (k, axes)."""
        return np.array(list(self._means)[:-1])


class Motion:
    """A motion that begins at the stamp ``began_ns`` in ns, from its windows so far.

    ``kind`` is the kind of its `Event`. ``level`` has the means of the segment before the motion,
    and is None if the motion is known to be no shock.
    """

    def __init__(self, kind: str, began_ns: int, level: RestLevel | None = None) -> None:
        self.kind = kind
        self.began_ns, self.ended_ns = began_ns, began_ns
        self.level = level
        self.windows = 0  # number of all windows
        self.quiet = 0  # number of windows at the end that are quiet (see `WindowClass`)
        self.steady = 0  # number of windows at the end that are quiet or only rotating
        # whether the axes of the accelerometer were exchanged, or changed their signs
        self.axes_changed = False
        # means of the last windows before the motion, (k, axes)
        self.before = level.before() if level is not None else np.empty((0, 0))
        # means of the latest windows of the motion, (axes,) each
        self._after: deque[Floats] = deque(maxlen=LEVEL_WINDOWS)
        self._samples = 0  # number of samples
        self._total: float | Floats = 0.0  # sum of the samples, (axes,)

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
        """Return by how much the motion changed the mean of each axis, (axes,).

        The change is in the unit of the samples. It is 0 if noise explains it, and NaN if the mean
        before or after the motion is not known.
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
        """Return whether this call is the first one that finds changed axes of the sensors.

        The axes changed if gravity has another direction in the steady windows at the end than
        before the motion, although the gyro measured no rotation since the motion began.
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
        """Return the windows of a shock with replaced samples; empty if the motion is no shock.

        ``held`` are the last window before the motion and all windows of the motion. The quiet
        windows at the end, except the first of them, are not replaced.
        """
        if self.level is None or self.change(floor).any():
            return []
        means_after = list(self._after)[1 - self.quiet :]  # of windows that are not replaced
        number = min(len(self.before), len(means_after))
        first, last = (np.mean(w, axis=0) for w in (self.before[-number:], means_after[:number]))
        turned = (self._total - self._samples * first)[floor.gyro] * period_s
        block = joined(held[: 1 - self.quiet])
        n = len(block)
        allowed = REPLACED_SHOCK_SHARE * self.level.rest - self.level.replaced
        if np.linalg.norm(turned) > TURNED or n > allowed:
            return []
        fraction = np.arange(1, n + 1) / (n + 1)
        rows = first[:, None] + (last - first)[:, None] * fraction
        self.level.replaced += n
        levels = np.full(rows.shape, number * floor.size, np.int32)
        return [ImuBatch.of_rows(block.stamps_ns, rows, block.cut, levels), *held[1 - self.quiet :]]
