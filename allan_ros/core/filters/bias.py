# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bias of a sensor at rest: value, interval, and how long it stays within a tolerance.

The bias is the mean of the samples over the next 10 s without their white noise. A Kalman filter
with the states of the process model estimates it from means over 1 s.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..deferred import special
from ..errors import AllanError
from ..fit.model import Z_95, AxisFit
from ..noise import ProcessModel
from .growth import drift_model, expected_model, predicted_growth
from .reductions import state_space

Floats = NDArray[np.float64]

MEAN_S = 1.0
"""Length in s of the means that are the input of the filter."""

AHEAD_S = 10.0
"""Time in s over which the bias is averaged."""

LONGEST_S = 1e6
"""Longest time in s over which a bias is predicted."""

KEPT_MEANS = 600
"""Number of means of an axis that are kept to initialize a changed model."""


@dataclass(frozen=True)
class TurnOnBias:
    """Repeatability of the bias of one axis from one recording to the next.

    Attributes
    ----------
    recordings : int
        Number of recordings.
    mean, std : float
        Mean and standard deviation of the means of the recordings, in the unit of the samples.
    ci95 : (low, high)
        Interval of ``std``, for normally distributed means.
    """

    recordings: int
    mean: float
    std: float
    ci95: tuple[float, float]


def turn_on_bias(means: Floats) -> TurnOnBias | None:
    """Return the scatter of the means of recordings, (recordings,); None for fewer than two."""
    free = len(means) - 1
    if free < 1:
        return None
    std = float(np.std(means, ddof=1))
    low, high = (
        std * math.sqrt(free / quantile) for quantile in special.chdtri(free, [0.025, 0.975])
    )
    return TurnOnBias(len(means), float(np.mean(means)), std, (low, high))


