# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From sums to the five coefficients: `fit_noise`."""

from .values import TERMS, AxisFit, Coefficient, GaussMarkov, NoiseFit, Sinusoid

__all__ = ['TERMS', 'AxisFit', 'Coefficient', 'GaussMarkov', 'NoiseFit', 'Sinusoid']
