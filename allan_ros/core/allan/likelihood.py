# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Restricted maximum likelihood of the means over time intervals, for tests of stationarity.

The null model of the means is white noise, bias instability and random walk, plus a constant and a
ramp. The three noise variances maximize the likelihood of the contrasts: linear combinations of the
means that do not depend on the constant and the ramp (restricted maximum likelihood: Patterson &
Thompson, Biometrika 58, 1971). A test adds an effect to this model, for example a warm-up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..deferred import lapack
from .history import Recording

Floats = NDArray[np.float64]

GROWTH = 24
"""Age of an interval divided by its length: 512 cells are pooled to about 100 intervals."""

TOLERANCE = 1e-3
"""Increase of twice the log likelihood below which an iteration ends."""


@dataclass(frozen=True)
class CellMeans:
    """Means of the samples over consecutive intervals of one recording."""

    # (intervals,) first and last edge of each interval, in cells from the start of the recording
    begin: Floats
    end: Floats
    means: Floats  # (intervals, axes)

    @classmethod
    def growing(cls, recording: Recording) -> CellMeans:
        """Return the means over intervals whose length is 1/24 of their age, at least one cell."""
        cells = len(recording.cell_samples)
        edges = [0]
        while edges[-1] < cells:
            edges.append(min(edges[-1] + max(1, edges[-1] // GROWTH), cells))
        return cls._between(recording, np.array(edges))

    @classmethod
    def even(cls, recording: Recording, most: int) -> CellMeans:
        """Return the means over at most ``most`` intervals of equal length."""
        width = 1
        while len(recording.cell_samples) > most * width:
            width *= 2
        return cls._between(recording, np.arange(0, len(recording.cell_samples) + 1, width))

    @classmethod
    def _between(cls, recording: Recording, edges: NDArray[np.int64]) -> CellMeans:
        """Return the means over the intervals that have samples in at least half of their time."""
        begin, end, number = edges[:-1], edges[1:], recording.cell_samples[: edges[-1]]
        if not len(begin):
            return cls(np.zeros(0), np.zeros(0), recording.cell_means[:0])
        samples = np.add.reduceat(number, begin)
        means = recording.cell_means[: edges[-1]]
        sums = np.add.reduceat(means * number[:, None], begin, axis=0)
        some = 2 * samples >= (end - begin) * recording.step
        mean = sums[some] / np.maximum(samples[some], 1)[:, None]
        return cls(begin[some].astype(float), end[some].astype(float), mean)

    def since(self, age: float) -> CellMeans:
        """Return the means over the intervals that begin at a given age (in cells) or later."""
        late = self.begin >= age
        return CellMeans(self.begin[late], self.end[late], self.means[late])


class VarianceModel:
    """Null model of means over given intervals: white noise, bias instability and random walk.

    Attributes
    ----------
    begin, end : (intervals,) float64 arrays
        Edges of the intervals, in cells.
    contrasts : (intervals - 2, intervals) float64 array
        Matrix that maps the means to contrasts: orthonormal, and 0 for a constant or a ramp.
    units : tuple of (intervals - 2, intervals - 2) float64 arrays
        Covariance of the contrasts for unit variance of each of the three processes.
    """

    def __init__(self, begin: Floats, end: Floats) -> None:
        self.begin, self.end = begin, end
        middle = (begin + end) / 2.0
        fixed = np.stack([np.ones(len(begin)), middle - middle.mean()], axis=1)
        basis, _ = np.linalg.qr(fixed, mode='complete')
        self.contrasts: Floats = basis[:, 2:].T
        self.units = tuple(self._of_contrasts(v) for v in self._covariances())

    def exponential(self, decay: float) -> Floats:
        """Return the contrasts of a bias exp(-age/decay), with age and decay in cells."""
        low, high = (np.exp(-age / decay) for age in (self.begin, self.end))
        return np.asarray(self.contrasts @ (decay * (low - high) / (self.end - self.begin)))

    def linear(self, duration: float) -> Floats:
        """Return the contrasts of a bias 1 - age/duration that is 0 after ``duration`` (cells)."""
        low, high = (np.minimum(age, duration) for age in (self.begin, self.end))
        area = (high - low) - (high**2 - low**2) / (2.0 * duration)
        return np.asarray(self.contrasts @ (area / (self.end - self.begin)))

    def steps(self, ages: Floats, samples: NDArray[np.int64]) -> Floats:
        """Return the contrasts of unit steps of the bias at ``ages`` in cells, (contrasts, steps).

        ``samples`` is the number of samples in each cell. It determines which fraction of an
        interval is after a step.
        """
        total = np.concatenate([[0], np.cumsum(samples)])
        begin, end = (edge.astype(int)[:, None] for edge in (self.begin, self.end))
        after = total[end] - total[np.clip(ages.astype(int), begin, end)]
        return np.asarray(self.contrasts @ (after / (total[end] - total[begin])))

    def early_walk(self, age: float) -> Floats:
        """Return the covariance of the contrasts of a unit random walk before ``age`` (in cells).

        The walk is measured backwards from its end: it is 0 from ``age`` on.
        """
        until_end = np.maximum(age - (self.begin + self.end) / 2.0, 0.0)
        return self._of_contrasts(np.minimum(until_end[:, None], until_end))

    def _of_contrasts(self, covariance: Floats) -> Floats:
        """Return the covariance of the contrasts from a covariance of the means."""
        return np.asarray(self.contrasts @ covariance @ self.contrasts.T)

    def _covariances(self) -> list[Floats]:
        """Return the covariances of the means for unit processes, up to a constant and a ramp.

        They are second differences of the generalized covariances of the phase: -|t|/2 (white
        noise), t^2 ln|t| / (2 pi) (bias instability) and |t|^3 / 12 (random walk).
        """
        ends = (self.begin, self.end)
        lags = [np.abs(x[:, None] - y) for x in ends for y in ends]
        widths = np.outer(self.end - self.begin, self.end - self.begin)
        return [
            (begins - outward - inward + last) / widths
            for begins, outward, inward, last in zip(*(_phase_covariances(t) for t in lags))
        ]


def _phase_covariances(lag: Floats) -> tuple[Floats, Floats, Floats]:
    log = np.log(np.where(lag > 0.0, lag, 1.0))
    return -lag / 2.0, lag * lag * log / (2.0 * math.pi), lag**3 / 12.0


@lru_cache(maxsize=4)
def _model(begin: tuple[float, ...], end: tuple[float, ...]) -> VarianceModel:
    return VarianceModel(np.array(begin), np.array(end))


def clear_cache() -> None:
    """Free the memory of the cached models, about 4 MB."""
    _model.cache_clear()
    _null_model.cache_clear()


def variance_model(means: CellMeans) -> VarianceModel:
    """Return the null model for the intervals of ``means``; the last four models are cached."""
    return _model(tuple(means.begin.tolist()), tuple(means.end.tolist()))


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of normally distributed contrasts for given noise variances."""

    value: float  # twice the log likelihood, without constant terms
    variances: Floats  # (components,) variances of the noise processes
    whitening: Floats  # (contrasts, contrasts) W with W C W' = 1 for the covariance C
    residual: Floats  # (contrasts,) whitened contrasts minus their expected value
    amplitudes: Floats  # (effects,) best amplitudes of the effects on the mean


def likelihood(
    values: Floats, units: Sequence[Floats], variances: Floats, effects: Floats | None = None
) -> Likelihood:
    """Return the likelihood of contrasts for given variances, with the best amplitudes of effects.

    ``values``, (contrasts,), are the contrasts of the means of one axis. Each noise process has one
    of the ``variances`` and one of the ``units``: the covariance of the contrasts, (contrasts,
    contrasts), for unit variance. ``effects``, (contrasts, effects), are the contrasts of effects
    on the mean, for an amplitude of 1.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance is not positive definite.
    """
    covariance = sum((v * u for v, u in zip(variances, units)), np.zeros_like(units[0]))
    covariance[np.diag_indices_from(covariance)] += 1e-12 * np.trace(covariance) / len(values)
    factor = np.linalg.cholesky(covariance)
    whitening: Floats = lapack.dtrtri(factor, lower=1)[0]
    white: Floats = np.asarray(whitening @ values)
    amplitudes = np.zeros(0)
    if effects is not None and effects.shape[1]:
        whitened = whitening @ effects
        amplitudes = np.asarray(np.linalg.lstsq(whitened, white, rcond=None)[0])
        white -= whitened @ amplitudes
    value = -2.0 * float(np.log(np.diag(factor)).sum()) - float(white @ white)
    return Likelihood(value, variances, whitening, white, amplitudes)


def maximum(
    values: Floats,
    units: Sequence[Floats],
    start: Floats,
    effects: Floats | None = None,
    iterations: int = 25,
) -> Likelihood:
    """Return the maximum of `likelihood` over nonnegative variances, found by Fisher scoring.

    The search begins with the variances ``start`` and takes at most ``iterations``; the other
    parameters are those of `likelihood`.
    """
    best = likelihood(values, units, start, effects)
    for _ in range(iterations):
        score, information = _score(best, units)
        free = (best.variances > 0.0) | (score > 0.0)
        if not free.any():
            break
        scale = np.sqrt(np.diag(information)[free])
        scaled = information[np.ix_(free, free)] / np.outer(scale, scale)
        scaled[np.diag_indices_from(scaled)] += 1e-9
        change = np.zeros(len(start))
        change[free] = np.linalg.solve(scaled, score[free] / scale) / scale
        found = _line_search(best, values, units, change, effects)
        if found is None:
            break
        gain, best = found.value - best.value, found
        if gain < TOLERANCE:
            break
    return best


def _score(at: Likelihood, units: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the gradient of the log likelihood in the variances, and the Fisher information."""
    inverse = at.whitening.T @ at.whitening
    weighted = at.whitening.T @ at.residual
    products = [inverse @ unit for unit in units]
    score = [float(weighted @ u @ weighted - np.trace(p)) / 2.0 for u, p in zip(units, products)]
    information = [[float(np.sum(p * q.T)) / 2.0 for q in products] for p in products]
    return np.array(score), np.array(information)


def _line_search(
    at: Likelihood, values: Floats, units: Sequence[Floats], change: Floats, effects: Floats | None
) -> Likelihood | None:
    """Return the likelihood after a step that does not decrease it, or None after ten halvings."""
    for halvings in range(10):
        new = np.maximum(at.variances + change * 0.5**halvings, 0.0)
        if not new.any():
            continue
        try:
            found = likelihood(values, units, new, effects)
        except np.linalg.LinAlgError:
            continue
        if found.value >= at.value:
            return found
    return None


STARTS = ((0.4, 0.3, 0.3), (0.9, 0.05, 0.05), (0.05, 0.05, 0.9))
"""Fractions of the total variance due to white noise, bias instability and random walk, from which
the maximum is searched."""

FIRST_ITERATIONS = 2
"""Number of iterations from each start, after which only the best is continued. On simulated
records, this lowers twice the log likelihood by at most 0.005 compared with continuing all."""


def null_model(values: Floats, model: VarianceModel) -> Likelihood | None:
    """Return the maximum likelihood of the contrasts ``values`` of one axis without any effect.

    It is None if all contrasts are 0. The last 12 results are cached.
    """
    return _null_model(values.tobytes(), model) if float(values @ values) > 0.0 else None


@lru_cache(maxsize=12)
def _null_model(data: bytes, model: VarianceModel) -> Likelihood:
    values = np.frombuffer(data)
    scale = float(values @ values) / len(values)
    sizes = np.array([np.trace(unit) / len(values) for unit in model.units])
    starts = [scale * np.array(shares) / sizes for shares in STARTS]
    first = [maximum(values, model.units, start, iterations=FIRST_ITERATIONS) for start in starts]
    best = max(first, key=lambda found: found.value)
    return maximum(values, model.units, best.variances)
