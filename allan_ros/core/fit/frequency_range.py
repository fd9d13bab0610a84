# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection of the noise model of one axis, and of the highest frequency that the model describes.

Low-pass filter
---------------
A low-pass filter in the sensor removes power at high frequencies. No noise type describes this loss
of power. Such an axis is fitted only below the highest frequency for which the model passes its
tests. In this fit, the terms in f^2 (quantization noise) and in f^4 may be negative, and describe
the remaining effect of the filter. If the model passes for no frequency, octaves that differ from
the model get less weight.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..allan.grid import octave
from ..noise import RANDOM_TERMS, Process
from ..noise.process import GAIN_RESOLVED
from .candidates import Candidates
from .likelihood import AxisData, Fit, inverse
from .result import LackOfFit, N, Q
from .selection import EXCLUDED, Selection
from .statistics import LowPassCurvature

LACK_OF_FIT = 1e-3
"""Probability in a chi-squared test of the deviance of an octave, or of all octaves, below which a
model is rejected. The probability for an octave is first multiplied by the number of octaves.
Measured false alarms: 0.1 % of 2100 axes."""

CURVATURE = 2.5
"""A low-pass filter is assumed if the coefficient of f^2 in the spectrum is below 0 by more than
this number of its standard errors. The expected rate of false alarms is 0.6 % (one-sided). A filter
was found on 0.4 % of 2100 axes without a filter. If the fit allows a negative coefficient of f^2,
the magnitude of the coefficient of f^4 is tested instead."""

LEAST_BINS = 12
"""Fewest bins of a fit that does not use all frequencies."""

WHITE_NOISE = 3.0
"""Least ratio of the variance of the white noise to the standard error of this variance in a model
that passes its tests. The rate of false alarms that is stated at `CURVATURE` includes this test."""

LOST_POWER = 0.8, 0.5
"""Least ratios of the power in the highest octave of a fit to the power two octaves lower, for a
spectrum that looks low-pass filtered. The first number is for the fit of all frequencies, the
second for fits of fewer frequencies. If the ratio for the fit of all frequencies is too small, this
fit and the next fits of fewer frequencies are skipped until the ratio is large enough. In a skipped
fit, several processes might imitate the filter, and the fit would take up to four times as long.
There are two exceptions: the fit of the lowest frequencies is never skipped, and the fit of all
frequencies is tried if a fast process explains the spectrum (`_bends_like_noise`)."""

FILTERED_FROM = 0.375
"""Frequency, in cycles per sample, above which the power is compared with a fit (`EXPLAINED`). A
low-pass filter removes more power there than at lower frequencies."""

EXPLAINED = 0.92
"""Ratio of the measured power above `FILTERED_FROM` to the power of a fit with a fast Gauss-Markov
process. Above this ratio, the process may explain a spectrum that looks low-pass filtered. Measured
ratios: 0.94 or more for such a process, at most 0.88 for a low-pass filter."""

DOMINATED = 2.0
"""Least power of a bin in which a sinusoid dominates, relative to a fit without sinusoids."""

TOPS = tuple(0.5 / 2**i for i in range(8))
"""Frequencies that are tried as the highest frequency of a fit, in cycles per sample."""

FILTER = LowPassCurvature()
"""Term in f^4 of the spectrum of a low-pass filter."""


