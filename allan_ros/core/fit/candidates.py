# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates for the processes of a noise model, rated by the score of the likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..allan.grid import octave
from ..noise import PROCESS_TYPES
from .likelihood import AxisData, Fit
from .limits import SHORTEST_TIME
from .statistics import Component, Floats, Statistics, contrasts

WANDER = 1e-3
"""Relative uncertainty of the frequency of a sinusoid."""

BANDWIDTHS = (1.0, 3.0)
"""Correlation times of the candidates with a frequency, in periods. Shorter ones than the first are
not allowed: they imitate a low-pass filter."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Processes that may be added, with their expectations; equal for all axes of a recording."""

    statistics: Statistics

    @cached_property
    def times(self) -> list[Component]:
        """Gauss-Markov processes with correlation times up to the longest segment."""
        most = math.log2(max(self.statistics.longest / SHORTEST_TIME, 1.0))
        return [('gauss_markov', SHORTEST_TIME * 2.0**k) for k in np.arange(0.0, most + 0.01, 0.5)]

    @cached_property
    def lines(self) -> list[Component]:
        """Sinusoids at the frequencies of the bins and between them."""
        known = self.statistics
        highest = min(known.crossover, 0.5 / known.step)
        low = np.arange(1.0, known.longest * highest, 0.5) / known.longest
        width = np.diff(known.f, append=known.f[-1:] if len(known.f) else [])
        same = np.append(np.diff(known.octave) == 0, False) if len(known.f) else width > 0
        between = (known.f + width / 2.0)[same]
        every = np.unique(np.concatenate([low, known.f, between]))
        return [('sinusoid', float(f)) for f in every if 0.0 < f < 0.49]

    @cached_property
    def broad(self) -> list[Component]:
        """Processes with frequency and correlation time, at frequencies above the block means."""
        kinds = [k for k, v in PROCESS_TYPES.items() if v.shape == ('frequency', 'time')]
        f = self.statistics.f[self.statistics.f > 2.0 * self.statistics.crossover]
        return [
            (kind, float(x), float(1.5 * c / x)) for kind in kinds for x in f for c in BANDWIDTHS
        ]

    def narrowest(self, frequency: float) -> float:
        """Return the correlation time from which a process looks like a sinusoid in the spectra.

        Its bandwidth is then a third of the width of a bin.
        """
        f, each = self.statistics.f, self.statistics.octave
        at = int(np.argmin(np.abs(f - frequency))) if len(f) else 0
        return float(octave(int(each[at]) if len(f) else 0).length)

    @property
    def by_kind(self) -> tuple[list[Component], ...]:
        """All candidates in groups of which the best one is fitted."""
        return self.times, self.lines, self.broad

    @property
    def all(self) -> list[Component]:
        return [each for group in self.by_kind for each in group]

    @cached_property
    def power(self) -> Floats:
        """Expected power of each candidate, (candidates, bins)."""
        return np.array([self.statistics.power_of(each) for each in self.all])

    @cached_property
    def covariances(self) -> list[Floats]:
        """Covariances of the contrasts of each group for the Gauss-Markov processes."""
        columns = [self.statistics.column(each).low for each in self.times]
        return [
            np.array([c[g][1:, 1:] for c in columns]) for g in range(len(self.statistics.groups))
        ]

    def alias(self, frequency: float) -> Floats:
        """Return the largest power of the alias of a sinusoid with variance 1 in each bin, (bins,).

        Only octave spectra of means have aliases. The power is 0 in spectra of samples, and in bins
        far from the frequency of the alias.
        """
        known, n = self.statistics, len(self.times)
        size = np.array([octave(o).length for o in known.octave.tolist()])
        step = np.array([octave(o).step for o in known.octave.tolist()])
        at = np.abs(frequency - np.round(frequency * step) / step)
        near = np.abs(at - known.f) < 2.0 / size + WANDER * frequency
        largest = self.power[n : n + len(self.lines)].max(axis=0)
        gain = (np.sin(np.pi * known.f) / math.sin(math.pi * frequency)) ** 2
        return np.where(near & (step > 1) & (known.f < frequency / 2.0), largest * gain, 0.0)

    @cached_property
    def slow(self) -> int:
        """Number of sinusoids in `lines` that are slow enough to change the block means."""
        return sum(f < 2.0 * self.statistics.crossover for _, f in self.lines)

    @cached_property
    def waves(self) -> list[Floats]:
        """Contrasts of a cosine and a sine of each slow sinusoid, (sinusoids, 2, contrasts).

        The sum of their squares is the covariance for a random phase.
        """
        f = np.array([each[1] for each in self.lines[: self.slow]])
        step = self.statistics.step
        gain = np.sin(np.pi * step * f) / (step * np.sin(np.pi * f)) / math.sqrt(2.0)
        out = []
        for g in self.statistics.groups:
            turns = 2.0 * np.pi * step * f[:, None] * np.arange(g.points)
            both = np.stack([np.cos(turns), np.sin(turns)], axis=1) * gain[:, None, None]
            out.append(both @ contrasts(g.points, g.high)[:, 1:])
        return out

    def gains(self, data: AxisData, fit: Fit, shortest: float, fastest: float) -> Floats:
        """Return the approximate gain in -2 log L of each candidate, (candidates,).

        Gauss-Markov processes below the correlation time ``shortest`` and sinusoids above the
        frequency ``fastest`` are not allowed.
        """
        s = fit.spectrum()
        half = data.dof[data.used] / 2.0
        c = self.power[:, data.used] / s
        score = c @ (half * (data.power[data.used] / s - 1.0))
        own = c**2 @ half
        cross = c @ (fit.columns.power / s[:, None] * half[:, None])
        n = len(self.times)
        slow = slice(n, n + self.slow)
        for group, d, e, w in zip(data.low, fit.columns.low, self.covariances, self.waves):
            v = np.linalg.inv(np.tensordot(fit.p, d, 1))
            h = v @ group.gram @ v - group.segments * v
            vd = v @ d @ v
            ve = v @ e
            score[:n] += 0.5 * np.tensordot(e, h, 2)
            own[:n] += 0.5 * group.segments * np.sum(ve * ve.transpose(0, 2, 1), (1, 2))
            cross[:n] += 0.5 * group.segments * np.tensordot(e, vd, ((1, 2), (1, 2)))
            score[slow] += 0.5 * np.sum((w @ h) * w, (1, 2))
            own[slow] += 0.5 * group.segments * np.sum((w @ v @ w.transpose(0, 2, 1)) ** 2, (1, 2))
            flat = (w[:, :, :, None] * w[:, :, None, :]).sum(1).reshape(len(w), -1)
            cross[slow] += 0.5 * group.segments * (flat @ vd.reshape(len(vd), -1).T)
        on = fit.free
        size = np.sqrt(np.maximum(np.diag(fit.information)[on], 1e-300))
        known = fit.information[np.ix_(on, on)] / np.outer(size, size) + 1e-9 * np.eye(len(on))
        cross = cross[:, on] / size
        rest = own - np.sum(cross * np.linalg.solve(known, cross.T).T, axis=1)
        left = (fit.moment - fit.information @ fit.p)[on] / size
        score = score - cross @ np.linalg.solve(known, left)
        first = np.array([each[1] for each in self.all])
        allowed = np.where(np.arange(len(first)) < n, first >= shortest, first < fastest)
        # with less information of its own, a candidate cannot be told from the model
        allowed &= (score > 0.0) & (rest > 1e-5 * own)
        return np.where(allowed, score**2 / np.where(allowed, rest, 1.0), 0.0)
