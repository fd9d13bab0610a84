# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise floor of a sensor at rest, statistics of windows of samples, and isolated spikes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .timing import Block

Floats = NDArray[np.float64]

LEAST_WINDOW = 16
"""Shortest window in samples; the variance of fewer samples is not useful."""

QUANTILE = 0.25
"""The floor is this quantile of the windows' variances: up to three quarters of the windows may be
motion."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal variable over its median absolute value."""

FLOOR_GAIN = 0.25
"""Weight of a new block of still windows when the floor is updated."""

RELEARN_RATIO = 5.0
"""If a block is quieter than the floor by this factor (standard deviation), the floor and the data
so far were taken in motion."""

ROUNDING = 1e-13
"""A deviation below this fraction of the mean is rounding: no sensor has a resolution of 43
bits."""

COLOURED_STEP = 3.0
"""If the steps between window means exceed those of white noise by this factor, the noise is not
white."""

SLOW = 0.2
"""If the ratio (see `smoothness`) is smaller than this, the noise has low frequencies."""

HEAVY_BAND, HEAVY_SHARE, LEAST_HEAVY = (4.5, 7.0), 1.5e-3, 3
"""Noise has heavy tails if this share, and this number, of samples lies in this band of deviations:
the share is 2e-5 in white noise and 7e-3 in a t distribution with three degrees of freedom."""

LOUDER_RATIO = 1.5
"""Smallest ratio of the standard deviation to that of the floor at which an axis counts as
louder."""

LOUDER_SPREAD = 4.0
"""The variances of the windows of stationary noise lie within this factor of their median."""

LOUDER_SPECTRUM = 0.5
"""Smallest ratio of the smoothness (see `smoothness`) of louder noise to that of the floor, or of
white noise. The energy of a motion lies at low frequencies."""

SAME_DIRECTION = 0.035
"""Largest change of gravity, relative to its size, if an IMU did not tilt (2 degrees)."""

SPIKE_SIGMAS = 7.0
"""A sample with this many floor deviations from the mean of its window is a spike if it is
isolated. In white noise these are 1e-10 of the samples, and the variance changes by less than
1e-8."""

SPIKE_NEIGHBORS, NEIGHBOR_RATIO = 4, 0.6
"""A spike is isolated if its direct neighbors, and all but one of this number of samples before and
after it, are closer to the mean than this fraction of the smallest spike. After a knock the sensor
rings, after a spike it does not."""


@dataclass(frozen=True)
class RestLimits:
    """Limits of the slow changes that a sensor can show at rest, (axes,) arrays.

    White noise has no limit: large values indicate another unit, which is reported elsewhere.
    """

    deviation: Floats  # standard deviation within a window of noise at low frequencies
    # of the step between the means of neighboring windows, if larger than that of white noise
    step: Floats
    turn: Floats  # of the change of the mean rate from its value at rest
    gravity: NDArray[np.bool_]  # the axes that measure gravity

    @classmethod
    def of(cls, axes: tuple[str, ...], rate_limit: float) -> RestLimits:
        """Return the limits in rad/s and m/s^2, above the values of any IMU at rest."""
        gyro = np.array([axis.startswith('gyro') for axis in axes])
        turn = np.where(gyro, rate_limit, np.inf)
        return cls(np.where(gyro, 0.1, 1.5), np.where(gyro, 0.0087, 0.15), turn, ~gyro)