class SelectedModel(NamedTuple):
    """Selected model of one axis.

    Attributes
    ----------
    rules : Selection
        Rules and data of the selection. Bins that contain sinusoids, and octaves that differ from
        the model, have reduced weights.
    fit : Fit
        Fitted components. The coefficients of quantization noise and of the term in f^4 may be
        negative if the samples are low-pass filtered.
    top : float
        Highest frequency of the fit in cycles per sample: 0.5 if all data are used.
    lack : dict of int to float
        Octaves in which the measured power differs from the model -> measured over modeled power.
    """

    rules: Selection
    fit: Fit
    top: float
    lack: dict[int, float]

    @property
    def chi_squared(self) -> tuple[float, float]:
        """Chi-squared of all octaves up to ``top``, and its degrees of freedom."""
        parts = list(_deviances(self.rules.data, self.fit).values())
        return sum(x for x, _ in parts), sum(n for _, n in parts)

    @property
    def goodness(self) -> float | None:
        """The result of `chi_squared`, converted to a normal deviate; None without octaves.

        The third root of chi^2 is nearly normal (Wilson & Hilferty, PNAS 17, 1931).
        """
        value, number = self.chi_squared if len(self.rules.data.power) else (0.0, 0.0)
        if not number:
            return None
        variance = 2.0 / (9.0 * number)
        return (math.pow(value / number, 1.0 / 3.0) - 1.0 + variance) / math.sqrt(variance)

    @property
    def shortest_factor(self) -> int:
        """Smallest averaging factor that the model describes; 1 if all data are used."""
        return round(4.0 / self.top) if self.top < 0.5 else 1

    def lack_of_fit(self, tau0: float) -> tuple[LackOfFit, ...]:
        """Return the octaves that differ from the model; ``tau0`` is the sample period in s."""
        statistics = self.rules.data.statistics
        octaves_with_lack = []
        for o, ratio in sorted(self.lack.items()):
            f = statistics.f[statistics.octave == o] / tau0
            octaves_with_lack.append(LackOfFit(float(f[0]), float(f[-1]), ratio))
        return tuple(octaves_with_lack)

    @property
    def low_pass(self) -> float:
        """Coefficient q of the term 3 q/m^2 that a filter adds to the Allan variance.

        The coefficient is 0 if the samples are not low-pass filtered.

        The filter changes the spectrum of white noise by d(f), where f is in cycles per sample.
        Below ``top``, the highest frequency of the fit, d(f) is the model of the filter. Above
        ``top``, d(f) is the measured power minus the model without the filter. At averaging factors
        m that are large compared with 1/``top``, d(f) changes the Allan variance by 3/m^2 times the
        integral of d(f)/(2 sin^2(pi f)) over f up to 1/2, because sin^4(pi f m) is 3/8 on average.
        """
        data, fit = self.rules.data, self.fit
        if not self.rules.signed:
            return 0.0
        f = data.statistics.f
        describes_filter = np.array([c in (RANDOM_TERMS[Q], FILTER) for c in fit.components])
        columns = replace(data, used=np.ones(len(f), bool)).columns(fit.components).power
        change = np.where(
            f < self.top,
            columns @ np.where(describes_filter, fit.p, 0.0),
            data.power - columns @ np.where(describes_filter, 0.0, fit.p),
        )
        step = np.array([octave(o).step for o in data.statistics.octave.tolist()])
        width = np.array([1.0 / octave(o).length for o in data.statistics.octave.tolist()])
        return float(np.sum(step * change * width / (2.0 * np.sin(np.pi * f) ** 2)))


class _TestResults(NamedTuple):
    """Results of the tests of a model."""

    fits: bool  # whether the model agrees with each octave and with all octaves together
    looks_filtered: bool  # whether the spectrum bends like the spectrum of a low-pass filter

    # whether the white noise is not known well, or processes of the model may imitate a filter
    may_hide_filter: bool

    @property
    def holds(self) -> bool:
        """Whether the model has passed all tests."""
        return self.fits and not self.looks_filtered and not self.may_hide_filter

    @property
    def nearly_holds(self) -> bool:
        """Whether the model has failed at most one test, and this test is not `may_hide_filter`."""
        return not self.may_hide_filter and (self.fits or not self.looks_filtered)


class _Trial(NamedTuple):
    """Model that was selected for the frequencies below ``top``, and the result of its tests."""

    top: float
    rules: Selection
    fit: Fit
    test_results: _TestResults


