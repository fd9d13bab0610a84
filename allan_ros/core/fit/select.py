# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the table of an axis must be fitted: what of it the five terms describe, and what else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .goodness import (
    DEFICIT_LIMIT,
    Z_FAIL,
    Goodness,
    best_case_goodness,
    long_tau_deficit,
    misfit_of,
    misfit_without_deficit,
)
from .intervals import Score
from .model import Floats
from .solve import (
    NO_MISFIT,
    FitOptions,
    Misfit,
    PointFit,
    Q,
    Whitening,
    nonnegative_least_squares,
    point_fit,
    weights_at,
)
from .table import Extra, GaussMarkovTerm, PooledTable, SinusoidTerm, Table

SHAPES_PER_OCTAVE = 8
"""Shapes tried in the first search."""


LONGEST_CORRELATION = 10
"""A correlation time over a tenth of the record cannot be told from flicker and a walk."""


SHORTEST_CORRELATION = 4.0
"""Samples: a shorter one cannot be told from white noise."""


FASTEST_LINE = 0.25
"""Of the sample rate: a faster line is hidden in the first two averaging factors."""


LINE_CYCLES = 10
"""A line must pass so often in the record to be one."""


LEAST_GAIN = 12.0
"""Fall of chi^2 that chance does not bring about in any of some hundred shapes (3.5 sigma)."""


PINNED_RISE = 3.84
"""Rise of chi^2 that bounds the shape at 95 %."""


PINNED_RATIO = 2.0
"""A shape is pinned down if its interval spans less than this factor to either side."""


Kind = type[GaussMarkovTerm] | type[SinusoidTerm]


@dataclass(frozen=True)
class Candidate:
    """An extra term that the table may ask for.

    Attributes
    ----------
    extra : Extra
    low, high : float
        The 95 % interval of its shape.
    power_low, power_high : float
        Its power at the ends of that interval that are least and greatest, relative to its power.
    gain : float
        How far it brings chi^2 down.
    """

    extra: Extra
    low: float
    high: float
    power_low: float
    power_high: float
    gain: float

    @property
    def pinned(self) -> bool:
        """Whether the table asks for the term and knows its shape."""
        near = self.extra.shape / PINNED_RATIO < self.low
        return self.gain > LEAST_GAIN and near and self.high < self.extra.shape * PINNED_RATIO


def candidates(table: Table, power: Floats, misfit: Misfit, samples: int) -> list[Candidate]:
    """Return the best Gauss-Markov term and the best line, whichever gains most first.

    Parameters
    ----------
    table : Table
        Without the term to be found.
    power : (terms,) float64 array
        A fit of it.
    misfit : Misfit
        Fractional error of that fit: the weights of the comparison.
    samples : int
        Length of the longest segment.
    """
    shapes: list[tuple[Kind, float, float]] = [
        (GaussMarkovTerm, SHORTEST_CORRELATION, samples / LONGEST_CORRELATION),
        (SinusoidTerm, LINE_CYCLES / samples, FASTEST_LINE),
    ]
    search = _Search(table, power, misfit)
    found = [search.best(kind, low, high) for kind, low, high in shapes if low < high]
    return sorted(found, key=lambda c: -c.gain)


