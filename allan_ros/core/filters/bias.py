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
"""Number of means of an axis that are stored, so that the Kalman filter can restart from them when
the noise model changes: 10 min."""

STEP_MEANS, STEP_SIGMA = 30, 6.0
"""The bias has made a step if the sum of the prediction errors of the latest means exceeds
`STEP_SIGMA` standard deviations of this sum. Sums over 1 to `STEP_MEANS` means are tested."""


class BiasModel(NamedTuple):
    """Stochastic model of the bias of one axis: noise processes and an unknown constant slope."""

    processes: Model
    slope_std: float = 0.0  # prior standard deviation of the slope in SI per s; 0 for no slope

    @classmethod
    def of_fit(cls, fit: AxisFit) -> BiasModel:
        """Return the model from the fit of an axis.

        The standard deviation of the slope is the root of the sum of the squares of R and of its
        standard error, even if R is not resolved. If the slope was omitted, the 95 % interval of
        the bias 10 min ahead would contain only 89 to 93 % of the values of simulated sensors.
        """
        ramp = fit.noise['R'].magnitude
        value, limit = ramp.value or 0.0, ramp.upper95 or 0.0
        if ramp.status == 'estimated':
            # without an interval, the prior is vague
            low, high = ramp.ci95 or (0.0, 2e3 * Z_95 * value)
            error = (high - low) / (2.0 * Z_95)
        else:
            error = max(limit - value, 0.0) / Z_95
        std = math.hypot(value, error)
        return cls(fit.model, std if math.isfinite(std) else 0.0)


class BiasFilter:
    """Kalman filter for the bias of one axis at rest, from means over 1 s (`MEAN_S`).

    Successive means have no gap between them, except for the times that are given to `pause`.

    Parameters
    ----------
    model : BiasModel
        Noise processes and slope, which become the states of the Kalman filter.

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
            # without any noise, the innovation variance would become 0
            space = replace(space, white=1e-12)
        self._space = replace(space, slope=bool(model.slope_std))
        self._slope_std = model.slope_std
        self._phi, self._noise = self._space.transition(MEAN_S), self._space.noise(MEAN_S)
        self._known = False  # whether a mean was added
        self._state = np.zeros(self._space.size)
        self._covariance = np.zeros((self._space.size, self._space.size))
        # latest means and their prediction errors in standard deviations
        self._errors: deque[tuple[float, float]] = deque(maxlen=STEP_MEANS)

    def update(self, mean: float) -> None:
        """Predict the state over 1 s, and update it with the mean of the samples of this second.

        If the bias has made a step, the state is estimated only from the means after the step.
        """
        self._update(mean)
        sums = np.cumsum([error for _, error in self._errors][::-1])
        excess = np.abs(sums) / np.sqrt(np.arange(1, len(sums) + 1))
        if excess.max() > STEP_SIGMA:
            since = [mean for mean, _ in self._errors][-1 - int(excess.argmax()) :]
            self._known = False
            self._errors.clear()
            for each in since:
                self._update(each)

    def _update(self, mean: float) -> None:
        if not self._known:  # the prior of the constant part of the bias is vague
            spread = [value for value, _ in self._space.processes]
            vague = 1e3 * (sum(spread) + self._space.white + self._space.walk + self._slope_std)
            self._state[1] = mean
            self._covariance = self._space.initial_covariance(vague, self._slope_std)
        self._predict(self._phi, self._noise)
        variance = self._covariance[0, 0]
        gain = self._covariance[:, 0] / variance
        error = mean * MEAN_S - self._state[0]
        self._errors.append((mean, float(error / math.sqrt(variance))))
        self._state = self._state + gain * error
        self._covariance = self._covariance - np.outer(gain, self._covariance[0])
        self._known = True

    def pause(self, seconds: float) -> None:
        """Predict the state over a time in s for which there is no mean, for example a motion."""
        if self._known and seconds > 0.0:
            self._predict(self._space.transition(seconds), self._space.noise(seconds))

    def estimate(self) -> Estimate:
        """Return the predicted mean bias over the next 10 s, in the unit of the samples.

        Raises
        ------
        AllanError
            If no mean has been added.
        """
        if not self._known:
            raise AllanError('the bias is not known: keep the sensor at rest for a second')
        mean = self._space.transition(AHEAD_S)[0, 1:] / AHEAD_S
        added = self._space.noise(AHEAD_S)[0, 0] - self._space.white**2 * AHEAD_S
        variance = mean @ self._covariance[1:, 1:] @ mean + added / AHEAD_S**2
        return Estimate.normal(float(mean @ self._state[1:]), math.sqrt(max(float(variance), 0.0)))

    def _predict(self, phi: Floats, noise: Floats) -> None:
        phi = phi.copy()
        phi[0, 0] = 0.0  # the integral of the samples starts from 0 for each mean
        self._state = phi @ self._state
        self._covariance = phi @ self._covariance @ phi.T + noise


class BiasTracker:
    """Estimates of the bias of all axes of an IMU from means at rest, by one `BiasFilter` per axis.

    When the noise models change, each filter restarts from the stored means of its axis. When the
    time jumps back, as after a reset, the stored means are removed.
    """

    def __init__(self) -> None:
        self._models: dict[str, BiasModel] = {}
        self._filters: dict[str, BiasFilter] = {}
        self._kept: dict[str, deque[tuple[int, float]]] = {}

    def add_means(self, axis: str, end_ns: Sequence[int], values: Sequence[float]) -> None:
        """Add means of an axis over 1 s, and the times in ns at which they end.

        Means that end at or before the latest stored mean are ignored. If all new means end before
        it, the time has jumped back: then the stored means are removed, and all new means are used.
        """
        kept = self._kept.setdefault(axis, deque(maxlen=STORED_MEANS))
        if kept and len(end_ns) and end_ns[-1] < kept[-1][0]:
            kept.clear()
            self._filters.pop(axis, None)
        last = kept[-1][0] if kept else None
        new = [(end, mean) for end, mean in zip(end_ns, values) if last is None or end > last]
        kept.extend(new)
        if axis not in self._filters:
            self._restart(axis)
        else:
            _add(self._filters[axis], new, last)

    def set_models(self, models: Mapping[str, BiasModel]) -> None:
        """Replace the models of all axes, given by axis name."""
        if models == self._models:
            return
        self._models, self._filters = dict(models), {}
        for axis in models:
            self._restart(axis)

    def bias(self, axis: str) -> Estimate | None:
        """Return the predicted mean bias of an axis over the 10 s after the latest mean.

        The unit is the unit of the samples. The result is None without a model or a mean.
        """
        return self._filters[axis].estimate() if axis in self._filters else None

    @property
    def end_ns(self) -> int:
        """Time in ns at which the latest mean ends, of all axes with a bias; 0 if none has one."""
        return max((self._kept[axis][-1][0] for axis in self._filters), default=0)

    def _restart(self, axis: str) -> None:
        """Run a new filter of an axis over the stored means, if the axis has a model and means."""
        if axis in self._models and (kept := self._kept.get(axis)):
            self._filters[axis] = BiasFilter(self._models[axis])
            _add(self._filters[axis], kept)


def _add(bias: BiasFilter, means: Iterable[tuple[int, float]], last: int | None = None) -> None:
    """Add pairs (end time in ns, mean) to a filter.

    ``last`` is the end time of the mean before the first pair; None if there is none.
    """
    for end, mean in means:
        pause = 0.0 if last is None else (end - last) * 1e-9 - MEAN_S
        if pause > 0.1 * MEAN_S:
            bias.pause(pause)
        bias.update(mean)
        last = end
