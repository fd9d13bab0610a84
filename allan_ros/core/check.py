# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare a measured number with limits, or with the same number of another recording.

`check_limits` compares a number with limits. `differences` tests for each pair of recordings
whether the second differs from the first.

Method
------
Coefficients are compared by the logarithm of their ratio. The interval of the ratio is computed
from the two intervals of the coefficients, which may be asymmetric (method of variance estimates
recovery: Zou & Donner, Statistics in Medicine 27, 2008, eq. 9, on logarithms).

If only one recording resolves a coefficient, the lower limit from this recording is compared with
the upper limit from the other recording. The p value follows from the confidence level at which the
two limits are equal.

Allan deviations at equal averaging times are compared by the F distribution of the ratio of two
variances with their equivalent degrees of freedom (NIST SP 1065 section 5.3.1).

Many comparisons are made at once. Holm's procedure (Scandinavian Journal of Statistics 6, 1979)
limits the probability of one or more false detections to `FAMILY_ERROR`, even if the comparisons
are dependent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .allan.curve import CI_LEVEL, AxisCurve
from .estimate import UNKNOWN, Z_95, Estimate, lies_beyond
from .fit.result import TERMS

MARGIN = 0.2
"""Default of the fraction by which a coefficient may exceed a limit. The typical figures of a
datasheet describe the median IMU, and noise increases by some percent with temperature."""

FAMILY_ERROR = 0.05
"""Largest probability of one or more significant differences between recordings of equal noise,
among all comparisons made at once."""

TAU_RATIO = 4.0
"""Ratio of successive averaging times at which Allan deviations are compared. Deviations at closer
averaging times are strongly correlated, so further comparisons would add little."""

MIN_EDF = 3.0
"""Smallest number of equivalent degrees of freedom of an Allan deviation that is compared. If both
deviations have 3 degrees of freedom, their ratio is significant only above about 10 when one axis
is compared, and only above about 17 when six axes are compared."""

EDF_TABLE = np.geomspace(0.5, 1e10, 1000)
"""Degrees of freedom, (1000,), at which the ratio of the upper to the lower confidence limit of an
Allan deviation is tabulated."""

SMALLEST_SCALE = 1e-12
"""Value that replaces any smaller standard error of the logarithm of an estimate, so that there is
no division by zero."""

LARGEST_EXPONENT = 709.0
"""Largest whole number x for which exp(x) is a finite float64."""

Judgement = Literal['within', 'exceeds', 'higher', 'lower', 'alike', 'undecided']
"""Verdict of a check. A number is 'within' limits or 'exceeds' limits. Compared with another
recording, a number is significantly 'higher' or 'lower', or 'alike' if there is no significant
difference. The verdict is 'undecided' if the test is impossible or inconclusive."""

Equivalence = Literal['same', 'different', 'undecided']
"""Whether the data show that two numbers differ by less than a stated fraction ('same') or by more
than this fraction ('different'); 'undecided' if the data show neither."""

Z_90 = 1.6449
"""Normal quantile of 95 %, for a one-sided test at the 5 % level, and for the two ends of a 90 %
interval."""

Floats = NDArray[np.float64]

Known = tuple[float, float, float]
"""(value, low, high): a positive value and the ends of its 95 % interval."""