def estimate(
    data: AxisData,
    candidates: Candidates,
    possible: Process | None = None,
    rounding: Process | None = None,
) -> SelectedModel:
    """Return the selected model of one axis.

    ``rounding`` are the rounding errors of a counter, which replace quantization noise in the model
    unless the samples are low-pass filtered.

    ``possible`` is a process whose shape is known, such as a daily cycle. The model contains this
    process if the process is resolved in addition to all other components.
    """
    base = (rounding or RANDOM_TERMS[Q], *RANDOM_TERMS[Q + 1 :])
    if possible is None:
        return _estimate(Selection(data, candidates, base))
    selected = _estimate(Selection(data, candidates, (*base, possible)))
    at = len(RANDOM_TERMS)
    others = (*selected.fit.components[:at], *selected.fit.components[at + 1 :])
    signed = tuple(i - (i > at) for i in selected.fit.signed)
    fit_without_process = selected.rules.data.solve(
        others, None, np.delete(selected.fit.p, at), signed=signed
    )
    if fit_without_process.value - selected.fit.value > GAIN_RESOLVED:
        return selected
    return _estimate(Selection(data, candidates, base))


def _estimate(rules: Selection) -> SelectedModel:
    """Return the selected model of one axis; ``rules`` contain the data of the axis."""
    data = rules.data
    if len(data.power) < LEAST_BINS:
        rules, fit = rules.selected()
        return SelectedModel(rules, rules.bounded(fit), 0.5, {})
    best = _highest_trial(rules)
    fit, rules = best.fit, best.rules
    lack: dict[int, float] = {}
    if not best.test_results.holds:
        rules, fit, lack = _down_weighted(rules, fit)
    if rules.signed:  # a term in f^4 may be too small for the test, but change the estimates
        fit = rules.data.solve(
            (*fit.components, FILTER), None, np.append(fit.p, 0.0), signed=(Q, len(fit.p))
        )
        rules = replace(rules, signed=(Q, len(fit.p) - 1))
    return SelectedModel(rules, rules.bounded(fit), best.top, lack)


def _down_weighted(rules: Selection, fit: Fit) -> tuple[Selection, Fit, dict[int, float]]:
    """Return the selection and the fit with less weight on octaves that differ from the model.

    The weights are computed twice: from ``fit``, and from the fit with the first weights. The third
    result is octave -> measured over modeled power, for octaves that differ from one of these fits.
    """
    from scipy.special import chdtrc

    data = rules.data
    power_ratios: dict[int, float] = {}
    for _ in range(2):
        dof = data.dof.copy()
        for o, (deviance, deviance_dof) in _deviances(data, fit).items():
            if chdtrc(deviance_dof, deviance) * data.statistics.octaves < LACK_OF_FIT:
                in_octave = data.statistics.octave == o
                dof[in_octave] *= deviance_dof / deviance
                ratio = data.power[data.used] / fit.spectrum()
                power_ratios[o] = float(np.mean(ratio[in_octave[data.used]]))
        rules = replace(rules, data=replace(data, dof=dof))
        fit = rules.without_superfluous(rules.fit(fit.components, fit.p))
    return rules, fit, power_ratios


def _highest_trial(rules: Selection) -> _Trial:
    """Return the first trial that passes, from the highest frequency to lower frequencies.

    A trial fits a model to the frequencies below a limit, and passes if the model passes all tests.
    If it does not use all frequencies, the highest octave of the data must also have less power
    than the white noise of the model.
    Frequencies at which a filter has removed much power are skipped (`LOST_POWER`). If a fast
    process explains the spectrum (`_bends_like_noise`), the highest frequency is tried before it is
    skipped; this trial passes only if its model contains such a process.

    After the first trial that nearly passes (`_TestResults.nearly_holds`), only a half and a
    quarter of the frequency of this trial are tried. If a low-pass filter is the cause, the model
    normally passes at one of these frequencies. If no trial passes, the result is the first trial
    that nearly passes. If there is none, the result is the trial of the highest frequency that is
    not skipped.
    """
    f = rules.data.statistics.f
    tops = [top for top in TOPS if np.sum(f < top) >= LEAST_BINS]
    if (
        len(tops) > 1
        and _relative_power(rules.data, tops[0]) < LOST_POWER[0]
        and _test(rules, rules.base_fit).looks_filtered
    ):
        if _bends_like_noise(rules):
            trial = _trial(rules, tops[0])
            if trial.test_results.holds and any(c.bends_spectrum for c in trial.fit.components):
                return trial
        tops = tops[1:]
        while len(tops) > 1 and _relative_power(rules.data, tops[0]) < LOST_POWER[1]:
            tops = tops[1:]
    nearly_passing_trial = None
    for top in tops:
        if nearly_passing_trial is not None and top < nearly_passing_trial.top / 4.0:
            break
        trial = _trial(rules, top)
        if trial.test_results.holds and (top == TOPS[0] or _loses_power(rules.data, trial.fit)):
            return trial
        if nearly_passing_trial is None and trial.test_results.nearly_holds:
            nearly_passing_trial = trial
    return nearly_passing_trial or _trial(rules, tops[0])


