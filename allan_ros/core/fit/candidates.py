# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates of the search for processes, and the approximate gain of each candidate.

The gain in -2 log L is approximately the square of the score of a candidate, divided by its
information. Score and information are sums over the spectra and the groups of block means, minus
the parts that the components of the fit explain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..allan.grid import octave
from ..noise import SEARCHED, Process
from ..noise.process import FREQUENCY, Search
from .likelihood import RIDGE, AxisData, Fit
from .statistics import Floats, Ints, Statistics, contrasts, without_lines

SHORTEST_TIME = 2.0
"""Shortest correlation time of a Gauss-Markov process in samples. A process with a shorter
correlation time looks like white noise."""

WANDER = 1e-3
"""Assumed uncertainty of the frequency of a sinusoid, divided by this frequency. The frequency of
an alias has the same absolute uncertainty, in cycles per sample, as the frequency of the
sinusoid."""

LEAST_OWN = 1e-5
"""Least share of the Fisher information of a candidate that is independent of the components of the
fit. With a smaller share, the candidate cannot be distinguished from these components."""


class Moments(NamedTuple):
    """Derivatives of the log likelihood with respect to the coefficients of candidates, at zero."""

    score: Floats  # (candidates,) first derivatives of the log likelihood
    information: Floats  # (candidates,) Fisher information of the coefficient of each candidate

    # Fisher information between candidates and components of the fit, (candidates, components)
    shared: Floats

    def gains(self, fit: Fit) -> Floats:
        """Return the approximate gain in -2 log L of adding each candidate to a fit, (candidates,).

        The gain is 0 for a candidate whose coefficient would not be above 0, and for a candidate
        that cannot be distinguished from the components of the fit.
        """
        free = fit.free
        scale = np.sqrt(np.maximum(np.diag(fit.information)[free], 1e-300))
        scaled_information = fit.information[np.ix_(free, free)] / np.outer(scale, scale)
        scaled_information += RIDGE * np.eye(len(free))
        shared = self.shared[:, free] / scale
        own_information = self.information - np.sum(
            shared * np.linalg.solve(scaled_information, shared.T).T, axis=1
        )
        score_of_fit = (fit.moment - fit.information @ fit.p)[free] / scale
        score = self.score - shared @ np.linalg.solve(scaled_information, score_of_fit)
        is_distinct = (score > 0.0) & (own_information > LEAST_OWN * self.information)
        return np.where(is_distinct, score**2 / np.where(is_distinct, own_information, 1.0), 0.0)


@dataclass(frozen=True, eq=False)
class LowBandFit:
    """Matrices from which the moments of candidates are computed, for one group of segments.

    Attributes
    ----------
    segments : int
        Number of segments.
    inverse : (contrasts, contrasts) array
        Inverse V of the covariance of the contrasts in the fit.
    excess : (contrasts, contrasts) array
        V G V - segments V, where G is the Gram matrix of the contrasts. This matrix is twice the
        derivative of the log likelihood with respect to the covariance.
    components : (components, contrasts, contrasts) array
        V D V, where D is the covariance of a component with the coefficient 1.
    """

    segments: int
    inverse: Floats
    excess: Floats
    components: Floats

    @classmethod
    def all_of(cls, data: AxisData, fit: Fit) -> list[LowBandFit]:
        """Return the matrices of an axis for each group of segments, computed from a fit."""
        matrices = []
        for group, d in zip(data.low, fit.columns.low):
            v = np.asarray(np.linalg.inv(np.tensordot(fit.p, d, 1)), np.float64)
            matrices.append(
                cls(group.segments, v, v @ group.gram @ v - group.segments * v, v @ d @ v)
            )
        return matrices

    def moments_of(self, covariances: Floats) -> Moments:
        """Return the moments of candidates from their covariances.

        ``covariances``, (candidates, contrasts, contrasts), are the covariances of the contrasts
        for the coefficient 1, in units of `AxisData.scale`.
        """
        v, half_segments = self.inverse @ covariances, 0.5 * self.segments
        return Moments(
            0.5 * np.tensordot(covariances, self.excess, 2),
            half_segments * np.sum(v * v.transpose(0, 2, 1), (1, 2)),
            half_segments * np.tensordot(covariances, self.components, ((1, 2), (1, 2))),
        )

    def moments_of_sinusoids(self, waves: Floats) -> Moments:
        """Return the moments of sinusoids; the covariance of the contrasts of a sinusoid is w'w.

        ``waves``, (candidates, 2, contrasts), has the matrix w of each sinusoid: the contrasts of
        its cosine and of its sine, for the coefficient 1. The covariances are in units of
        `AxisData.scale`.
        """
        quadratic_forms = waves @ self.inverse @ waves.transpose(0, 2, 1)
        half_segments = 0.5 * self.segments
        covariances = (waves[:, :, :, None] * waves[:, :, None, :]).sum(1).reshape(len(waves), -1)
        return Moments(
            0.5 * np.sum((waves @ self.excess) * waves, (1, 2)),
            half_segments * np.sum(quadratic_forms**2, (1, 2)),
            half_segments * (covariances @ self.components.reshape(len(self.components), -1).T),
        )


