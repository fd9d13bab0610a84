# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rounding errors of a counter: their shape is computed from the step and the mean of the samples.

Why the shape is computed
-------------------------
If the rounding errors are correlated, a fit with quantization noise, which assumes independent
errors, has a wrong N and Q. The spectrum of the correlated errors differs from the spectrum of
quantization noise mostly by a combination of the spectra of Q and N. Therefore, a search by
likelihood would find the correlation only in data from which N and Q are already wrong by several
standard errors.
"""

from __future__ import annotations

import math

import numpy as np

from ..allan.at_rest import step_of_sums
from ..allan.sums import AllanSums
from ..noise import RANDOM_TERMS, Process
from ..noise.processes.rounded_angle import rounding_of_counter
from .likelihood import AxisData
from .result import N, Q
from .selection import TOLERANCE

LEAST_RATIO = 1.8
"""Least ratio of the squared step to the variance of the samples for which the correlation of the
rounding errors is taken into account. This ratio is reached if the step is 1.6 times the standard
deviation of the white noise of a sample. The correlation of successive rounding errors is then
0.03 %."""

LARGEST_DIFFERENCE = 0.2
"""Largest relative difference between the fitted variance of the rounding errors and step^2/12. If
the difference is larger, the samples are rounded without carrying the remainder."""

ROUNDS = 3
"""Number of times that the shape is computed from N, and N is fitted again."""


def rounding_errors(sums: AllanSums, axis: int, data: AxisData) -> Process | None:
    """Return the rounding errors of a counter with a large step, or None.

    The result is None if no step is found, if the step is too small (`LEAST_RATIO`), or if the
    fitted variance of the errors is not near step^2/12 (`LARGEST_DIFFERENCE`).

    ``data`` are the statistics of the axis. The shape of the result is in samples. It depends on
    the step, on the white noise, and on the rate, which the block means show
    (`rounding_of_counter`).
    """
    step = step_of_sums(sums, axis, math.sqrt(data.scale))
    if step is None or step**2 < LEAST_RATIO * data.scale:
        return None
    means = np.concatenate([m.values[:, axis] for r in sums.recordings for m in r.means])
    effect_of_rate = complex(np.mean(np.exp(2j * math.pi / step * means)))
    fit, rounding = data.solve(RANDOM_TERMS, tolerance=TOLERANCE), None
    for _ in range(ROUNDS):
        rounding = rounding_of_counter(step, float(fit.p[N]) * data.scale, effect_of_rate)
        fit = data.solve((rounding, *RANDOM_TERMS[Q + 1 :]), None, fit.p, tolerance=TOLERANCE)
    is_carried = abs(12.0 * fit.p[Q] * data.scale / step**2 - 1.0) < LARGEST_DIFFERENCE
    return rounding if is_carried else None
