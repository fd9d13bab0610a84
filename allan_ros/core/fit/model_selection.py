# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Model selection for one axis: the simplest model that describes its Allan variances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import AllanError
from .gls_solver import NO_MISFIT, FitOptions, PointFit, covariance_at, initial_variances, point_fit
from .goodness import (
    DEFICIT_LIMIT,
    Z_EXCLUDE_SHORT,
    Z_FAIL,
    Goodness,
    aic,
    best_case_goodness,
    goodness_z,
    long_tau_deficit,
    looks_filtered,
    minus_log_profile,
    misfit_of_long_averages,
    misfit_of_table,
    passes,
    passes_unfiltered,
    precise_rows,
    relative_error_of_n,
    with_model_error,
)
from .intervals import ScoreTest
from .model import RANDOM_TERMS, Floats, K, Q
from .process_search import LONGEST_CORRELATION, MAX_PROCESSES, ProcessSearch
from .processes import GaussMarkovTerm, Process, SinusoidTerm
from .table import PooledTable, Table

M_MIN = (2, 4, 8, 16, 64)
"""Smallest averaging factors that are tried if the shortest averages do not fit."""

Z_LOW_PASS = -3.0
"""Value of q, in standard errors, below which the samples are low-pass filtered. Without a filter,
one of 700 records has such a q."""

Z_GOOD = 1.0
"""Normal deviate below which a fit is not compared with fits of fewer averages; exceeded by chance
in one of six records."""

LEAST_DECREASE = 3.5
"""Decrease of chi^2 above which a model with one more process is fitted and compared by likelihood,
which is slower."""

GAUSS_MARKOV_RATIO = 11.0
"""Likelihood ratio statistic (twice the log ratio) above which a model that passes the tests gets
one more Gauss-Markov process. It is exceeded by chance on one of 200 axes."""

IMPRECISE_RATIO = 2.0
"""Largest part of the likelihood ratio statistic that may come from Allan variances of few degrees
of freedom."""

SINUSOID_RATIO = 21.0
"""The same as `GAUSS_MARKOV_RATIO` for a sinusoid; exceeded by chance in one of 2000 records."""

MAX_ERROR_RATIO = 4.0
"""Largest ratio of the relative error of N without the shortest averages to that of a fit of all
averages with a model error."""

FILTER_LIKE_SCALE = 8.0
"""A process may describe a filter if its scale is below this multiple of m_min."""

FILTER_LIKE_ERROR_RATIO = 2.0
"""Fits whose relative error of N exceeds the smallest one by this factor are not selected."""

LEAST_ERROR_OF_N = 1.1
"""Smallest possible relative error of N with free q, divided by sqrt(m_min/samples)."""

ROUNDS = 6
"""Largest number of alternations between the search and the covariance; two are usual."""

SAME_SHAPE = 0.05
"""Relative change of a shape that has a negligible effect on the covariance."""

Z_SLACK = 1.0
"""A model with processes may exceed the normal deviate of an accepted model by this value."""

BOUNDED_MARGIN = 10.0
"""Decrease of the Akaike criterion above which a bounded drift replaces a random walk."""

WALK_LIKE_OCTAVES = 4
"""Number of octaves of correlation times, from the longest one down, that may replace a random
walk."""

Z_STOP_SEARCH = 30.0
"""Normal deviate above which a search is not repeated with the covariance of its own fit."""

KEPT_SCALE = 2.0
"""If the shortest averages are excluded, processes whose scale exceeds this multiple of the
smallest averaging factor are kept."""


@dataclass(frozen=True)
class Selection:
    """The selected fit of an axis and the results of the tests that selected it.

    Attributes
    ----------
    fit : PointFit
    first : Goodness
        Chi^2 test of the five terms at all averaging times.
    z_quantization : float
        Test of q = 0 in a fit of the five terms, as a normal deviate. It is far below 0 if the
        samples are low-pass filtered.
    filtered : bool
        Whether a low-pass filter affects the shortest averaging times.
    hint : float or None
        Frequency, in cycles per sample, of a possible vibration that affects the excluded short
        averaging times; None if there is none.
    levels_off : bool
        Whether Allan variances at long averaging times are significantly lower than the model.
    """

    fit: PointFit
    first: Goodness
    z_quantization: float
    filtered: bool = False
    hint: float | None = None
    levels_off: bool = False


