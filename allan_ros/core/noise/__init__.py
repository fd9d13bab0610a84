# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise processes, and the noise model of one axis."""

from __future__ import annotations

from .old import (
    FLICKER_FLOOR,
    PROCESS_TYPES,
    Gamma,
    NoiseTerms,
    ProcessModel,
    gamma_of,
    gauss_markov_avar,
    term_avar,
    unit_avar,
)

__all__ = [
    'FLICKER_FLOOR',
    'PROCESS_TYPES',
    'Gamma',
    'NoiseTerms',
    'ProcessModel',
    'gamma_of',
    'gauss_markov_avar',
    'term_avar',
    'unit_avar',
]
