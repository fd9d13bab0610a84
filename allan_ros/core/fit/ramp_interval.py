# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interval of the ramp: what the walk may not have done.

A value c of the ramp is tried by holding it, refitting the powers to the table less that ramp, and
asking how many standard deviations at that fit the estimate r lies from c. Held far from the
truth, the ramp that is left over is taken for a walk, whose r varies more, so that z(c) never
grows beyond a few. The table less its *own* ramp sets the bound: with the walk at its 95 % upper
limit, r is not further than this from the truth. The interval is what passes both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from .evidence import Evidence, variances
from .intervals import Z_TWO_SIDED, cross
from .model import Floats
from .point import PointFit
from .solve import K, solve, with_floor

Z_DETECT = 2.58
"""Normal quantile of 99.5 %: R has a sign, so both tails count for 1 % false alarms."""

AGREE = 0.01
"""Segments whose ramps differ as much as noise makes them once in a hundred have their own."""


@dataclass(frozen=True)
class RampInterval:
    """A ramp per sample, its 95 % interval and verdicts.

    ``shared`` is False where the segments' ramps differ: it is then that of the longest.
    """

    value: float
    low: float
    high: float
    observable: bool
    shared: bool


def ramp_interval(evidence: Evidence, axis: int, fit: PointFit, walk: float) -> RampInterval | None:
    """Return the ramp of one axis, or None where no segment can show one.

    Parameters
    ----------
    evidence : Evidence
    axis : int
    fit : PointFit
    walk : float
        The upper limit of k.
    """
    variance = fit.ramp_variance
    chosen = np.flatnonzero(variance > 0.0)
    if not len(chosen):
        return None
    ramps = fit.table.ramps[chosen]
    value, deviation = _mean(ramps, variance[chosen])
    spread = float(np.sum((ramps - value) ** 2 / variance[chosen]))
    shared = len(chosen) == 1 or bool(chdtrc(len(chosen) - 1, spread) > AGREE)
    if not shared:
        chosen, ramps = chosen[:1], ramps[:1]
        value, deviation = _mean(ramps, variance[chosen])

    ignored = np.zeros(len(variance))
    ignored[chosen] = np.nan

    def z(c: float) -> float:
        known = np.full(len(variance), np.nan)
        known[chosen] = c
        less = fit.frame.table(evidence, axis, fit.power, known)
        held = solve(less, fit.power, signed=fit.frame.signed, misfit=fit.frame.misfit)
        noise = fit.frame.noise(with_floor(less, held))
        free, effects = evidence.ramps(axis, noise, ignored)
        r, sd = _mean(free[chosen], (variances(effects) @ noise)[chosen])
        return (r - c) / sd

    bound = np.inf
    if np.isfinite(walk):
        most = fit.power.copy()
        most[K] = max(walk, most[K])
        bound = _mean(ramps, replace(fit, power=most).ramp_variance[chosen])[1]
    reach = Z_TWO_SIDED * bound
    low = cross(z, Z_TWO_SIDED, value, value - 2.0 * deviation, value - reach)
    high = cross(z, -Z_TWO_SIDED, value, value + 2.0 * deviation, value + reach)
    observable = abs(value) > Z_DETECT * bound or abs(z(0.0)) > Z_DETECT
    return RampInterval(value, low, high, observable, shared)


def _mean(ramps: Floats, variance: Floats) -> tuple[float, float]:
    """Return the mean weighted by 1/variance, and its standard deviation."""
    weight = 1.0 / variance
    return float(weight @ ramps / weight.sum()), float(1.0 / np.sqrt(weight.sum()))
