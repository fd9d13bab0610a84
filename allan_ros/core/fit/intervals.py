# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""95 % intervals: profile likelihood of coefficients, generalized least squares of the ramp."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .likelihood import AxisData, Fit, flags, inverse
from .limits import LEVEL_95
from .statistics import Floats


class Interval(NamedTuple):
    """95 % interval of a coefficient, and the gain in -2 log L of its estimate over 0."""

    low: float
    high: float
    gain: float


def information_with_shapes(data: AxisData, fit: Fit, shapes: Sequence[tuple[int, int]]) -> Floats:
    """Return the Fisher information of the coefficients of a fit, then of the shapes.

    ``shapes`` are pairs: index of a component, index of a number of its shape. The unknown is the
    logarithm of this number times the coefficient.
    """
    columns = data.columns(fit.components, shapes)
    moments = data.moments(columns, np.append(fit.p, np.zeros(len(shapes))))
    assert moments is not None  # the model of a fit is positive
    return moments[1]


def profile_interval(
    data: AxisData, fit: Fit, i: int, with_shapes: Floats | None = None
) -> Interval:
    """Return the interval of the coefficient ``i`` of a fit, by its profile likelihood.

    All other coefficients are fitted again at each value. It is the set of values whose
    -2 log L exceeds the minimum by at most 3.84. With ``with_shapes``, from
    `information_with_shapes`, it is wider by the ratio of the standard errors with unknown and with
    known shapes.
    """
    estimate = float(fit.p[i])
    on = np.union1d(fit.free, [i])
    covariance = inverse(fit.information[np.ix_(on, on)])[:, int(np.searchsorted(on, i))]
    error = math.sqrt(covariance[np.searchsorted(on, i)])
    wider = 1.0
    if with_shapes is not None:
        every = np.append(on, np.arange(len(fit.p), len(with_shapes)))
        scatter = np.diag(inverse(with_shapes[np.ix_(every, every)]))
        wider = max(math.sqrt(scatter[np.searchsorted(on, i)]) / error, 1.0)

    def distance(value: float) -> float:
        start = fit.p.copy()
        start[on] += covariance / error**2 * (value - estimate)
        start = np.where(flags(len(start), fit.signed), start, np.maximum(start, 0.0))
        new = data.solve(
            fit.components, fit.columns, start, {i: value}, fit.signed, rounds=10, tolerance=1e-2
        )
        if not math.isfinite(new.value):
            return 1e3
        return math.sqrt(max(new.value - fit.value, 0.0))

    z = math.sqrt(LEVEL_95)
    if i in fit.signed:
        return Interval(estimate - z * wider * error, estimate + z * wider * error, 0.0)
    at_zero = distance(0.0) if estimate < 20.0 * error else 20.0
    low = 0.0
    if at_zero > z:
        least = max(estimate - 4.0 * error, 0.0)
        low = _crossing(distance, z, estimate, least, at_zero if least == 0.0 else 4.0)
    high = estimate + 2.0 * error
    at_high = distance(high)
    while at_high < z and high < 1e12:
        high = estimate + 2.0 * (high - estimate)
        at_high = distance(high)
    high = _crossing(distance, z, estimate, high, at_high)
    return Interval(
        max(estimate - wider * (estimate - low), 0.0),
        estimate + wider * (high - estimate),
        (at_zero / wider) ** 2,
    )


def _crossing(distance, z: float, inside: float, outside: float, at_outside: float) -> float:  # type: ignore[no-untyped-def]
    """Return the value between ``inside`` and ``outside`` whose distance is z."""
    at_inside, value = 0.0, outside
    for _ in range(10):
        share = (z - at_inside) / max(at_outside - at_inside, 1e-9)
        value = inside + (outside - inside) * min(max(share, 0.05), 0.95)
        reached = distance(value)
        if abs(reached - z) < 0.02:
            break
        if reached < z:
            inside, at_inside = value, reached
        else:
            outside, at_outside = value, reached
    return value


class RampEstimate(NamedTuple):
    """Ramp per sample in scaled units: estimate, standard error and its degrees of freedom."""

    value: float
    error: float
    dof: float

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval."""
        from scipy.special import stdtrit

        return float(stdtrit(self.dof, 0.975)) * self.error


def ramp_estimate(data: AxisData, fit: Fit) -> RampEstimate | None:
    """Return the ramp that all segments have in common, or None if there are too few block means.

    It is the generalized least-squares estimate from the block means with the fitted covariance.
    Its degrees of freedom follow from the errors of the coefficients (Satterthwaite).
    """
    information, moment = 0.0, 0.0
    slope = np.zeros(len(fit.p))
    statistics = data.statistics
    columns = [statistics.column(c, data.axis).low for c in fit.components]
    for g, (group, low) in enumerate(zip(statistics.groups, data.low)):
        d = np.array([column[g] for column in columns])
        t = np.arange(group.points) - (group.points - 1) / 2.0
        unit = statistics.step * math.sqrt(float(t @ t))  # the line contrast of a ramp of 1
        e = np.zeros(d.shape[1])
        e[0] = unit
        w = np.linalg.solve(np.tensordot(fit.p, d, 1), e)
        information += group.segments * float(w[0]) * unit
        moment += float(w @ low.line)
        slope += group.segments * np.einsum('i,kij,j->k', w, d, w)
    if not information > 0.0:
        return None
    slope = slope / information
    scatter = float(slope @ fit.covariance() @ slope)
    return RampEstimate(moment / information, information**-0.5, max(2.0 / max(scatter, 1e-9), 1.0))
