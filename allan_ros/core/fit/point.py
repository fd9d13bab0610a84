# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The point fit of one axis: ramps and powers in turn."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .evidence import Evidence, Table
from .extra import Extra, with_extras
from .model import RANDOM_TERMS, WHITE, Floats
from .solve import N, first_guess, solve

RAMP_ROUNDS = 4
"""Rounds of ramp and table; powers settle in two or three."""

RAMP_TOLERANCE = 1e-2
"""Relative change of the powers that no longer matters to the weights of the ramp."""


@dataclass(frozen=True)
class Frame:
    """How the table of an axis is fitted.

    Attributes
    ----------
    m_min : int
        Smallest averaging factor that is used.
    signed : bool
        Whether q may be negative, as it looks behind a low-pass filter.
    misfit : float
        Fractional error of the model.
    extras : tuple of Extra
        Terms beside the five.
    """

    m_min: int = 1
    signed: bool = False
    misfit: float = 0.0
    extras: tuple[Extra, ...] = ()

    def table(
        self, evidence: Evidence, axis: int, power: Floats, ramps: Floats | None = None
    ) -> Table:
        """Return the table of an axis with the ramps that are best under the powers."""
        table = evidence.table(axis, self.noise(power), ramps)
        return with_extras(table.rows(table.m >= self.m_min), self.extras)

    def noise(self, power: Floats) -> Floats:
        """Return q, w, b, k >= 0 of noise that is like the model's over long times."""
        four: Floats = np.maximum(power[: len(RANDOM_TERMS)], 0.0)
        for extra, p in zip(self.extras, power[len(RANDOM_TERMS) :]):
            four[N] += p * extra.white()
        return four


@dataclass(frozen=True)
class PointFit:
    """Powers, the table (with its ramps) they were fitted to, and how."""

    power: Floats
    table: Table
    frame: Frame = field(default_factory=Frame)

    @property
    def ramp_variance(self) -> Floats:
        """Variance of the ramp of each kept segment, (segments,); 0 where it has none."""
        return np.asarray(self.table.ramp_variance @ self.frame.noise(self.power))


def point_fit(
    evidence: Evidence, axis: int, frame: Frame = Frame(), power: Floats | None = None
) -> PointFit:
    """Return the powers of one axis: ramps out, powers in, until both are steady.

    Parameters
    ----------
    evidence : Evidence
    axis : int
        Position among the axes of the sums.
    frame : Frame
    power : (4,) float64 array, optional
        Where to begin.
    """
    if power is None:
        power = first_guess(evidence.table(axis, WHITE))
    power = np.concatenate([power, np.zeros(len(RANDOM_TERMS) + len(frame.extras) - len(power))])
    table = frame.table(evidence, axis, power)
    for _ in range(RAMP_ROUNDS):
        new = solve(table, power, signed=frame.signed, misfit=frame.misfit)
        settled = np.all(np.abs(new - power) <= RAMP_TOLERANCE * np.abs(power))
        power = new
        if settled:
            break
        table = frame.table(evidence, axis, power)
    return PointFit(power, table, frame)
