# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons as tables: with limits, with an earlier run, of several recordings or IMUs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..core.allan.common_noise import CommonNoise
from ..core.check import Check
from ..core.estimate import NOTHING_KNOWN, UNKNOWN, Estimate
from ..core.fit.result import TERMS
from ..core.imu import SI_UNITS, sensor_of, shown_unit
from ..core.number_text import prefixed, significant
from ..results.common_result import CommonResult
from ..results.comparison import Inflation, RunComparison, significant_of, use_of
from ..results.results import Results
from .coefficient_table import (
    Coefficients,
    axis_headings,
    coefficient_cell,
    largest,
    term_name,
)
from .comparison_text import ratio_text, verdict_text
from .format import NO_BREAK, pretty_unit
from .table import Cell, Heading, Table


def limit_table(
    axes: Coefficients, comparisons: Sequence[Check], units: str, stated: Mapping[str, str]
) -> Table:
    """Return the coefficients of one sensor, each with its share of the limit and the verdict.

    ``stated`` maps a term to its limits as text. A term without a limit has no row.
    """

    def share_of_limit(check: Check) -> str:
        coefficient = axes[check.axis][check.quantity]
        resolved = coefficient.resolved
        size = coefficient.magnitude.value if resolved else coefficient.upper95
        share = f'{100.0 * size / check.limit:.0f}{NO_BREAK}% of the limit' if size else ''
        return share if resolved or not share else f'< {share}'

    notes = {term: f'stated {text}' for term, text in stated.items()}
    return _checks_table(axes, comparisons, units, notes, share_of_limit)


def baseline_table(
    axes: Coefficients, comparisons: Sequence[Check], units: str, before: Results
) -> Table:
    """Return the coefficients of one sensor, each with its value in ``before`` and the verdict."""

    def former(check: Check) -> str:
        unit = shown_unit(check.axis, check.quantity, units)
        cell = coefficient_cell(before.axes[check.axis].fit.noise[check.quantity], unit)
        return f'before: {cell.text.replace(" ", NO_BREAK)}'

    return _checks_table(axes, comparisons, units, {}, former)


def _checks_table(
    axes: Coefficients,
    comparisons: Sequence[Check],
    units: str,
    notes: Mapping[str, str],
    detail: Callable[[Check], str],
) -> Table:
    """Return the coefficients that are compared; ``detail`` returns the detail of a cell.

    ``notes`` maps terms to explanations that replace the names in the headings.
    """
    sensor = sensor_of(next(iter(axes)))
    rows = []
    for term in TERMS:
        checks = {c.axis: c for c in comparisons if c.quantity == term and c.axis in axes}
        unit = shown_unit(sensor, term, units)
        cells = [
            Cell(
                coefficient_cell(axes[axis][term], unit).text,
                detail(checks[axis]),
                status=checks[axis].verdict,
            )
            if axis in checks
            else Cell()
            for axis in axes
        ]
        if checks:
            note = notes.get(term) or term_name(sensor, term)
            rows.append((Heading(term, unit.name, note), cells))
    return Table(Heading('term'), axis_headings(axes), rows)


def runs_table(comparison: RunComparison, axes: Sequence[str], units: str) -> Table:
    """Return the coefficients of several recordings for the axes of one sensor.

    Each term has a row for each recording, and rows with the ratios to the first recording. Terms
    that no recording measures are omitted. The last rows count the averaging times at which the
    Allan deviation differs from the first recording.
    """
    sensor = sensor_of(axes[0])
    rows: list[tuple[Heading, list[Cell]]] = []
    for term in TERMS:
        known = {run: _of_axes(each, axes, term) for run, each in comparison.runs.items()}
        size = largest([c for of_run in known.values() for c in of_run])
        unit = prefixed(shown_unit(sensor, term, units), size)
        cells = {run: [coefficient_cell(c, unit) for c in of_run] for run, of_run in known.items()}
        if all(cell.text == NOTHING_KNOWN for of_run in cells.values() for cell in of_run):
            continue
        for i, (run, of_run) in enumerate(cells.items()):
            heading = Heading('') if i else Heading(term, unit.name)
            rows.append((heading, [Cell(run), *of_run]))
        for run, checks in comparison.differences.items():
            of_axis = {d.axis: d for d in checks if d.quantity == term}
            ratios = [of_axis.get(axis) for axis in axes]
            texts = [f'{ratio_text(d)} {verdict_text(d)}'.strip() if d else '' for d in ratios]
            rows.append((Heading(''), [Cell(f'{run} ratio'), *map(Cell, texts)]))
    for run, checks in comparison.differences.items():
        counts = [Cell(run)]
        for axis in axes:
            tested = [d for d in checks if d.axis == axis and d.tau is not None]
            differ = len(significant_of(tested))
            counts.append(Cell(f'{differ} of {len(tested)} differ' if tested else ''))
        rows.append((Heading('deviation'), counts))
    runs = Heading('', repeats=True)
    return Table(Heading(sensor), [runs, *(Heading(axis[-1]) for axis in axes)], rows)