@dataclass(frozen=True)
class Check:
    """A number of an IMU, compared with limits or with the same number of another recording, in SI.

    Attributes
    ----------
    axis : str
        Name of the axis or sensor; '' for a number of the whole IMU.
    quantity : str
        A term (Q, N, B, K or R), 'adev' for the Allan deviation at ``tau``, or another quantity
        that a test plan limits.
    reference : str
        Name of the datasheet, plan or recording that the number is compared with. For values that
        others measured with IMUs of the same model, the number of these IMUs, such as '3 units'.
    measured : Estimate
        The measured number. It has neither value nor limit if only the ratio is known.
    lower, upper : float or None
        The limits; None for no limit. In a comparison with another recording, ``upper`` is the
        value or the upper limit from the other recording; None if that number is 'likely',
        unknown, or has no finite interval above 0.
    ratio : Estimate
        Ratio of the measured number to ``upper``, unknown without an ``upper`` above 0, and if
        neither of two recordings resolves the number. If only one of them resolves the number, the
        ratio has no value, and its interval (if any) begins at 0 or ends at infinity.
    verdict : Judgement
        See `Judgement`. In a comparison of recordings, the verdicts 'higher' and 'lower' are
        corrected for the number of comparisons.
    tau : float or None
        Averaging time in s of an Allan deviation; None for other quantities.
    p : float or None
        p value: the probability of a difference at least as large between recordings of equal
        noise; None if unknown, or in a comparison with limits.
    note : str
        Why a number that a plan limits is unknown; '' if it is known or the reason is not stated.
    """

    axis: str
    quantity: str
    reference: str = ''
    measured: Estimate = UNKNOWN
    lower: float | None = None
    upper: float | None = None
    ratio: Estimate = UNKNOWN
    verdict: Judgement = 'undecided'
    tau: float | None = None
    p: float | None = None
    note: str = ''

    @property
    def significant(self) -> bool:
        """Whether the verdict is 'higher' or 'lower'."""
        return self.verdict in ('higher', 'lower')

    @property
    def limit(self) -> float:
        """The upper limit (`upper`); NaN if there is none."""
        return math.nan if self.upper is None else self.upper

    @property
    def at_least(self) -> float:
        """Lower end of the 95 % interval of the ratio.

        Without an interval, this is the ratio itself, or 0 if the ratio is unknown.
        """
        return (self.ratio.ci95 or (self.ratio.value or 0.0,))[0]

    @property
    def factor(self) -> float:
        """The ratio, but at least 1; 1 if the ratio is unknown."""
        return max(self.ratio.value or 1.0, 1.0)

    def beyond(self, margin: float) -> bool:
        """Return whether two recordings differ significantly by more than the fraction ``margin``.

        The complete 95 % interval of the ratio must lie above 1 + ``margin``, or below
        1 / (1 + ``margin``).
        """
        return self.significant and lies_beyond(self.ratio.ci95 or (1.0, 1.0), margin)

    def equivalence(self, within: float) -> Equivalence:
        """Return whether both recordings have the same value up to the fraction ``within``.

        The result is 'same' if the 90 % interval of the ratio lies between 1 / (1 + within) and
        1 + within. It is 'different' if the complete 90 % interval lies above or below this range,
        else 'undecided'. The method is two one-sided tests at 5 % (Schuirmann, J.
        Pharmacokin. Biopharm. 15, 1987): if the true ratio is at an end of the range, the result is
        'same' with a probability of at most 5 %.
        """
        if self.ratio.value is None or self.ratio.value <= 0.0 or self.ratio.ci95 is None:
            return 'undecided'
        limit, center = math.log1p(within), math.log(self.ratio.value)
        log_ends = (math.log(end) if end > 0.0 else -math.inf for end in self.ratio.ci95)
        low, high = (center + (end - center) * Z_90 / Z_95 for end in log_ends)
        if -limit < low and high < limit:
            return 'same'
        return 'different' if low > limit or high < -limit else 'undecided'

    def as_limit(self, margin: float) -> Check | None:
        """Return the check with the value or limit from the other recording as an upper limit.

        The verdict is 'exceeds' if the number is significantly higher than in the other recording,
        and the complete 95 % interval of the ratio lies above 1 + ``margin``. Otherwise, it is
        'undecided' if only one of the recordings resolves the number and the interval of the ratio
        reaches above 1 + ``margin``, else 'within'. Returns None if the recordings could not be
        compared.
        """
        if self.p is None or self.ratio.ci95 is None or self.upper is None:
            return None
        verdict: Judgement = 'undecided'
        if self.verdict == 'higher' and self.beyond(margin):
            verdict = 'exceeds'
        elif self.ratio.value is not None or self.ratio.ci95[1] <= 1.0 + margin:
            verdict = 'within'
        return replace(self, verdict=verdict)

    def document(self) -> dict[str, Any]:
        """Return the check as a JSON object, without its note."""
        return {
            'axis': self.axis,
            'quantity': self.quantity,
            'tau_s': self.tau,
            'reference': self.reference,
            'measured': self.measured.document(),
            'lower': self.lower,
            'upper': self.upper,
            'ratio': self.ratio.value,
            'ci95': self.ratio.ci95,
            'p': self.p,
            'verdict': self.verdict,
        }


WORST_FIRST: tuple[Judgement, ...] = ('exceeds', 'undecided', 'within')
"""Verdicts of comparisons with limits, the worst first."""