@dataclass(frozen=True, eq=False)
class Kind:
    """All candidates of one kind of process, with the expected statistics of each.

    Attributes
    ----------
    processes : sequence of Process
        Candidates of one class, at least one.
    statistics : Statistics
        Statistics of a recording.
    """

    processes: Sequence[Process]
    statistics: Statistics

    @property
    def first(self) -> Process:
        """The first candidate, which represents the kind where the shape does not matter."""
        return self.processes[0]

    @cached_property
    def number(self) -> Floats:
        """First shape parameter of each candidate, (candidates,).

        This parameter is a correlation time in samples, or a frequency in cycles per sample.
        """
        return np.array([each.shape[0] for each in self.processes])

    @cached_property
    def power(self) -> Floats:
        """Expected power of each candidate with the coefficient 1, (candidates, bins).

        The power has the squared unit of the coefficient.
        """
        return np.array([self.statistics.power_of(each) for each in self.processes])

    @cached_property
    def slow(self) -> Ints:
        """Indices, (k,), of the candidates whose effect on block means is included in a search.

        The effect of the other candidates on block means is neglected.
        """
        if self.first.low_band == 'dense':
            return np.arange(len(self.processes))
        if self.first.low_band == 'none':
            return np.arange(0)
        return np.flatnonzero(self.number < 2.0 * self.statistics.crossover)

    @cached_property
    def covariances(self) -> list[Floats]:
        """Covariances of the contrasts for the k slow candidates, for each group of segments.

        Each array is (k, contrasts, contrasts). The covariances are computed for the coefficient 1
        and have the squared unit of the coefficient.
        """
        known = self.statistics
        low = [known.column(self.processes[i]).low for i in self.slow.tolist()]
        return [np.array(group) for group in zip(*(without_lines(a, known.sizes) for a in low))]

    @cached_property
    def waves(self) -> list[Floats]:
        """Contrasts of a cosine and a sine of each slow sinusoid, for each group of segments.

        Each array is (sinusoids, 2, contrasts). The outer product of the cosine plus the outer
        product of the sine is the covariance of a sinusoid with random phase and the coefficient 1,
        in the squared unit of the coefficient.
        """
        f, step = self.number[self.slow], self.statistics.step
        gain = np.sin(np.pi * step * f) / (step * np.sin(np.pi * f)) / math.sqrt(2.0)
        contrasts_of_groups = []
        for g in self.statistics.groups:
            turns = 2.0 * np.pi * step * f[:, None] * np.arange(g.size.points)
            wave_means = np.stack([np.cos(turns), np.sin(turns)], axis=1) * gain[:, None, None]
            contrasts_of_groups.append(wave_means @ contrasts(g.size)[:, g.size.lines :])
        return contrasts_of_groups

    def gains(self, data: AxisData, fit: Fit, low: Sequence[LowBandFit]) -> Floats:
        """Return the approximate gain in -2 log L of each candidate, (candidates,).

        ``low`` are the matrices of the axis for each group of segments, computed from ``fit``.
        """
        return self.moments(data, fit, low).gains(fit)

    def moments(self, data: AxisData, fit: Fit, low: Sequence[LowBandFit]) -> Moments:
        """Return score and Fisher information of all candidates; the arguments are as in `gains`.

        The score is the derivative of the log likelihood with respect to the coefficient of a
        candidate, at the coefficient 0.
        """
        s, half_dof = fit.spectrum(), data.dof[data.used] / 2.0
        relative_power = self.power[:, data.used] / s
        moments = Moments(
            relative_power @ (half_dof * (data.power[data.used] / s - 1.0)),
            relative_power**2 @ half_dof,
            relative_power @ (fit.columns.power / s[:, None] * half_dof[:, None]),
        )
        for group, matrices in enumerate(low if len(self.slow) else ()):
            if self.first.low_band == 'dense':
                low_moments = matrices.moments_of(self.covariances[group])
            else:
                low_moments = matrices.moments_of_sinusoids(self.waves[group])
            for total, part in zip(moments, low_moments):
                total[self.slow] += part
        return moments

    def allowed(self, shortest: float, fastest: float) -> Floats:
        """Return 1 for each candidate within the limits of a search, and 0 for others.

        The result is (candidates,). Frequencies must be below ``fastest``, in cycles per sample.
        Correlation times of processes without a frequency must be at least ``shortest``, in
        samples.
        """
        has_frequency = FREQUENCY in self.first.parameters
        is_allowed = self.number < fastest if has_frequency else self.number >= shortest
        return is_allowed.astype(float)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Processes that a fit may add, with the expected statistics of each.

    Axes with the same `Statistics` share one object.
    """

    statistics: Statistics

    @cached_property
    def search(self) -> Search:
        """Properties of the data that limit the shapes of the candidates."""
        statistics = self.statistics
        block = np.array([octave(o).length for o in statistics.octave.tolist()], float)
        return Search(
            statistics.longest,
            statistics.step,
            statistics.crossover,
            statistics.f,
            block,
            SHORTEST_TIME,
        )

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """All kinds of processes that have at least one candidate."""
        grids = (list(kind.grid(self.search)) for kind in SEARCHED)
        return tuple(Kind(grid, self.statistics) for grid in grids if grid)

    def alias(self, frequency: float) -> Floats:
        """Return the largest power in each bin, (bins,), of the alias of a sinusoid of amplitude 1.

        ``frequency`` is the frequency of the sinusoid in cycles per sample. Only octave spectra of
        means have aliases. The power is 0 in spectra of samples, in bins far from the frequency of
        the alias, and in bins from half of ``frequency`` on.
        """
        statistics = self.statistics
        size = np.array([octave(o).length for o in statistics.octave.tolist()])
        step = np.array([octave(o).step for o in statistics.octave.tolist()])
        alias_frequency = np.abs(frequency - np.round(frequency * step) / step)
        is_near = np.abs(alias_frequency - statistics.f) < 2.0 / size + WANDER * frequency
        largest_power = np.max(
            [kind.power.max(axis=0) for kind in self.kinds if kind.first.is_line], 0
        )
        gain = (np.sin(np.pi * statistics.f) / math.sin(math.pi * frequency)) ** 2
        return np.where(
            is_near & (step > 1) & (statistics.f < frequency / 2.0), largest_power * gain, 0.0
        )
