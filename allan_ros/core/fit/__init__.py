# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimate the noise coefficients of an IMU from its Allan sums: `stationary.fit_stationary`.

Terms
-----
- *variance coefficients* q, w, b, k: the squares of Q, N, B, K with the sample period tau0 as the
  unit of time. The expected values of all statistics are linear in these coefficients.
- *ramp*: constant rate of change of the samples (term R), in the unit of the samples per sample.
- *process*: a Gauss-Markov process, a sinusoid or a resonance that is added to the model if the
  five terms do not describe the data. The *shape* of a process is its correlation time, its
  frequency, or both.
- *component*: a term or a process of a model.
- *gain*: decrease of -2 log likelihood.
- *lack of fit*: significant difference of the data from the model in an octave of frequencies.
"""
