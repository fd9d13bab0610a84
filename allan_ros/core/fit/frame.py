# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the table of an axis must be fitted: what of it the five terms describe, and what else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .evidence import Evidence
from .goodness import Goodness, goodness, misfit_of
from .intervals import Score
from .point import Frame, PointFit, point_fit
from .search import Candidate, candidates
from .solve import Q

M_MIN = (1, 2, 4, 8, 16, 32, 64)
"""Smallest averaging factors that are tried, until the rest of the curve fits."""

Z_LOW_PASS = -3.0
"""A negative q that chance brings about in one of 700 records: the samples are filtered."""

MISFIT_GAIN = 0.7
"""An extra term that does not mend the fit must at least bring the misfit down to this part."""

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
    filtered : bool
        Whether q is negative: a low-pass filter hides the shortest averaging times.
    terms : tuple of Candidate
        The extra terms that were added, as the frame lists them.
    hint : Candidate or None
        What the curve below ``m_min`` looks like, if anything.
    """

    fit: PointFit
    first: Goodness
    filtered: bool = False
    terms: tuple[Candidate, ...] = ()
    hint: Candidate | None = None


def choose_frame(evidence: Evidence, axis: int) -> Chosen:
    """Return the fit of an axis in the simplest frame that describes its table.

    In turn: the five terms; q negative, as behind a low-pass filter; without the shortest
    averaging times; with a Gauss-Markov term or a line; with a fractional error of the model.
    """
    free = point_fit(evidence, axis, Frame(signed=True))
    first = goodness(free.table, free.power)
    filtered = bool(Score(free.table, Q, free.power)(0.0) < Z_LOW_PASS)
    if not first.fails:
        fit = free if filtered else point_fit(evidence, axis, Frame(), np.maximum(free.power, 0.0))
        return Chosen(fit, first, filtered)
    shorter = _without_the_shortest(evidence, axis, free)
    if shorter is not None:
        eps = misfit_of(free.table, free.power, signed=True)
        seen = candidates(free.table, free.power, eps, evidence.segments[0].samples)
        hint = seen[0] if seen and seen[0].pinned else None
        return Chosen(shorter, first, filtered, hint=hint)
    return _with_extras(evidence, axis, free, Chosen(free, first, filtered))


def _without_the_shortest(evidence: Evidence, axis: int, free: PointFit) -> PointFit | None:
    """Return the fit from the smallest factor on from which the table is described, if any."""
    for m_min in M_MIN[1:]:
        rows = free.table.rows(free.table.m >= m_min)
        if len(rows.m) <= rows.terms.shape[1]:
            return None
        fit = point_fit(evidence, axis, replace(free.frame, m_min=m_min), free.power)
        if not goodness(fit.table, fit.power).fails:
            return fit
    return None


def _with_extras(evidence: Evidence, axis: int, plain: PointFit, chosen: Chosen) -> Chosen:
    """Return the fit with the terms that mend it or at least bring the misfit well down."""
    fit, terms = plain, chosen.terms
    misfit = misfit_of(fit.table, fit.power, signed=True)
    for _ in range(MOST_EXTRAS):
        kinds = {type(t.extra) for t in terms}
        found = candidates(fit.table, fit.power, misfit, evidence.segments[0].samples)
        better = None
        for candidate in found:
            if not candidate.pinned or type(candidate.extra) in kinds:
                continue
            extras = (*fit.frame.extras, candidate.extra)
            frame = replace(plain.frame, extras=extras, misfit=misfit)
            tried = point_fit(evidence, axis, frame, fit.power)
            mended = point_fit(evidence, axis, replace(frame, misfit=0.0), tried.power)
            if not goodness(mended.table, mended.power).fails:
                return replace(chosen, fit=mended, terms=(*terms, candidate))
            left = misfit_of(tried.table, tried.power, signed=True)
            if left < MISFIT_GAIN * misfit:
                better = tried, left, candidate
                break
        if better is None:
            break
        fit, misfit, candidate = better
        terms = (*terms, candidate)
        shorter = _without_the_shortest(
            evidence, axis, replace(fit, frame=replace(fit.frame, misfit=0.0))
        )
        if shorter is not None:
            return replace(chosen, fit=shorter, terms=terms)
    frame = replace(fit.frame, misfit=misfit)
    return replace(chosen, fit=point_fit(evidence, axis, frame, fit.power), terms=terms)
