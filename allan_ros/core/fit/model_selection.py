# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Model selection of one axis: the five terms if they describe its table, else further
processes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import AllanError
from .gls_solver import (
    NO_MISFIT,
    FitOptions,
    K,
    PointFit,
    Q,
    first_guess,
    point_fit,
    weights_at,
)
from .goodness import (
    DEFICIT_LIMIT,
    Z_CUT,
    Z_FAIL,
    Goodness,
    best_case_goodness,
    criterion,
    deviate,
    fits,
    is_good,
    long_tau_deficit,
    loosened,
    misfit_of,
    misfit_without_deficit,
    precise_rows,
    replaces_white,
    surprise,
    white_error,
)
from .intervals import Score
from .model import RANDOM_TERMS, Floats
from .process_search import LONGEST_CORRELATION, MOST, ProcessSearch
from .processes import Extra, GaussMarkovTerm, SinusoidTerm
from .table import PooledTable, Table

M_MIN = (2, 4, 8, 16, 64)
"""Smallest averaging factors that are tried if the shortest averages do not fit."""

Z_LOW_PASS = -3.0
"""A more negative q occurs by chance in one of 700 records, so the samples are filtered."""

Z_LOOK = 1.0
"""A fit that is at most this bad (one in six) needs no shorter table."""

LEAST_GAIN = 3.5
"""Decrease of chi^2 above which one more process is compared by likelihood, which is slower."""

LIKELIER = 11.0
"""Twice the log likelihood ratio for which a model that fits gets one more Gauss-Markov process.
Records of the five terms exceed it on one of two hundred axes."""

LIKELIER_SLACK = 2.0
"""Largest contribution of the longest averages to this ratio."""


LIKELIER_LINE = 21.0
"""The same for one more sinusoid: one in 2000 records."""


CUT_LOSS = 4.0
"""The shortest averages are kept if N would otherwise be less certain by more than this factor than
with a model error on the complete table."""

IMITATES = 8.0
"""Scale of a process, relative to m_min, below which it may imitate a filter."""

IMITATION_LOSS = 2.0
"""Largest factor by which N may become less certain without such processes."""

CUT_ERROR = 1.1
"""Smallest relative error of N over sqrt(m_min/samples), with free q."""

ROUNDS = 6
"""Largest number of rounds of search and covariance; shapes usually converge in two."""

SAME_SHAPE = 0.05
"""Relative change of a shape that has no effect on the covariance."""


Z_SLACK = 1.0
"""A model with processes may exceed the goodness of fit of an accepted model by this much."""

BOUNDED_MARGIN = 10.0
"""Decrease of the criterion for which a random walk is replaced by a bounded drift."""

EXCHANGED_OCTAVES = 4
"""Octaves of correlation times, from the longest one down, that may take the place of a walk."""

HOPELESS = 30.0
"""A search whose goodness of fit is worse than this is not repeated with its own covariance."""

CLEAR_OF_CUT = 2.0
"""If the shortest averages are left out, processes that peak above this many times the smallest
factor are kept."""


@dataclass(frozen=True)
class Selection:
    """The selected fit of an axis and why it was selected.

    Attributes
    ----------
    fit : PointFit
    first : Goodness
        Goodness of fit of the five terms on the complete table.
    z_quantization : float
        q of the five terms divided by its standard deviation; far below 0 with a low-pass filter.
    filtered : bool
        Whether a low-pass filter hides the shortest averaging times.
    hint : float or None
        Frequency, in cycles per sample, of a sinusoid that resembles the averages below ``m_min``.
    levels_off : bool
        Whether the long averages lie below the extrapolation of the precise part of the curve.
    """

    fit: PointFit
    first: Goodness
    z_quantization: float
    filtered: bool = False
    hint: float | None = None
    levels_off: bool = False

    @property
    def fits(self) -> bool:
        """Whether the model describes the table."""
        return fits(self.fit)