def worst_verdict(checks: Iterable[Check]) -> Judgement | None:
    """Return the worst verdict of comparisons with limits; None if there is no comparison."""
    verdicts = {check.verdict for check in checks}
    return next((verdict for verdict in WORST_FIRST if verdict in verdicts), None)


def check_limits(
    axis: str,
    quantity: str,
    reference: str,
    measured: Estimate,
    lower: float | None = None,
    upper: float | None = None,
    margin: float = 0.0,
    note: str = '',
) -> Check:
    """Compare a measured number with limits.

    The verdict is 'exceeds' if the complete 95 % interval lies above ``upper * (1 + margin)`` or
    below ``lower``. It is 'within' if the complete interval lies between these two limits, and
    'undecided' otherwise. The interval of a number that is not resolved reaches from 0 to its upper
    limit.

    Parameters
    ----------
    axis, quantity, reference, note : str
        Fields of `Check`.
    measured : Estimate
        The measured number.
    lower, upper : float or None
        The limits in the unit of ``measured``; None for no limit.
    margin : float
        Fraction by which the number may exceed ``upper``.

    Examples
    --------
    >>> two = Estimate(2.0, (1.9, 2.1))
    >>> limits = (1.0, 3.0), (2.5,)
    >>> [check_limits('gyro_x', 'N', 'plan', two, *each).verdict for each in limits]
    ['within', 'exceeds']
    """
    interval = measured.ci95 if measured.resolved else None
    if measured.status != 'estimated' and measured.upper95 is not None:
        interval = 0.0, measured.upper95
    least = -math.inf if lower is None else lower
    most = math.inf if upper is None else upper * (1.0 + margin)
    verdict: Judgement = 'undecided'
    if interval is not None and (interval[0] > most or interval[1] < least):
        verdict = 'exceeds'
    elif interval is not None and least <= interval[0] and interval[1] <= most:
        verdict = 'within'
    ratio = measured.times(1.0 / upper) if upper is not None and upper > 0.0 else UNKNOWN
    return Check(axis, quantity, reference, measured, lower, upper, ratio, verdict, note=note)


class AxisNoise(NamedTuple):
    """Noise of one axis: term -> coefficient, and the Allan deviation curve; None if unknown."""

    noise: Mapping[str, Estimate] | None
    curve: AxisCurve | None


Run = Mapping[str, AxisNoise]
"""One recording: name of an axis -> coefficients and Allan deviation curve of this axis."""


def differences(pairs: Iterable[tuple[str, Run, Run]]) -> list[tuple[Check, ...]]:
    """Compare the second recording of each pair with the first, and return the checks of each pair.

    For each axis that both recordings have, the five terms are compared, if they are known, and
    then the Allan deviations at averaging times that both curves cover. The verdicts are corrected
    for the total number of comparisons in all pairs: the probability of one or more false
    detections is at most `FAMILY_ERROR`.

    Parameters
    ----------
    pairs : iterable of (name of the first recording, first recording, second recording)
    """
    without_verdicts = [list(_run_differences(*pair)) for pair in pairs]
    with_verdicts = iter(_with_verdicts(list(chain(*without_verdicts)), FAMILY_ERROR))
    return [tuple(islice(with_verdicts, len(checks))) for checks in without_verdicts]


def _run_differences(reference: str, first: Run, second: Run) -> Iterator[Check]:
    for axis in (axis for axis in first if axis in second):
        a, b = first[axis], second[axis]
        if a.noise is not None and b.noise is not None:
            for term in TERMS:
                first_estimate, second_estimate = a.noise[term].magnitude, b.noise[term].magnitude
                yield _term_difference(axis, term, reference, first_estimate, second_estimate)
        if a.curve is not None and b.curve is not None:
            yield from _curve_differences(axis, reference, a.curve, b.curve)