def _bends_like_noise(rules: Selection) -> bool:
    """Return whether a fast Gauss-Markov process explains a spectrum that bends.

    The process is fitted together with the base components, which include white noise. Bins in
    which a sinusoid dominates have nearly no weight in the fit. The result is True if the white
    noise exceeds `WHITE_NOISE` standard errors, and if the ratio of the power above `FILTERED_FROM`
    to the power of the fit exceeds `EXPLAINED`. With a low-pass filter, the ratio is smaller. The
    ratio is the median over the bins, so that a few sinusoids have no effect on it.
    """
    data = rules.data
    fit = _with_fast_process(rules)
    is_dominated = data.power > DOMINATED * fit.spectrum()
    if is_dominated.any():
        dof = np.where(is_dominated, EXCLUDED, 1.0) * data.dof
        fit = _with_fast_process(replace(rules, data=replace(data, dof=dof)))
    is_resolved = float(fit.p[N]) > WHITE_NOISE * math.sqrt(fit.covariance()[N, N])
    is_high = data.statistics.f > FILTERED_FROM
    relative_power = float(np.median((data.power / fit.spectrum())[is_high]))
    return is_resolved and relative_power > EXPLAINED


def _with_fast_process(rules: Selection) -> Fit:
    """Return the fit of the base components and of the fast Gauss-Markov process that fits best."""
    base = rules.base_fit
    fast_processes = [
        c for kind in rules.candidates.kinds for c in kind.processes if c.bends_spectrum
    ]
    fits = [rules.fit((*rules.base, c), np.append(base.p, base.p[N])) for c in fast_processes]
    return rules.refined(min(fits, key=lambda each: each.value), [len(base.p)])


def _filter_may_explain(rules: Selection, fit: Fit) -> bool:
    """Return whether a low-pass filter may explain the data instead of the fast processes of a fit.

    The fast processes are Gauss-Markov processes that bend the spectrum (`bends_spectrum`). The
    result is True if -2 log L with the filter instead of these processes exceeds -2 log L of the
    fit by less than `GAIN_RESOLVED`. It is False if the fit has no such process, or if the fit
    already allows a negative coefficient of quantization noise.
    """
    is_fast = np.array([c.bends_spectrum for c in fit.components])
    if rules.signed or not is_fast.any():
        return False
    other_components = [c for c, fast in zip(fit.components, is_fast) if not fast]
    filter_rules = replace(rules, signed=(Q, len(other_components)))
    filter_fit = filter_rules.fit((*other_components, FILTER), np.append(fit.p[~is_fast], 0.0))
    return filter_fit.value - fit.value < GAIN_RESOLVED


def _loses_power(data: AxisData, fit: Fit) -> bool:
    """Return whether the highest octave has significantly less power than the white noise of a fit.

    The power of the octave is the median over the bins, on which a few sinusoids have no effect.
    """
    is_high = data.statistics.f > TOPS[1]
    error = math.sqrt(math.pi / float(data.statistics.dof[is_high].sum()))
    return float(np.median(data.power[is_high])) < (1.0 - CURVATURE * error) * float(fit.p[N])