@dataclass(frozen=True)
class Windows:
    """Mean, variance and largest deviation of k windows: values, (3, axes, k)."""

    values: Floats

    mean = property(lambda self: self.values[0])
    variance = property(lambda self: self.values[1])
    peak = property(lambda self: self.values[2])

    @classmethod
    def of(cls, rows: Floats, size: int) -> Windows:
        """Measure windows of ``size`` samples; rows is (axes, k * size)."""
        cube = rows.reshape(len(rows), -1, size)
        mean = np.add.reduce(cube, axis=2) / size
        # rounding keeps the order, so the most distant sample is the largest or the smallest one
        peak = np.maximum(cube.max(axis=2) - mean, mean - cube.min(axis=2))
        from_mean = cube - mean[:, :, None]
        variance = np.einsum('ijk,ijk->ij', from_mean, from_mean) / max(size - 1, 1)
        # the variance of constant samples is 0, whatever the rounding of their mean leaves
        variance[variance <= (ROUNDING * mean) ** 2] = 0.0
        return cls(np.stack([mean, variance, peak]))

    def __getitem__(self, which: slice | NDArray[np.bool_]) -> Windows:
        """Return some of the windows."""
        return Windows(self.values[:, :, which])

    @classmethod
    def joined(cls, parts: Iterable[Windows]) -> Windows:
        """Return the windows of all parts."""
        return cls(np.concatenate([part.values for part in parts], axis=2))


