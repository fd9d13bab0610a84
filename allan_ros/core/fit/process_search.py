# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Search for the fewest Gauss-Markov processes and sinusoids that describe Allan variances.

With a fixed covariance, the best variances for given correlation times and frequencies (shapes) are
a nonnegative least-squares problem, which is convex. The search adds the process that decreases
chi^2 most, adjusts all shapes in turn, and stops when one more process is not significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .gls_solver import Whitening, nonnegative_least_squares
from .goodness import Z_FAIL, degrees_of_freedom
from .model import RANDOM_TERMS, B, Floats, K, N, Q
from .processes import GaussMarkovTerm, Process, SinusoidTerm
from .table import Table

SHAPES_PER_OCTAVE = 6
"""Number of shapes per octave on the grid of the first search."""

SHORTEST_CORRELATION = 0.3
"""Shortest correlation time in samples. White noise after a first-order filter is a process with a
short correlation time, so such a process reveals the filter."""

SHORTEST_IN_M_MIN = 4.0
"""Shortest correlation time, as a multiple of the smallest averaging factor, if shorter averages
are excluded."""

LONGEST_CORRELATION = 8
"""Length of the longest segment divided by the longest correlation time. Processes with longer ones
cannot be distinguished from a random walk and a ramp."""

FASTEST_SINUSOID = 0.5
"""Highest frequency of a sinusoid, in cycles per smallest averaging time. A lower limit would
replace a strong sinusoid near 0.5 by others that do not exist."""

SINUSOID_PERIODS = 2.5
"""Smallest number of periods of a sinusoid in the longest segment. A cycle of fewer periods cannot
be distinguished from a random walk."""

MAX_PROCESSES = {GaussMarkovTerm: 3, SinusoidTerm: 3}
"""Largest number of processes of each kind."""

REJECTED_GAIN = 12.0
"""Smallest decrease of chi^2 for which one more process is added while the model is rejected. By
chance it does not occur among some hundred shapes (3.5 standard deviations)."""

ACCEPTED_GAIN = 21.0
"""The same if the model is not rejected; it occurs by chance in one of 2000 records."""

NO_WALK_GAIN = 6.0
"""The same for a Gauss-Markov process of a model without a random walk, which is later compared
with a model that has one."""

STRONG_GAIN = 1000.0
"""Decrease of chi^2 above which several shapes are refined before one is chosen. Between the shapes
of the first search, chi^2 of a strong sinusoid may be far lower than at all of them."""

STRONG_STARTS = 4
"""Number of these shapes."""

NEGLIGIBLE_WHITE = 0.05
"""Fraction of the Allan variance below which white noise may be omitted while a process is
selected."""

SWEEPS = 4
"""Largest number of rounds in which all shapes are adjusted in turn."""

FINE = 8
"""Number of shapes between two neighbors of the grid when the shape of a Gauss-Markov process is
refined."""

SINUSOID_FINE = 32
"""The same for a sinusoid. Near the frequency of a strong sinusoid, chi^2 has many minima."""

ZOOM = 4.0
"""Factor by which the resolution increases in each round of a refinement."""

SINUSOID_ZOOMS = 9
"""Largest number of these rounds for a sinusoid. The data determine the frequency of a strong
sinusoid to one part in a million."""

NEGLIGIBLE_GAIN = 0.05
"""Change of chi^2 below which the adjustment of shapes stops."""


@dataclass(frozen=True)
class ProcessFit:
    """The best fit of given processes and the four random terms with a fixed covariance.

    Attributes
    ----------
    extras : tuple of Process
        Gauss-Markov processes before sinusoids.
    variances : (4 + extras,) float64 array
        Variance coefficients of the terms and the processes.
    chi_squared : float
        Sum of the squared whitened residuals.
    """

    extras: tuple[Process, ...]
    variances: Floats
    chi_squared: float


