# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise of one axis as states of a Kalman filter, with the exact discrete matrices.

The states are the integral of the samples (angle or velocity) and the parts of the bias:

    angle' = walk + sum gauss_markov_i + white noise of density N
    walk' = slope + white noise of density K        (slope: a constant, only where it is asked for)
    gauss_markov_i' = -gauss_markov_i / tau_i + white noise of density sigma_i sqrt(2/tau_i)

Bias instability has no finite number of states. Four Gauss-Markov processes whose correlation
times are a constant factor apart follow its Allan variance from about 3 s to 3000 s within 5 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..noise import FLICKER_FLOOR, NoiseTerms, ProcessModel, gauss_markov_avar

Floats = NDArray[np.float64]

FLICKER_PROCESSES = 4
LONGEST_FLICKER_S = 1500.0
SHORTEST_FLICKER_S = 1.5
"""Correlation times of the first and last process that represent bias instability. The first is
shorter where bias instability exceeds white noise already at short times."""


@dataclass(frozen=True)
class StateSpace:
    """White noise, a random walk and first-order Gauss-Markov processes.

    Attributes
    ----------
    white : float
        N, per sqrt(Hz).
    walk : float
        K. The walk is a state even where K is 0: it then holds a constant bias.
    gauss_markov : tuple of (sigma, tau)
        Stationary standard deviation in the unit of the samples, correlation time in s.
    slope : bool
        Whether a constant slope of the walk is a state, the last one.
    """

    white: float
    walk: float = 0.0
    gauss_markov: tuple[tuple[float, float], ...] = ()
    slope: bool = False

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 + len(self.gauss_markov) + self.slope

    def model(self) -> ProcessModel:
        """Return the same noise as a `ProcessModel`; a slope has no level and is left out."""
        return ProcessModel(NoiseTerms(N=self.white, K=self.walk), self.gauss_markov)

    def transition(self, dt: float) -> Floats:
        """Return Phi, (size, size), over a step of ``dt`` s; states in the order of the module."""
        _check_step(dt)
        phi = np.eye(self.size)
        phi[0, 1] = dt
        for i, (_, tau) in enumerate(self.gauss_markov, 2):
            phi[i, i] = math.exp(-dt / tau)
            phi[0, i] = -tau * math.expm1(-dt / tau)
        if self.slope:
            phi[1, -1], phi[0, -1] = dt, dt * dt / 2.0
        return phi

    def noise(self, dt: float) -> Floats:
        """Return Qd, (size, size): the covariance that a step of ``dt`` s adds to the states."""
        _check_step(dt)
        q = np.zeros((self.size, self.size))
        k2 = self.walk**2
        q[0, 0] = self.white**2 * dt + k2 * dt**3 / 3.0
        q[1, 1] = k2 * dt
        q[0, 1] = q[1, 0] = k2 * dt**2 / 2.0
        for i, (sigma, tau) in enumerate(self.gauss_markov, 2):
            x = dt / tau
            q[0, 0] += sigma**2 * tau**2 * _integrated_variance(x)
            q[i, i] = -(sigma**2) * math.expm1(-2.0 * x)
            q[0, i] = q[i, 0] = sigma**2 * tau * math.expm1(-x) ** 2
        return q

    def initial_covariance(self, walk: float, slope: float = 0.0) -> Floats:
        """Return the covariance before any sample, from the std of walk and slope."""
        variances = [0.0, walk**2, *(sigma**2 for sigma, _ in self.gauss_markov)]
        return np.diag(variances + [slope**2] * self.slope)

    def sample_variance(self, rate: float) -> float:
        """Return R = N^2 f, the white variance of one sample at ``rate`` Hz."""
        return self.white**2 * rate


def state_space(model: ProcessModel) -> StateSpace:
    """Return the states of a process model.

    Bias instability becomes `flicker_processes`. Its part slower than three times their longest
    correlation time T adds the random walk of these processes, K^2 = B^2/(3 pi T).

    Sinusoids are not noise states, quantization is not a process and a ramp is not random: they
    are left out. `reductions.reduce_model` covers the ramp by the walk.
    """
    terms = model.terms
    flicker = flicker_processes(terms.B, terms.N) if terms.B else ()
    slow = terms.B / math.sqrt(3.0 * math.pi * LONGEST_FLICKER_S)
    return StateSpace(terms.N, math.hypot(terms.K, slow), (*flicker, *model.gauss_markov))


def flicker_processes(
    bias_instability: float, white: float = 0.0
) -> tuple[tuple[float, float], ...]:
    """Return Gauss-Markov processes (sigma, tau) whose sum has the Allan variance of flicker noise.

    Parameters
    ----------
    bias_instability : float
        B, the coefficient.
    white : float
        N. White noise hides flicker at averaging times below N^2 / (0.441 B^2); the shortest
        correlation time is a fifth of that, within 0.15 s and `SHORTEST_FLICKER_S`.
    """
    hidden_s = white**2 / (FLICKER_FLOOR * bias_instability**2)
    shortest = min(max(hidden_s / 5.0, 0.15), SHORTEST_FLICKER_S)
    taus = np.geomspace(shortest, LONGEST_FLICKER_S, FLICKER_PROCESSES)
    tau = np.geomspace(1.3 * taus[0], 2.0 * taus[-1], 40)
    columns = np.stack([gauss_markov_avar(tau, one) / FLICKER_FLOOR for one in taus], axis=1)
    from scipy.optimize import nnls  # slow to import, and most targets do without

    weights, _ = nnls(columns, np.ones_like(tau))
    return tuple(
        (bias_instability * math.sqrt(weight), float(one)) for weight, one in zip(weights, taus)
    )


def _integrated_variance(x: float) -> float:
    """Return 2x - 3 + 4 exp(-x) - exp(-2x): variance of the integral over x correlation times."""
    if x > 0.05:
        return 2.0 * x + 4.0 * math.expm1(-x) - math.expm1(-2.0 * x)
    return x**3 * (2.0 / 3.0 - x * (0.5 - x * (7.0 / 30.0 - x / 12.0)))


def _check_step(dt: float) -> None:
    if not 0.0 < dt < math.inf:
        raise AllanError(f'the step is {dt:g} s: give a rate above 0 Hz')