def smoothness(stretches: Iterable[Floats]) -> Floats:
    """Return the von Neumann ratio per axis: 1 for white noise, near 0 for slow motion.

    The ratio is half the mean square of the differences between neighboring samples, divided by the
    variance about the mean of each stretch, (axes, n). It is NaN if the samples are constant.
    """
    stretches = list(stretches)
    differences = sum((np.diff(rows, axis=1) ** 2).sum(axis=1) for rows in stretches)
    deviations = sum(rows.var(axis=1) * rows.shape[1] for rows in stretches)
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(0.5 * np.asarray(differences) / deviations)


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of a sensor at rest, (axes,) arrays in the unit of the samples (squared).

    It is learned in windows of ``size`` samples.
    """

    variance: Floats  # about the mean of a still window
    step: Floats  # standard deviation of the step between the means of neighboring windows
    mean: Floats
    lsb: Floats  # smallest change between two samples: the resolution of the sensor, or less
    smooth: Floats  # `smoothness` of the samples
    # whether the samples have heavy tails: single large values are noise, not spikes
    heavy: NDArray[np.bool_]
    size: int
    limits: RestLimits

    @classmethod
    def learned(cls, stretches: Iterable[Floats], size: int, limits: RestLimits) -> NoiseFloor:
        """Learn from the first samples, (axes, n) each."""
        stretches = list(stretches)
        measured: list[Windows] = []
        steps: list[Floats] = []
        axes = len(limits.turn)
        lsb = np.full(axes, np.inf)
        for rows in stretches:
            window = min(size, rows.shape[1])
            if window < 2:
                continue
            measured.append(Windows.of(rows[:, : rows.shape[1] // window * window], window))
            steps.append(np.abs(np.diff(measured[-1].mean, axis=1)))
            change = np.abs(np.diff(rows, axis=1))
            lsb = np.minimum(lsb, np.where(change > 0.0, change, np.inf).min(axis=1))
        lsb[~np.isfinite(lsb)] = 0.0
        zero = np.zeros(axes)
        if not measured:
            unknown = np.full(axes, np.nan)
            return cls(zero, zero, zero, lsb, unknown, zero > 0.0, size, limits)
        windows, step = Windows.joined(measured), np.concatenate(steps, axis=1)
        variance = _quantile(windows.variance, QUANTILE)
        scale = np.maximum(variance, 0.25 * lsb**2)
        return cls(
            variance,
            MAD_TO_SIGMA * _quantile(step, 0.5) if step.size else zero,
            _quantile(windows.mean, 0.5),
            lsb,
            smoothness(stretches),
            _have_heavy_tails(stretches, size, np.sqrt(scale)),
            size,
            limits,
        )

    @property
    def scale(self) -> Floats:
        """Variance whose multiples are the thresholds, (axes,), at least that of rounding."""
        return np.maximum(self.variance, 0.25 * self.lsb**2)

    def can_be_rest(self) -> bool:
        """Return whether this can be the floor of a sensor at rest."""
        white = np.sqrt(2.0 / self.size) * np.sqrt(self.scale)
        steps = (self.step > self.limits.step) & (self.step > COLOURED_STEP * white)
        swings = (self.variance > self.limits.deviation**2) & (self.smooth < SLOW)
        return not bool((steps | swings).any())

    def if_learned_in_motion(self, block: Windows) -> NoiseFloor | None:
        """Return the floor of a block if it is far quieter than this floor; else None."""
        # an axis that repeats one value has no noise to compare
        quiet = _quantile(block.variance, QUANTILE)
        quiet = np.where(quiet > 0.0, quiet, self.variance)
        if (quiet > self.variance / RELEARN_RATIO**2).all():
            return None  # the common case: the scale of no axis is lower, either
        new = replace(self, variance=quiet)
        if not (RELEARN_RATIO**2 * new.scale < self.scale).any():
            return None
        at_rest = (block.variance <= 2.0 * quiet[:, None]).all(axis=0)
        steps = np.abs(np.diff(block.mean, axis=1))
        mean = block.mean[:, at_rest] if at_rest.any() else block.mean
        return replace(
            new, step=MAD_TO_SIGMA * _quantile(steps, QUANTILE), mean=_quantile(mean, 0.5)
        )

    def following(self, block: Windows, still: NDArray[np.bool_], turning: bool) -> NoiseFloor:
        """Return the floor after a block of windows, some of which, (k,), were ``still``.

        ``turning`` is whether only the mean rate differed from the floor, in all windows.
        """
        if np.count_nonzero(still) >= len(still) // 2:
            rest = block if still.all() else block[still]
            recent = _quantile(rest.variance, QUANTILE)
            variance = self.variance + FLOOR_GAIN * (recent - self.variance)
            return replace(self, variance=variance, mean=_quantile(rest.mean, 0.5))
        if turning:
            # a steady rate during a whole block is a bias that changed suddenly, or was learned in
            # a turn
            return replace(self, mean=_quantile(block.mean, 0.5))
        return self

    def louder(self, rows: Floats, block: Windows) -> Floats | None:
        """Return the ratio of the noise of a block at rest to the floor, (axes,); None in motion.

        Louder noise is stationary, has a spectrum as broad as that of the floor or of white noise,
        and does not change the mean rate and the direction of gravity. The samples of the block are
        ``rows``, (axes, n).
        """
        level = _quantile(block.variance, 0.5)
        scale = self.scale
        with np.errstate(invalid='ignore', divide='ignore'):
            ratio = np.sqrt(level / scale)
        ratio[scale == 0.0] = 1.0
        louder = ratio > LOUDER_RATIO
        if not louder.any() or not np.isfinite(ratio).all():
            return None
        within = block.variance <= LOUDER_SPREAD * level[:, None]
        within &= LOUDER_SPREAD * block.variance >= level[:, None]
        if (within[louder].mean(axis=1) < 0.9).any():
            return None
        least = LOUDER_SPECTRUM * np.fmin(self.smooth, 1.0)
        if (smoothness([rows])[louder] < least[louder]).any():
            return None
        sigma = np.sqrt(np.maximum(level, scale))
        white = np.sqrt(2.0 / self.size) * sigma
        steps = np.abs(np.diff(block.mean, axis=1))
        least_step = COLOURED_STEP * np.maximum(white, self.step)
        if (MAD_TO_SIGMA * _quantile(steps, 0.5) > least_step).any():
            return None
        moved = np.abs(_quantile(block.mean, 0.5) - self.mean)
        vertical = self.limits.gravity
        gravity = float(np.linalg.norm(self.mean[vertical]))
        allowed = np.where(vertical, SAME_DIRECTION * gravity, self.limits.turn) + white
        return None if (moved > allowed).any() else ratio


def _have_heavy_tails(stretches: list[Floats], size: int, sigma: Floats) -> NDArray[np.bool_]:
    """Return which axes have many values just below the threshold of spikes, (axes,)."""
    low, high = (factor * sigma[:, None, None] for factor in HEAVY_BAND)
    inside, samples = np.zeros(len(sigma), np.int64), 0
    for rows in stretches:
        window = max(min(size, rows.shape[1]), 1)
        cube = rows[:, : rows.shape[1] // window * window].reshape(len(rows), -1, window)
        off = np.abs(cube - np.median(cube, axis=2, keepdims=True))
        inside += np.count_nonzero((off > low) & (off < high), axis=(1, 2))
        samples += rows.shape[1]
    return np.asarray(inside >= max(LEAST_HEAVY, HEAVY_SHARE * samples))


def _quantile(values: Floats, share: float) -> Floats:
    """Return the lower quantile of each row: one of its values, found without interpolation."""
    k = int(share * (values.shape[1] - 1))
    return np.asarray(np.partition(values, k, axis=1)[:, k])


def without_spikes(
    block: Block, size: int, before: Floats, after: Floats, floor: NoiseFloor
) -> tuple[Block, Windows, int]:
    """Replace isolated spikes in windows of ``size`` samples by the mean of their neighbors.

    Spikes of axes whose noise has heavy tails stay in the block, but not in the windows. The
    arguments ``before`` and ``after`` are up to `SPIKE_NEIGHBORS` samples next to the block. The
    result is the block, its windows, and the number of values that were replaced.
    """
    rows = block.rows
    windows = Windows.of(rows, size)
    least = SPIKE_SIGMAS * np.sqrt(floor.scale)
    flagged = (windows.peak > least[:, None]) & (least > 0.0)[:, None]
    if not flagged.any() or size < LEAST_WINDOW:
        return block, windows, 0
    axes, at = np.nonzero(flagged)
    cube = rows.reshape(len(rows), -1, size)[axes, at]
    level = np.median(cube, axis=1)
    sigma = MAD_TO_SIGMA * np.median(np.abs(cube - level[:, None]), axis=1)
    # where the noise itself became louder, by more than the scatter of the estimate
    louder = SPIKE_SIGMAS * sigma > (1.0 + 5.0 / np.sqrt(size)) * least[axes]
    height = np.where(louder, SPIKE_SIGMAS * sigma, least[axes])
    far = np.abs(cube - level[:, None]) > height[:, None]
    few = np.count_nonzero(far, axis=1) <= 1 + size // LEAST_WINDOW  # more than this are a motion
    around = np.concatenate([before, rows, after], axis=1)
    judged = rows.copy()
    found = np.zeros(rows.shape, bool)
    for n, k in zip(*np.nonzero(far & few[:, None])):
        axis, i = axes[n], at[n] * size + k
        x, j = around[axis], i + before.shape[1]
        first = max(0, j - SPIKE_NEIGHBORS)
        near = np.abs(x[first : j + SPIKE_NEIGHBORS + 1] - level[n])
        if _is_isolated(near > NEIGHBOR_RATIO * height[n], j - first):
            judged[axis, i] = 0.5 * (x[j - 1] + x[j + 1])
            found[axis, i] = True
    changed = found.any(axis=0).reshape(-1, size).any(axis=1)
    if not changed.any():
        return block, windows, 0
    some = judged.reshape(len(rows), -1, size)[:, changed].reshape(len(rows), -1)
    windows.values[:, :, changed] = Windows.of(some, size).values
    found[floor.heavy] = False
    filled = found if block.filled is None else block.filled | found
    replaced = np.where(found, judged, rows)
    return Block(block.stamps, replaced, block.cut, filled), windows, int(np.count_nonzero(found))


def _is_isolated(far: NDArray[np.bool_], at: int) -> bool:
    """Return whether at most one other sample is far from the level, and none is next to an
    index."""
    inside = 0 < at < len(far) - 1
    return inside and not far[at - 1] and not far[at + 1] and int(np.count_nonzero(far)) <= 2
