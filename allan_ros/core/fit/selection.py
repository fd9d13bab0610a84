# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of processes: which Gauss-Markov processes, sinusoids and resonances the data need.

Processes are added one at a time. Every candidate is rated by the square of its score divided by
its information, which approximates the gain in -2 log L; the best one of each kind is fitted, its
shape is moved along its derivative, and it is kept if the gain exceeds the threshold of its kind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..allan.grid import LONGEST_BLOCK
from ..noise import RANDOM_TERMS, REPLACEMENTS, Parameter, Process
from ..noise.process import FREQUENCY, LEAST_PERIODS, Search
from .candidates import SHORTEST_TIME, Candidates, LowBandFit
from .likelihood import AxisData, Fit, Shape
from .result import N
from .statistics import Floats

MAX_PROCESSES = 6

LEAST_BINS = 8
"""Smallest number of bins for which the threshold of a search over frequencies is computed."""

LEAST_LINE_DOF = 100.0
"""Least degrees of freedom of a bin that a sinusoid dominates. With fewer, the amplitude is
inaccurate; with all, a strong sinusoid would have to be as narrow as the model."""

LINES_PER_OCTAVE = 3
"""Sinusoids within an octave that can imitate any smooth spectrum (no axis)."""

ALIASED = 0.1
"""Variance of the block means, or power of a bin, due to the alias of a fast sinusoid, relative to
noise, from which it matters."""

STRONG = 0.998
"""Share of a sinusoid in the power of a bin from which it reaches bins far from it."""

EXCLUDED = 1e-6
"""Weight of the bins that may contain the alias of a sinusoid."""

TOLERANCE = 0.03
"""Change of -2 log L below which the fit of a candidate ends."""