def select_model(pooled: PooledTable, axis: int, known: FitOptions | None = None) -> Selection:
    """Return the fit of an axis with the simplest model that describes its table.

    The models are tried in this order: the five terms; with Gauss-Markov processes and sinusoids;
    with a negative q, as with a low-pass filter; without the shortest averaging times; with a
    fractional model error. If fit options are ``known``, only these are used.
    """
    free = point_fit(pooled, axis, FitOptions(signed=True))
    first = best_case_goodness(free.table, free.variances)
    z_quantization = Score(free.table, Q, free.variances)(0.0)
    selected = Selection(free, first, z_quantization, z_quantization < Z_LOW_PASS)
    if not selected.filtered:
        plain = point_fit(pooled, axis, FitOptions(), np.maximum(free.variances, 0.0))
        selected = replace(selected, fit=plain)
    if known is not None:
        fit = point_fit(pooled, axis, known, selected.fit.variances)
        selected = replace(selected, fit=fit, filtered=known.signed)
        return selected if selected.fits else _with_misfit(pooled, axis, selected)
    if first.fails or not selected.fits:
        selected = _with_processes(pooled, axis, selected)
    if selected.fit.options.misfit.size == 0.0:
        selected = replace(selected, fit=_with_likely_processes(pooled, axis, selected.fit))
    return selected


def _with_likely_processes(pooled: PooledTable, axis: int, fit: PointFit) -> PointFit:
    """Add processes as long as each makes the model much more likely, and return the fit.

    chi^2 of the complete table is a weak test of one process: flicker and a random walk imitate it
    in all but a few directions, but the test sums over all directions.
    """
    for _ in range(sum(MOST.values())):
        more = _one_more(pooled, axis, fit, GaussMarkovTerm)
        more = more or _one_more(pooled, axis, fit, SinusoidTerm)
        if more is None or replaces_white(more):
            break
        fit = more
    return fit


def _one_more(pooled: PooledTable, axis: int, fit: PointFit, kind: type[Extra]) -> PointFit | None:
    """Return the fit with one more process of a kind if this is more likely, else None."""
    is_line = kind is SinusoidTerm
    search = _search_with(pooled, axis, fit)
    found = search.fitted(fit.options.extras)
    more = search.with_one_more(found, (kind,))
    least = LIKELIER_LINE if is_line else LEAST_GAIN
    if more is None or found.chi_squared - more.chi_squared < least:
        return None
    try:
        new = point_fit(pooled, axis, replace(fit.options, extras=more.extras), more.variances)
        search = _search_with(pooled, axis, new)
        more = search.adjusted(search.fitted(more.extras), 2)
        new = point_fit(pooled, axis, replace(fit.options, extras=more.extras), more.variances)
        before = fit.options.table(pooled, axis, new.options.noise(new.variances))
        before = before.rows(np.isin(before.m, new.table.m))
        gain = surprise(before, fit) - surprise(new.table, new)
        if not is_line and gain > LIKELIER:
            precise = precise_rows(new)
            without = surprise(before.rows(precise), fit)
            gain = min(gain, LIKELIER_SLACK + without - surprise(new.table.rows(precise), new))
    except AllanError:  # below the precision of the covariance: no better description
        return None
    return new if gain > (LIKELIER_LINE if is_line else LIKELIER) else None


def _search_with(pooled: PooledTable, axis: int, fit: PointFit) -> ProcessSearch:
    """Return a search with the covariance of a fit."""
    options = replace(fit.options, misfit=NO_MISFIT, extras=())
    table = options.table(pooled, axis, fit.options.noise(fit.variances))
    used = fit.table.rows(np.isin(fit.table.m, table.m))
    covariance = weights_at(used, fit.variances, NO_MISFIT)
    return _search(pooled, table.rows(np.isin(table.m, used.m)), covariance, options)


def _search(
    pooled: PooledTable, table: Table, covariance: Floats, options: FitOptions
) -> ProcessSearch:
    samples = pooled.segments[0].samples
    return ProcessSearch(table, covariance, samples, signed=options.signed, walk=options.walk)


