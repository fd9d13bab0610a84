# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a window of samples is, held against the noise floor: still, in motion, or stuck."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .noise_floor import NoiseFloor, Windows

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LEAST_WINDOW = 16
"""Samples from which the variance of a window says something."""

LEAVE_SHARE = 0.8
"""Motion ends below this share of the standard deviation at which it begins."""

PEAK_SIGMAS = 20.0
"""A sample this many floor deviations from its window's mean is a knock. Real accelerometers at
rest show single samples at 10 deviations every few minutes: those are their noise."""

STEP_SIGMAS = 8.0
"""Means of neighbouring windows this many of their own deviations apart are a motion."""


class Verdict(NamedTuple):
    """What k windows are, (k,) bool arrays.

    ``hot``: motion, or an axis ``stuck`` at one value. ``calm``: may end a motion.
    ``turning_only``: nothing stands out but the mean rate.
    """

    hot: Flags
    calm: Flags
    stuck: Flags
    turning_only: Flags


class _Limits(NamedTuple):
    """Where a window begins to stand out, (axes, 1) arrays; infinite where the floor is unknown."""

    variance: Floats
    peak: Floats
    step: Floats
    turn: Floats

    @classmethod
    def of(cls, floor: NoiseFloor, size: int, motion_ratio: float, rate_limit: Floats) -> _Limits:
        scale, lsb = floor.scale[:, None], floor.lsb[:, None]
        unknown = np.where(scale > 0.0, 0.0, np.inf)
        sigma = np.sqrt(scale)
        step_sigma = np.maximum(np.sqrt(2.0 / size) * sigma, floor.step[:, None])
        # few samples spread a variance: a short window is judged by its farthest sample alone
        unsure = unknown if size >= LEAST_WINDOW else np.full_like(unknown, np.inf)
        return cls(
            motion_ratio**2 * scale + unsure,
            np.maximum(PEAK_SIGMAS * sigma, 2.5 * lsb) + unknown,
            STEP_SIGMAS * step_sigma + lsb + unsure,
            np.maximum(rate_limit[:, None], STEP_SIGMAS * step_sigma),
        )


def judge_windows(
    windows: Windows,
    previous_mean: Floats | None,
    size: int,
    floor: NoiseFloor,
    motion_ratio: float,
    rate_limit: Floats,
) -> Verdict:
    """Hold windows of ``size`` samples against the floor.

    Parameters
    ----------
    previous_mean : (axes,) array or None
        Of the window before the first; None when it does not follow on any.
    motion_ratio : float
        Standard deviation of a moving window over that of the floor.
    rate_limit : (axes,) array
        Least mean rate, away from the still one, that is a turn.
    """
    limits = _Limits.of(floor, size, motion_ratio, rate_limit)
    previous = windows.mean[:, :1] if previous_mean is None else previous_mean[:, None]
    means = np.concatenate([previous, windows.mean], axis=1)
    step = np.abs(means[:, 1:] - means[:, :-1])
    restless = windows.variance > LEAVE_SHARE**2 * limits.variance
    knocked = (windows.peak > limits.peak) | (step > limits.step)
    turning = np.abs(windows.mean - floor.mean[:, None]) > limits.turn
    quiet = np.zeros(windows.mean.shape[1], bool)
    if windows.variance.all() and not (restless | knocked | turning).any():
        return Verdict(quiet, ~quiet, quiet, quiet)  # the common case: an IMU at rest
    noisy = (floor.variance > floor.lsb**2)[:, None] & (size >= LEAST_WINDOW)
    stuck = ((windows.variance == 0.0) & noisy).any(axis=0)
    wild = windows.variance > limits.variance
    hot = (wild | knocked | turning).any(axis=0) | stuck
    restless_any = (restless | knocked).any(axis=0) | stuck
    return Verdict(hot, ~(hot | restless_any), stuck, turning.any(axis=0) & ~restless_any)


def saturated(rows: Floats) -> int:
    """Return how many samples of a moving window stand at their axis' extreme, three in a row."""
    size = np.abs(rows)
    top = size == size.max(axis=1, keepdims=True)
    three = top[:, 2:] & top[:, 1:-1] & top[:, :-2]
    inside = np.zeros(rows.shape[1], bool)
    for axis in np.flatnonzero(three.any(axis=1) & (rows.min(axis=1) < rows.max(axis=1))):
        for shift in range(3):
            inside[shift : shift + three.shape[1]] |= three[axis]
    return int(np.count_nonzero(inside))