def select_model(pooled: PooledTable, axis: int, known: FitOptions | None = None) -> Selection:
    """Fit one axis with the simplest model that describes its Allan variances.

    The models are tried in this order: the five terms; with Gauss-Markov processes and sinusoids;
    with a negative q, as for low-pass filtered samples; without the shortest averaging times; with
    a relative model error. If the fit options are ``known``, only these are used.
    """
    free = point_fit(pooled, axis, FitOptions(signed=True))
    first = best_case_goodness(free.table, free.variances)
    z_quantization = ScoreTest(free.table, Q, free.variances)(0.0)
    selected = Selection(free, first, z_quantization, z_quantization < Z_LOW_PASS)
    if not selected.filtered:
        plain = point_fit(pooled, axis, FitOptions(), np.maximum(free.variances, 0.0))
        selected = replace(selected, fit=plain)
    if known is not None:
        fit = point_fit(pooled, axis, known, selected.fit.variances)
        selected = replace(selected, fit=fit, filtered=known.signed)
        return selected if passes(selected.fit) else _with_model_error(pooled, axis, selected)
    if first.fails or not passes(selected.fit):
        selected = _with_processes(pooled, axis, selected)
    if selected.fit.options.misfit.size == 0.0:
        selected = replace(selected, fit=_add_significant_processes(pooled, axis, selected.fit))
    return selected


def _add_significant_processes(pooled: PooledTable, axis: int, fit: PointFit) -> PointFit:
    """Add processes as long as a likelihood ratio test finds them significant."""
    # The chi^2 test of all averages has little power against a single process, because flicker and
    # a random walk together have nearly the same curve.
    for _ in range(sum(MAX_PROCESSES.values())):
        more = _add_process(pooled, axis, fit, GaussMarkovTerm)
        more = more or _add_process(pooled, axis, fit, SinusoidTerm)
        if more is None or looks_filtered(more):
            break
        fit = more
    return fit


def _add_process(
    pooled: PooledTable, axis: int, fit: PointFit, kind: type[Process]
) -> PointFit | None:
    """Add one process of the given kind; return None if none is significant."""
    is_line = kind is SinusoidTerm
    search = _search_at(pooled, axis, fit)
    found = search.fitted(fit.options.extras)
    more = search.with_one_more(found, (kind,))
    least = SINUSOID_RATIO if is_line else LEAST_DECREASE
    if more is None or found.chi_squared - more.chi_squared < least:
        return None
    try:
        new = point_fit(pooled, axis, replace(fit.options, extras=more.extras), more.variances)
        search = _search_at(pooled, axis, new)
        more = search.adjusted(search.fitted(more.extras), 2)
        new = point_fit(pooled, axis, replace(fit.options, extras=more.extras), more.variances)
        before = fit.options.table(pooled, axis, new.options.noise(new.variances))
        before = before.rows(np.isin(before.m, new.table.m))
        gain = minus_log_profile(before, fit) - minus_log_profile(new.table, new)
        if not is_line and gain > GAUSS_MARKOV_RATIO:
            precise = precise_rows(new)
            without = minus_log_profile(before.rows(precise), fit)
            gain = min(
                gain,
                IMPRECISE_RATIO + without - minus_log_profile(new.table.rows(precise), new),
            )
    except AllanError:  # the covariance is singular within its precision
        return None
    return new if gain > (SINUSOID_RATIO if is_line else GAUSS_MARKOV_RATIO) else None


def _search_at(pooled: PooledTable, axis: int, fit: PointFit) -> ProcessSearch:
    """Return a process search that uses the covariance of a given fit."""
    options = replace(fit.options, misfit=NO_MISFIT, extras=())
    table = options.table(pooled, axis, fit.options.noise(fit.variances))
    used = fit.table.rows(np.isin(fit.table.m, table.m))
    covariance = covariance_at(used, fit.variances, NO_MISFIT)
    return _search(pooled, table.rows(np.isin(table.m, used.m)), covariance, options)


def _search(
    pooled: PooledTable, table: Table, covariance: Floats, options: FitOptions
) -> ProcessSearch:
    samples = pooled.segments[0].samples
    return ProcessSearch(table, covariance, samples, signed=options.signed, walk=options.walk)