def _relative_power(data: AxisData, top: float) -> float:
    """Return the power in the octave below ``top`` relative to the power two octaves lower.

    The first power is the median over the bins of its octave, the second is the minimum. A few
    sinusoids have no effect on the median or on the minimum. The result is 1 if one of the octaves
    has no bins.
    """
    f, power = data.statistics.f, data.power
    high_power, low_power = (
        power[(f > top / 2.0) & (f < top)],
        power[(f > top / 8.0) & (f < top / 4.0)],
    )
    return (
        float(np.median(high_power) / low_power.min())
        if len(high_power) and len(low_power)
        else 1.0
    )


def _trial(rules: Selection, top: float) -> _Trial:
    """Select a model for the frequencies below ``top``, and test this model."""
    f = rules.data.statistics.f
    rules = replace(rules, data=replace(rules.data, used=f < top), fastest=top)
    if top < 0.5:  # Q describes the filter; no process may be fast enough to imitate the filter
        base = (RANDOM_TERMS[Q], *rules.base[Q + 1 :])
        rules = replace(rules, base=base, signed=(Q,), shortest=8.0 / top, fastest=top / 2.0)
    rules, fit = rules.selected()
    return _Trial(top, rules, fit, _test(rules, fit))


def _deviances(data: AxisData, fit: Fit) -> dict[int, tuple[float, float]]:
    """Return octave -> deviance from the model, and degrees of freedom of this deviance."""
    ratio = data.power[data.used] / fit.spectrum()
    statistics = data.statistics
    share = data.dof / statistics.dof_of(data.axis)
    weight = (statistics.dof_alone * share)[data.used] / statistics.correlation
    deviance = weight * (ratio - 1.0 - np.log(np.maximum(ratio, 1e-300)))
    octave = statistics.octave[data.used]
    return {
        int(o): (
            float(deviance[octave == o].sum()),
            float(np.sum(octave == o)) / statistics.correlation,
        )
        for o in np.unique(octave)
    }


def _test(rules: Selection, fit: Fit) -> _TestResults:
    """Return the results of the tests of a model.

    The power in each octave and in all octaves is compared with the model (chi-squared tests). The
    spectrum looks low-pass filtered if it contains a significant negative term in f^2. If the fit
    already allows a negative term in f^2, the spectrum looks low-pass filtered if it contains a
    significant term in f^4. The model may hide a low-pass filter if the white noise is less than
    `WHITE_NOISE` standard errors, if processes imitate the filter, or if the filter explains the
    data nearly as well as the fast processes.
    """
    from scipy.special import chdtrc

    data = rules.data
    parts = list(_deviances(data, fit).values())
    tails = [chdtrc(n, x) * len(parts) for x, n in parts]
    tails.append(chdtrc(sum(n for _, n in parts), sum(x for x, _ in parts)))
    s = fit.spectrum()
    nonzero = np.flatnonzero(fit.p != 0.0)
    component = FILTER if rules.signed else RANDOM_TERMS[Q]
    power = data.statistics.column(component, data.axis).power[data.used]
    root_weights = np.sqrt(data.dof[data.used] / 2.0)
    a = np.column_stack([power, fit.columns.power[:, nonzero]]) * (root_weights / s)[:, None]
    covariance = inverse(a.T @ a)
    score = a.T @ ((data.power[data.used] / s - 1.0) * root_weights)
    z = float(covariance[0] @ score) / math.sqrt(covariance[0, 0])
    white = 0.0
    if fit.p[N] > 0.0:
        at = 1 + int(np.searchsorted(nonzero, N))
        white = float(fit.p[N]) / math.sqrt(covariance[at, at])
    is_bent = abs(z) > CURVATURE if rules.signed else fit.p[Q] == 0.0 and z < -CURVATURE
    may_hide_filter = (
        white < WHITE_NOISE or rules.imitates_filter(fit) or _filter_may_explain(rules, fit)
    )
    return _TestResults(min(tails) >= LACK_OF_FIT, is_bent, may_hide_filter)