def _curve_differences(
    axis: str, reference: str, first: AxisCurve, second: AxisCurve
) -> Iterator[Check]:
    """Yield checks, without verdicts, of the Allan deviations at several averaging times.

    The averaging times lie in the range that both curves cover. The first averaging time is the
    start of this range, and each further averaging time is longer by the factor `TAU_RATIO`.
    Deviations and degrees of freedom are interpolated on logarithmic scales. Points of a curve with
    fewer than `MIN_EDF` degrees of freedom are not used.
    """
    from scipy import special

    curves = _log_points(first), _log_points(second)
    if not all(len(points) for points in curves):
        return
    tau = math.exp(max(points[0, 0] for points in curves))
    longest = math.exp(min(points[-1, 0] for points in curves))
    while tau <= longest * (1.0 + 1e-9):
        (adev_a, edf_a), (adev_b, edf_b) = (
            tuple(math.exp(np.interp(math.log(tau), points[:, 0], points[:, i])) for i in (1, 2))
            for points in curves
        )
        variance_ratio = (adev_b / adev_a) ** 2
        low, high = (
            math.sqrt(variance_ratio / special.fdtri(edf_b, edf_a, quantile))
            for quantile in (0.975, 0.025)
        )
        p_below, p_above = (
            special.fdtr(edf_b, edf_a, variance_ratio),
            special.fdtrc(edf_b, edf_a, variance_ratio),
        )
        p = min(2.0 * float(min(p_below, p_above)), 1.0)
        ratio, measured = Estimate(adev_b / adev_a, (low, high)), Estimate(adev_b)
        yield Check(axis, 'adev', reference, measured, None, adev_a, ratio, tau=tau, p=p)
        tau *= TAU_RATIO


def _log_points(curve: AxisCurve) -> Floats:
    """Return the logarithms of tau, Allan deviation and degrees of freedom, (points, 3).

    Points with fewer than `MIN_EDF` degrees of freedom are excluded.
    """
    with np.errstate(invalid='ignore', divide='ignore'):
        edf = _degrees_of_freedom(curve.ci_low, curve.ci_high)
        is_comparable = (curve.adev > 0.0) & np.isfinite(edf) & (edf >= MIN_EDF) & (curve.tau > 0.0)
    return np.log(np.stack([curve.tau, curve.adev, edf], axis=1)[is_comparable])


def _with_verdicts(checks: Sequence[Check], family_error: float) -> list[Check]:
    """Return the checks with verdicts; Holm's procedure selects the significant checks."""
    p_values = sorted((check.p, i) for i, check in enumerate(checks) if check.p is not None)
    significant_indices: set[int] = set()
    for rank, (p, i) in enumerate(p_values):
        if p > family_error / (len(p_values) - rank):
            break
        significant_indices.add(i)
    return [
        replace(check, verdict=_judged(check, i in significant_indices))
        for i, check in enumerate(checks)
    ]


def _judged(check: Check, is_significant: bool) -> Judgement:
    if check.p is None or check.ratio.ci95 is None:
        return 'undecided'
    if not is_significant:
        # if only one recording resolves the coefficient, equality cannot be concluded
        return 'undecided' if check.ratio.value is None else 'alike'
    return 'higher' if check.ratio.ci95[0] > 1.0 else 'lower'


def _term_difference(
    axis: str, term: str, reference: str, first: Estimate, second: Estimate
) -> Check:
    a, b = _known(first), _known(second)
    reference_value = _limit(first) if a is None else a[0]
    check = Check(axis, term, reference, second, upper=reference_value)
    # the errors of R and of the squares of the other terms are assumed to be normally distributed
    exponent = 1.0 if term == 'R' else 2.0
    if a is not None and b is not None:
        ratio, ci95, p = _ratio_of_estimates(a, b)
        return replace(check, ratio=Estimate(ratio, ci95), p=p)
    if a is not None and (limit := _limit(second)) is not None:
        ratio_below = replace(UNKNOWN, recording_ci95=(0.0, limit / a[1]))
        return replace(check, ratio=ratio_below, p=_p_value_of_limit(a, limit, exponent))
    if b is not None and (limit := _limit(first)) is not None:
        ratio_above = replace(UNKNOWN, recording_ci95=(b[1] / limit, math.inf))
        return replace(check, ratio=ratio_above, p=_p_value_of_limit(b, limit, exponent))
    return check


def _known(coefficient: Estimate) -> Known | None:
    """Return the value of a coefficient and the ends of its 95 % interval.

    A value outside of the interval is replaced by the nearest end. Returns None if the coefficient
    is not resolved, or has no finite interval above 0.
    """
    value, interval = coefficient.value, coefficient.ci95
    if coefficient.status != 'estimated' or not value or interval is None:
        return None
    low, high = interval
    if not 0.0 < low <= high < math.inf:
        return None
    return min(max(value, low), high), low, high