def _with_processes(pooled: PooledTable, axis: int, selected: Selection) -> Selection:
    """Return the simplest fit with processes that passes the tests, else one with a model error."""
    plain = replace(selected.fit, options=replace(selected.fit.options, signed=False))
    # Filtered samples usually need a negative q, which only the next search allows.
    best = _search_processes(pooled, axis, plain, Z_STOP_SEARCH if selected.filtered else np.inf)
    if passes_unfiltered(best):
        best = _prefer_bounded_drift(pooled, axis, best)
        return replace(selected, fit=best, filtered=False)
    filtered = selected.filtered or looks_filtered(best)
    tried = [] if looks_filtered(best) else [best]
    if selected.filtered:
        tried.append(_search_processes(pooled, axis, selected.fit))
    good = [fit for fit in tried if passes_unfiltered(fit)]
    if not good and (filtered or goodness_z(best) > Z_EXCLUDE_SHORT):
        good, tried = _exclude_short_averages(pooled, axis, selected.fit, tried or [best])
    if good:
        best_fit = next((fit for fit in good if goodness_z(fit) < Z_GOOD), good[0])
    else:
        best_fit = min(tried, key=lambda fit: (looks_filtered(fit), goodness_z(fit)))
    best_fit = _prefer_bounded_drift(pooled, axis, best_fit)
    lines = [e.shape for e in best.options.extras if isinstance(e, SinusoidTerm)]
    hidden = [f for f in lines if 1.0 / f < 2.0 * best_fit.options.m_min]
    hint = hidden[0] if hidden and best_fit.options.m_min > 1 else None
    selected = replace(selected, fit=best_fit, filtered=filtered, hint=hint)
    if good and goodness_z(best_fit) < Z_FAIL + Z_SLACK:
        return selected
    return _with_model_error(pooled, axis, selected)


def _prefer_bounded_drift(pooled: PooledTable, axis: int, fit: PointFit) -> PointFit:
    """Replace the random walk by slow Gauss-Markov processes if this fits much better."""
    # Both models describe the short averages equally well, so the few long averages decide.
    if not fit.variances[K] > 0.0:
        return fit
    without = replace(fit, options=replace(fit.options, walk=False))
    other = _search_processes(pooled, axis, without)
    z = goodness_z(fit)
    # A model that fails the test gets a model error anyway, so z is less important.
    most = max(z, Z_FAIL) + Z_SLACK if z < Z_FAIL + Z_SLACK else 2.0 * z
    # Slow sinusoids can imitate a random walk.
    more = _sinusoids(other) > _sinusoids(fit)
    if not more and goodness_z(other) <= most and aic(other) + BOUNDED_MARGIN < aic(fit):
        return other
    # The search also fits errors of the short averages, which the model error should cover.
    others = _replace_walk(pooled, axis, fit) if fit.options.misfit.size > 0.0 else []
    other = min([fit, *others], key=lambda each: aic(each, fit.options.misfit))
    gain = aic(fit, fit.options.misfit) - aic(other, fit.options.misfit)
    return other if gain > BOUNDED_MARGIN else fit


def _sinusoids(fit: PointFit) -> int:
    return sum(isinstance(extra, SinusoidTerm) for extra in fit.options.extras)


def _replace_walk(pooled: PooledTable, axis: int, fit: PointFit) -> list[PointFit]:
    """Return fits in which one slow Gauss-Markov process replaces the random walk."""
    extras = fit.options.extras
    count = sum(isinstance(extra, GaussMarkovTerm) for extra in extras)
    if count == MAX_PROCESSES[GaussMarkovTerm]:
        return []
    longest = pooled.segments[0].samples / LONGEST_CORRELATION
    out = []
    for time in longest / 2.0 ** np.arange(WALK_LIKE_OCTAVES):
        new = (*extras[:count], GaussMarkovTerm(float(time)), *extras[count:])
        try:
            options = replace(fit.options, walk=False, extras=new)
            out.append(point_fit(pooled, axis, options, fit.variances))
        except AllanError:  # the covariance is singular within its precision
            break
    return out


def _with_model_error(pooled: PooledTable, axis: int, selected: Selection) -> Selection:
    """Repeat the fit with a relative model error that makes it pass the tests."""
    fit, misfit = selected.fit, NO_MISFIT
    signed = fit.options.signed
    if goodness_z(fit) >= Z_FAIL:
        misfit = misfit_of_table(fit.table, fit.variances, signed)
    levels_off = long_tau_deficit(fit.table, fit.variances, misfit) <= DEFICIT_LIMIT
    if levels_off:
        misfit = misfit_of_long_averages(fit.table, fit.variances, signed, misfit)
    options = replace(fit.options, misfit=misfit)
    with_error = point_fit(pooled, axis, options, fit.variances)
    return replace(selected, fit=with_error, levels_off=levels_off)


