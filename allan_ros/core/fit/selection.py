# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of processes: which Gauss-Markov processes, sinusoids and resonances the data need.

Method
------
Processes are added one at a time. Every candidate is rated by an approximation of its gain in
-2 log L: the square of the score divided by the information. The best candidate of each kind is
fitted, and its shape is improved. Of these fits, the selection keeps the one whose gain exceeds the
threshold of its kind by the largest amount. The search ends if no gain exceeds the threshold, after
six processes, or if the processes imitate a low-pass filter.
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
"""Largest number of processes that are added to the base of a model (`Selection.base`)."""

LEAST_BINS = 8
"""The threshold of a search over frequencies increases with the number of bins. It is computed for
at least this number of bins."""

LEAST_LINE_DOF = 100.0
"""Number to which the degrees of freedom of a bin are reduced if a sinusoid dominates in the bin.
With fewer degrees of freedom, the amplitude would be inaccurate. With all degrees of freedom of the
bin, the fit would require a strong sinusoid to be as narrow as in the model."""

LINES_PER_OCTAVE = 3
"""Number of sinusoids within an octave that can imitate any smooth spectrum. None of 2100 simulated
axes without a low-pass filter has as many within an octave."""

ALIASED = 0.1
"""Least effect of the alias of a fast sinusoid that is taken into account: the power of the alias
in a bin, or the variance of the alias in the block means, relative to the noise."""

STRONG = 0.998
"""If a sinusoid has at least this share of the power of a bin, the power that the sinusoid adds to
distant bins is considered, too."""

EXCLUDED = 1e-6
"""Factor of the degrees of freedom of bins that may contain the alias of a sinusoid: nearly 0, so
that these bins have no effect."""

TOLERANCE = 0.03
"""Change of -2 log L in one step below which a fit, or the improvement of shapes, ends."""