@dataclass(frozen=True)
class BiasEstimate:
    """The bias of one axis, in the unit of the samples, with its standard deviation."""

    value: float
    std: float

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the bias."""
        half = Z_95 * self.std
        return self.value - half, self.value + half


class BiasModel(NamedTuple):
    """Prior model of the bias of one axis: random processes and a constant slope."""

    processes: ProcessModel
    slope_std: float = 0.0  # standard deviation of a constant slope of the bias, per s; 0 for none

    @classmethod
    def of_fit(cls, fit: AxisFit) -> BiasModel:
        """Return the `expected_model` of a fit with the root mean square of the ramps that the fit
        allows.

        A ramp that a record cannot resolve still moves the bias in the next minutes. Without this
        ramp, the 95 % interval of the bias 10 min ahead has a coverage of 89 to 93 % for the
        sensors of table 1.
        """
        ramp = fit.noise['R']
        value, limit = abs(ramp.value or 0.0), ramp.upper95 or 0.0
        if ramp.status == 'estimated':
            low, high = ramp.ci95 or (0.0, 2e3 * Z_95 * value)  # no interval: a vague prior
            error = (high - low) / (2.0 * Z_95)
        else:
            error = max(limit - value, 0.0) / Z_95
        std = math.hypot(value, error)
        return cls(expected_model(fit), std if math.isfinite(std) else 0.0)


class BiasFilter:
    """Kalman filter for the bias of one axis at rest.

    Parameters
    ----------
    model : BiasModel
    period : float
        Averaging time of each mean in s; the means follow each other without gaps.

    Examples
    --------
    >>> from allan_ros.core.noise import NoiseTerms
    >>> bias = BiasFilter(BiasModel(ProcessModel(NoiseTerms(N=0.1))))
    >>> for mean in (1.0, 1.2, 0.8, 1.0):
    ...     bias.update(mean)
    >>> estimate = bias.estimate()
    >>> round(estimate.value, 3), round(estimate.std, 3)
    (1.0, 0.05)
    """

    def __init__(self, model: BiasModel, period: float = MEAN_S) -> None:
        space = state_space(drift_model(model.processes))
        if not space.white and not space.walk:
            # without any noise, the variance of the walk would become 0
            space = replace(space, white=1e-12)
        self._space = replace(space, slope=bool(model.slope_std))
        self._slope_std = model.slope_std
        self.period = period
        self._phi, self._noise = self._space.transition(period), self._space.noise(period)
        self.reset()

    def reset(self) -> None:
        """Drop all means, because the sensor was switched off or replaced."""
        self.count = 0
        self._state = np.zeros(self._space.size)
        self._covariance = np.zeros((self._space.size, self._space.size))

    def update(self, mean: float) -> None:
        """Add the mean of the samples over the next ``period``."""
        if self.count == 0:  # the constant part of the bias, with a vague prior
            spread = [sigma for sigma, _ in self._space.gauss_markov]
            vague = 1e3 * (sum(spread) + self._space.white + self._space.walk + self._slope_std)
            self._state[1] = mean
            self._covariance = self._space.initial_covariance(vague, self._slope_std)
        self._predict(self._phi, self._noise)
        variance = self._covariance[0, 0]
        gain = self._covariance[:, 0] / variance
        self._state = self._state + gain * (mean * self.period - self._state[0])
        self._covariance = self._covariance - np.outer(gain, self._covariance[0])
        self.count += 1

    def pause(self, seconds: float) -> None:
        """Advance the time without samples, or with samples in motion."""
        if self.count and seconds > 0.0:
            self._predict(self._space.transition(seconds), self._space.noise(seconds))

    def estimate(self, after: float = 0.0, over: float = AHEAD_S) -> BiasEstimate:
        """Return the mean bias from ``after`` s from now on, over ``over`` s.

        Raises
        ------
        AllanError
            When there is no mean yet.
        """
        if not self.count:
            raise AllanError('the bias is not known: keep the sensor at rest for a second')
        state, covariance = self._state, self._covariance
        if after > 0.0:
            phi = self._space.transition(after)
            state = phi @ state
            covariance = phi @ covariance @ phi.T + self._space.noise(after)
        mean = self._space.transition(over)[0, 1:] / over
        added = self._space.noise(over)[0, 0] - self._space.white**2 * over
        variance = mean @ covariance[1:, 1:] @ mean + added / over**2
        return BiasEstimate(float(mean @ state[1:]), math.sqrt(max(float(variance), 0.0)))

    def _predict(self, phi: Floats, noise: Floats) -> None:
        phi = phi.copy()
        phi[0, 0] = 0.0  # every mean starts its own integral
        self._state = phi @ self._state
        self._covariance = phi @ self._covariance @ phi.T + noise


@dataclass(frozen=True)
class AxisBias:
    """The current bias of one axis."""

    estimate: BiasEstimate  # mean over the 10 s after the latest mean
    end_ns: int  # time of the latest mean
    # results of `optimal_window` and `time_within`
    optimal_s: float
    within_s: float
    tolerance: float  # in the unit of the samples


class BiasTracker:
    """Estimates the bias of all axes of an IMU from its means at rest.

    A changed model starts from the stored means. If time goes back, as after a reset, all means are
    dropped.

    Parameters
    ----------
    tolerance : mapping of 'gyro' and 'accel' to float
        Tolerance of `AxisBias`; 0: twice the half-width of the interval after a long rest.
    """

    def __init__(self, tolerance: Mapping[str, float]) -> None:
        self._tolerance = tolerance
        self._models: dict[str, BiasModel] = {}
        self._filters: dict[str, BiasFilter] = {}
        self._facts: dict[str, tuple[float, float, float]] = {}
        self._kept: dict[str, deque[tuple[int, float]]] = {}

    def take(self, axis: str, end_ns: Sequence[int], values: Sequence[float]) -> None:
        """Add the latest means of an axis with their end times; known ones are skipped."""
        kept = self._kept.setdefault(axis, deque(maxlen=KEPT_MEANS))
        if kept and len(end_ns) and end_ns[-1] < kept[-1][0]:
            kept.clear()
            self._filters.pop(axis, None)
        for end, value in zip(end_ns, values):
            if kept and end <= kept[-1][0]:
                continue
            if axis in self._filters:
                _advance(self._filters[axis], kept[-1][0] if kept else None, end, value)
            kept.append((end, value))
        if axis not in self._filters:
            self._rebuild(axis)

    def use(self, models: Mapping[str, BiasModel]) -> None:
        """Replace the models of the axes."""
        if models == self._models:
            return
        self._models, self._filters, self._facts = dict(models), {}, {}
        for axis in models:
            self._rebuild(axis)

    def bias(self, axis: str) -> AxisBias | None:
        """Return the bias of an axis; None without a model or a mean."""
        bias, kept = self._filters.get(axis), self._kept.get(axis)
        if bias is None or not kept:
            return None
        if axis not in self._facts:
            model = self._models[axis]
            tolerance = self._tolerance.get(axis.split('_', 1)[0], 0.0)
            if not tolerance:
                tolerance = 2.0 * Z_95 * steady_filter(model).estimate().std
            within = time_within(model, tolerance)
            self._facts[axis] = (optimal_window(model.processes), within, tolerance)
        return AxisBias(bias.estimate(), kept[-1][0], *self._facts[axis])

    def _rebuild(self, axis: str) -> None:
        """Initialize the filter of an axis from the stored means."""
        kept = self._kept.get(axis)
        if axis not in self._models or not kept:
            return
        self._filters[axis] = BiasFilter(self._models[axis])
        last = None
        for end, value in kept:
            _advance(self._filters[axis], last, end, value)
            last = end


def _advance(bias: BiasFilter, last: int | None, end: int, value: float) -> None:
    """Add the mean that ends at a time, after the time without means before it."""
    pause = 0.0 if last is None else (end - last) * 1e-9 - MEAN_S
    if pause > 0.1 * MEAN_S:
        bias.pause(pause)
    bias.update(value)


def optimal_window(model: ProcessModel, longest: float = LONGEST_S) -> float:
    """Return the averaging time in s, at most ``longest``, whose mean predicts the bias best.

    White noise requires long averages, drift short ones.
    """
    windows = np.geomspace(1.0, longest, 200)
    error = predicted_growth(drift_model(model), AHEAD_S, windows)
    return float(windows[int(np.argmin(error))])


def time_within(model: BiasModel, tolerance: float) -> float:
    """Return the time in s for which the bias stays within +-``tolerance`` (95 %) of an estimate.

    The estimate comes from a long rest. The time is 0 if the estimate is less accurate than the
    tolerance, and at most `LONGEST_S`.

    Raises
    ------
    AllanError
        When the tolerance is not above 0.
    """
    if not 0.0 < tolerance < math.inf:
        raise AllanError(f'the tolerance is {tolerance:g}: give a number above 0')
    bias = steady_filter(model)
    after = np.concatenate([[0.0], np.geomspace(1.0, LONGEST_S, 120)])
    kept = [t for t in after if Z_95 * bias.estimate(float(t)).std <= tolerance]
    return float(max(kept, default=0.0))


def steady_filter(model: BiasModel, seconds: float = 3600.0) -> BiasFilter:
    """Return a filter after ``seconds`` of zero means, from which the expected intervals follow."""
    bias = BiasFilter(model, period=10.0 * MEAN_S)
    for _ in range(round(seconds / bias.period)):
        bias.update(0.0)
    return bias