def _with_processes(pooled: PooledTable, axis: int, selected: Selection) -> Selection:
    """Return the fit with the processes with which it passes, else the best ones and a model
    error."""
    plain = replace(selected.fit, options=replace(selected.fit.options, signed=False))
    # Filtered samples usually need a negative q, which the next search allows.
    best = _searched(pooled, axis, plain, HOPELESS if selected.filtered else np.inf)
    if is_good(best):
        best = _bounded(pooled, axis, best)
        return replace(selected, fit=best, filtered=False)
    filtered = selected.filtered or replaces_white(best)
    tried = [] if replaces_white(best) else [best]
    if selected.filtered:
        tried.append(_searched(pooled, axis, selected.fit))
    good = [fit for fit in tried if is_good(fit)]
    if not good and (filtered or deviate(best) > Z_CUT):
        good, tried = _of_a_part(pooled, axis, selected.fit, tried or [best])
    if good:
        best_fit = next((fit for fit in good if deviate(fit) < Z_LOOK), good[0])
    else:
        best_fit = min(tried, key=lambda fit: (replaces_white(fit), deviate(fit)))
    best_fit = _bounded(pooled, axis, best_fit)
    lines = [e.shape for e in best.options.extras if isinstance(e, SinusoidTerm)]
    hidden = [f for f in lines if 1.0 / f < 2.0 * best_fit.options.m_min]
    hint = hidden[0] if hidden and best_fit.options.m_min > 1 else None
    selected = replace(selected, fit=best_fit, filtered=filtered, hint=hint)
    if good and deviate(best_fit) < Z_FAIL + Z_SLACK:
        return selected
    return _with_misfit(pooled, axis, selected)


def _bounded(pooled: PooledTable, axis: int, fit: PointFit) -> PointFit:
    """Return the fit with a long Gauss-Markov process in place of the random walk, if more likely.

    Both describe the precise part of the curve equally well. The few long averages decide whether
    the drift is bounded.
    """
    if not fit.variances[K] > 0.0:
        return fit
    without = replace(fit, options=replace(fit.options, walk=False))
    other = _searched(pooled, axis, without)
    z = deviate(fit)
    # A model that fails in any case gets a model error, so z is less important.
    most = max(z, Z_FAIL) + Z_SLACK if z < Z_FAIL + Z_SLACK else 2.0 * z
    if deviate(other) <= most and criterion(other) + BOUNDED_MARGIN < criterion(fit):
        return other
    # The search weighs errors of the short averages that a model error is to absorb.
    others = _exchanged(pooled, axis, fit) if fit.options.misfit.size > 0.0 else []
    other = min([fit, *others], key=lambda each: criterion(each, fit.options.misfit))
    gain = criterion(fit, fit.options.misfit) - criterion(other, fit.options.misfit)
    return other if gain > BOUNDED_MARGIN else fit


def _exchanged(pooled: PooledTable, axis: int, fit: PointFit) -> list[PointFit]:
    """Return fits with a long Gauss-Markov process added, and the random walk left out."""
    extras = fit.options.extras
    count = sum(isinstance(extra, GaussMarkovTerm) for extra in extras)
    if count == MOST[GaussMarkovTerm]:
        return []
    longest = pooled.segments[0].samples / LONGEST_CORRELATION
    out = []
    for time in longest / 2.0 ** np.arange(EXCHANGED_OCTAVES):
        new = (*extras[:count], GaussMarkovTerm(float(time)), *extras[count:])
        try:
            options = replace(fit.options, walk=False, extras=new)
            out.append(point_fit(pooled, axis, options, fit.variances))
        except AllanError:  # beyond the precision of the covariance: not a better description
            break
    return out


def _with_misfit(pooled: PooledTable, axis: int, selected: Selection) -> Selection:
    """Return the fit with the model error with which it passes, only on the averages that need
    it."""
    fit, misfit = selected.fit, NO_MISFIT
    signed = fit.options.signed
    if deviate(fit) >= Z_FAIL:
        misfit = misfit_of(fit.table, fit.variances, signed)
    levels_off = long_tau_deficit(fit.table, fit.variances, misfit) <= DEFICIT_LIMIT
    if levels_off:
        misfit = misfit_without_deficit(fit.table, fit.variances, signed, misfit)
    options = replace(fit.options, misfit=misfit)
    loose = point_fit(pooled, axis, options, fit.variances)
    return replace(selected, fit=loose, levels_off=levels_off)


