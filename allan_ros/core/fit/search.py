# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which extra term the table asks for, if any: its shape, and how well the table pins it down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .active_set import nonnegative_least_squares
from .evidence import Table
from .extra import Extra, GaussMarkovTerm, SinusoidTerm
from .model import Floats
from .solve import Q, Whitening, weights_at

SHAPES_PER_OCTAVE = 8
"""Shapes tried in the first search."""

LONGEST_CORRELATION = 10
"""A correlation time over a tenth of the record cannot be told from flicker and a walk."""

SHORTEST_CORRELATION = 4.0
"""Samples: a shorter one cannot be told from white noise."""

FASTEST_LINE = 0.25
"""Of the sample rate: a faster line is hidden in the first two averaging factors."""

LINE_CYCLES = 10
"""A line must pass so often in the record to be one."""

LEAST_GAIN = 12.0
"""Fall of chi^2 that chance does not bring about in any of some hundred shapes (3.5 sigma)."""

PINNED_RISE = 3.84
"""Rise of chi^2 that bounds the shape at 95 %."""

PINNED_RATIO = 2.0
"""A shape is pinned down if its interval spans less than this factor to either side."""


Kind = type[GaussMarkovTerm] | type[SinusoidTerm]


@dataclass(frozen=True)
class Candidate:
    """An extra term that the table may ask for.

    Attributes
    ----------
    extra : Extra
    low, high : float
        The 95 % interval of its shape.
    power_low, power_high : float
        Its power at the ends of that interval that are least and greatest, relative to its power.
    gain : float
        How far it brings chi^2 down.
    """

    extra: Extra
    low: float
    high: float
    power_low: float
    power_high: float
    gain: float

    @property
    def pinned(self) -> bool:
        """Whether the table asks for the term and knows its shape."""
        near = self.extra.shape / PINNED_RATIO < self.low
        return self.gain > LEAST_GAIN and near and self.high < self.extra.shape * PINNED_RATIO


def candidates(table: Table, power: Floats, misfit: float, samples: int) -> list[Candidate]:
    """Return the best Gauss-Markov term and the best line, whichever gains most first.

    Parameters
    ----------
    table : Table
        Without the term to be found.
    power : (terms,) float64 array
        A fit of it.
    misfit : float
        Fractional error of that fit: the weights of the comparison.
    samples : int
        Length of the longest segment.
    """
    shapes: list[tuple[Kind, float, float]] = [
        (GaussMarkovTerm, SHORTEST_CORRELATION, samples / LONGEST_CORRELATION),
        (SinusoidTerm, LINE_CYCLES / samples, FASTEST_LINE),
    ]
    search = _Search(table, power, misfit)
    found = [search.best(kind, low, high) for kind, low, high in shapes if low < high]
    return sorted(found, key=lambda c: -c.gain)


class _Search:
    """chi^2 of one table with one more term, its weights held."""

    def __init__(self, table: Table, power: Floats, misfit: float) -> None:
        self.table = table
        self.whitening = Whitening.of(weights_at(table, power, misfit))
        self.columns = np.column_stack([table.terms, table.avar])
        white = self.whitening.apply(self.columns)
        self.without = _fitted(white[:, :-1], white[:, -1])[0]

    def tried(self, kind: Kind, shapes: Floats) -> tuple[Floats, Floats]:
        """Return chi^2 with the term at each shape, and its power there."""
        more = [kind(float(s)).column(self.table) for s in shapes]
        white = self.whitening.apply(np.column_stack([self.columns, *more]))
        known = self.columns.shape[1]
        terms, target = white[:, : known - 1], white[:, known - 1]
        fits = [_fitted(np.column_stack([terms, c]), target) for c in white[:, known:].T]
        chi_squared, power = np.array(fits).T
        return chi_squared, power

    def best(self, kind: Kind, low: float, high: float) -> Candidate:
        """Return the shape of least chi^2 and its interval."""
        number = int(np.log2(high / low) * SHAPES_PER_OCTAVE) + 2
        shapes = np.geomspace(low, high, number)
        at = shapes[int(np.argmin(self.tried(kind, shapes)[0]))]
        step = shapes[1] / shapes[0]
        fine = at * np.geomspace(1.0 / step, step, 2 * SHAPES_PER_OCTAVE + 1)
        fine = fine[(fine >= low) & (fine <= high)]
        near, powers = self.tried(kind, fine)
        middle = int(np.argmin(near))
        shape, least, power = float(fine[middle]), float(near[middle]), float(powers[middle])
        reach = shape * np.geomspace(1.0 / PINNED_RATIO, PINNED_RATIO, 4 * SHAPES_PER_OCTAVE + 1)
        around, powers = self.tried(kind, reach)
        inside = around < least + PINNED_RISE
        inside[len(reach) // 2] = True
        spacing = float(reach[1] / reach[0])
        relative = powers[inside] / power if power > 0.0 else np.ones(1)
        return Candidate(
            kind(shape),
            float(reach[inside].min()) / spacing,
            float(reach[inside].max()) * spacing,
            min(float(relative.min()), 1.0),
            max(float(relative.max()), 1.0),
            self.without - least,
        )


def _fitted(design: Floats, target: Floats) -> tuple[float, float]:
    """Return the least squared residual, with q of either sign, and the last power."""
    power = nonnegative_least_squares(design, target, (Q,))
    rest = target - design @ power
    return float(rest @ rest), float(power[-1])
