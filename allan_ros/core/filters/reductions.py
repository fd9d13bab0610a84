# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""State-space models of the noise of one axis for a filter, complete or reduced to few states.

`StateSpace` represents all noise processes as states, with the exact discrete-time matrices. The
states are the integral of the samples (angle or velocity) and the components of the bias:

    angle' = walk + sum gauss_markov_i + white noise of density N
    walk' = slope + white noise of density K        (slope: an optional constant)
    gauss_markov_i' = -gauss_markov_i / tau_i + white noise of density sigma_i sqrt(2/tau_i)

Bias instability has no exact model with a finite number of states. It is approximated by four
Gauss-Markov processes with logarithmically spaced correlation times, whose Allan variance agrees
within 5 % from about 3 s to 3000 s.

A filter with the parameters N and K models only white noise and a random walk. If the sensor also
has bias instability, such a filter underestimates its error with the fitted N and K. A `Reduction`
contains raised parameters: the filter predicts an error growth at least as large as the complete
model does, over a range of prediction horizons (times that a filter integrates without a
correction). The bias is assumed to be averaged over the longest of these horizons.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..noise import FLICKER_FLOOR, NoiseTerms, ProcessModel, gauss_markov_avar
from .growth import drift_model, has_drift, predicted_growth

Floats = NDArray[np.float64]
Processes = tuple[tuple[float, float], ...]
"""First-order Gauss-Markov processes (sigma, tau): stationary standard deviation in the unit of the
samples, correlation time in s."""

FLICKER_PROCESSES = 4
"""Number of Gauss-Markov processes that approximate bias instability."""

LONGEST_FLICKER_S = 1500.0
"""Longest correlation time in s of these processes."""

SHORTEST_FLICKER_S = 1.5
"""Default of their shortest correlation time in s. It is smaller if bias instability exceeds white
noise at shorter averaging times."""


@dataclass(frozen=True)
class StateSpace:
    """State-space model of white noise, a random walk and first-order Gauss-Markov processes.

    The states are, in this order, the integral of the samples, the random walk, the Gauss-Markov
    processes, and optionally the slope of the walk.

    Attributes
    ----------
    white : float
        Density N of the white noise, in the unit of the samples per sqrt(Hz).
    walk : float
        Density K of the random walk. If it is 0, the walk is a constant bias.
    gauss_markov : tuple of (sigma, tau)
        Stationary standard deviation in the unit of the samples, and correlation time in s.
    slope : bool
        Whether a constant slope of the walk is the last state.
    """

    white: float
    walk: float = 0.0
    gauss_markov: Processes = ()
    slope: bool = False

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 + len(self.gauss_markov) + self.slope

    def transition(self, dt: float) -> Floats:
        """Return the state transition matrix Phi, (size, size), for a step of ``dt`` s."""
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
        """Return the discrete process noise covariance Qd, (size, size), of a step of ``dt`` s."""
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
        """Return the initial covariance of the states, (size, size).

        ``walk`` and ``slope`` are the prior standard deviations of these states. The Gauss-Markov
        processes have their stationary variance, and the integral starts from 0.
        """
        variances = [0.0, walk**2, *(sigma**2 for sigma, _ in self.gauss_markov)]
        return np.diag(variances + [slope**2] * self.slope)

    def sample_variance(self, rate: float) -> float:
        """Return R = N^2 f, the variance of the white noise of one sample at ``rate`` Hz."""
        return self.white**2 * rate


def state_space(model: ProcessModel) -> StateSpace:
    """Return the state-space model of noise processes.

    Bias instability becomes the Gauss-Markov processes of `flicker_processes`. For its slow
    components, K^2 of the random walk is increased by B^2/(3 pi T), where T is their longest
    correlation time. Quantization, ramp and sinusoids are left out, because a filter has no states
    for them.
    """
    terms = model.terms
    flicker = flicker_processes(terms.B, terms.N) if terms.B else ()
    slow = terms.B / math.sqrt(3.0 * math.pi * LONGEST_FLICKER_S)
    return StateSpace(terms.N, math.hypot(terms.K, slow), (*flicker, *model.gauss_markov))


