# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The point fit of one axis: ramps and powers in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .evidence import Evidence, Table
from .model import Floats
from .solve import first_guess, solve

RAMP_ROUNDS = 4
"""Rounds of ramp and table; powers settle in two or three."""

RAMP_TOLERANCE = 1e-2
"""Relative change of the powers that no longer matters to the weights of the ramp."""


@dataclass(frozen=True)
class PointFit:
    """Powers, and the table (with its ramps) they were fitted to."""

    power: Floats
    table: Table


def point_fit(evidence: Evidence, axis: int, *, signed: bool = False) -> PointFit:
    """Return the powers of one axis: ramps out, powers in, until both are steady."""
    white = np.array([0.0, 1.0, 0.0, 0.0])
    table = evidence.table(axis, white)
    power = first_guess(table)
    for _ in range(RAMP_ROUNDS):
        table = evidence.table(axis, power)
        new = solve(table, power, signed=signed).power
        settled = np.all(np.abs(new - power) <= RAMP_TOLERANCE * np.abs(power))
        power = new
        if settled:
            break
    return PointFit(power, table)