PROMISING = 0.4
"""A candidate is fitted only if its approximate gain is at least this fraction of the threshold.
The shape of a fitted candidate is improved only if the candidate can become the best one. Before
this improvement, the gain of the candidate is assumed to be at least this fraction of the final
gain. Both conditions save time. They do not change the false alarms in recordings without
processes."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Selects the processes of the noise model of one axis.

    Attributes
    ----------
    data : AxisData
        Statistics of the axis.
    candidates : Candidates
        Processes that may be added.
    base : tuple of Process
        Components from which every model starts. A process with a shape may replace one of them.
    signed : tuple of int
        Indices of the coefficients that may be negative: terms of a low-pass filter.
    shortest : float
        Shortest correlation time of an added process without a frequency, in samples.
    fastest : float
        Upper limit of the frequencies of the candidates for a sinusoid or a resonance, in cycles
        per sample. The frequency of a selected process is refined, and can be higher.
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
        """Properties of the data that limit the shapes of the processes."""
        return replace(self.candidates.search, shortest=self.shortest)

    def fit(self, components: Sequence[Process], p: Floats | None = None) -> Fit:
        """Return the fit of a model that consists of the given components.

        ``p``, (components,), are the coefficients to start from, in units of `AxisData.scale`.
        """
        return self.data.solve(components, None, p, signed=self.signed, tolerance=TOLERANCE)

    @cached_property
    def base_fit(self) -> Fit:
        """Fit of the components of `base` alone."""
        return self.fit(self.base)

    def selected(self) -> tuple[Selection, Fit]:
        """Return the selection and the selected fit.

        If processes were added, bins that contain sinusoids have less weight
        (`with_reduced_sinusoid_weights`).
        """
        rules, fit = self, self.base_fit
        while len(fit.p) < len(self.base) + MAX_PROCESSES:
            larger = rules._with_one_more(fit)
            if larger is None:
                break
            rules, fit = self.with_reduced_sinusoid_weights(larger)
            if self.imitates_filter(fit):
                return rules, fit
        reduced = rules.without_superfluous(fit)
        if reduced is fit:
            return rules, fit
        return self.with_reduced_sinusoid_weights(reduced)

    def _with_one_more(self, fit: Fit) -> Fit | None:
        """Return the fit with the best further process, or None if no process is added.

        A process is added only if its gain exceeds its threshold.
        """
        matrices, is_aliased = LowBandFit.all_of(self.data, fit), self._aliased(fit)
        larger_fits: list[Fit] = []
        for kind in self.candidates.kinds:
            gains = kind.gains(self.data, fit, matrices) * kind.allowed(self.shortest, self.fastest)
            if is_aliased and kind.first.is_line:
                gains[kind.slow] = 0.0
            if gains.max() < PROMISING * self.threshold(kind.first):
                continue
            start = 1e-3 * float(np.diag(fit.information) @ fit.p) / max(len(self.data.power), 1)
            process = kind.processes[int(gains.argmax())]
            larger_fits.append(self.fit((*fit.components, process), np.append(fit.p, start)))
        best, best_value = None, math.inf
        for new_fit in sorted(larger_fits, key=self._penalized):
            gain, threshold = fit.value - new_fit.value, self.threshold(new_fit.components[-1])
            if fit.value - gain / PROMISING + threshold > best_value:
                continue
            new_fit = self.refined(new_fit, [len(fit.p)], 3)
            if self._penalized(new_fit) < best_value:
                best, best_value = new_fit, self._penalized(new_fit)
        if best is None:
            return None
        best = self.refined(self._located(best), range(len(self.base), len(best.p)))
        best = self._with_limits(best)
        return best if best.value + self.threshold(best.components[-1]) < fit.value else None

    def _penalized(self, fit: Fit) -> float:
        """Return -2 log L of a fit plus the threshold of its last component."""
        return fit.value + self.threshold(fit.components[-1])

    def _located(self, fit: Fit) -> Fit:
        """Return the fit after a search for the frequency of the last component.

        Only the frequency of a strong sinusoid is searched for. Such a sinusoid also adds power to
        the bins of the longest blocks of samples, so that the likelihood has many maxima within one
        bin. Closely spaced frequencies up to half a bin away are tried.
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
                new_fit = self.fit((*fit.components[:-1], moved), fit.p)
                best = min(best, new_fit, key=lambda each: each.value)
        return best

    def _with_limits(self, fit: Fit) -> Fit:
        """Return the fit in which simpler processes replace processes whose shape is at a limit.

        A resonance that is too narrow for the spectra becomes a sinusoid.
        """
        search = self.search
        components = tuple(c.limit(search) for c in fit.components)
        if components == fit.components:
            return fit
        return self.refined(self.fit(components, fit.p), range(len(self.base), len(fit.p)))

    def without_superfluous(self, fit: Fit) -> Fit:
        """Return the fit without added processes that the other processes made superfluous.

        Sinusoids are kept.
        """
        k = len(self.base)
        while k < len(fit.p):
            process = fit.components[k]
            if not process.is_line:
                others = (*fit.components[:k], *fit.components[k + 1 :])
                reduced = self.fit(others, np.maximum(np.delete(fit.p, k), 1e-9))
                if reduced.value - fit.value < self.threshold(process):
                    fit, k = reduced, len(self.base)
                    continue
            k += 1
        return fit

    def refined(self, fit: Fit, which: Iterable[int], rounds: int = 8) -> Fit:
        """Return the fit after the shapes of some components were improved.

        ``which`` are the indices of these components. The direction of a change is a step of Fisher
        scoring for all coefficients and shapes together. The search ends when -2 log L decreases by
        less than `TOLERANCE`, at the latest after ``rounds`` steps.
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
            full_fit = self.data.solve(
                fit.components,
                self.data.columns(fit.components, shapes),
                np.append(fit.p, np.zeros(len(shapes))),
                signed=(*self.signed, *range(n, n + len(shapes))),
                rounds=1,
                tolerance=math.inf,
            )
            if not fit.value - full_fit.value > TOLERANCE:
                break
            value_before = fit.value
            for size in (1.0, 0.3, 0.1):
                components = list(fit.components)
                for (k, parameter), slope in zip(shapes, full_fit.p[n:]):
                    step = size * slope / fit.p[k]
                    components[k] = self._moved(components[k], parameter, step)
                p = np.maximum(fit.p + size * (full_fit.p[:n] - fit.p), 1e-6 * fit.p)
                new_fit = self.fit(components, p)
                if new_fit.value < fit.value:
                    fit = new_fit
                    break
            if value_before - fit.value < TOLERANCE:
                break
        return fit

    def _moved(self, process: Process, parameter: Parameter, step: float) -> Process:
        """Return a process with one shape parameter multiplied by exp(``step``).

        The step and the parameter are kept within the limits of a search.
        """
        low, high = process.bounds(parameter, self.search)
        most = parameter.largest_step
        moved = process.numbers[parameter.name] * math.exp(min(max(step, -most), most))
        return process.with_shape({parameter.name: min(max(moved, low), high)})

    def _aliased(self, fit: Fit) -> bool:
        """Return whether the alias of a fast sinusoid in the block means is comparable to noise.

        In means over M samples, a sinusoid of the frequency f keeps up to 1/(M sin(pi f)) of its
        amplitude. The frequency of the alias depends on more digits of f than the spectra
        determine. A slow sinusoid or a bounded random walk therefore cannot be distinguished from
        the alias.
        """
        step = self.data.statistics.step
        aliases = (p * c.alias_variance(step) for p, c in zip(fit.p, fit.components))
        return bool(sum(aliases) > ALIASED * fit.p[N] / step)

    def imitates_filter(self, fit: Fit) -> bool:
        """Return whether processes have the smooth spectrum of a low-pass filter.

        Such processes are several sinusoids within one octave, or a broad resonance near the
        highest frequency of a spectrum that bends. Sinusoids six octaves or more below `fastest` do
        not count, because a filter does not bend the spectrum there.
        """
        frequencies = (c.shape[0] for c in fit.components if c.is_line)
        octaves_of_lines = np.log2(sorted(f for f in frequencies if f > self.fastest / 64.0))
        further_lines = LINES_PER_OCTAVE - 1
        widths_in_octaves = octaves_of_lines[further_lines:] - octaves_of_lines[:-further_lines]
        is_bent = self.signed or any(c.bends_spectrum for c in fit.components)
        is_broad_resonance = any(c.is_broad_near(self.fastest) for c in fit.components)
        return bool((is_bent and is_broad_resonance) or np.any(widths_in_octaves < 1.0))

    def bounded(self, fit: Fit) -> Fit:
        """Return the fit in which processes with a shape replace terms, if the data show the shape.

        For example, a random walk is a Gauss-Markov process with an infinite correlation time T.
        The random walk is replaced by a bounded random walk if the data show that 1/T is above 0.
        """
        for term, kind in REPLACEMENTS.items():
            fit = self._replaced(fit, RANDOM_TERMS.index(term()), kind)
        return fit

    def _replaced(self, fit: Fit, index: int, kind: type[Process]) -> Fit:
        """Return the fit with a process of a given kind instead of a term, if this fit is better.

        ``index`` is the index of the term. If the gain does not exceed the threshold of the process
        (`Process.threshold`), ``fit`` is returned.
        """
        if fit.p[index] <= 0.0 or self._aliased(fit):
            return fit
        best = new_fit = fit
        threshold = kind.threshold(max(len(self.data.power), LEAST_BINS))
        for process in kind.grid(self.search):
            components = (*fit.components[:index], process, *fit.components[index + 1 :])
            new_fit = self.fit(components, new_fit.p)
            if new_fit.value > best.value + threshold:
                break
            best = min(best, new_fit, key=lambda each: each.value)
        if fit.value - best.value < PROMISING * threshold:
            return fit
        best = self.refined(best, [index])
        return best if fit.value - best.value > threshold else fit

    def with_reduced_sinusoid_weights(self, fit: Fit) -> tuple[Selection, Fit]:
        """Return the selection with less weight on bins that contain sinusoids, and the new fit.

        A real sinusoid is never as narrow as in the model, so that a bin in which a sinusoid
        dominates determines only the amplitude. Bins that may contain the alias of a sinusoid get
        nearly no weight. The new fit has the same components as ``fit``.
        """
        sinusoids = [i for i, c in enumerate(fit.components) if c.is_line]
        columns = [self.data.statistics.column(c, self.data.axis).power for c in fit.components]
        powers = fit.p[:, None] * np.array(columns)
        sinusoid_share = np.clip(powers[sinusoids].sum(0) / powers.sum(0), 0.0, 1.0)
        least_dof = np.minimum(self.data.dof, LEAST_LINE_DOF)
        dof = np.maximum(self.data.dof * (1.0 - sinusoid_share) ** 2, least_dof)
        other_power = np.maximum(powers.sum(0) - powers[sinusoids].sum(0), 1e-300)
        for i in sinusoids:
            alias = fit.p[i] * self.candidates.alias(fit.components[i].shape[0])
            dof = np.where(alias > ALIASED * other_power, EXCLUDED * dof, dof)
        rules = replace(self, data=replace(self.data, dof=dof))
        return rules, rules.fit(fit.components, fit.p)
