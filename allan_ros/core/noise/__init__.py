# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise processes, and the noise model of one axis."""

from __future__ import annotations

from .model import Model, Part
from .process import Gamma, Parameter, Process
from .processes.flicker import FLICKER_FLOOR
from .processes.gauss_markov import GaussMarkov
from .registry import LETTERS, PROCESSES, RANDOM_TERMS, REPLACEMENTS, SEARCHED

__all__ = [
    'FLICKER_FLOOR',
    'LETTERS',
    'PROCESSES',
    'RANDOM_TERMS',
    'REPLACEMENTS',
    'SEARCHED',
    'Gamma',
    'GaussMarkov',
    'Model',
    'Parameter',
    'Part',
    'Process',
]
