# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates the noise of a sensor at rest from the statistics of short windows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LEAST_WINDOW = 16
"""Shortest window in samples; the variance of fewer samples is not useful."""

QUANTILE = 0.25
"""The noise floor is this quantile of the variances of the windows. So up to three quarters of the
windows may contain motion."""

MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation of a zero-mean normal variable to the median of its absolute
value."""

FLOOR_GAIN = 0.25
"""Weight of a new block of still windows when the noise floor is updated."""

RELEARN_RATIO = 5.0
"""If the standard deviation of a block is smaller than the noise floor by this factor, the floor
was learned in motion, and all data so far are discarded."""

ROUNDING = 1e-13
"""A standard deviation below this fraction of the mean is a rounding error: no sensor has a
resolution of 43 bits."""

COLORED_STEP = 3.0
"""If the steps between window means exceed those of white noise by this factor, the noise is not
white."""

LOW_FREQUENCY = 0.2
"""Below this von Neumann ratio, low frequencies dominate the noise."""

OUTLIER_MADS = 6.0
"""An outlier deviates from the median of its window by more than this number of median absolute
deviations (four standard deviations of white noise)."""

HEAVY_SHARE, LEAST_HEAVY = 5e-3, 3
"""Noise has heavy tails if this share of the samples, and at least this number, are outliers. The
share is 5e-5 for white noise, and 7e-3 for a t distribution with five degrees of freedom."""

EXAMINED = 16
"""One of this number of windows at rest is searched for outliers, to save time."""

MEMORY = 2.0**20
"""Number of samples from which the share of outliers is computed; older ones lose weight."""

INCREASE_RATIO = 1.5
"""Ratio of the standard deviation of an axis to its noise floor above which the noise counts as
increased."""

INCREASE_SPREAD = 4.0
"""The variances of the windows of stationary noise lie within this factor of their median."""

INCREASE_SPECTRUM = 0.5
"""The von Neumann ratio of increased noise is at least this fraction of that of the noise floor (or
of white noise, if that is smaller). Motion has a smaller ratio, because it has low frequencies."""

SAME_DIRECTION = 0.035
"""Largest change of the measured gravity vector, relative to its magnitude, of an IMU that did not
tilt (2 degrees)."""


@dataclass(frozen=True)
class RestLimits:
    """Limits that a sensor at rest does not exceed, (axes,) arrays in rad/s and m/s^2.

    White noise has no limit, because an implausibly high level is due to a wrong unit, not motion.
    """

    deviation: Floats  # standard deviation within a window, if low frequencies dominate
    # step between the means of neighboring windows, if larger than that of white noise
    step: Floats
    rate: Floats  # deviation of the mean angular rate from its value at rest; infinite for accel
    gravity: Flags  # whether the axis measures gravity

    @classmethod
    def of(cls, axes: tuple[str, ...], rate_limit: float) -> RestLimits:
        """Return limits above the values of any IMU at rest; ``rate_limit`` is in rad/s."""
        gyro = np.array([axis.startswith('gyro') for axis in axes])
        rate = np.where(gyro, rate_limit, np.inf)
        return cls(np.where(gyro, 0.1, 1.5), np.where(gyro, 0.0087, 0.15), rate, ~gyro)


@dataclass(frozen=True)
class Windows:
    """Mean, variance and largest absolute deviation of k windows: ``values``, (3, axes, k)."""

    values: Floats

    mean = property(lambda self: self.values[0])
    variance = property(lambda self: self.values[1])
    peak = property(lambda self: self.values[2])

    @classmethod
    def of(cls, rows: Floats, size: int) -> Windows:
        """Compute the statistics of windows of ``size`` samples; rows is (axes, k * size)."""
        cube = rows.reshape(len(rows), -1, size)
        mean = np.add.reduce(cube, axis=2) / size
        # the sample with the largest deviation is the largest or the smallest one
        peak = np.maximum(cube.max(axis=2) - mean, mean - cube.min(axis=2))
        from_mean = cube - mean[:, :, None]
        variance = np.einsum('ijk,ijk->ij', from_mean, from_mean) / max(size - 1, 1)
        # the variance of constant samples is 0, but rounding of their mean makes it positive
        variance[variance <= (ROUNDING * mean) ** 2] = 0.0
        return cls(np.stack([mean, variance, peak]))

    def __getitem__(self, which: slice | Flags) -> Windows:
        """Return the windows selected by a slice or a mask (k,)."""
        return Windows(self.values[:, :, which])

    @classmethod
    def joined(cls, parts: Iterable[Windows]) -> Windows:
        """Concatenate the windows of all parts, at least one."""
        return cls(np.concatenate([part.values for part in parts], axis=2))


def von_neumann_ratio(parts: Iterable[Floats]) -> Floats:
    """Return the von Neumann ratio per axis, (axes,): 1 for white noise, near 0 for slow motion.

    It is half the mean square of the differences between neighboring samples, divided by the
    variance. Each part, (axes, n), is a sequence of samples without a gap. The ratio is NaN if the
    samples are constant. Source: J. von Neumann, Annals of Mathematical Statistics 12 (1941), 367.
    """
    parts = list(parts)
    differences = sum((np.diff(rows, axis=1) ** 2).sum(axis=1) for rows in parts)
    deviations = sum(rows.var(axis=1) * rows.shape[1] for rows in parts)
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(0.5 * np.asarray(differences) / deviations)


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of a sensor at rest, estimated from windows of ``size`` samples.

    The arrays are (axes,), in the unit of the samples.
    """

    variance: Floats  # about the mean of a still window, in the squared unit
    step: Floats  # standard deviation of the step between the means of neighboring windows
    mean: Floats
    lsb: Floats  # smallest change between two samples: at most the resolution of the sensor
    ratio: Floats  # von Neumann ratio of the samples
    size: int
    limits: RestLimits
    # outliers among the samples that were searched for them: number of each axis, and of samples
    outliers: Floats
    examined: float

    @classmethod
    def learned(cls, parts: Iterable[Floats], size: int, limits: RestLimits) -> NoiseFloor:
        """Return the noise floor of the first samples; a quarter of them should be at rest.

        Each part, (axes, n), is a sequence of samples without a gap.
        """
        parts = list(parts)
        measured: list[Windows] = []
        steps: list[Floats] = []
        axes = len(limits.rate)
        lsb = np.full(axes, np.inf)
        for rows in parts:
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
            return cls(zero, zero, zero, lsb, unknown, size, limits, zero, 0.0)
        windows, step = Windows.joined(measured), np.concatenate(steps, axis=1)
        return cls(
            _quantile(windows.variance, QUANTILE),
            MAD_TO_SIGMA * _quantile(step, 0.5) if step.size else zero,
            _quantile(windows.mean, 0.5),
            lsb,
            von_neumann_ratio(parts),
            size,
            limits,
            zero,
            0.0,
        )

    @property
    def heavy(self) -> Flags:
        """Which axes have heavy tails, (axes,): their single large values are noise, not spikes."""
        return np.asarray(self.outliers >= max(LEAST_HEAVY, HEAVY_SHARE * self.examined))

    def with_outliers(self, rows: Floats) -> NoiseFloor:
        """Return the noise floor after the search for outliers in k windows, (axes, k * size)."""
        if not rows.size:
            return self
        cube = rows.reshape(len(rows), -1, self.size)
        off = np.abs(cube - _quantile(cube, 0.5)[:, :, None]).reshape(len(rows), -1)
        # half a resolution more, because the deviations are rounded
        limit = OUTLIER_MADS * (_quantile(off, 0.5) + 0.5 * self.lsb)
        found = np.count_nonzero(off > limit[:, None], axis=1)
        kept = max(0.0, 1.0 - off.shape[1] / MEMORY) if self.examined >= MEMORY else 1.0
        return replace(
            self,
            outliers=kept * self.outliers + found,
            examined=kept * self.examined + off.shape[1],
        )

    @property
    def scale(self) -> Floats:
        """Variance from which the thresholds are computed, (axes,): at least (lsb / 2)^2."""
        return np.maximum(self.variance, 0.25 * self.lsb**2)

    def is_plausible(self) -> bool:
        """Return whether a sensor at rest can have this noise; if not, it moved."""
        white = np.sqrt(2.0 / self.size) * np.sqrt(self.scale)
        steps = (self.step > self.limits.step) & (self.step > COLORED_STEP * white)
        slow = (self.variance > self.limits.deviation**2) & (self.ratio < LOW_FREQUENCY)
        return not bool((steps | slow).any())

    def replacement(self, block: Windows) -> NoiseFloor | None:
        """Return the noise floor of a block if it is lower by `RELEARN_RATIO`, else None.

        A much lower floor means that the sensor moved when this one was learned.
        """
        # an axis that repeats one value has no noise to compare
        quiet = _quantile(block.variance, QUANTILE)
        quiet = np.where(quiet > 0.0, quiet, self.variance)
        if (quiet > self.variance / RELEARN_RATIO**2).all():
            return None  # the common case
        new = replace(self, variance=quiet)
        if not (RELEARN_RATIO**2 * new.scale < self.scale).any():
            return None
        at_rest = (block.variance <= 2.0 * quiet[:, None]).all(axis=0)
        steps = np.abs(np.diff(block.mean, axis=1))
        mean = block.mean[:, at_rest] if at_rest.any() else block.mean
        return replace(
            new,
            step=MAD_TO_SIGMA * _quantile(steps, QUANTILE),
            mean=_quantile(mean, 0.5),
            outliers=np.zeros(len(quiet)),
            examined=0.0,
        )

    def updated(self, block: Windows, still: Flags, rotating: bool) -> NoiseFloor:
        """Return the noise floor updated by a block of k windows.

        ``still``, (k,), flags windows at rest, of which half are needed. If all windows differ from
        the floor only in their mean angular rate (``rotating``), only the mean is updated.
        """
        if np.count_nonzero(still) >= len(still) // 2:
            rest = block if still.all() else block[still]
            recent = _quantile(rest.variance, QUANTILE)
            variance = self.variance + FLOOR_GAIN * (recent - self.variance)
            return replace(self, variance=variance, mean=_quantile(rest.mean, 0.5))
        if rotating:
            # a constant rate during a complete block is a bias that changed suddenly, or that was
            # learned during a rotation
            return replace(self, mean=_quantile(block.mean, 0.5))
        return self

    def increase(self, rows: Floats, block: Windows) -> Floats | None:
        """Return the ratio of the noise of a block at rest to the noise floor, (axes,).

        ``rows``, (axes, n), are the samples of the block, and ``block`` their windows. Returns None
        if the noise has not increased, or if the sensor moves. It is at rest if the noise is
        stationary with a spectrum as broad as that of the floor or of white noise, and if neither
        the mean rate nor the direction of gravity changes.
        """
        level = _quantile(block.variance, 0.5)
        scale = self.scale
        with np.errstate(invalid='ignore', divide='ignore'):
            ratio = np.sqrt(level / scale)
        ratio[scale == 0.0] = 1.0
        increased = ratio > INCREASE_RATIO
        if not increased.any() or not np.isfinite(ratio).all():
            return None
        within = block.variance <= INCREASE_SPREAD * level[:, None]
        within &= INCREASE_SPREAD * block.variance >= level[:, None]
        if (within[increased].mean(axis=1) < 0.9).any():
            return None
        smallest_ratio = INCREASE_SPECTRUM * np.fmin(self.ratio, 1.0)
        if (von_neumann_ratio([rows])[increased] < smallest_ratio[increased]).any():
            return None
        sigma = np.sqrt(np.maximum(level, scale))
        white = np.sqrt(2.0 / self.size) * sigma
        steps = np.abs(np.diff(block.mean, axis=1))
        largest_step = COLORED_STEP * np.maximum(white, self.step)
        if (MAD_TO_SIGMA * _quantile(steps, 0.5) > largest_step).any():
            return None
        change = np.abs(_quantile(block.mean, 0.5) - self.mean)
        accel = self.limits.gravity
        gravity = float(np.linalg.norm(self.mean[accel]))
        allowed = np.where(accel, SAME_DIRECTION * gravity, self.limits.rate) + white
        return None if (change > allowed).any() else ratio


def _quantile(values: Floats, share: float) -> Floats:
    """Return a quantile over the last dimension without interpolation (the lower value)."""
    k = int(share * (values.shape[-1] - 1))
    return np.asarray(np.partition(values, k, axis=-1)[..., k])