def _searched(pooled: PooledTable, axis: int, fit: PointFit, hopeless: float = np.inf) -> PointFit:
    """Return the fit with the processes that its table needs, if any.

    The first covariance is computed from the five terms and scaled to the measured curve, because
    the covariance of a fit is wrong where the fit fails. A search that fails by more than
    ``hopeless`` ends after the first round.
    """
    options = replace(fit.options, misfit=NO_MISFIT, extras=())
    table = options.table(pooled, axis, fit.options.noise(fit.variances))
    search = _search(pooled, table, _scaled_covariance(table), options)
    extras: tuple[Extra, ...] = fit.options.extras
    for _ in range(ROUNDS):
        found = search.search(extras)
        settled = _same_shapes(found.extras, extras)
        extras = found.extras
        if not extras and settled:
            break
        try:
            fit = point_fit(pooled, axis, replace(options, extras=extras), found.variances)
        except AllanError:  # below the precision of the covariance: no better description
            break
        if settled or search.z(found) > hopeless:
            break
        search = _search_with(pooled, axis, fit)
    return fit


def _scaled_covariance(table: Table) -> Floats:
    """Return the covariance of a rough fit, scaled to the measured values."""
    variances = first_guess(table)
    model = table.terms @ variances
    growth = np.where(table.avar > 0.0, table.avar, model) / model
    return np.asarray(weights_at(table, variances, NO_MISFIT) * np.outer(growth, growth))


def _same_shapes(new: tuple[Extra, ...], old: tuple[Extra, ...]) -> bool:
    """Return whether both have the same processes with almost the same shapes."""
    return len(new) == len(old) and all(
        type(a) is type(b) and abs(a.shape - b.shape) <= SAME_SHAPE * b.shape
        for a, b in zip(new, old)
    )


def _of_a_part(
    pooled: PooledTable, axis: int, fit: PointFit, tried: list[PointFit]
) -> tuple[list[PointFit], list[PointFit]]:
    """Return the good fits without the shortest averages, best first, and fits to use otherwise.

    With a small model error, the complete table may determine N far better than a part of it.

    Parameters
    ----------
    pooled : PooledTable
    axis : int
    fit : PointFit
        Fit of the five terms.
    tried : list of PointFit
        Fits of the complete table, none of them good.
    """
    loose = {
        white_error(pooled, axis, each): each
        for each in (loosened(pooled, axis, t) for t in tried if not replaces_white(t))
    }
    most = CUT_LOSS * min(loose, default=np.inf)
    start = replace(fit, options=replace(tried[0].options, signed=True))
    cuts = _without_the_shortest(pooled, axis, start, most)
    good = {white_error(pooled, axis, cut): cut for cut in cuts if is_good(cut)}
    most = min(most, IMITATION_LOSS * min(good, default=np.inf))
    best_first = sorted((_imitations(cut), cut.options.m_min, e) for e, cut in good.items())
    usable = [good[e] for _, _, e in best_first if e < most]
    return usable, [loose[min(loose)]] if loose else [*tried, *cuts]


def _without_the_shortest(
    pooled: PooledTable, axis: int, start: PointFit, most: float
) -> list[PointFit]:
    """Return fits with an increasing smallest factor, until one passes well.

    A table that barely passes may still deviate at its short end. ``most`` is the largest relative
    error of N.
    """
    out: list[PointFit] = []
    for m_min in M_MIN:
        if np.count_nonzero(start.table.m >= m_min) <= 2 * len(RANDOM_TERMS):
            break
        if CUT_ERROR * np.sqrt(m_min / pooled.sums.samples) > most:
            break
        options = FitOptions(m_min=m_min, signed=True)
        fit = point_fit(pooled, axis, options, start.variances[: len(RANDOM_TERMS)])
        if not (fits(fit) or any(is_good(each) for each in out)):
            kept = tuple(e for e in start.options.extras if e.scale > CLEAR_OF_CUT * m_min)
            known = replace(fit, options=replace(options, extras=kept))
            fit = _searched(pooled, axis, _resized(known), HOPELESS)
        out.append(fit)
        if is_good(fit) and deviate(fit) < Z_LOOK and not _imitations(fit):
            break
    return out


def _imitations(fit: PointFit) -> int:
    """Return the number of processes that may imitate a filter on the shortest averages."""
    return sum(e.scale < IMITATES * fit.options.m_min for e in fit.options.extras)


def _resized(fit: PointFit) -> PointFit:
    """Return the fit with the variances of all processes in its options set to 0."""
    variances = np.zeros(len(RANDOM_TERMS) + len(fit.options.extras))
    variances[: len(RANDOM_TERMS)] = fit.variances[: len(RANDOM_TERMS)]
    return replace(fit, variances=variances)