PROMISING = 0.4
"""Share of its threshold that the approximate gain of a candidate must reach to be fitted. It saves
time: without it, the same processes are found in records without any."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Selects the processes of the noise model of one axis, from its data and thresholds.

    Attributes
    ----------
    data : AxisData
    candidates : Candidates
    base : tuple of Process
        Components that every model contains.
    signed : tuple of int
        Coefficients that may be negative: q if the samples are low-pass filtered.
    shortest, fastest : float
        Shortest correlation time in samples, and highest frequency of a sinusoid.
    """

    data: AxisData
    candidates: Candidates
    base: tuple[Process, ...] = RANDOM_TERMS
    signed: tuple[int, ...] = ()
    shortest: float = SHORTEST_TIME
    fastest: float = 0.5

    def threshold(self, process: Process) -> float:
        """Return the least gain in -2 log L of one more process."""
        return process.threshold(max(len(self.data.power), LEAST_BINS))

    @cached_property
    def search(self) -> Search:
        """Range of shapes that the used data can tell apart."""
        return replace(self.candidates.search, shortest=self.shortest)

    def fit(self, components: Sequence[Process], p: Floats | None = None) -> Fit:
        """Return the fit of some components."""
        return self.data.solve(components, None, p, signed=self.signed, tolerance=TOLERANCE)

    def selected(self) -> tuple[Selection, Fit]:
        """Return the fit with all processes that exceed their threshold, and its rules."""
        rules, fit = self, self.fit(self.base)
        while len(fit.p) < len(self.base) + MAX_PROCESSES:
            more = rules._with_one_more(fit)
            if more is None:
                break
            rules, fit = self.weighed(more)
            if self.imitates_filter(fit):
                return rules, fit
        fewer = rules.without_superfluous(fit)
        return (rules, fit) if fewer is fit else self.weighed(fewer)

    def _with_one_more(self, fit: Fit) -> Fit | None:
        """Return the fit with the best further process, or None if none exceeds its threshold."""
        low, is_aliased = LowBandFit.all_of(self.data, fit), self._aliased(fit)
        best, least = None, math.inf
        for kind in self.candidates.kinds:
            gains = kind.gains(self.data, fit, low) * kind.allowed(self.shortest, self.fastest)
            if is_aliased and kind.first.is_line:
                gains[kind.slow] = 0.0
            threshold = self.threshold(kind.first)
            if gains.max() < PROMISING * threshold:
                continue
            seed = 1e-3 * float(np.diag(fit.information) @ fit.p) / max(len(self.data.power), 1)
            added = kind.processes[int(gains.argmax())]
            new = self.fit((*fit.components, added), np.append(fit.p, seed))
            new = self.refined(new, [len(fit.p)], 3)
            if new.value + threshold < least:
                best, least = new, new.value + threshold
        if best is None:
            return None
        best = self.refined(self._located(best), range(len(self.base), len(best.p)))
        best = self._with_limits(best)
        return best if best.value + self.threshold(best.components[-1]) < fit.value else None

    def _located(self, fit: Fit) -> Fit:
        """Return the fit with the best frequency of the last sinusoid within one bin.

        A strong one reaches the bins of the longest blocks of samples, too, where its power has
        many maxima. So the likelihood has many minima.
        """
        last = fit.components[-1]
        share = float(np.max(fit.p[-1] * fit.columns.power[:, -1] / fit.spectrum(), initial=0.0))
        if not last.is_line or share < STRONG:
            return fit
        frequency = last.shape[0]
        width = 1.0 / self.search.narrowest(frequency)
        best = fit
        for f in frequency + np.arange(-0.5 * width, 0.5 * width, 0.5 / LONGEST_BLOCK):
            if LEAST_PERIODS / self.data.statistics.longest < f < 0.499:
                moved = last.with_shape({FREQUENCY.name: float(f)})
                new = self.fit((*fit.components[:-1], moved), fit.p)
                best = min(best, new, key=lambda each: each.value)
        return best

    def _with_limits(self, fit: Fit) -> Fit:
        """Return the fit with the limits of processes that are at the end of their range.

        A resonance that is narrow in the spectra becomes a sinusoid.
        """
        search = self.search
        components = tuple(c.limit(search) for c in fit.components)
        if components == fit.components:
            return fit
        return self.refined(self.fit(components, fit.p), range(len(self.base), len(fit.p)))

    def without_superfluous(self, fit: Fit) -> Fit:
        """Remove processes that later ones have made superfluous."""
        k = len(self.base)
        while k < len(fit.p):
            process = fit.components[k]
            if not process.is_line:
                others = (*fit.components[:k], *fit.components[k + 1 :])
                rest = self.fit(others, np.maximum(np.delete(fit.p, k), 1e-9))
                if rest.value - fit.value < self.threshold(process):
                    fit, k = rest, len(self.base)
                    continue
            k += 1
        return fit

    def refined(self, fit: Fit, which: Iterable[int], rounds: int = 8) -> Fit:
        """Move the shapes of some components while the likelihood grows.

        A step of Fisher scoring of all coefficients and shapes together gives the direction.
        """
        which = list(which)
        for _ in range(rounds):
            n = len(fit.p)
            shapes = [
                Shape(k, parameter)
                for k in which
                if fit.p[k] > 0.0
                for parameter in fit.components[k].parameters
            ]
            full = self.data.solve(
                fit.components,
                self.data.columns(fit.components, shapes),
                np.append(fit.p, np.zeros(len(shapes))),
                signed=(*self.signed, *range(n, n + len(shapes))),
                rounds=1,
                tolerance=math.inf,
            )
            if not fit.value - full.value > TOLERANCE:
                break
            before = fit.value
            for size in (1.0, 0.3, 0.1):
                components = list(fit.components)
                for (k, parameter), slope in zip(shapes, full.p[n:]):
                    step = size * slope / fit.p[k]
                    components[k] = self._moved(components[k], parameter, step)
                p = np.maximum(fit.p + size * (full.p[:n] - fit.p), 1e-6 * fit.p)
                new = self.fit(components, p)
                if new.value < fit.value:
                    fit = new
                    break
            if before - fit.value < TOLERANCE:
                break
        return fit

    def _moved(self, process: Process, parameter: Parameter, step: float) -> Process:
        """Return a process of which the logarithm of one number of its shape is changed."""
        low, high = process.bounds(parameter, self.search)
        most = parameter.largest_step
        moved = process.numbers[parameter.name] * math.exp(min(max(step, -most), most))
        return process.with_shape({parameter.name: min(max(moved, low), high)})

    def _aliased(self, fit: Fit) -> bool:
        """Return whether the alias of a fast sinusoid in the block means is comparable to noise.

        The averages over M samples leave 1/(M sin(pi f)) of its amplitude, at an alias that depends
        on more digits of the frequency than the spectra determine. A slow sinusoid or a bounded
        walk cannot be told from it.
        """
        step = self.data.statistics.step
        left = (p * c.alias_variance(step) for p, c in zip(fit.p, fit.components))
        return bool(sum(left) > ALIASED * fit.p[N] / step)

    def imitates_filter(self, fit: Fit) -> bool:
        """Return whether processes have the smooth spectrum of a low-pass filter.

        They are close sinusoids, or a broad resonance near the highest frequency below which the
        spectrum bends. Six octaves below it, a filter does not bend the spectrum.
        """
        lines = (c.shape[0] for c in fit.components if c.is_line)
        f = np.log2(sorted(each for each in lines if each > self.fastest / 64.0))
        near = LINES_PER_OCTAVE - 1
        bends = self.signed or any(c.bends_spectrum for c in fit.components)
        broad = bends and any(c.is_broad_near(self.fastest) for c in fit.components)
        return bool(broad or np.any(f[near:] - f[:-near] < 1.0))

    def bounded(self, fit: Fit) -> Fit:
        """Return the fit in which processes with a shape replace terms, if the data show this.

        K is a Gauss-Markov process of infinite correlation time T; 1/T > 0 is one more coefficient.
        """
        for term, kind in REPLACEMENTS.items():
            fit = self._replaced(fit, RANDOM_TERMS.index(term()), kind)
        return fit

    def _replaced(self, fit: Fit, at: int, kind: type[Process]) -> Fit:
        """Return the fit in which a process of some kind replaces the term at an index, or not."""
        if fit.p[at] <= 0.0 or self._aliased(fit):
            return fit
        best = new = fit
        least = kind.threshold(max(len(self.data.power), LEAST_BINS))
        for process in kind.grid(self.search):
            components = (*fit.components[:at], process, *fit.components[at + 1 :])
            new = self.fit(components, new.p)
            if new.value > best.value + least:
                break
            best = min(best, new, key=lambda each: each.value)
        if fit.value - best.value < PROMISING * least:
            return fit
        best = self.refined(best, [at])
        return best if fit.value - best.value > least else fit

    def weighed(self, fit: Fit) -> tuple[Selection, Fit]:
        """Reduce the weight of bins that sinusoids dominate, and exclude bins with their aliases.

        A sinusoid is never as narrow as the model; such bins say little except its amplitude. The
        result is the selection with these weights, and its fit of the same components.
        """
        lines = [i for i, c in enumerate(fit.components) if c.is_line]
        columns = [self.data.statistics.column(c, self.data.axis).power for c in fit.components]
        parts = fit.p[:, None] * np.array(columns)
        share = np.clip(parts[lines].sum(0) / parts.sum(0), 0.0, 1.0)
        least = np.minimum(self.data.dof, LEAST_LINE_DOF)
        dof = np.maximum(self.data.dof * (1.0 - share) ** 2, least)
        other = np.maximum(parts.sum(0) - parts[lines].sum(0), 1e-300)
        for i in lines:
            alias = fit.p[i] * self.candidates.alias(fit.components[i].shape[0])
            dof = np.where(alias > ALIASED * other, EXCLUDED * dof, dof)
        rules = replace(self, data=replace(self.data, dof=dof))
        return rules, rules.fit(fit.components, fit.p)
