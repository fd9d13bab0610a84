# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise models of one axis for the states of a filter: exact, or reduced to fewer states.

`StateSpace` represents all processes as states, with the exact discrete matrices. The states are
the integral of the samples (angle or velocity) and the parts of the bias:

    angle' = walk + sum gauss_markov_i + white noise of density N
    walk' = slope + white noise of density K        (slope: a constant, only on request)
    gauss_markov_i' = -gauss_markov_i / tau_i + white noise of density sigma_i sqrt(2/tau_i)

Bias instability cannot be represented by a finite number of states. Four Gauss-Markov processes
whose correlation times are a constant factor apart follow its Allan variance from about 3 s to 3000
s within 5 %.

A filter with N and K models only white noise and a random walk. With the bare coefficients of a
sensor that also has bias instability, it underestimates its error. A `Reduction` chooses the
parameters of the filter's states so that the predicted growth of the error is at least that of the
complete model, over a stated range of horizons. The bias is assumed to be averaged over the longest
of these horizons (see `growth`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..fit.gls_solver import nonnegative_least_squares
from ..noise import FLICKER_FLOOR, NoiseTerms, ProcessModel, gauss_markov_avar
from .growth import drift_model, has_drift, predicted_growth

Floats = NDArray[np.float64]
Processes = tuple[tuple[float, float], ...]
"""Gauss-Markov processes (sigma, tau): stationary standard deviation in the unit of the samples,
correlation time in s."""

FLICKER_PROCESSES = 4
"""Number of Gauss-Markov processes that represent bias instability."""

LONGEST_FLICKER_S = 1500.0
SHORTEST_FLICKER_S = 1.5
"""Shortest correlation time in s of these processes. It is smaller if bias instability exceeds
white noise already at short times."""


@dataclass(frozen=True)
class StateSpace:
    """White noise, a random walk and first-order Gauss-Markov processes.

    Attributes
    ----------
    white : float
        N, per sqrt(Hz).
    walk : float
        K. The walk is a state even if K is 0: it is then a constant bias.
    gauss_markov : tuple of (sigma, tau)
    slope : bool
        Whether a constant slope of the walk is a state, the last one.
    """

    white: float
    walk: float = 0.0
    gauss_markov: Processes = ()
    slope: bool = False

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 + len(self.gauss_markov) + self.slope

    def model(self) -> ProcessModel:
        """Return the same noise as a `ProcessModel`; a slope has no level and is left out."""
        return ProcessModel(NoiseTerms(N=self.white, K=self.walk), self.gauss_markov)

    def transition(self, dt: float) -> Floats:
        """Return Phi, (size, size), for a step of ``dt`` s; for the order of the states see the
        module.
        """
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
        """Return the covariance before the first sample, from the std of walk and slope."""
        variances = [0.0, walk**2, *(sigma**2 for sigma, _ in self.gauss_markov)]
        return np.diag(variances + [slope**2] * self.slope)

    def sample_variance(self, rate: float) -> float:
        """Return R = N^2 f, the white variance of one sample at ``rate`` Hz."""
        return self.white**2 * rate


def state_space(model: ProcessModel) -> StateSpace:
    """Return the states of a process model.

    Bias instability becomes `flicker_processes`. The part that is slower than three times their
    longest correlation time T becomes a random walk with K^2 = B^2/(3 pi T).

    Sinusoids, quantization and the ramp are left out, because they are not random processes of a
    filter. `reduce_model` represents the ramp and slow sinusoids by the walk.
    """
    terms = model.terms
    flicker = flicker_processes(terms.B, terms.N) if terms.B else ()
    slow = terms.B / math.sqrt(3.0 * math.pi * LONGEST_FLICKER_S)
    return StateSpace(terms.N, math.hypot(terms.K, slow), (*flicker, *model.gauss_markov))


def flicker_processes(bias_instability: float, white: float = 0.0) -> Processes:
    """Return Gauss-Markov processes whose sum has the Allan variance of flicker noise of level B.

    White noise hides flicker at averaging times below N^2 / (0.441 B^2); the shortest correlation
    time is a fifth of this, limited to the range from 0.15 s to `SHORTEST_FLICKER_S`.
    """
    hidden_s = white**2 / (FLICKER_FLOOR * bias_instability**2)
    shortest = min(max(hidden_s / 5.0, 0.15), SHORTEST_FLICKER_S)
    taus = np.geomspace(shortest, LONGEST_FLICKER_S, FLICKER_PROCESSES)
    tau = np.geomspace(1.3 * taus[0], 2.0 * taus[-1], 40)
    columns = np.stack([gauss_markov_avar(tau, one) / FLICKER_FLOOR for one in taus], axis=1)
    weights = nonnegative_least_squares(columns, np.ones_like(tau))
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


# --- reductions -----------------------------------------------------------------------------------

States = Literal['none', 'walk', 'gauss_markov', 'processes']

STATES: tuple[States, ...] = ('none', 'walk', 'gauss_markov', 'processes')
"""Models of the bias: none, a random walk, one Gauss-Markov process, or a walk and processes."""

SHORTEST_HORIZON_S = 1.0
"""Lower end of a range of horizons of which only the upper end is given."""

HORIZONS_PER_RANGE = 30
"""Number of horizons, spaced evenly in their logarithm, at which two models are compared."""

POOR_RATIO = 2.0
"""A reduction whose growth is off by more than this factor does not describe the sensor."""


class Horizons(NamedTuple):
    """A range of times over which a filter integrates between two corrections, in s."""

    low: float
    high: float

    @classmethod
    def up_to(cls, high: float) -> Horizons:
        """Return the range from `SHORTEST_HORIZON_S` (or ``high``/10, if less) to ``high``.

        Raises
        ------
        AllanError
            When ``high`` is not above 0 and finite.
        """
        if not 0.0 < high < math.inf:
            raise AllanError(f'the horizon is {high:g} s: give a time above 0 s')
        return cls(min(SHORTEST_HORIZON_S, high / 10.0), high)

    def times(self) -> Floats:
        """Return logarithmically spaced times over the range."""
        return np.geomspace(self.low, self.high, HORIZONS_PER_RANGE)

    def __str__(self) -> str:
        return f'{self.low:g} to {self.high:g} s'


@dataclass(frozen=True)
class Reduction:
    """A noise model with the states of a filter."""

    states: States  # one of `STATES`
    # N and K; K is 0 if the states have no walk, or the model no drift
    white: float
    walk: float
    gauss_markov: Processes  # tuple of (sigma, tau)
    # range in which the growth predicted by the filter bounds that of the complete model
    horizons: Horizons
    # smallest and largest ratio of the predicted growth to the growth of the complete model
    ratio: tuple[float, float]

    @property
    def poor(self) -> bool:
        """Whether the growth is off by more than `POOR_RATIO` at some horizon."""
        return self.ratio[1] > POOR_RATIO or self.ratio[0] < 1.0 / POOR_RATIO

    def model(self) -> ProcessModel:
        """Return the noise that the filter assumes, as a `ProcessModel`."""
        return ProcessModel(NoiseTerms(N=self.white, K=self.walk), self.gauss_markov)


def reduce_model(
    model: ProcessModel, states: States = 'walk', horizons: Horizons = Horizons(1.0, 30.0)
) -> Reduction:
    """Return the noise model for a filter with the given states.

    ============  ================================================================================
    none          N is raised until white noise alone bounds the growth.
    walk          N is kept and K raised until the growth is bounded.
    gauss_markov  N is kept; of the processes that bound the growth, the closest one is used.
    processes     Everything is kept: B becomes four Gauss-Markov processes. Only a ramp and slow
                  sinusoids, for which there are no states, raise K.
    ============  ================================================================================

    If the result would be poor (see `Reduction.poor`), the shortest Gauss-Markov processes count as
    white noise and raise N.

    Quantization and sinusoids faster than `SLOW_SINUSOID_HZ` have bounded integrals and are left
    out.

    Raises
    ------
    AllanError
        When the states are not one of `STATES`.

    Examples
    --------
    Two terms are their own reduction:

    >>> reduction = reduce_model(ProcessModel(NoiseTerms(N=1e-3, K=1e-5)))
    >>> round(reduction.walk, 9), [round(ratio, 3) for ratio in reduction.ratio]
    (1e-05, [1.0, 1.0])
    """
    if states not in STATES:
        raise AllanError(f'states {states!r} are unknown: choose one of {", ".join(STATES)}')
    complete = drift_model(model)
    made = [_reduced(complete, 0, states, horizons)]
    if states in ('walk', 'gauss_markov'):
        while made[-1].poor and len(made) <= len(complete.gauss_markov):
            made.append(_reduced(complete, len(made), states, horizons))
    return min(made, key=lambda reduction: reduction.poor * reduction.ratio[1])


def _reduced(complete: ProcessModel, quick: int, states: States, horizons: Horizons) -> Reduction:
    """Return a reduction that counts the ``quick`` shortest processes as white noise."""
    by_time = sorted(complete.gauss_markov, key=lambda pair: pair[1])
    added = sum(2.0 * sigma**2 * tau for sigma, tau in by_time[:quick])
    white = math.sqrt(complete.terms.N**2 + added)
    terms = replace(complete.terms, N=0.0)
    drift = replace(complete, terms=terms, gauss_markov=tuple(by_time[quick:]))
    with_white = replace(drift, terms=replace(terms, N=white))
    walk = 0.0
    processes: Processes = ()
    if states == 'none':
        needed = _variance(drift, horizons) / _unit_variance('N', 0.0, horizons)
        white = math.sqrt(white**2 + float(np.max(needed)))
    elif states == 'gauss_markov':
        closest = closest_process(with_white, horizons)
        processes = (closest,) if closest else ()
    else:
        if states == 'processes':  # only ramp and sinusoids have no states
            space = state_space(with_white)
            processes = space.gauss_markov
            terms = NoiseTerms(K=space.walk, R=terms.R)
            drift = ProcessModel(terms, sinusoids=drift.sinusoids)
        needed = _variance(drift, horizons) / _unit_variance('K', 0.0, horizons)
        walk = math.sqrt(float(np.max(needed)))
    made = Reduction(states, white, walk, processes, horizons, (1.0, 1.0))
    times = horizons.times()
    top, bottom = (predicted_growth(m, times, horizons.high) for m in (made.model(), complete))
    if np.any(bottom > 0.0):
        ratio = top / bottom
        return replace(made, ratio=(float(ratio.min()), float(ratio.max())))
    return replace(made, ratio=(math.inf, math.inf)) if np.any(top > 0.0) else made


def _variance(model: ProcessModel, horizons: Horizons) -> Floats:
    """Return the variance of the error at the times of a range."""
    return predicted_growth(model, horizons.times(), horizons.high) ** 2


@lru_cache(maxsize=512)
def _unit_variance(term: str, tau: float, horizons: Horizons) -> Floats:
    """Return the variance of the error for N = 1, K = 1, or a Gauss-Markov process with sigma =
    1."""
    terms = NoiseTerms(**{term: 1.0}) if term else NoiseTerms()
    variance = _variance(ProcessModel(terms, () if term else ((1.0, tau),)), horizons)
    variance.setflags(write=False)
    return variance


def closest_process(
    model: ProcessModel, horizons: Horizons, tau: float | None = None, bound: bool = True
) -> tuple[float, float] | None:
    """Return the Gauss-Markov process (sigma, tau) closest to the drift of a model; None without
    drift.

    Parameters
    ----------
    model : ProcessModel
        The model. Its white noise hides drift at short horizons.
    horizons : Horizons
    tau : float or None
        Correlation time in s; None to choose it.
    bound : bool
        Whether the growth is never below that of the model, as a filter needs it. Otherwise
        deviations above and below are equal, as a simulation needs it.
    """
    complete = drift_model(model)
    if not has_drift(complete):
        return None
    white = complete.terms.N**2 * _unit_variance('N', 0.0, horizons)
    # above 0 unless only rounding remains after white noise
    needed = np.maximum(_variance(complete, horizons) - white, np.finfo(float).tiny)
    grid = np.geomspace(horizons.low / 3.0, 100.0 * horizons.high, 60).tolist()
    own = [pair[1] for pair in complete.gauss_markov]
    best, least = (0.0, 1.0), math.inf
    for one in [*own, *grid] if tau is None else [tau]:
        unit = _unit_variance('', one, horizons)
        ratio = needed / unit
        variances = [float(ratio.max())] if bound else np.geomspace(ratio.min(), ratio.max(), 9)
        for variance in variances:
            off = np.log((white + variance * unit) / (white + needed))
            error = float(np.abs(off).max())
            if error < least - 1e-9:
                best, least = (math.sqrt(variance), one), error
    return best


def common_correlation_time(models: Sequence[ProcessModel], horizons: Horizons) -> float:
    """Return the correlation time in s for several axes, all of which drift."""
    taus = [one[1] for model in models if (one := closest_process(model, horizons))]
    return math.exp(sum(math.log(tau) for tau in taus) / len(taus))
