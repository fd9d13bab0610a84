# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise of one axis in the few states that a given filter has.

A filter with N and K only knows white noise and a random walk. Given the bare coefficients of a
sensor that also has bias instability, it underestimates its error. A reduction chooses the
parameters of the filter's states so that the growth of the error that the filter predicts is
nowhere below that of the complete model, over a stated range of horizons. The bias counts as known
from the longest of these horizons (see `growth`).
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
from ..noise import NoiseTerms, ProcessModel
from .growth import drift_model, has_drift, predicted_growth
from .state_space import state_space

Floats = NDArray[np.float64]
States = Literal['none', 'walk', 'gauss_markov', 'processes']

STATES: tuple[States, ...] = ('none', 'walk', 'gauss_markov', 'processes')
"""Model of the bias: nothing, a random walk, one Gauss-Markov process, or walk and processes."""

SHORTEST_HORIZON_S = 1.0
"""Lower end of a range of horizons that is given by its upper end only."""

HORIZONS_PER_RANGE = 30

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
    """A noise model with the states of a filter.

    Attributes
    ----------
    states : one of `STATES`
    white, walk : float
        N and K; K is 0 where the states have no walk, or nothing drifts.
    gauss_markov : tuple of (sigma, tau)
    horizons : Horizons
        Where the growth that the filter predicts bounds that of the complete model.
    ratio : (low, high)
        Least and largest ratio of predicted growth to that of the complete model over the horizons.
    """

    states: States
    white: float
    walk: float
    gauss_markov: tuple[tuple[float, float], ...]
    horizons: Horizons
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
    """Return the noise model that a filter with the given states should be given.

    ============  ================================================================================
    none          N is raised until white noise alone bounds the growth.
    walk          N is kept and K raised until the growth is bounded.
    gauss_markov  N is kept; of the processes that bound the growth, the closest one is taken.
    processes     Everything is kept: B becomes four Gauss-Markov processes. Only a ramp, for
                  which there is no state, raises K.
    ============  ================================================================================

    Where the result would be poor (see `Reduction.poor`), the shortest Gauss-Markov processes count
    as white noise and raise N.

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
    white, drift = _split(complete, quick)
    times, terms = horizons.times(), drift.terms
    needed = predicted_growth(drift, times, horizons.high) ** 2
    walk = 0.0
    processes: tuple[tuple[float, float], ...] = ()
    if states == 'none':
        unit = _unit_variance('N', 0.0, horizons)
        white = math.sqrt(white**2 + float(np.max(needed / unit)))
    elif states == 'gauss_markov':
        processes = closest_process(replace(drift, terms=replace(terms, N=white)), horizons)
    else:
        if states == 'processes':  # only the ramp has no state of its own
            space = state_space(replace(drift, terms=replace(terms, N=white)))
            processes = space.gauss_markov
            steady = ProcessModel(NoiseTerms(K=space.walk, R=terms.R))
            needed = predicted_growth(steady, times, horizons.high) ** 2
        unit = _unit_variance('K', 0.0, horizons)
        walk = math.sqrt(float(np.max(needed / unit)))
    made = Reduction(states, white, walk, processes, horizons, (1.0, 1.0))
    return replace(made, ratio=growth_ratio(made.model(), complete, horizons))


def growth_ratio(
    believed: ProcessModel, complete: ProcessModel, horizons: Horizons
) -> tuple[float, float]:
    """Return the least and the largest ratio of two models' growth over a range of horizons.

    (1, 1) where neither grows, infinite where only ``believed`` does.
    """
    h = horizons.times()
    top, bottom = (predicted_growth(one, h, horizons.high) for one in (believed, complete))
    if not np.any(bottom > 0.0):
        return (math.inf, math.inf) if np.any(top > 0.0) else (1.0, 1.0)
    ratio = top / bottom
    return float(ratio.min()), float(ratio.max())


def _split(model: ProcessModel, quick: int) -> tuple[float, ProcessModel]:
    """Return N with the ``quick`` shortest processes counted as white noise, and what remains."""
    by_time = sorted(model.gauss_markov, key=lambda pair: pair[1])
    added = sum(2.0 * sigma**2 * tau for sigma, tau in by_time[:quick])
    rest = replace(model, terms=replace(model.terms, N=0.0), gauss_markov=tuple(by_time[quick:]))
    return math.sqrt(model.terms.N**2 + added), rest


@lru_cache(maxsize=512)
def _unit_variance(term: str, tau: float, horizons: Horizons) -> Floats:
    """Return the variance of the error for N = 1, K = 1, or a Gauss-Markov process of sigma 1."""
    one = (
        ProcessModel(NoiseTerms(**{term: 1.0}))
        if term
        else ProcessModel(gauss_markov=((1.0, tau),))
    )
    variance = predicted_growth(one, horizons.times(), horizons.high) ** 2
    variance.setflags(write=False)
    return variance


def closest_process(
    model: ProcessModel,
    horizons: Horizons,
    tau: float | None = None,
    bound: bool = True,
) -> tuple[tuple[float, float], ...]:
    """Return the Gauss-Markov process (sigma, tau) closest to the drift of a model; () for none.

    Parameters
    ----------
    model : ProcessModel
        Its white noise hides drift at short horizons.
    horizons : Horizons
    tau : float or None
        Correlation time in s; None to choose it.
    bound : bool
        Whether the growth is nowhere below that of the model, as a filter needs it; else it is as
        far above as below, as a simulation needs it.
    """
    complete = drift_model(model)
    times = horizons.times()
    white = complete.terms.N**2 * _unit_variance('N', 0.0, horizons)
    needed = predicted_growth(complete, times, horizons.high) ** 2 - white
    if not has_drift(complete):
        return ()
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
    return (best,)


def common_correlation_time(models: Sequence[ProcessModel], horizons: Horizons) -> float | None:
    """Return the correlation time in s that suits several axes; None where nothing drifts."""
    taus = [process[1] for one in models for process in closest_process(one, horizons)]
    return math.exp(sum(math.log(tau) for tau in taus) / len(taus)) if taus else None