def _search_processes(
    pooled: PooledTable, axis: int, fit: PointFit, largest_z: float = np.inf
) -> PointFit:
    """Search for processes and repeat the fit with them."""
    # The covariance of a model is wrong where the model fails. The first search therefore uses that
    # of the five terms, scaled to the measured curve. It is not repeated if its normal deviate
    # exceeds ``largest_z``.
    options = replace(fit.options, misfit=NO_MISFIT, extras=())
    table = options.table(pooled, axis, fit.options.noise(fit.variances))
    search = _search(pooled, table, _scaled_covariance(table), options)
    extras: tuple[Process, ...] = fit.options.extras
    for _ in range(ROUNDS):
        found = search.search(extras)
        settled = _same_shapes(found.extras, extras)
        extras = found.extras
        if not extras and settled:
            break
        try:
            fit = point_fit(pooled, axis, replace(options, extras=extras), found.variances)
        except AllanError:  # the covariance is singular within its precision
            break
        if settled or search.z(found) > largest_z:
            break
        search = _search_at(pooled, axis, fit)
    return fit


def _scaled_covariance(table: Table) -> Floats:
    """Return the covariance of a first estimate, scaled to the measured Allan variances."""
    variances = initial_variances(table)
    model = table.terms @ variances
    growth = np.where(table.avar > 0.0, table.avar, model) / model
    return np.asarray(covariance_at(table, variances, NO_MISFIT) * np.outer(growth, growth))


def _same_shapes(new: tuple[Process, ...], old: tuple[Process, ...]) -> bool:
    """Return whether both lists contain the same processes with nearly equal shapes."""
    return len(new) == len(old) and all(
        type(a) is type(b) and abs(a.shape - b.shape) <= SAME_SHAPE * b.shape
        for a, b in zip(new, old)
    )


def _exclude_short_averages(
    pooled: PooledTable, axis: int, fit: PointFit, tried: list[PointFit]
) -> tuple[list[PointFit], list[PointFit]]:
    """Return the fits without short averaging times that pass (best first), and alternatives."""
    # The alternatives are used if no fit passes. ``tried`` contains fits of all averages, which
    # fail. With a small model error, such a fit may still determine N far better than a fit of a
    # part of the averages.
    with_error = {
        relative_error_of_n(pooled, axis, each): each
        for each in (with_model_error(pooled, axis, t) for t in tried if not looks_filtered(t))
    }
    most = MAX_ERROR_RATIO * min(with_error, default=np.inf)
    start = replace(fit, options=replace(tried[0].options, signed=True))
    cuts = _fits_excluding_short(pooled, axis, start, most)
    good = {relative_error_of_n(pooled, axis, cut): cut for cut in cuts if passes_unfiltered(cut)}
    most = min(most, FILTER_LIKE_ERROR_RATIO * min(good, default=np.inf))
    best_first = sorted((_count_filter_like(cut), cut.options.m_min, e) for e, cut in good.items())
    usable = [good[e] for _, _, e in best_first if e < most]
    return usable, [with_error[min(with_error)]] if with_error else [*tried, *cuts]


def _fits_excluding_short(
    pooled: PooledTable, axis: int, start: PointFit, largest_error: float
) -> list[PointFit]:
    """Return fits that exclude more and more short averaging times, until one clearly passes."""
    out: list[PointFit] = []
    for m_min in M_MIN:
        if np.count_nonzero(start.table.m >= m_min) <= 2 * len(RANDOM_TERMS):
            break
        if LEAST_ERROR_OF_N * np.sqrt(m_min / pooled.sums.samples) > largest_error:
            break
        options = FitOptions(m_min=m_min, signed=True)
        fit = point_fit(pooled, axis, options, start.variances[: len(RANDOM_TERMS)])
        if not (passes(fit) or any(passes_unfiltered(each) for each in out)):
            kept = tuple(e for e in start.options.extras if e.scale > KEPT_SCALE * m_min)
            variances = np.append(fit.variances, np.zeros(len(kept)))
            known = PointFit(variances, fit.table, replace(options, extras=kept))
            fit = _search_processes(pooled, axis, known, Z_STOP_SEARCH)
        out.append(fit)
        if passes_unfiltered(fit) and goodness_z(fit) < Z_GOOD and not _count_filter_like(fit):
            break
    return out


def _count_filter_like(fit: PointFit) -> int:
    """Return the number of processes that may be the effect of a low-pass filter."""
    return sum(e.scale < FILTER_LIKE_SCALE * fit.options.m_min for e in fit.options.extras)
