# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise of a still sensor, and the windows of samples that are held against it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


QUIET = 0.25
"""The floor is this quantile of the windows' variances: three quarters of them may be motion."""


MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal variable over its median absolute value."""


FLOOR_GAIN = 0.25
"""Share by which the floor follows a block of still windows."""


RELEARN_RATIO = 5.0
"""When a block is quieter than the floor by this factor (standard deviation), the floor had been
learned in motion: what was taken for evidence is none."""


ROUNDING = 1e-13
"""A deviation below this share of the mean is rounding: no sensor resolves 43 bits."""


@dataclass(frozen=True)
class Windows:
    """Statistics of k windows; (axes, k) arrays of the samples' unit."""

    mean: Floats
    variance: Floats
    peak: Floats

    @classmethod
    def of(cls, rows: Floats, size: int) -> Windows:
        """Measure windows of ``size`` samples; rows is (axes, k * size)."""
        cube = rows.reshape(len(rows), -1, size)
        mean = np.add.reduce(cube, axis=2) / size
        # rounding keeps the order, so the farthest sample is the largest or the smallest one
        peak = np.maximum(cube.max(axis=2) - mean, mean - cube.min(axis=2))
        from_mean = cube - mean[:, :, None]
        variance = np.einsum('ijk,ijk->ij', from_mean, from_mean) / max(size - 1, 1)
        # one value throughout has no variance, whatever the rounding of its mean leaves
        variance[variance <= (ROUNDING * mean) ** 2] = 0.0
        return cls(mean, variance, peak)

    def __getitem__(self, which: slice | NDArray[np.bool_]) -> Windows:
        """Return some of the windows."""
        return Windows(self.mean[:, which], self.variance[:, which], self.peak[:, which])

    @classmethod
    def joined(cls, parts: Iterable[Windows]) -> Windows:
        """Return windows that follow on each other as one."""
        parts = list(parts)
        if len(parts) == 1:
            return parts[0]
        columns = zip(*((p.mean, p.variance, p.peak) for p in parts))
        return cls(*(np.concatenate(arrays, axis=1) for arrays in columns))


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of a still sensor, per axis, in the unit of the samples (squared).

    Attributes
    ----------
    variance : (axes,) float64 array
        Of the samples of a window about their mean.
    step : (axes,) float64 array
        Standard deviation of the step between the means of neighbouring windows.
    mean : (axes,) float64 array
        Of a still window.
    lsb : (axes,) float64 array
        Smallest change between two samples: the last bit of the sensor, or less.
    """

    variance: Floats
    step: Floats
    mean: Floats
    lsb: Floats

    @classmethod
    def learned(cls, stretches: Iterable[Floats], size: int, axes: int) -> NoiseFloor:
        """Learn from the first samples, (axes, n) each, in windows of ``size`` samples."""
        measured: list[Windows] = []
        steps: list[Floats] = []
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
            return cls(zero, zero, zero, lsb)
        windows, step = Windows.joined(measured), np.concatenate(steps, axis=1)
        return cls(
            _quantile(windows.variance, QUIET),
            MAD_TO_SIGMA * _quantile(step, 0.5) if step.size else zero,
            _quantile(windows.mean, 0.5),
            lsb,
        )

    @property
    def scale(self) -> Floats:
        """Variance that thresholds are multiples of, (axes,): never below that of rounding.

        Where noise is below the last bit, single flips of it are honest (LSB^2/4 at most).
        """
        return np.maximum(self.variance, 0.25 * self.lsb**2)

    def if_learned_in_motion(self, block: Windows) -> NoiseFloor | None:
        """Return the floor of a block that is far quieter than this floor; None if it is not."""
        # an axis that is stuck says nothing of its noise
        quiet = _quantile(block.variance, QUIET)
        quiet = np.where(quiet > 0.0, quiet, self.variance)
        if (quiet > self.variance / RELEARN_RATIO**2).all():
            return None  # the common case: no scale is below, either
        new = replace(self, variance=quiet)
        if not (RELEARN_RATIO**2 * new.scale < self.scale).any():
            return None
        at_rest = (block.variance <= 2.0 * quiet[:, None]).all(axis=0)
        steps = np.abs(np.diff(block.mean, axis=1))
        mean = block.mean[:, at_rest] if at_rest.any() else block.mean
        return replace(new, step=MAD_TO_SIGMA * _quantile(steps, QUIET), mean=_quantile(mean, 0.5))

    def following(self, block: Windows, still: NDArray[np.bool_], turning: bool) -> NoiseFloor:
        """Return the floor after a block of windows.

        Parameters
        ----------
        block : Windows
        still : (k,) bool array
            Which of them were still.
        turning : bool
            Nothing stood out in any of them but the mean rate.
        """
        if np.count_nonzero(still) >= len(still) // 2:
            rest = block if still.all() else block[still]
            recent = _quantile(rest.variance, QUIET)
            variance = self.variance + FLOOR_GAIN * (recent - self.variance)
            return NoiseFloor(variance, self.step, _quantile(rest.mean, 0.5), self.lsb)
        if turning:
            # a steady rate for a whole block is a bias that jumped, or was learned in a turn
            return replace(self, mean=_quantile(block.mean, 0.5))
        return self


def _quantile(values: Floats, share: float) -> Floats:
    """Return the lower quantile of each row: a value that is there, found without interpolation."""
    k = int(share * (values.shape[1] - 1))
    found: Floats = np.partition(values, k, axis=1)[:, k]
    return found
