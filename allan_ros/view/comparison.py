# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons of coefficients with limits, other recordings, or other IMUs: tables and sentences.

`inflation_lines` and `common_lines` add titles and notes for the terminal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ..core.allan.common_noise import CommonNoise
from ..core.check import Check
from ..core.estimate import NOTHING_KNOWN, UNKNOWN, Estimate, prefixed, significant
from ..core.filters.noise_parameters import horizon_text
from ..core.findings import grouped
from ..core.fit.result import TERMS
from ..core.imu import SI_UNITS, sensor_of, shown_unit
from ..results.common_result import CommonResult
from ..results.comparison import Inflation, RunComparison, significant_of, use_of
from ..results.results import UNSUITABLE, WRONG_UNITS, Results
from .coefficient_table import (
    Coefficients,
    axis_headings,
    coefficient_cell,
    largest,
    term_name,
)
from .finding_text import finding_line, texts_of
from .format import NO_BREAK, pretty_unit
from .table import WIDE, Cell, Heading, Table, terminal_lines

# --- limits and former values ---------------------------------------------------------------------


def stated_limits(texts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return term -> its different limits as one text, such as '0.3 °/√h / 0.4 °/√h'."""
    return {
        term: ' / '.join(dict.fromkeys(map(pretty_unit, limits))).replace(' ', NO_BREAK)
        for term, limits in texts.items()
    }


def limit_table(
    axes: Coefficients, comparisons: Sequence[Check], units: str, stated: Mapping[str, str]
) -> Table:
    """Return a table of the coefficients of a sensor, with percentages of the limits and verdicts.

    ``stated`` maps a term to the text of its limits in the datasheet. A term without a limit has no
    row.
    """

    def share_of_limit(check: Check) -> str:
        coefficient = axes[check.axis][check.quantity]
        is_resolved = coefficient.resolved
        size = coefficient.magnitude.value if is_resolved else coefficient.upper95
        share = f'{100.0 * size / check.limit:.0f}{NO_BREAK}% of the limit' if size else ''
        return share if is_resolved or not share else f'< {share}'

    notes = {term: f'stated {text}' for term, text in stated.items()}
    return _checks_table(axes, comparisons, units, notes, share_of_limit)


def baseline_table(
    axes: Coefficients, comparisons: Sequence[Check], units: str, before: Results
) -> Table:
    """Return a table of the coefficients of one sensor, with former values and verdicts.

    ``before`` are the earlier results, which contain the former values. A term has a row if
    ``comparisons`` contains a check of this term.
    """

    def former_value(check: Check) -> str:
        unit = shown_unit(check.axis, check.quantity, units)
        cell = coefficient_cell(before.axes[check.axis].fit.noise[check.quantity], unit)
        return f'before: {cell.text.replace(" ", NO_BREAK)}'

    return _checks_table(axes, comparisons, units, {}, former_value)


def _checks_table(
    axes: Coefficients,
    comparisons: Sequence[Check],
    units: str,
    notes: Mapping[str, str],
    detail: Callable[[Check], str],
) -> Table:
    """Return a table of the coefficients in ``comparisons``, with a row for each term.

    ``detail`` returns the text that is shown with a coefficient, given its check. ``notes`` maps a
    term to a text that the heading of the row contains instead of the name of the term.
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


# --- recordings -----------------------------------------------------------------------------------

RATIO_DIGITS = 3
"""Significant digits of a ratio and of the ends of its interval."""


def ratio_text(difference: Check) -> str:
    """Return a ratio with its 95 % interval, or its limit, as text; '' without an interval."""
    if difference.ratio.ci95 is None:
        return ''
    low, high = difference.ratio.ci95
    if difference.ratio.value is not None:
        interval = '..'.join(significant(end, RATIO_DIGITS) for end in (low, high))
        return f'{significant(difference.ratio.value, RATIO_DIGITS)} ({interval})'
    if math.isinf(high):
        return f'> {significant(low, RATIO_DIGITS)}'
    return f'< {significant(high, RATIO_DIGITS)}'


def verdict_text(difference: Check) -> str:
    """Return the verdict on the second of two recordings: 'alike', 'higher' or 'lower'.

    If the comparison is impossible or undecided, the text is 'not comparable'.
    """
    return 'not comparable' if difference.verdict == 'undecided' else difference.verdict


def runs_table(comparison: RunComparison, axes: Sequence[str], units: str) -> Table:
    """Return a table that compares the coefficients of several recordings, for one sensor.

    Each term has a row for each recording, and further rows with the coefficients of the other
    recordings divided by the coefficients of the first recording. Terms for which no recording has
    a value or a limit are omitted. The last rows state at how many averaging times the Allan
    deviations of a recording and of the first recording differ significantly.
    """
    sensor = sensor_of(axes[0])
    rows: list[tuple[Heading, list[Cell]]] = []
    for term in TERMS:
        coefficients = {
            run: _coefficients_of(results, axes, term) for run, results in comparison.runs.items()
        }
        largest_size = largest([c for estimates in coefficients.values() for c in estimates])
        unit = prefixed(shown_unit(sensor, term, units), largest_size)
        cells = {
            run: [coefficient_cell(c, unit) for c in estimates]
            for run, estimates in coefficients.items()
        }
        if all(cell.text == NOTHING_KNOWN for run_cells in cells.values() for cell in run_cells):
            continue
        for i, (run, run_cells) in enumerate(cells.items()):
            heading = Heading('') if i else Heading(term, unit.name)
            rows.append((heading, [Cell(run), *run_cells]))
        for run, checks in comparison.differences.items():
            check_of_axis = {d.axis: d for d in checks if d.quantity == term}
            axis_checks = [check_of_axis.get(axis) for axis in axes]
            texts = [f'{ratio_text(d)} {verdict_text(d)}'.strip() if d else '' for d in axis_checks]
            rows.append((Heading(''), [Cell(f'{run} ratio'), *map(Cell, texts)]))
    for run, checks in comparison.differences.items():
        count_cells = [Cell(run)]
        for axis in axes:
            tested_deviations = [d for d in checks if d.axis == axis and d.tau is not None]
            n_different, n_tested = len(significant_of(tested_deviations)), len(tested_deviations)
            count_cells.append(Cell(f'{n_different} of {n_tested} differ' if n_tested else ''))
        rows.append((Heading('deviation'), count_cells))
    run_heading = Heading('', repeats=True)
    return Table(Heading(sensor), [run_heading, *(Heading(axis[-1]) for axis in axes)], rows)


def _coefficients_of(results: Results, axes: Sequence[str], term: str) -> list[Estimate]:
    axis_results = results.axes
    return [
        axis_results[axis].fit.noise[term] if axis in axis_results else UNKNOWN for axis in axes
    ]


def quantity_text(difference: Check) -> str:
    """Return the axis and the quantity of a comparison, such as 'gyro x deviation at 1.0 s'.

    For a coefficient, the text is, for example, 'gyro x N'.
    """
    axis = difference.axis.replace('_', ' ')
    if difference.tau is None:
        return f'{axis} {difference.quantity}'
    return f'{axis} deviation at {significant(difference.tau, 2)} s'


def _sentence(comparison: RunComparison, label: str, checks: Sequence[Check]) -> str:
    first_label, differing = comparison.first, significant_of(checks)
    if not differing:
        n_terms = sum(d.tau is None and d.verdict == 'alike' for d in checks)
        n_deviations = sum(d.tau is not None and d.verdict == 'alike' for d in checks)
        if not n_terms + n_deviations:
            return f'{label} and {first_label} have no quantity that can be compared'
        return (
            f'{label} and {first_label} do not differ significantly in {n_terms} coefficients '
            f'and {n_deviations} deviations '
            f'({100.0 * comparison.family_error:g} % false alarms overall)'
        )
    # Coefficients take precedence over Allan deviations.
    candidates = [d for d in differing if d.tau is None] or differing
    largest_ratio = max(candidates, key=_size)
    return (
        f'{label} differs from {first_label} in {len(differing)} of {len(checks)} comparisons, '
        f'most in {quantity_text(largest_ratio)}: {ratio_text(largest_ratio)} times'
    )


def _equivalence_sentence(comparison: RunComparison, label: str, checks: Sequence[Check]) -> str:
    terms_by_result: dict[str, dict[str, list[str]]] = {
        'same': {},
        'different': {},
        'undecided': {},
    }
    for d in checks:
        if d.tau is None and d.p is not None:
            terms = terms_by_result[d.equivalence(comparison.within)]
            terms.setdefault(d.quantity, []).append(d.axis.replace('_', ' '))
    texts = (
        '; '.join(f'{term} of {", ".join(axes)}' for term, axes in terms.items())
        for terms in terms_by_result.values()
    )
    same_terms, different_terms, undecided_terms = (text or 'no term' for text in texts)
    return (
        f'{label} is the same as {comparison.first} to {100.0 * comparison.within:g} % in '
        f'{same_terms}; it differs by more in {different_terms}; undecided, because the intervals '
        f'are too wide: {undecided_terms}'
    )


def _size(difference: Check) -> float:
    """Return the distance from 1 to the 95 % interval of a significant ratio, as a logarithm."""
    low, high = difference.ratio.ci95 or (1.0, 1.0)
    return math.log(low) if low > 1.0 else -math.log(high)


def _datasheet_sentence(label: str, results: Results) -> str:
    name, checks = results.datasheet.name if results.datasheet else '', results.datasheet_checks
    exceeded = [
        f'{c.axis.replace("_", " ")} {c.quantity}' for c in checks if c.verdict == 'exceeds'
    ]
    if exceeded:
        return f'{label} exceeds the datasheet of {name} in {", ".join(exceeded)}'
    n_undecided = sum(c.verdict == 'undecided' for c in checks)
    if n_undecided == len(checks):
        return f'{label} cannot be judged by the datasheet of {name}'
    note = f'; {n_undecided} of {len(checks)} are undecided' if n_undecided else ''
    return f'{label} is within the datasheet of {name}{note}'


def sentences(comparison: RunComparison) -> Iterator[str]:
    """Yield the results of a comparison as sentences.

    The first sentences name recordings with a wrong or changed unit of measurement, and recordings
    that do not show the noise of the sensor at rest, for example because it moved. Then one
    sentence for each further recording compares it with the first recording. If
    ``comparison.within`` is set, further sentences state the results of the tests of equivalence
    with the first recording. The last sentences compare the recordings with datasheets.
    """
    for label, results in comparison.runs.items():
        for finding in grouped(results.findings):
            if finding.id in (*WRONG_UNITS, *UNSUITABLE):
                yield f'{label}: {texts_of(finding).message.rstrip(".")}'
    for each in comparison.differences.items():
        yield _sentence(comparison, *each)
    for each in comparison.differences.items() if comparison.within else ():
        yield _equivalence_sentence(comparison, *each)
    for label, results in comparison.checked:
        yield _datasheet_sentence(label, results)


# --- motors and other IMUs ------------------------------------------------------------------------

SHOWN_TAU_S = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Averaging times in s at which a ratio or a coherence is shown."""

NEAR = 1.5
"""Largest factor between the averaging time of a measured ratio or coherence and the rounded
averaging time in the heading of its column."""


def inflation_table(inflation: Inflation) -> Table:
    """Return a table of the N and K to use with motors on, in SI, with a row for each axis.

    Each of these coefficients is the larger of its values with motors off and on. The column after
    it contains the factor, at least 1, by which the motors increase the coefficient.
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
    """Return a table of ratios of Allan deviations: with motors on / with motors off.

    There is a row for each axis, and a column for each averaging time in `SHOWN_TAU_S` near which a
    ratio with an interval is known for any axis.
    """
    ratios = {axis: inflation.ratios(axis) for axis in inflation.axes}
    cells = {
        tau: [_ratio_cell(_nearest(checks, tau)) for checks in ratios.values()]
        for tau in SHOWN_TAU_S
    }
    shown_taus = [tau for tau, column in cells.items() if any(cell.text for cell in column)]
    rows = [(Heading(axis), [cells[tau][i] for tau in shown_taus]) for i, axis in enumerate(ratios)]
    return Table(Heading(''), [Heading(f'{tau:g} s') for tau in shown_taus], rows)


def inflation_lines(inflation: Inflation, columns: int = WIDE) -> Iterator[str]:
    """Yield the lines of text about the noise with motors on, compared with motors off.

    The lines contain N and K, the ratios of the Allan deviations, and the option for `allan
    export`. ``columns`` is the width of the tables in characters; the other lines are not wrapped.
    """
    yield f'N and K for a filter, over {horizon_text(inflation.horizon)}'
    yield from terminal_lines(inflation_table(inflation), columns)
    yield from ('', 'Allan deviation with motors on over motors off, 95 % interval')
    yield from terminal_lines(deviation_ratio_table(inflation), columns)
    yield from ('', f'For `allan export`: --inflate {inflation.option}')


def _nearest(checks: Sequence[Check], tau: float) -> Check | None:
    """Return the check with the averaging time closest to ``tau`` (s).

    Returns None if no averaging time differs from ``tau`` by a factor of less than `NEAR`.
    """
    candidates = [c for c in checks if c.tau is not None and tau / NEAR < c.tau < NEAR * tau]
    return min(candidates, key=lambda c: abs((c.tau or 0.0) - tau), default=None)


def _ratio_cell(check: Check | None) -> Cell:
    if check is None or check.ratio.value is None or check.ratio.ci95 is None:
        return Cell()
    return _share_cell(check.ratio.value, *check.ratio.ci95)


def _share_cell(value: float, low: float, high: float) -> Cell:
    # adding 0.0 turns -0.0 into 0.0, which is written without a minus sign
    value, low, high = (round(number, 2) + 0.0 for number in (value, low, high))
    return Cell(f'{value:.2f}', f'{low:.2f}..{high:.2f}', value)


def common_table(common: CommonResult, units: str = 'deg/h') -> Table:
    """Return a table of N as measured, N without common noise, and the coherence of the IMUs.

    There is a row for each common axis of each IMU. For a single IMU, there is a row for each pair
    of axes of a sensor, and no N. If the IMUs measure the common noise with different factors, a
    column contains these factors. Further columns contain the coherence at 0.1 s, 1 s, 10 s and
    100 s, if it is known near this averaging time for any row.
    """
    coherence_taus = SHOWN_TAU_S[1:]
    cells = {tau: [_coherence_cell(row, tau) for row in common.rows] for tau in coherence_taus}
    shown_taus = [tau for tau, column in cells.items() if any(cell.text for cell in column)]
    has_noise = any(row.measured or row.own for row in common.rows)
    has_gains = any(row.gain != 1.0 for row in common.rows)
    rows = []
    for i, row in enumerate(common.rows):
        unit, noise = shown_unit(row.axis, 'N', units), []
        for estimate in (row.measured, row.own) if has_noise else ():
            noise.append(Cell() if estimate is None else coefficient_cell(estimate, unit))
        if has_gains:
            noise.append(Cell(f'{row.gain:.3f}', value=row.gain))
        heading = Heading(row.axis, unit.name if has_noise else '')
        rows.append((heading, [Cell(row.label), *noise, *(cells[t][i] for t in shown_taus)]))
    own_heading = 'own N' if len({row.label for row in common.rows}) > 2 else 'own N, mean of both'
    number_headings = [
        *(('N', own_heading) if has_noise else ()),
        *(('factor',) if has_gains else ()),
    ]
    names = ['IMU', *number_headings, *(f'at {t:g} s' for t in shown_taus)]
    return Table(
        Heading('axis'),
        [Heading(name, repeats=name == 'IMU') for name in names],
        rows,
        '95 % intervals; coherence at averaging times: 0 is independent noise, 1 common noise, '
        'such as vibration',
    )


def common_lines(common: CommonResult, units: str = 'deg/h', columns: int = WIDE) -> Iterator[str]:
    """Yield the lines of the table of common noise, and the warnings and errors of the recordings.

    ``units`` is 'deg/h' or 'SI', and ``columns`` is the width of the table in characters. Warnings
    and errors are not wrapped.
    """
    yield from terminal_lines(common_table(common, units), columns)
    for label, findings in common.findings.items():
        yield from (
            f'{finding.severity}: {label}: {finding_line(finding)}'
            for finding in findings
            if finding.severity != 'info'
        )


def _coherence_cell(row: CommonNoise, tau: float) -> Cell:
    taus, *coherence_and_limits = row.coherence
    log_ratios = np.abs(np.log(taus / tau))
    nearest = int(np.argmin(log_ratios))
    value, low, high = (float(number[nearest]) for number in coherence_and_limits)
    # the coherence of constant samples is NaN
    if log_ratios[nearest] > np.log(NEAR) or not math.isfinite(value):
        return Cell()
    return _share_cell(value, low, high)
