# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The step of rounded samples, recovered from the phase.

Samples that are whole multiples of a step (plus the first one) have a phase of whole multiples, to
double precision; samples that passed through single precision are not told.
Rounding adds white noise of step^2/12 per sample to N; it is not the quantization noise Q, which
is white in the phase (Widrow & Kollar, Quantization Noise, 2008).
"""

from __future__ import annotations

import numpy as np

from .model import Floats

COARSEST_IGNORED = 0.02
"""A step below this part of the white noise per sample adds 3e-5 of its variance."""

NEAR_WHOLE = 0.05
"""How near to whole numbers the phase must be, in steps."""

LEAST_POINTS = 8
"""Fewer phase points are multiples of some step by chance."""


def lattice_step(phase: Floats, deviation: float) -> float | None:
    """Return the step of which all phase points are multiples, or None.

    Parameters
    ----------
    phase : (points,) float64 array
        Coarse phase record of one axis.
    deviation : float
        Standard deviation of the white noise per sample: far finer steps are of no account.
    """
    least = COARSEST_IGNORED * deviation
    moved = np.unique(np.abs(phase[np.abs(phase) > least]))
    if len(moved) < LEAST_POINTS or not deviation > 0.0:
        return None
    step = 0.0
    for i, value in enumerate(moved):
        step = _common_divisor(float(value), step, least)
        if step < least:
            return None
        # Euclid gathers rounding errors; the multiples so far, the smallest first, take them out.
        for known in moved[: i + 1]:
            multiple = np.round(known / step)
            if multiple < 1.0:
                return None  # the divisor grew past what it should divide: there is none
            step = float(known / multiple)
    off = np.abs(moved / step - np.round(moved / step))
    return step if off.max() < NEAR_WHOLE else None


def _common_divisor(a: float, b: float, least: float) -> float:
    """Return the greatest common divisor of two numbers, remainders below ``least`` being 0."""
    while b >= least:
        rest = a % b
        a, b = b, min(rest, b - rest)
    return a
