# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimate of the bias of a sensor at rest, with its 95 % interval.

The bias is defined as the mean of the samples over the next 10 s, without their white noise. It is
estimated by a Kalman filter from means over 1 s. The states of the Kalman filter are the noise
processes of the sensor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..estimate import Z_95, Estimate
from ..fit.result import AxisFit
from ..noise import Model
from .state_space import state_space

Floats = NDArray[np.float64]

MEAN_S = 1.0
"""Averaging time in s of the means that are the input of the Kalman filter."""

AHEAD_S = 10.0
"""Time in s over which the future bias is averaged."""

STORED_MEANS = 600
"""Largest number of stored means of each axis, for 10 min at rest. When the noise model changes,
the Kalman filter restarts from the stored means."""

STEP_MEANS, STEP_SIGMA = 30, 6.0
"""A step of the bias is detected if the sum of the prediction errors of the latest means differs
from 0 by more than `STEP_SIGMA` standard deviations of this sum. Each prediction error is first
divided by its standard deviation. Sums over 1 to `STEP_MEANS` means are tested."""


class BiasModel(NamedTuple):
    """Stochastic model of the bias of one axis: noise processes and an optional constant slope."""

    processes: Model
    slope_std: float = 0.0  # prior standard deviation of the slope, in SI per s; 0 for no slope

    @classmethod
    def of_fit(cls, fit: AxisFit) -> BiasModel:
        """Return the model from the fit of an axis.

        The prior standard deviation of the slope is sqrt(R^2 + s^2), where s is the standard error
        of R. If R is not resolved, s is computed from its upper limit: without a slope, the 95 %
        intervals for the bias 10 min ahead contained the true bias of only 89 to 93 % of simulated
        sensors. If R is resolved but has no interval, s is 1000 times R. The model has no slope if
        the prior standard deviation would be 0 or infinite.
        """
        ramp = fit.noise['R'].magnitude
        value, limit = ramp.value or 0.0, ramp.upper95 or 0.0
        if ramp.status == 'estimated':
            # without an interval, the prior distribution is wide
            low, high = ramp.ci95 or (0.0, 2e3 * Z_95 * value)
            error = (high - low) / (2.0 * Z_95)
        else:
            error = max(limit - value, 0.0) / Z_95
        std = math.hypot(value, error)
        return cls(fit.model, std if math.isfinite(std) else 0.0)


class BiasFilter:
    """Kalman filter for the bias of one axis at rest, from means over 1 s (`MEAN_S`).

    The means are taken to follow each other without gaps, except for the times that `pause`
    receives.

    Parameters
    ----------
    model : BiasModel
        Noise processes and slope. Of the processes, the Kalman filter contains white noise and the
        processes with states (see `state_space`).

    Examples
    --------
    >>> bias = BiasFilter(BiasModel(Model.of(N=0.1)))
    >>> for mean in (1.0, 1.2, 0.8, 1.0):
    ...     bias.update(mean)
    >>> estimate = bias.estimate()
    >>> round(estimate.value, 3), round(estimate.std, 3)
    (1.0, 0.05)
    """

    def __init__(self, model: BiasModel) -> None:
        space = state_space(model.processes.drift)
        if not space.white and not space.walk:
            # without noise, the variance of the prediction error would become 0
            space = replace(space, white=1e-12)
        self._space = replace(space, slope=bool(model.slope_std))
        self._slope_std = model.slope_std
        self._phi, self._noise = self._space.transition(MEAN_S), self._space.noise(MEAN_S)
        self._weights_ahead = self._space.transition(AHEAD_S)[0, 1:] / AHEAD_S
        noise_ahead = self._space.noise(AHEAD_S)[0, 0] - self._space.white**2 * AHEAD_S
        self._variance_ahead = noise_ahead / AHEAD_S**2
        self._has_mean = False  # whether a mean has been added
        self._state = np.zeros(self._space.size)
        self._covariance = np.zeros((self._space.size, self._space.size))
        # (mean, prediction error in standard deviations) of the latest means
        self._errors: deque[tuple[float, float]] = deque(maxlen=STEP_MEANS)

    def update(self, mean: float) -> None:
        """Predict the state over 1 s, and update it with the mean of the samples of this second.

        If a step of the bias is detected, the state is estimated again, only from the means after
        the step.
        """
        self._update(mean)
        sums = np.cumsum([error for _, error in self._errors][::-1])
        relative_sums = np.abs(sums) / np.sqrt(np.arange(1, len(sums) + 1))
        if relative_sums.max() > STEP_SIGMA:
            means_after_step = [mean for mean, _ in self._errors][
                -1 - int(relative_sums.argmax()) :
            ]
            self._has_mean = False
            self._errors.clear()
            for mean_after_step in means_after_step:
                self._update(mean_after_step)

    def _update(self, mean: float) -> None:
        if not self._has_mean:  # the prior distribution of the constant bias is wide
            process_stds = [value for value, _ in self._space.processes]
            wide_std = 1e3 * (
                sum(process_stds) + self._space.white + self._space.walk + self._slope_std
            )
            self._state = np.zeros(self._space.size)
            self._state[1] = mean
            self._covariance = self._space.initial_covariance(wide_std, self._slope_std)
        self._predict(self._phi, self._noise)
        variance = self._covariance[0, 0]
        gain = self._covariance[:, 0] / variance
        error = mean * MEAN_S - self._state[0]
        self._errors.append((mean, float(error / math.sqrt(variance))))
        self._state = self._state + gain * error
        self._covariance = self._covariance - np.outer(gain, self._covariance[0])
        self._has_mean = True

    def pause(self, seconds: float) -> None:
        """Predict the state over a time in s without means, for example during motion.

        Before the first mean, or if the time is not above 0, this has no effect. Raises AllanError
        if the time is infinite.
        """
        if self._has_mean and seconds > 0.0:
            self._predict(self._space.transition(seconds), self._space.noise(seconds))

    def estimate(self) -> Estimate:
        """Return the predicted mean of the bias over the next 10 s, in the unit of the samples.

        Raises
        ------
        AllanError
            When no mean has been added.
        """
        if not self._has_mean:
            raise AllanError('the bias is not known: keep the sensor at rest for a second')
        weights = self._weights_ahead
        variance = weights @ self._covariance[1:, 1:] @ weights + self._variance_ahead
        return Estimate.normal(
            float(weights @ self._state[1:]), math.sqrt(max(float(variance), 0.0))
        )

    def _predict(self, phi: Floats, noise: Floats) -> None:
        phi = phi.copy()
        phi[0, 0] = 0.0  # the integral of the samples restarts from 0 for each mean
        self._state = phi @ self._state
        self._covariance = phi @ self._covariance @ phi.T + noise