def flicker_processes(bias_instability: float, white: float = 0.0) -> Processes:
    """Return Gauss-Markov processes whose sum approximates the Allan variance of flicker noise.

    ``bias_instability`` is the coefficient B of the flicker noise, and ``white`` the density N of
    the white noise. White noise dominates at averaging times below N^2 / (0.441 B^2). The shortest
    correlation time is a fifth of this, limited to the range 0.15 s to `SHORTEST_FLICKER_S`.
    """
    crossing_s = white**2 / (FLICKER_FLOOR * bias_instability**2)
    shortest = min(max(crossing_s / 5.0, 0.15), SHORTEST_FLICKER_S)
    taus = np.geomspace(shortest, LONGEST_FLICKER_S, FLICKER_PROCESSES)
    tau = np.geomspace(1.3 * taus[0], 2.0 * taus[-1], 40)
    columns = np.stack([gauss_markov_avar(tau, one) / FLICKER_FLOOR for one in taus], axis=1)
    weights = np.linalg.lstsq(columns, np.ones_like(tau), rcond=None)[0]  # all positive
    return tuple(
        (bias_instability * math.sqrt(weight), float(one)) for weight, one in zip(weights, taus)
    )


def _integrated_variance(x: float) -> float:
    """Return 2x - 3 + 4 exp(-x) - exp(-2x), accurate for small x."""
    if x > 0.05:
        return 2.0 * x + 4.0 * math.expm1(-x) - math.expm1(-2.0 * x)
    return x**3 * (2.0 / 3.0 - x * (0.5 - x * (7.0 / 30.0 - x / 12.0)))


def _check_step(dt: float) -> None:
    if not 0.0 < dt < math.inf:
        raise AllanError(f'the step is {dt:g} s: give a rate above 0 Hz')


# --- reductions -----------------------------------------------------------------------------------

States = Literal['none', 'walk', 'processes']
"""Bias models of a filter: no state, a random walk, or a random walk with several Gauss-Markov
processes."""

HORIZON_S = 30.0
"""Default of the longest horizon."""

HORIZONS_PER_RANGE = 30
"""Number of horizons at which the error growth of two models is compared."""

POOR_RATIO = 2.0
"""Largest accepted ratio between the error growth of a reduction and of the complete model."""


def shortest_horizon(longest: float) -> float:
    """Return the shortest horizon in s of the range up to ``longest``: 1 s, or a tenth of it."""
    return min(1.0, longest / 10.0)


def horizon_text(longest: float) -> str:
    """Return the range of horizons up to ``longest`` as text.

    >>> horizon_text(30.0)
    '1 to 30 s'
    """
    return f'{shortest_horizon(longest):g} to {longest:g} s'