def _limit(coefficient: Estimate) -> float | None:
    """Return the 95 % upper limit of a coefficient that is not resolved; None if it is unknown.

    A limit of 0 is not used, nor the limit of a coefficient with the status 'likely'.
    """
    limit = coefficient.upper95
    if coefficient.status != 'not_observable' or limit is None:
        return None
    return limit if 0.0 < limit < math.inf else None


def _ratio_of_estimates(a: Known, b: Known) -> tuple[float, tuple[float, float], float]:
    """Return the ratio b / a, its 95 % interval, and the p value for equal true coefficients.

    The p value uses the upper half of the interval of the smaller estimate, and the lower half of
    the interval of the larger estimate.
    """
    from scipy import special

    log_ratio = math.log(b[0]) - math.log(a[0])
    distance_below = math.hypot(_log_distance(b[0], b[1], b), _log_distance(a[2], a[0], a))
    distance_above = math.hypot(_log_distance(b[2], b[0], b), _log_distance(a[0], a[1], a))
    half_width = distance_below if log_ratio > 0.0 else distance_above
    z = abs(log_ratio) * Z_95 / half_width if half_width > 0.0 else math.inf * bool(log_ratio)
    interval = _exp(log_ratio - distance_below), _exp(log_ratio + distance_above)
    return _exp(log_ratio), interval, min(2.0 * float(special.ndtr(-z)), 1.0)


def _exp(x: float) -> float:
    return math.exp(x) if x < LARGEST_EXPONENT else math.inf


def _log_distance(upper: float, lower: float, x: Known) -> float:
    """Return ln(upper / lower), but at least half the width of the interval of ln x.

    ``x`` is an estimate with its interval. ``upper`` and ``lower`` are the value of ``x`` and one
    end of the interval, the larger number first.
    """
    # without the half width, the distance would be 0 if the value is an end of its interval
    return max(math.log(upper) - math.log(lower), (math.log(x[2]) - math.log(x[1])) / 2.0)


def _p_value_of_limit(resolved: Known, limit: float, exponent: float) -> float:
    """Return the p value for equal noise if only one of two recordings resolves a coefficient.

    ``resolved`` is the estimate from this recording, and ``limit`` is the upper limit from the
    other recording. The p value follows from the confidence level at which the lower limit of
    ``resolved`` equals the upper limit. The coefficient to the power of ``exponent`` is assumed to
    have a normally distributed error.
    """
    # The estimate is compared with the upper limit of the number that is not resolved. At the
    # normal quantile z, the lower limit of the estimate is value exp(-s z), where s is the standard
    # error of its logarithm. The upper limit is limit (z / 1.96)^(1 / exponent), because the number
    # that is not resolved is assumed to be 0, which is the worst case. At the z where both limits
    # are equal, each limit is wrong with probability Phi(-z). The p value is 4 Phi(-z): two limits
    # can be wrong, and either recording could be the one that resolves the number.
    from scipy import special

    value, low, _ = resolved
    scale = exponent * max(_log_distance(value, low, resolved) / Z_95, SMALLEST_SCALE)
    # With p = exponent, this z solves p s z exp(p s z) = p s 1.96 (value / limit)^p. The Lambert W
    # function gives the solution, here in logarithms.
    log_right_side = math.log(scale * Z_95) + exponent * (math.log(value) - math.log(limit))
    z = float(special.wrightomega(log_right_side)) / scale
    # The upper limit is known only for a confidence level of 95 % or more.
    return min(4.0 * float(special.ndtr(-z)), 1.0) if z >= Z_95 else 1.0


def _degrees_of_freedom(low: Floats, high: Floats) -> Floats:
    """Return the degrees of freedom, (n,), of Allan deviations with given confidence limits.

    The result follows from the ratio of the limits, ``high`` / ``low``, and lies in the range of
    `EDF_TABLE`. It is NaN unless ``low`` is finite and above 0, and ``high`` is larger.
    """
    from scipy import special

    tail = (1.0 - CI_LEVEL) / 2.0
    # the limits of a deviation are proportional to 1 / sqrt(chi^2)
    log_ratios = (
        np.log(special.chdtri(EDF_TABLE, tail) / special.chdtri(EDF_TABLE, 1.0 - tail)) / 2.0
    )
    degrees: Floats = np.exp(
        np.interp(np.log(np.log(high / low)), np.log(log_ratios)[::-1], np.log(EDF_TABLE)[::-1])
    )
    return np.where(np.isfinite(low) & (low > 0.0) & (high > low), degrees, np.nan)