class ProcessSearch:
    """Search for Gauss-Markov processes and sinusoids that describe measured Allan variances.

    Parameters
    ----------
    table : Table
        Allan variances with the columns of the four random terms.
    covariance : (factors, factors) float64 array
        Covariance of the Allan variances; it is not changed by the search.
    samples : int
        Length of the longest segment in samples.
    signed : bool
        Whether q (quantization) may be negative.
    walk : bool
        Whether k (random walk) may differ from 0.
    """

    def __init__(
        self,
        table: Table,
        covariance: Floats,
        samples: int,
        *,
        signed: bool,
        walk: bool,
    ) -> None:
        self.table, self.signed = table, signed
        self.freedom = degrees_of_freedom(covariance)
        self._to_white = Whitening.of(covariance).apply(np.eye(len(table.m)))
        self._terms, self._target = self._to_white @ table.terms, self._to_white @ table.avar
        if not walk:
            self._terms[:, K] = 0.0
        self._walk = walk
        shortest = SHORTEST_CORRELATION if table.m[0] == 1 else SHORTEST_IN_M_MIN
        least = shortest * float(table.m[0])
        drifts = _spaced(least, samples / LONGEST_CORRELATION)
        lines = _spaced(SINUSOID_PERIODS / samples, FASTEST_SINUSOID / float(table.m[0]))
        self._grid: list[Process] = [GaussMarkovTerm(float(t)) for t in drifts]
        self._grid += [SinusoidTerm(float(f)) for f in lines]
        self._columns = self._whitened_columns(self._grid)
        self._of_kind = {
            kind: np.array([isinstance(e, kind) for e in self._grid], bool)
            for kind in (GaussMarkovTerm, SinusoidTerm)
        }

    def _whitened_columns(self, extras: Sequence[Process]) -> Floats:
        """Return the whitened columns of processes, (rows, processes)."""
        if not extras:
            return np.zeros((len(self._target), 0))
        return self._to_white @ self.table.columns(extras)

    def fitted(self, extras: Sequence[Process]) -> ProcessFit:
        """Return the fit of given processes and the four random terms."""
        design = np.column_stack([self._terms, self._whitened_columns(extras)])
        variances = nonnegative_least_squares(design, self._target, (Q,) if self.signed else ())
        residual = self._target - design @ variances
        return ProcessFit(tuple(extras), variances, float(residual @ residual))

    def search(self, start: Sequence[Process] = ()) -> ProcessFit:
        """Return the fit with the fewest processes that describe the data.

        The search begins with the processes ``start`` and removes insignificant ones.
        """
        found = self._remove_insignificant(self.adjusted(self.fitted(start)))
        while True:
            more = self.with_one_more(found)
            if more is None or found.chi_squared - more.chi_squared < self._least_decrease(found):
                return self.adjusted(self._add_drift_process(found), SWEEPS)
            found = more

    def _remove_insignificant(self, found: ProcessFit) -> ProcessFit:
        """Remove the processes that are not significant."""
        while found.extras:
            without = [self._remove_process(found, out) for out in range(len(found.extras))]
            gains = [less.chi_squared - found.chi_squared for less in without]
            excess = [
                gain - self._least_decrease(less, extra)
                for gain, less, extra in zip(gains, without, found.extras)
            ]
            if min(excess) > 0.0:
                break
            found = self.adjusted(without[int(np.argmin(excess))])
        return found

    def _remove_process(self, found: ProcessFit, out: int) -> ProcessFit:
        """Remove the process at index ``out`` and fit again."""
        # A sinusoid close to a removed one is adjusted.
        kept = [e for k, e in enumerate(found.extras) if k != out]
        less = self.fitted(kept)
        gone = found.extras[out]
        for k, other in enumerate(kept):
            near = abs(np.log2(other.shape / gone.shape)) * SHAPES_PER_OCTAVE < 1.0
            if isinstance(gone, SinusoidTerm) and isinstance(other, SinusoidTerm) and near:
                less = self._adjust_process(less, k, everywhere=False)
        return less

    def _add_drift_process(self, found: ProcessFit) -> ProcessFit:
        """Add a Gauss-Markov process to a model without random walk, if chi^2 decreases enough."""
        if self._walk:
            return found
        more = self.with_one_more(found, (GaussMarkovTerm,))
        enough = more is not None and found.chi_squared - more.chi_squared > NO_WALK_GAIN
        return more if more is not None and enough else found

    def z(self, found: ProcessFit) -> float:
        """Return the standardized chi^2 of a fit, (chi^2 - nu) / sqrt(2 nu)."""
        freedom = max(self.freedom - np.count_nonzero(found.variances) - len(found.extras), 1.0)
        return float((found.chi_squared - freedom) / np.sqrt(2.0 * freedom))

    def _least_decrease(self, found: ProcessFit, extra: Process | None = None) -> float:
        """Return the decrease of chi^2 above which one more process is significant."""
        if isinstance(extra, GaussMarkovTerm) and not self._walk:
            return NO_WALK_GAIN
        return REJECTED_GAIN if self.z(found) >= Z_FAIL else ACCEPTED_GAIN

    def with_one_more(
        self,
        found: ProcessFit,
        kinds: Sequence[type[Process]] = (GaussMarkovTerm, SinusoidTerm),
    ) -> ProcessFit | None:
        """Return the best fit with one more process of ``kinds``.

        Correlation times and frequencies of all processes are adjusted. Returns None if no process
        decreases chi^2, or the fit has `MAX_PROCESSES` of each kind.
        """
        allowed = np.zeros(len(self._grid), bool)
        for kind in kinds:
            if sum(isinstance(e, kind) for e in found.extras) < MAX_PROCESSES[kind]:
                allowed |= self._of_kind[kind]
        at = np.flatnonzero(allowed)
        if not len(at):
            return None
        chi_squared = self._chi_squared_with(found.extras, found.variances, self._columns[:, at])
        least = float(chi_squared.min())
        if not np.isfinite(least):
            return None
        tried = [int(np.argmin(chi_squared))]
        if found.chi_squared - least > STRONG_GAIN:
            around = np.concatenate([[np.inf], chi_squared, [np.inf]])
            lowest = (chi_squared <= around[:-2]) & (chi_squared <= around[2:])
            minima = np.flatnonzero(lowest & np.isfinite(chi_squared))
            tried = minima[np.argsort(chi_squared[minima])][:STRONG_STARTS].tolist()
        more = [self._add_process(found, self._grid[at[k]], refined=len(tried) > 1) for k in tried]
        return self.adjusted(min(more, key=lambda each: each.chi_squared))

    def _add_process(self, found: ProcessFit, extra: Process, refined: bool) -> ProcessFit:
        """Add a process and fit again; adjust its correlation time or frequency if refined."""
        extras = _sorted([*found.extras, extra])
        more = self.fitted(extras)
        if not refined:
            return more
        return self._adjust_process(more, extras.index(extra), everywhere=False)

    def adjusted(self, found: ProcessFit, sweeps: int = 1) -> ProcessFit:
        """Improve each correlation time and frequency in turn, up to ``sweeps`` times."""
        for sweep in range(sweeps):
            before = found.chi_squared
            for k in range(len(found.extras)):
                found = self._adjust_process(found, k, everywhere=sweep == 0)
            if before - found.chi_squared < NEGLIGIBLE_GAIN:
                break
        return found

    def _adjust_process(self, found: ProcessFit, k: int, everywhere: bool) -> ProcessFit:
        """Choose the best correlation time or frequency of process k and fit again."""
        # Without ``everywhere``, only values near the present one are searched.
        best = found.extras[k]
        others = [e for n, e in enumerate(found.extras) if n != k]
        variances = np.delete(found.variances, len(RANDOM_TERMS) + k)
        kind = self._of_kind[type(best)]
        grid = [e for e, here in zip(self._grid, kind) if here]
        if not grid:  # too few averages to adjust the shape
            return found
        if everywhere:
            coarse = self._chi_squared_with(others, variances, self._columns[:, kind])
            if coarse.min() < found.chi_squared - NEGLIGIBLE_GAIN:
                best = grid[int(np.argmin(coarse))]
        active = tuple(c for c in (B, K) if found.variances[c] > 0.0)
        step = 2.0 ** (1.0 / SHAPES_PER_OCTAVE)
        low, high = grid[0].shape, grid[-1].shape
        points, zooms = (
            (SINUSOID_FINE, SINUSOID_ZOOMS) if isinstance(best, SinusoidTerm) else (FINE, 2)
        )
        last = np.inf
        for zoom in range(zooms):
            reach = step ** (ZOOM**-zoom)
            shapes = best.shape * np.geomspace(1.0 / reach, reach, 2 * points + 1)
            fine = [replace(best, shape=float(s)) for s in np.clip(shapes, low, high)]
            chi_squared = self._chi_squared_with(
                others, variances, self._whitened_columns(fine), (active,)
            )
            least = float(chi_squared.min())
            if not np.isfinite(least):
                break
            best = fine[int(np.argmin(chi_squared))]
            if zoom > 0 and last - least < NEGLIGIBLE_GAIN:
                break
            last = least
        changed = self.fitted(_sorted([*others, best]))
        return changed if changed.chi_squared < found.chi_squared else found

    def _chi_squared_with(
        self,
        extras: Sequence[Process],
        variances: Floats,
        candidates: Floats,
        actives: Sequence[tuple[int, ...]] = ((), (B,), (K,), (B, K)),
    ) -> Floats:
        """Return chi^2 of the fit with each candidate column added, (candidates,)."""
        # It is infinite if a coefficient becomes negative. Each of ``actives`` lists which of
        # flicker and random walk may differ from 0; the smallest chi^2 is returned.
        known = np.column_stack([self._terms, self._whitened_columns(extras)])
        least = np.full(candidates.shape[1], np.inf)
        # A small white noise coefficient could become negative next to another process.
        white = self.table.terms[:, N] * variances[N]
        is_small = bool(np.all(white < NEGLIGIBLE_WHITE * self.table.avar))
        optional = (Q, N, B, K) if is_small else (Q, B, K)
        certain = [c for c in range(known.shape[1]) if c not in optional]
        if self.signed or variances[Q] != 0.0:
            certain.append(Q)
        for some in actives if self._walk else [each for each in actives if K not in each]:
            active = sorted((*certain, *some))
            basis, upper = np.linalg.qr(known[:, active] / self._scale(known[:, active]))
            residual = self._target - basis @ (basis.T @ self._target)
            shared = basis.T @ candidates
            alone = np.sum(candidates**2, axis=0) - np.sum(shared**2, axis=0)
            along = candidates.T @ residual
            share = along / np.maximum(alone, 1e-12 * np.sum(candidates**2, axis=0))
            free = [n for n, c in enumerate(active) if c == Q]
            other = np.linalg.solve(upper, (basis.T @ self._target)[:, None] - shared * share)
            other[free] = 0.0
            possible = (share > 0.0) & (other >= 0.0).all(axis=0)
            chi_squared = residual @ residual - along * share
            least = np.where(possible, np.minimum(least, chi_squared), least)
        return least

    @staticmethod
    def _scale(columns: Floats) -> Floats:
        size = np.sqrt(np.sum(columns**2, axis=0))
        return np.where(size > 0.0, size, 1.0)


def _spaced(low: float, high: float) -> Floats:
    """Return logarithmically spaced values; none if low >= high."""
    if low >= high:
        return np.zeros(0)
    return np.geomspace(low, high, int(np.log2(high / low) * SHAPES_PER_OCTAVE) + 2)


def _sorted(extras: Sequence[Process]) -> list[Process]:
    """Return the Gauss-Markov processes, then the sinusoids, each sorted by its shape."""
    return sorted(extras, key=lambda e: (isinstance(e, SinusoidTerm), e.shape))
