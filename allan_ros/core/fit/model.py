# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The five noise terms in sample units, and their way back to SI.

Sample units: the sample period is 1 and the phase theta is the running sum of the samples. Four
terms are random and enter as their squares, ``power = (q, w, b, k)``; the ramp r is not random
and is estimated from the signed sums, so it has no column here.

    q = Q^2/tau0^2    w = N^2/tau0    b = B^2    k = K^2 tau0    r = R tau0

    E avar(m) = 3 q/m^2 + w/m + (2 ln2/pi) b + k (m/3 + 1/(6 m)) + r^2 m^2/2

IEEE Std 952-2020 annex C; the k term is that of a walk that steps once a sample (exact at
small m), its 1/(6 m) is what a sampled walk has beyond the continuous one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..terms import NoiseTerms, term_avar

Floats = NDArray[np.float64]

RANDOM_TERMS = ('Q', 'N', 'B', 'K')
"""The terms with a column, in the order of every array of powers."""

WHITE = np.array([0.0, 1.0, 0.0, 0.0])
"""Powers of nothing but white noise: what weights are made for before the noise is known."""

TAU0_EXPONENT = {'Q': 1.0, 'N': 0.5, 'B': 0.0, 'K': -0.5}
"""coefficient = sqrt(power) tau0^exponent."""

DIFFERENCE = (1.0, -2.0, 1.0)
"""d(u) = theta(u + 2m) - 2 theta(u + m) + theta(u)."""


def avar_terms(m: NDArray[np.int64]) -> Floats:
    """Return the Allan variance of unit q, w, b, k at averaging factors m, (factors, 4)."""
    return term_avar(m, 1.0, NoiseTerms(1.0, 1.0, 1.0, 1.0))[:, : len(RANDOM_TERMS)]


def walk_from_cubic(white: Floats, cubic: Floats) -> Floats:
    """Return what belongs to k, (|t|^3 - |t|)/12, from the parts of -|t|/2 and |t|^3/12.

    The sampled walk is the continuous one plus white noise of a sixth of its step.
    """
    return cubic + white / 6.0


def phase_covariance(t: Floats) -> Floats:
    """Return the generalised covariances of theta at lag t of unit q, w, b, k, (4, ...).

    They hold for differences that annihilate straight lines of theta (Matheron 1973):
    delta(t), -|t|/2, t^2 ln|t|/(2 pi), (|t|^3 - |t|)/12.
    """
    a = np.abs(t)
    white = -a / 2
    log = np.log(np.where(a > 0.0, a, 1.0))
    return np.stack(
        [(a == 0.0).astype(float), white, a * a * log / (2 * math.pi), a**3 / 12 + white / 6]
    )


def to_si(term: str, power: float, tau0: float) -> float:
    """Return the SI coefficient of a power (q, w, b, k) or of the ramp r; 0 below 0."""
    if term == 'R':
        return power / tau0
    return math.sqrt(max(power, 0.0)) * math.pow(tau0, TAU0_EXPONENT[term])