def _of_axes(results: Results, axes: Sequence[str], term: str) -> list[Estimate]:
    known = results.axes
    return [known[axis].fit.noise[term] if axis in known else UNKNOWN for axis in axes]


def stated_limits(texts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return term -> its different limits as one text, such as '0.3 °/√h / 0.4 °/√h'."""
    return {
        term: ' / '.join(dict.fromkeys(pretty_unit(text) for text in each)).replace(' ', NO_BREAK)
        for term, each in texts.items()
    }


SHOWN_TAU_S = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Averaging times in s at which a ratio or a coherence is shown."""

NEAR = 1.5
"""Largest ratio between a measured averaging time and the rounded one in the heading."""


def inflation_table(inflation: Inflation) -> Table:
    """Return N and K with motors on, in SI, for a state estimator: a row for each axis.

    The columns beside N and K have the ratios to N and K with motors off.
    """
    rows = []
    for axis, terms in inflation.axes.items():
        units, cells = SI_UNITS[sensor_of(axis)], []
        for term, check in terms.items():
            value = use_of(check)
            cells.append(Cell(f'{significant(value, 4)} {units[term]}', value=value))
            cells.append(Cell(f'{check.factor:.2f}', value=check.factor))
        rows.append((Heading(axis), cells))
    headings = [Heading(name) for term in 'NK' for name in (f'{term} to use', 'factor')]
    return Table(Heading(''), headings, rows)


def deviation_ratio_table(inflation: Inflation) -> Table:
    """Return the ratios of Allan deviations with motors on and off: a row for each axis."""
    ratios = {axis: inflation.ratios(axis) for axis in inflation.axes}
    cells = {
        tau: [_ratio_cell(_nearest(checks, tau)) for checks in ratios.values()]
        for tau in SHOWN_TAU_S
    }
    shown = [tau for tau, column in cells.items() if any(cell.text for cell in column)]
    rows = [(Heading(axis), [cells[tau][i] for tau in shown]) for i, axis in enumerate(ratios)]
    return Table(Heading(''), [Heading(f'{tau:g} s') for tau in shown], rows)


def _nearest(checks: Sequence[Check], tau: float) -> Check | None:
    """Return the ratio whose averaging time is closest to ``tau``; None if none is near."""
    near = [c for c in checks if c.tau is not None and tau / NEAR < c.tau < NEAR * tau]
    return min(near, key=lambda c: abs((c.tau or 0.0) - tau), default=None)


def _ratio_cell(check: Check | None) -> Cell:
    if check is None or check.ratio.value is None or check.ratio.ci95 is None:
        return Cell()
    return _share_cell(check.ratio.value, *check.ratio.ci95)


def _share_cell(value: float, low: float, high: float) -> Cell:
    # adding 0.0 turns -0.0 into 0.0, so that no minus sign is written
    value, low, high = (round(number, 2) + 0.0 for number in (value, low, high))
    return Cell(f'{value:.2f}', f'{low:.2f}..{high:.2f}', value)


def common_table(common: CommonResult, units: str = 'deg/h') -> Table:
    """Return N as measured, N without common noise, and the coherence of the IMUs.

    There is a row for each axis and IMU, or for each two axes of one IMU.
    """
    times = SHOWN_TAU_S[1:]
    cells = {tau: [_coherence_cell(row, tau) for row in common.rows] for tau in times}
    shown = [tau for tau, column in cells.items() if any(cell.text for cell in column)]
    has_noise = any(row.measured or row.own for row in common.rows)
    has_gains = any(row.gain != 1.0 for row in common.rows)
    rows = []
    for i, row in enumerate(common.rows):
        unit, noise = shown_unit(row.axis, 'N', units), []
        for known in (row.measured, row.own) if has_noise else ():
            noise.append(Cell() if known is None else coefficient_cell(known, unit))
        if has_gains:
            noise.append(Cell(f'{row.gain:.3f}', value=row.gain))
        heading = Heading(row.axis, unit.name if has_noise else '')
        rows.append((heading, [Cell(row.label), *noise, *(cells[t][i] for t in shown)]))
    own = 'own N' if len({row.label for row in common.rows}) > 2 else 'own N, mean of both'
    numbers = [*(('N', own) if has_noise else ()), *(('factor',) if has_gains else ())]
    names = ['IMU', *numbers, *(f'at {t:g} s' for t in shown)]
    return Table(
        Heading('axis'),
        [Heading(name, repeats=name == 'IMU') for name in names],
        rows,
        '95 % intervals; coherence at averaging times: 0 is independent noise, 1 common noise, '
        'such as vibration',
    )


def _coherence_cell(row: CommonNoise, tau: float) -> Cell:
    times, *numbers = row.coherence
    distance = np.abs(np.log(times / tau))
    at = int(np.argmin(distance))
    if distance[at] > np.log(NEAR):
        return Cell()
    return _share_cell(*(float(number[at]) for number in numbers))
