# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two further terms of IEEE Std 952: Gauss-Markov noise and a sinusoid.

They have a shape, their correlation time or frequency, besides their power, and are fitted only
where the five terms fail (module `search`). Their Allan variance is that of module `terms`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..terms import gauss_markov_avar, sinusoid_avar
from .evidence import Table
from .model import RANDOM_TERMS, Floats, avar_terms

N = RANDOM_TERMS.index('N')

LINE_PEAK = 0.371
"""f m where sin^4(pi f m)/(pi f m)^2 is largest."""


@dataclass(frozen=True)
class GaussMarkovTerm:
    """First-order Gauss-Markov noise; its shape is the correlation time in samples."""

    shape: float

    exponent = 2.0
    """It scatters like the noise it joins: the covariance grows as V^2."""

    @property
    def scale(self) -> float:
        """Averaging factor at which it stands out."""
        return self.shape

    def column(self, table: Table) -> Floats:
        """Return its Allan variance at unit power, (factors,).

        What removing the ramps took from it is what they took from its white noise.
        """
        taken = avar_terms(table.m)[:, N] - table.terms[:, N]
        return gauss_markov_avar(table.m, self.shape) - self.white() * taken

    def white(self) -> float:
        """Return the w of white noise that it looks like over long times, at unit power."""
        return 2.0 * self.shape


@dataclass(frozen=True)
class SinusoidTerm:
    """A line in the spectrum; its shape is the frequency in cycles per sample."""

    shape: float

    exponent = 1.0
    """It does not scatter, but multiplies with the noise: the covariance grows as V."""

    @property
    def scale(self) -> float:
        """Averaging factor at which it stands out."""
        return LINE_PEAK / self.shape

    def column(self, table: Table) -> Floats:
        """Return its Allan variance at unit power, (factors,)."""
        return sinusoid_avar(table.m, self.shape)

    def white(self) -> float:
        """Return the w of white noise that it looks like over long times: none."""
        return 0.0


Extra = GaussMarkovTerm | SinusoidTerm


def with_extras(table: Table, extras: tuple[Extra, ...]) -> Table:
    """Return the table with a column for each extra term."""
    columns = np.column_stack([table.terms, *(e.column(table) for e in extras)])
    return replace(table, terms=columns, exponents=tuple(e.exponent for e in extras))