class _Search:
    """chi^2 of one table with one more term, its weights held."""

    def __init__(self, table: Table, power: Floats, misfit: Misfit) -> None:
        self.table = table
        self.whitening = Whitening.of(weights_at(table, power, misfit))
        self.columns = np.column_stack([table.terms, table.avar])
        white = self.whitening.apply(self.columns)
        self.without = _fitted(white[:, :-1], white[:, -1])[0]

    def tried(self, kind: Kind, shapes: Floats) -> tuple[Floats, Floats]:
        """Return chi^2 with the term at each shape, and its power there."""
        more = [kind(float(s)).column(self.table) for s in shapes]
        white = self.whitening.apply(np.column_stack([self.columns, *more]))
        known = self.columns.shape[1]
        terms, target = white[:, : known - 1], white[:, known - 1]
        fits = [_fitted(np.column_stack([terms, c]), target) for c in white[:, known:].T]
        chi_squared, power = np.array(fits).T
        return chi_squared, power

    def best(self, kind: Kind, low: float, high: float) -> Candidate:
        """Return the shape of least chi^2 and its interval."""
        number = int(np.log2(high / low) * SHAPES_PER_OCTAVE) + 2
        shapes = np.geomspace(low, high, number)
        at = shapes[int(np.argmin(self.tried(kind, shapes)[0]))]
        step = shapes[1] / shapes[0]
        fine = at * np.geomspace(1.0 / step, step, 2 * SHAPES_PER_OCTAVE + 1)
        fine = fine[(fine >= low) & (fine <= high)]
        near, powers = self.tried(kind, fine)
        middle = int(np.argmin(near))
        shape, least, power = float(fine[middle]), float(near[middle]), float(powers[middle])
        reach = shape * np.geomspace(1.0 / PINNED_RATIO, PINNED_RATIO, 4 * SHAPES_PER_OCTAVE + 1)
        around, powers = self.tried(kind, reach)
        inside = around < least + PINNED_RISE
        inside[len(reach) // 2] = True
        spacing = float(reach[1] / reach[0])
        relative = powers[inside] / power if power > 0.0 else np.ones(1)
        return Candidate(
            kind(shape),
            float(reach[inside].min()) / spacing,
            float(reach[inside].max()) * spacing,
            min(float(relative.min()), 1.0),
            max(float(relative.max()), 1.0),
            self.without - least,
        )


def _fitted(design: Floats, target: Floats) -> tuple[float, float]:
    """Return the least squared residual, with q of either sign, and the last power."""
    power = nonnegative_least_squares(design, target, (Q,))
    rest = target - design @ power
    return float(rest @ rest), float(power[-1])


M_MIN = (1, 2, 4, 8, 16, 32, 64)
"""Smallest averaging factors that are tried, until the rest of the curve fits."""


Z_LOW_PASS = -3.0
"""A negative q that chance brings about in one of 700 records: the samples are filtered."""


Z_LOOK = 1.0
"""A fit no worse than one in six is not looked at again, and good enough for a part of a table."""


SURE_GAIN = 21.0
"""Fall of chi^2 for one more term that chance brings about in one of 2000 records, with some
hundred shapes to choose from: enough to add it to a fit that passes."""


Z_CUT = 6.0
"""A fit rejected by less may be so by chance, and its shortest averages are what N rests on: they
are only cut off if it is worse, or the samples are filtered. What spoils them does by hundreds."""


MISFIT_GAIN = 0.7
"""An extra term that does not mend the fit must at least bring the misfit down to this part."""


CLEAR_OF_CUT = 2.0
"""An extra term is preferred to cutting the shortest averages off if it stands out at factors
this many times those that would be lost."""


MOST_EXTRAS = 2
"""Extra terms that are looked for, of different kinds."""


@dataclass(frozen=True)
class SelectedOptions:
    """The fit in the frame that was chosen, and why.

    Attributes
    ----------
    fit : PointFit
    first : Goodness
        Of the five terms on the whole table.
    z_quantization : float
        q in its standard deviations; far below 0 behind a low-pass filter.
    terms : tuple of Candidate
        The extra terms that were added, as the frame lists them.
    hint : Candidate or None
        What the curve below ``m_min`` looks like, if anything.
    """

    fit: PointFit
    first: Goodness
    z_quantization: float
    terms: tuple[Candidate, ...] = ()
    hint: Candidate | None = None
    levels_off: bool = False
    """Whether the long averages lie below what the precise part of the curve foretells."""

    @property
    def filtered(self) -> bool:
        """Whether a low-pass filter hides the shortest averaging times."""
        return self.z_quantization < Z_LOW_PASS

    @property
    def fits(self) -> bool:
        """Whether the terms describe the table."""
        return not best_case_goodness(self.fit.table, self.fit.power).fails


def select_options(evidence: PooledTable, axis: int) -> SelectedOptions:
    """Return the fit of an axis in the simplest frame that describes its table.

    In turn: the five terms; q negative, as behind a low-pass filter; with a line or a Gauss-Markov
    term; without the shortest averaging times; with a fractional error of the model. A drift that
    levels off passes all that on the strength of the shorter averages, and is asked for apart.
    """
    return _held_up(evidence, axis, _first_choice(evidence, axis))


def _held_up(evidence: PooledTable, axis: int, chosen: SelectedOptions) -> SelectedOptions:
    """Return a fit whose long averages do not sag: with a Gauss-Markov term, or a misfit."""
    fit = chosen.fit
    misfit = fit.frame.misfit
    if long_tau_deficit(fit.table, fit.power, misfit) > DEFICIT_LIMIT:
        return chosen
    for candidate in _candidates(evidence, chosen, misfit):
        added = _added(evidence, axis, chosen, candidate, misfit)
        if added.fits and long_tau_deficit(added.fit.table, added.fit.power) > DEFICIT_LIMIT:
            return added
    misfit = misfit_without_deficit(fit.table, fit.power, chosen.filtered, misfit)
    frame = replace(fit.frame, misfit=misfit)
    return replace(chosen, fit=point_fit(evidence, axis, frame, fit.power), levels_off=True)


def _first_choice(evidence: PooledTable, axis: int) -> SelectedOptions:
    """Return the simplest frame by the goodness of the fit alone."""
    free = point_fit(evidence, axis, FitOptions(signed=True))
    first = best_case_goodness(free.table, free.power)
    chosen = SelectedOptions(free, first, Score(free.table, Q, free.power)(0.0))
    if not chosen.filtered:
        plain = point_fit(evidence, axis, FitOptions(), np.maximum(free.power, 0.0))
        chosen = replace(chosen, fit=plain)
    if first.z < Z_LOOK:
        return chosen
    if not first.fails:
        sure = [c for c in _candidates(evidence, chosen, NO_MISFIT) if c.gain > SURE_GAIN]
        mended = [m for m in (_added(evidence, axis, chosen, c, NO_MISFIT) for c in sure) if m.fits]
        return mended[0] if mended else chosen
    return _mended(evidence, axis, chosen)


def _candidates(evidence: PooledTable, chosen: SelectedOptions, misfit: Misfit) -> list[Candidate]:
    """Return the terms of other kinds that the table asks for, best first."""
    have = {type(t.extra) for t in chosen.terms}
    longest = evidence.segments[0].samples
    found = candidates(chosen.fit.table, chosen.fit.power, misfit, longest)
    return [c for c in found if c.pinned and type(c.extra) not in have]


def _mended(evidence: PooledTable, axis: int, chosen: SelectedOptions) -> SelectedOptions:
    """Return the fit with what mends it, or brings the misfit well down, or with the misfit."""
    misfit = misfit_of(chosen.fit.table, chosen.fit.power, chosen.filtered)
    for _ in range(MOST_EXTRAS + 1):
        found = _candidates(evidence, chosen, misfit)
        more = [_added(evidence, axis, chosen, c, misfit) for c in found]
        shorter = None
        if chosen.filtered or chosen.first.z > Z_CUT:
            shorter = _without_the_shortest(evidence, axis, chosen.fit)
        cut = None if shorter is None else shorter.frame.m_min
        for added in more:
            # A filter looks like correlated noise of a few samples: then rather cut them off.
            if added.fits and (cut is None or added.terms[-1].extra.scale > CLEAR_OF_CUT * cut):
                return added
        if shorter is not None:
            line = next((c for c in found if isinstance(c.extra, SinusoidTerm)), None)
            return replace(chosen, fit=shorter, hint=line)
        errors = [misfit_of(a.fit.table, a.fit.power, chosen.filtered) for a in more]
        left = [error.size for error in errors]
        if not left or min(left) > MISFIT_GAIN * misfit.size:
            break
        best = int(np.argmin(left))
        chosen, misfit = more[best], errors[best]
    frame = replace(chosen.fit.frame, misfit=misfit)
    return replace(chosen, fit=point_fit(evidence, axis, frame, chosen.fit.power))


def _without_the_shortest(evidence: PooledTable, axis: int, free: PointFit) -> PointFit | None:
    """Return the fit from the smallest factor on from which the table is described, if any.

    A table that just passes may still be bent at its short end, so one that passes well is
    looked for first.
    """
    passing: PointFit | None = None
    for m_min in M_MIN[1:]:
        rows = free.table.rows(free.table.m >= m_min)
        if len(rows.m) <= rows.terms.shape[1]:
            break
        frame = replace(free.frame, m_min=m_min, signed=True, misfit=NO_MISFIT)
        fit = point_fit(evidence, axis, frame, free.power)
        z = best_case_goodness(fit.table, fit.power).z
        if z < Z_LOOK:
            return fit
        passing = fit if passing is None and z < Z_FAIL else passing
    return passing


def _added(
    evidence: PooledTable, axis: int, chosen: SelectedOptions, candidate: Candidate, misfit: Misfit
) -> SelectedOptions:
    """Return the fit with one more term."""
    frame = replace(chosen.fit.frame, extras=(*chosen.fit.frame.extras, candidate.extra))
    loose = point_fit(evidence, axis, replace(frame, misfit=misfit), chosen.fit.power)
    fit = point_fit(evidence, axis, frame, loose.power)
    return replace(chosen, fit=fit, terms=(*chosen.terms, candidate))
