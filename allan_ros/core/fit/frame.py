# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the table of an axis must be fitted: what of it the five terms describe, and what else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .evidence import Evidence
from .extra import SinusoidTerm
from .goodness import (
    Z_FAIL,
    Z_SAGS,
    Goodness,
    fairest,
    misfit_of,
    misfit_that_sags_not,
    sag,
)
from .intervals import Score
from .point import Frame, PointFit, point_fit
from .search import Candidate, candidates
from .solve import Q

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
class Chosen:
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
        return not fairest(self.fit.table, self.fit.power).fails


def choose_frame(evidence: Evidence, axis: int) -> Chosen:
    """Return the fit of an axis in the simplest frame that describes its table.

    In turn: the five terms; q negative, as behind a low-pass filter; with a line or a Gauss-Markov
    term; without the shortest averaging times; with a fractional error of the model. A drift that
    levels off passes all that on the strength of the shorter averages, and is asked for apart.
    """
    return _held_up(evidence, axis, _first_choice(evidence, axis))


def _held_up(evidence: Evidence, axis: int, chosen: Chosen) -> Chosen:
    """Return a fit whose long averages do not sag: with a Gauss-Markov term, or a misfit."""
    fit = chosen.fit
    misfit = fit.frame.misfit
    if sag(fit.table, fit.power, misfit) > Z_SAGS:
        return chosen
    for candidate in _candidates(evidence, chosen, misfit):
        added = _added(evidence, axis, chosen, candidate, misfit)
        if added.fits and sag(added.fit.table, added.fit.power) > Z_SAGS:
            return added
    misfit = misfit_that_sags_not(fit.table, fit.power, chosen.filtered, misfit)
    frame = replace(fit.frame, misfit=misfit)
    return replace(chosen, fit=point_fit(evidence, axis, frame, fit.power), levels_off=True)


def _first_choice(evidence: Evidence, axis: int) -> Chosen:
    """Return the simplest frame by the goodness of the fit alone."""
    free = point_fit(evidence, axis, Frame(signed=True))
    first = fairest(free.table, free.power)
    chosen = Chosen(free, first, Score(free.table, Q, free.power)(0.0))
    if not chosen.filtered:
        plain = point_fit(evidence, axis, Frame(), np.maximum(free.power, 0.0))
        chosen = replace(chosen, fit=plain)
    if first.z < Z_LOOK:
        return chosen
    if not first.fails:
        sure = [c for c in _candidates(evidence, chosen, 0.0) if c.gain > SURE_GAIN]
        mended = [m for m in (_added(evidence, axis, chosen, c, 0.0) for c in sure) if m.fits]
        return mended[0] if mended else chosen
    return _mended(evidence, axis, chosen)


def _candidates(evidence: Evidence, chosen: Chosen, misfit: float) -> list[Candidate]:
    """Return the terms of other kinds that the table asks for, best first."""
    have = {type(t.extra) for t in chosen.terms}
    longest = evidence.segments[0].samples
    found = candidates(chosen.fit.table, chosen.fit.power, misfit, longest)
    return [c for c in found if c.pinned and type(c.extra) not in have]


def _mended(evidence: Evidence, axis: int, chosen: Chosen) -> Chosen:
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
        left = [misfit_of(a.fit.table, a.fit.power, chosen.filtered) for a in more]
        if not left or min(left) > MISFIT_GAIN * misfit:
            break
        chosen, misfit = more[int(np.argmin(left))], min(left)
    frame = replace(chosen.fit.frame, misfit=misfit)
    return replace(chosen, fit=point_fit(evidence, axis, frame, chosen.fit.power))


def _without_the_shortest(evidence: Evidence, axis: int, free: PointFit) -> PointFit | None:
    """Return the fit from the smallest factor on from which the table is described, if any.

    A table that just passes may still be bent at its short end, so one that passes well is
    looked for first.
    """
    passing: PointFit | None = None
    for m_min in M_MIN[1:]:
        rows = free.table.rows(free.table.m >= m_min)
        if len(rows.m) <= rows.terms.shape[1]:
            break
        frame = replace(free.frame, m_min=m_min, signed=True, misfit=0.0)
        fit = point_fit(evidence, axis, frame, free.power)
        z = fairest(fit.table, fit.power).z
        if z < Z_LOOK:
            return fit
        passing = fit if passing is None and z < Z_FAIL else passing
    return passing


def _added(
    evidence: Evidence, axis: int, chosen: Chosen, candidate: Candidate, misfit: float
) -> Chosen:
    """Return the fit with one more term."""
    frame = replace(chosen.fit.frame, extras=(*chosen.fit.frame.extras, candidate.extra))
    loose = point_fit(evidence, axis, replace(frame, misfit=misfit), chosen.fit.power)
    fit = point_fit(evidence, axis, frame, loose.power)
    return replace(chosen, fit=fit, terms=(*chosen.terms, candidate))
