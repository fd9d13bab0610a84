# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All thresholds of the fit, with the false-alarm probability that each stands for.

Rates in parentheses are measured in the 2,100 axes of ``docs/validation.md``, which have none of
these effects. Limits that only save time or guard a search are in the modules that use them.
"""

GAIN_PROCESS = 11.0
"""Least gain in -2 log L of one more process, plus 2 log(bins) if it has a frequency: 1 % of axes
(0.7 % with `GAIN_BOUNDED`; sinusoids and resonances: none)."""

GAIN_BOUNDED = 7.0
"""Least gain in -2 log L of a bounded random walk instead of K, at any correlation time: 1 %."""

GAIN_RESOLVED = 5.41
"""Least gain in -2 log L from 0 for a term to be resolved: one-sided 1 % (B 1.0, K 1.0 %)."""

LEVEL_95 = 3.841
"""Decrease of -2 log L at the ends of a 95 % interval."""

MAX_PROCESSES = 6

SHORTEST_TIME = 8.0
"""Shortest correlation time of a Gauss-Markov process in samples; shorter ones are white noise."""

LEAST_LINE_DOF = 100.0
"""Least degrees of freedom of a bin that a sinusoid dominates. With fewer, the amplitude is
inaccurate; with all, a strong sinusoid would have to be as narrow as the model."""

LINES_PER_OCTAVE = 3
"""Sinusoids within an octave that can imitate any smooth spectrum (no axis)."""

LACK_OF_FIT = 1e-3
"""Probability of the chi^2 test of the octaves below which a model is rejected: 0.1 % (0.05 %)."""

CURVATURE = 2.5
"""Normal deviate of the next power of f of a low-pass filter above which a filter is assumed:
one-sided 0.6 % (0.6 %)."""

LEAST_BINS = 12
"""Fewest bins of a fit with a lower highest frequency."""

WHITE_NOISE = 3.0
"""Least ratio of the white noise to its standard error in a model that holds (within the 0.6 %)."""

LOST_POWER = 0.8, 0.5
"""Power of the highest octave, and of lower ones, relative to two octaves lower, below which the
search for the highest frequency of a filtered axis begins below this octave. They save time."""

RAMP_RESOLVED = 2.58 / 1.96
"""Least |R| in units of the half width of its interval for R to be resolved: two-sided 1 % (1.0 %
of the 900 axes without R)."""

LEAST_DRIFT_S = 10.0
"""Shortest time at rest in s for which B, K and R are estimated."""

LEAST_STATISTICS = 12
"""Fewest bins and contrasts of a fit."""

GAIN_WARM_UP = 16.5
"""Least gain in -2 log L of a warm-up, summed over the axes of a sensor: 1 % per sensor. The
99 % quantiles without a warm-up are 10 to 13, depending on the noise (`bench_stationarity.py`)."""

GAIN_STEPS, GAIN_MORE_STEPS = 20.0, 10.0
"""Least gain in -2 log L of a step of the bias, and of each further one. The 99 % quantiles without
steps are 11 to 22, depending on the noise (`bench_stationarity.py`)."""

LEVEL_CHANGES = 1e-3
"""Probability below which the level of the white noise varies, per axis (0 of 240 records)."""

TEMPERATURE_RESOLVED = 0.01
"""Probability of the F test of b1 and b2 below which a bias depends on temperature, per axis."""
