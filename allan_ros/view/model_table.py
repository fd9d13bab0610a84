# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the fitted models: numbers for a state estimator, parts of the model, error growth."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..core.estimate import NOTHING_KNOWN, VALUE_DIGITS, Estimate, significant
from ..core.fit.result import TERMS
from ..core.imu import ShownUnit, sensor_of
from ..core.settings import UNIT_SYSTEMS
from ..export import RAISED, origin_text, target_rows
from ..results.axis_result import AxisResult
from ..results.results import Results
from .coefficient_table import WALKS, axis_headings
from .format import NO_BREAK, deviation_text, part_text
from .table import Cell, Heading, Table

Axes = Mapping[str, AxisResult]
"""Axis -> results, for the axes of one sensor."""

ERROR_UNITS = {
    'gyro': {'deg/h': ShownUnit('°', 180.0 / math.pi), 'SI': ShownUnit('rad', 1.0)},
    'accel': dict.fromkeys(UNIT_SYSTEMS, ShownUnit('m/s', 1.0)),
}
"""Sensor -> 'deg/h' or 'SI' -> unit of the predicted error, which is an angle or a velocity."""

PLAIN = 'plain'
"""Status of a cell whose text is shown less prominently than a coefficient."""


def filter_table(results: Results) -> Table:
    """Return a table of the noise parameters in imu.yaml, in SI, with a row for each parameter.

    Each cell also states how its number was computed. Raises AllanError if imu.yaml cannot be
    written, for example because a sensor was not measured, or the unit of the samples is wrong.
    """
    measured_rows = [row for row in target_rows(results, 'kalibr') if row.levels]
    is_raised = any(level.raised_from is not None for row in measured_rows for level in row.levels)
    rows = [
        (
            Heading(row.key),
            [
                Cell(
                    significant(row.value, VALUE_DIGITS),
                    ', '.join(map(origin_text, row.levels)),
                    row.value,
                )
            ],
        )
        for row in measured_rows
    ]
    return Table(Heading(''), [Heading('', wraps=True)], rows, RAISED if is_raised else '')


def parts_table(axes: Axes) -> Table:
    """Return a table about the models of a sensor, with a column for each axis.

    The rows are: the largest deviation of the curve from the model; the dominant noise in each
    range of averaging times; and the other parts of the model, which are processes and likely
    terms. A row without content is omitted.
    """

    def lines_cell(parts: list[str]) -> Cell:
        return Cell('\n'.join(parts) or NOTHING_KNOWN, status=PLAIN)

    regions = [
        [
            f'{significant(r.tau_low, 2)}..{significant(r.tau_high, 2)}{NO_BREAK}s '
            + part_text(r.term, axis.fit.likely)
            for r in axis.regions
        ]
        for axis in axes.values()
    ]
    other_parts = [
        [
            f'{part}, likely but not resolved (?)' if part in TERMS else part
            for part in axis.part_adev(np.ones(1, int))
            if part not in TERMS or part in axis.fit.likely
        ]
        for axis in axes.values()
    ]
    deviations = [
        [text] if (text := deviation_text(axis.fit.deviation)) else [] for axis in axes.values()
    ]
    all_rows = (
        (Heading('largest deviation', note='of the curve from the model'), deviations),
        (Heading('dominant noise', note='by averaging time'), regions),
        (Heading('other parts', note='of the model'), other_parts),
    )
    rows = [(heading, [*map(lines_cell, parts)]) for heading, parts in all_rows if any(parts)]
    return Table(Heading(''), axis_headings(axes), rows)


def error_growth_table(axes: Axes, units: str) -> Table:
    """Return a table of the predicted angle or velocity error of one sensor without correction.

    Each cell contains the standard deviation of the error with its 95 % interval. There is a row
    for each time since the last correction, and a column for each axis.
    """
    sensor = sensor_of(next(iter(axes)))
    unit = ERROR_UNITS[sensor][units]
    rows = [
        (
            Heading(f'after {axis_growths[0].horizon:g}{NO_BREAK}s'),
            [size_cell(g.std, unit.factor) for g in axis_growths],
        )
        for axis_growths in zip(*(axis.growth for axis in axes.values()))
    ]
    return Table(Heading(f'{WALKS[sensor][0]} error', unit.name), axis_headings(axes), rows)


def size_cell(known: Estimate, factor: float) -> Cell:
    """Return a cell with a standard deviation (SI) and its 95 % interval, times ``factor``.

    If the interval begins at 0, only its upper end is stated. Without an interval, only the
    standard deviation is stated. If nothing above 0 is known, the text is `NOTHING_KNOWN`.
    """
    size = known.value or 0.0
    low, high = known.ci95 or (size, size)
    if not low > 0.0:
        return Cell(f'< {significant(high * factor, 2)}' if high > 0.0 else NOTHING_KNOWN)
    interval = '..'.join(significant(end * factor, 2) for end in known.ci95 or ())
    return Cell(significant(size * factor, 2), interval, size * factor)
