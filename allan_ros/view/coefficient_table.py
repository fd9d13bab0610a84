# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of noise coefficients, for readers and for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..core.estimate import Estimate, interval_text, known_numbers, prefixed, value_text
from ..core.fit.result import TERMS
from ..core.imu import ShownUnit, sensor_of, shown_unit
from .table import Cell, Heading, Table

Coefficients = Mapping[str, Mapping[str, Estimate]]
"""Axis -> term -> coefficient in SI."""

WALKS = {'gyro': ('angle', 'rate'), 'accel': ('velocity', 'acceleration')}
"""Sensor -> the quantities whose random walks are called N and K (IEEE Std 952 and 1293)."""


def coefficient_cell(coefficient: Estimate, unit: ShownUnit) -> Cell:
    """Return a cell with the value or the limit of a coefficient, and with its interval."""
    value, *_ = known_numbers(coefficient, unit)
    text, interval = value_text(coefficient, unit), interval_text(coefficient, unit)
    return Cell(text, interval, value, coefficient.status)


def coefficient_table(
    axes: Coefficients, units: str, terms: Sequence[str] = TERMS, prefixes: bool = False
) -> Table:
    """Return a table of the coefficients of one sensor, with a row for each term.

    The columns are the axes.

    Parameters
    ----------
    axes : mapping of axis to coefficients
        The coefficients of at least one axis of a single sensor.
    units : 'deg/h' or 'SI'
        Units of measurement of the values.
    terms : sequence of str
        The terms that are shown.
    prefixes : bool
        Whether a unit with the prefix u or m, such as ug, gets a larger prefix or none if the
        largest magnitude or upper limit of its row is large enough (`prefixed`). Other units, such
        as deg/h, are unchanged.
    """
    sensor = sensor_of(next(iter(axes)))
    rows = []
    for term in terms:
        coefficients = [noise[term] for noise in axes.values()]
        unit = shown_unit(sensor, term, units)
        if prefixes:
            unit = prefixed(unit, largest(coefficients))
        heading = Heading(term, unit.name, term_name(sensor, term))
        rows.append(
            (heading, [coefficient_cell(coefficient, unit) for coefficient in coefficients])
        )
    return Table(Heading(sensor), axis_headings(axes), rows)


def axis_table(axes: Coefficients, units: str, terms: Sequence[str] = TERMS) -> Table:
    """Return a table of coefficients with their units: a row for each axis, a column for each term.

    ``axes`` maps the axes of one or both sensors to coefficients, and ``units`` is 'deg/h' or 'SI'.
    """
    rows = []
    for axis, noise in axes.items():
        cells = []
        for term in terms:
            unit = shown_unit(axis, term, units)
            cell = coefficient_cell(noise[term], unit)
            cells.append(replace(cell, text=f'{cell.text} {unit.name}', detail=''))
        rows.append((Heading(axis), cells))
    return Table(Heading(''), [Heading(term) for term in terms], rows)


def axis_headings(axes: Mapping[str, object]) -> list[Heading]:
    """Return the headings 'x', 'y' and 'z' of the axes of one sensor."""
    return [Heading(axis[-1]) for axis in axes]


def term_name(sensor: str, term: str) -> str:
    """Return the name of a term of 'gyro' or 'accel', such as 'angle random walk' for N."""
    angle, rate = WALKS[sensor]
    return {
        'Q': 'quantization',
        'N': f'{angle} random walk',
        'B': 'bias instability',
        'K': f'{rate} random walk',
        'R': f'{rate} ramp',
    }[term]


def largest(known: Sequence[Estimate]) -> float:
    """Return the largest magnitude of several coefficients in SI.

    For a coefficient that is not resolved, the upper limit is used. The result is 0 if no magnitude
    and no limit is known.
    """
    sizes = [c.value if c.resolved else c.upper95 for c in known]
    return max((abs(s) for s in sizes if s is not None and math.isfinite(s)), default=0.0)


NUMBERS = ('value', 'ci95_low', 'ci95_high', 'upper95')
"""Names of the columns with the numbers that `known_numbers` returns, in the same order."""


def coefficient_list(axes: Coefficients, units: str) -> Table:
    """Return a table of all coefficients for programs, with a row for each axis and term.

    The columns are the axis, the term, the numbers (`NUMBERS`) and the unit. Each cell has a
    `Cell.value`, and no text for display.
    """
    rows = []
    for axis, noise in axes.items():
        for term, coefficient in noise.items():
            unit = shown_unit(axis, term, units)
            values = (term, *known_numbers(coefficient, unit), unit.name)
            rows.append((Heading(axis), [Cell(value=value) for value in values]))
    columns = [Heading(name) for name in ('term', *NUMBERS, 'unit')]
    return Table(Heading('axis'), columns, rows)