class Level(NamedTuple):
    """Value of one noise coefficient of one axis for a filter, in SI."""

    axis: str  # name of the axis
    term: str  # N, B, K or R, or 'sigma' of a Gauss-Markov process
    value: float  # finite and above 0: the estimate, or the 95 % upper limit without an estimate
    ci95: tuple[float, float] | None = None  # 95 % interval of the value; None if unknown
    is_limit: bool = False  # whether the value is an upper limit
    # fitted coefficient (0 if it is not resolved) of a value that was increased so
    # that the filter does not underestimate the error growth; None if it was not increased
    raised_from: float | None = None

    @property
    def no_interval(self) -> bool:
        """Whether the value is an estimate without a 95 % interval."""
        return self.ci95 is None and not self.is_limit and self.raised_from is None

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval: (0, value) for a limit, and (0, inf) if it is unknown."""
        low, high = (0.0, self.value) if self.is_limit else self.ci95 or (0.0, math.inf)
        return max(low, 0.0), high


class Reduction(NamedTuple):
    """Noise model of one axis, reduced to the states of a filter."""

    model: ProcessModel  # N, K and Gauss-Markov processes that the filter assumes
    # smallest and largest ratio over the horizons of the error growth (standard deviation) that the
    # filter predicts to the growth with the complete model
    ratio: tuple[float, float]
    levels: Mapping[str, Level]  # N and K with their intervals, if the model of an axis was reduced

    @property
    def poor(self) -> bool:
        """Whether the error growth is wrong by more than a factor of 2 at some horizon."""
        return self.ratio[1] > POOR_RATIO or self.ratio[0] < 1.0 / POOR_RATIO


def reduce_model(
    model: ProcessModel, states: States = 'walk', horizon: float = HORIZON_S
) -> Reduction:
    """Return a noise model reduced to the states of a filter.

    At all horizons from 1 s to ``horizon`` s, the reduced model predicts at least the error growth
    of ``model``. The ``states`` determine what is adjusted:

    ============  ================================================================================
    none          N is increased, because white noise represents all drift.
    walk          K is increased, N is kept.
    processes     B becomes four Gauss-Markov processes and all others are kept. K is increased only
                  for a ramp and slow sinusoids, which have no states.
    ============  ================================================================================

    If the result with 'walk' would be poor (see `Reduction.poor`), the Gauss-Markov processes with
    the shortest correlation times are treated as white noise and increase N. Quantization and
    sinusoids above 0.1 Hz are left out, because their integrals are bounded.

    Examples
    --------
    A model with N and K only is not changed:

    >>> reduction = reduce_model(ProcessModel(NoiseTerms(N=1e-3, K=1e-5)))
    >>> round(reduction.model.terms.K, 9), [round(ratio, 3) for ratio in reduction.ratio]
    (1e-05, [1.0, 1.0])
    """
    complete = drift_model(model)
    reductions = [_reduced(complete, 0, states, horizon)]
    while states == 'walk' and reductions[-1].poor and len(reductions) <= len(model.gauss_markov):
        reductions.append(_reduced(complete, len(reductions), states, horizon))
    return min(reductions, key=lambda reduction: reduction.poor * reduction.ratio[1])


def _reduced(complete: ProcessModel, fast: int, states: States, horizon: float) -> Reduction:
    """Return a reduction that treats the ``fast`` fastest Gauss-Markov processes as white noise."""
    by_time = sorted(complete.gauss_markov, key=lambda pair: pair[1])
    added = sum(2.0 * sigma**2 * tau for sigma, tau in by_time[:fast])
    white, walk = math.sqrt(complete.terms.N**2 + added), 0.0
    drift = replace(
        complete, terms=replace(complete.terms, N=0.0), gauss_markov=tuple(by_time[fast:])
    )
    processes: Processes = ()
    if states == 'none':
        squared = _growth(drift, horizon) ** 2 / _unit_variance('N', 0.0, horizon)
        white = math.sqrt(white**2 + float(np.max(squared)))
    else:
        if states == 'processes':  # only the ramp and sinusoids have no states
            space = state_space(replace(drift, terms=replace(drift.terms, N=white)))
            processes = space.gauss_markov
            terms = NoiseTerms(K=space.walk, R=drift.terms.R)
            drift = ProcessModel(terms, sinusoids=drift.sinusoids)
        squared = _growth(drift, horizon) ** 2 / _unit_variance('K', 0.0, horizon)
        walk = math.sqrt(float(np.max(squared)))
    model = ProcessModel(NoiseTerms(N=white, K=walk), processes)
    reduced, actual = (_growth(one, horizon) for one in (model, complete))
    if np.any(actual > 0.0):
        ratio = reduced / actual
        return Reduction(model, (float(ratio.min()), float(ratio.max())), {})
    unknown = math.inf if np.any(reduced > 0.0) else 1.0
    return Reduction(model, (unknown, unknown), {})


def _growth(model: ProcessModel, horizon: float) -> Floats:
    """Return the predicted growth at 30 horizons up to the given one."""
    times = np.geomspace(shortest_horizon(horizon), horizon, HORIZONS_PER_RANGE)
    return predicted_growth(model, times, horizon)


@lru_cache(maxsize=512)
def _unit_variance(term: str, tau: float, horizon: float) -> Floats:
    """Return the variance of the predicted error at 30 horizons, due to one unit of noise.

    The noise is N = 1, K = 1 or, if ``term`` is '', a Gauss-Markov process with standard deviation
    1 and correlation time ``tau``.
    """
    terms = NoiseTerms(**{term: 1.0}) if term else NoiseTerms()
    variance = _growth(ProcessModel(terms, () if term else ((1.0, tau),)), horizon) ** 2
    variance.setflags(write=False)
    return variance


def closest_process(
    model: ProcessModel, horizon: float, tau: float | None = None, bound: bool = True
) -> tuple[float, float] | None:
    """Return the Gauss-Markov process (sigma, tau) closest to the drift of a model, or None.

    It replaces all drift of the model and minimizes the largest relative difference of the error
    growth over the horizons up to ``horizon`` s. The result is None if the model has no drift.

    ``tau`` is the correlation time in s; with None, it is selected. If ``bound`` is set, the growth
    is not smaller than with the model, as a filter requires. Otherwise it may also be smaller.
    """
    complete = drift_model(model)
    if not has_drift(complete):
        return None
    white = complete.terms.N**2 * _unit_variance('N', 0.0, horizon)
    # the minimum applies only if the drift is below the rounding error of the white noise
    drift = np.maximum(_growth(complete, horizon) ** 2 - white, np.finfo(float).tiny)
    grid = np.geomspace(shortest_horizon(horizon) / 3.0, 100.0 * horizon, 60).tolist()
    own = [pair[1] for pair in complete.gauss_markov]
    best, least = (0.0, 1.0), math.inf
    for one in [*own, *grid] if tau is None else [tau]:
        unit = _unit_variance('', one, horizon)
        ratio = drift / unit
        variances = [float(ratio.max())] if bound else np.geomspace(ratio.min(), ratio.max(), 9)
        for variance in variances:
            errors = np.log((white + variance * unit) / (white + drift))
            error = float(np.abs(errors).max())
            if error < least - 1e-9:
                best, least = (math.sqrt(variance), one), error
    return best