class BiasTracker:
    """Estimates the bias of each axis of an IMU from means at rest, with one `BiasFilter` per axis.

    When the noise models change, the filters restart from the stored means. New means whose times
    have jumped back replace the stored means (see `add_means`).
    """

    def __init__(self) -> None:
        self._models: dict[str, BiasModel] = {}
        self._filters: dict[str, BiasFilter] = {}
        self._means: dict[str, deque[tuple[int, float]]] = {}

    def add_means(self, axis: str, end_ns: Sequence[int], values: Sequence[float]) -> None:
        """Add means of an axis over 1 s, and the times in ns at which they end.

        The new means must be in the order of time. Means that are not later than the latest stored
        mean are ignored. But if the last new mean is earlier than the latest stored mean, the time
        has jumped back. In this case, the new means replace the stored means.
        """
        means = self._means.setdefault(axis, deque(maxlen=STORED_MEANS))
        if means and len(end_ns) and end_ns[-1] < means[-1][0]:
            means.clear()
            self._filters.pop(axis, None)
        last_end = means[-1][0] if means else None
        new_means = [
            (end, mean) for end, mean in zip(end_ns, values) if last_end is None or end > last_end
        ]
        means.extend(new_means)
        if axis not in self._filters:
            self._restart(axis)
        else:
            _add(self._filters[axis], new_means, last_end)

    def set_models(self, models: Mapping[str, BiasModel]) -> None:
        """Replace the models of all axes; ``models`` maps the name of an axis to its model."""
        if models == self._models:
            return
        self._models, self._filters = dict(models), {}
        for axis in models:
            self._restart(axis)

    def bias(self, axis: str) -> Estimate | None:
        """Return the predicted mean of the bias of an axis over the 10 s after the latest mean.

        The bias has the unit of the samples. Returns None if the axis has no model or no mean.
        """
        return self._filters[axis].estimate() if axis in self._filters else None

    @property
    def end_ns(self) -> int:
        """End in ns of the latest mean of the axes whose bias is known; 0 if no bias is known."""
        return max((self._means[axis][-1][0] for axis in self._filters), default=0)

    def _restart(self, axis: str) -> None:
        """Start a new filter for an axis that has a model and means, and add its stored means."""
        if axis in self._models and (means := self._means.get(axis)):
            self._filters[axis] = BiasFilter(self._models[axis])
            _add(self._filters[axis], means)


def _add(bias: BiasFilter, means: Iterable[tuple[int, float]], last_end: int | None = None) -> None:
    """Add means over 1 s to a filter; ``means`` yields pairs (end time in ns, mean).

    ``last_end`` is the end time in ns of the last mean added before; None if there is none.
    """
    for end, mean in means:
        pause = 0.0 if last_end is None else (end - last_end) * 1e-9 - MEAN_S
        if pause > 0.1 * MEAN_S:
            bias.pause(pause)
        bias.update(mean)
        last_end = end
