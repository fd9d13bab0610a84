# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes by name and shape, for the components of the fit."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .model import BY_LETTER
from .process import Floats, Gamma, Process
from .registry import PROCESSES


class ProcessType(NamedTuple):
    """Meaning of each number of the shape of a process."""

    shape: tuple[Literal['time', 'frequency'], ...]  # in samples, in cycles per sample


PROCESS_TYPES = {
    name: ProcessType(tuple('time' if p.unit == 's' else 'frequency' for p in one.parameters))
    for name, one in PROCESSES.items()
    if one.parameters
}
"""Noise types with a shape."""


def process_of(kind: str, *shape: float) -> Process:
    """Return a term by its letter, or a process by its name and shape."""
    return BY_LETTER[kind] if kind in BY_LETTER else PROCESSES[kind](*shape)


def gamma_of(kind: str, *shape: float) -> Gamma:
    """Return gamma(M, j) of a term or of a process with the given shape."""
    return process_of(kind, *shape).gamma


def unit_avar(m: ArrayLike, kind: str, *shape: float) -> Floats:
    """Return the Allan variance of a noise type with the coefficient 1 at averaging factors m."""
    gamma = gamma_of(kind, *shape)
    return np.asarray(gamma(m, 0) - gamma(m, 1))
