# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare results with N and B that others measured with IMUs of the same model.

The file of a datasheet lists these values under ``measured``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from ..core.check import Check, Judgement
from ..core.estimate import Estimate
from ..core.imu import AXES, DATASHEET_UNITS, SENSORS, UNITS
from ..core.number_text import significant
from .datasheets import Datasheet, Measured
from .results import Results

CATALOGUE_UNITS = {('gyro', 'N'): 'deg/sqrt(h)', ('accel', 'N'): 'ug/sqrt(Hz)'}
"""Unit of a measured value in datasheet files, if it differs from `DATASHEET_UNITS`."""

CHANGE_WORDS: dict[Judgement, str] = {'alike': 'typical', 'higher': 'noisier', 'lower': 'quieter'}
"""Verdict of a comparison with other IMUs of the model -> its text."""


def measured_values(results: Results) -> dict[tuple[str, str], Estimate]:
    """Return (sensor, term) -> N or B in SI, for each term that all axes of the sensor resolve.

    The value is the root mean square of the axes, and the interval contains the intervals of all
    axes.
    """
    found = {}
    for kind, term in ((kind, term) for kind in SENSORS for term in 'NB'):
        names = [axis for axis in AXES[SENSORS[kind]] if axis in results.axes]
        known = [results.axes[axis].fit.noise[term] for axis in names]
        ends = [one.ci95 for one in known if one.status == 'estimated' and one.ci95]
        if ends and len(ends) == len(known):
            mean = math.sqrt(sum((one.value or 0.0) ** 2 for one in known) / len(known))
            low, high = min(e[0] for e in ends), max(e[1] for e in ends)
            found[kind, term] = Estimate(mean, (low, high))
    return found


def _texts(kind: str, term: str, *values: float, digits: int = 3) -> tuple[str, ...]:
    """Return values of a term, given in SI, as texts in datasheet units, followed by the unit."""
    unit = CATALOGUE_UNITS.get((kind, term), DATASHEET_UNITS[kind][term])
    return *(significant(value / UNITS[unit].factor, digits) for value in values), unit


def _numbers(estimate: Estimate) -> tuple[float, float, float]:
    """Return the value and the ends of its interval; NaN if unknown."""
    return estimate.value or math.nan, *(estimate.ci95 or (math.nan, math.nan))


def measured_entry(results: Results) -> str:
    """Return results as YAML text, for the list ``measured`` in the file of a datasheet."""
    terms: dict[str, list[str]] = {}
    for (kind, term), known in measured_values(results).items():
        value, low, high, unit = _texts(kind, term, *_numbers(known), digits=4)
        text = f'      {term}: {{value: {value}, low: {low}, high: {high}, unit: {unit}}}'
        terms.setdefault(f'    {kind}:', []).append(text)
    return '\n'.join(
        [
            'measured:',
            '  - by: your name or organization',
            '    url: where the recording or the results can be found',
            f'    hours: {results.duration_s / 3600.0:.3g}',
            f'    condition: {results.rate_hz:.4g} Hz, temperature, unit',
            *(line for head, texts in terms.items() for line in (head, *texts)),
        ]
    )


def measured_check_text(check: Check) -> str:
    """Return a check of `against_measured` as a sentence."""
    low, high = check.measured.ci95 or (math.nan, math.nan)
    numbers = (check.measured.value, low, high, check.lower, check.upper)
    known = (math.nan if number is None else number for number in numbers)
    value, low_text, high_text, least, most, unit = _texts(check.axis, check.quantity, *known)
    return (
        f'{check.axis} {check.quantity} {CHANGE_WORDS[check.verdict]}: {value} '
        f'({low_text}..{high_text}) {unit}, {check.reference}: {least}..{most}'
    )


def against_measured(sheet: Datasheet, results: Results) -> list[Check]:
    """Compare each resolved N and B with the values that others measured with IMUs of the model.

    The axis of a check is the sensor. Its limits are the smallest and the largest end of the
    intervals of all measured IMUs. The verdict is 'alike' if the interval of the results overlaps
    these limits, else 'lower' or 'higher'.
    """
    found = []
    for (kind, term), value in measured_values(results).items():
        known = [e.values[kind][term] for e in sheet.measured if term in e.values.get(kind, {})]
        ends = [one.ci95 for one in known if one.ci95]
        if ends and value.ci95:
            low, high = min(end[0] for end in ends), max(end[1] for end in ends)
            verdict: Judgement = 'lower' if value.ci95[1] < low else 'alike'
            verdict = 'higher' if value.ci95[0] > high else verdict
            units = '1 unit' if len(known) == 1 else f'{len(known)} units'
            found.append(Check(kind, term, units, value, low, high, verdict=verdict))
    return found


def measured_factors(sheet: Datasheet) -> Iterator[tuple[Measured, str, str, float | None]]:
    """Yield each measured value of a datasheet file as (measurement, sensor, term, ratio).

    The ratio is the measured value divided by the limit of the datasheet for the x axis; None if
    the datasheet states no such limit.
    """
    limits = sheet.values()
    for one in sheet.measured:
        for kind, terms in one.values.items():
            for term, value in terms.items():
                limit = limits.get(f'{kind}_x', {}).get(term)
                yield one, kind, term, (value.value or 0.0) / limit if limit else None


def known_factors(sheets: Iterable[Datasheet]) -> tuple[float, float]:
    """Return the smallest and the largest ratio of a measured N or B to its datasheet.

    Both are 1 if no value was measured.
    """
    ratios = [ratio for sheet in sheets for *_, ratio in measured_factors(sheet) if ratio]
    return min(ratios, default=1.0), max(ratios, default=1.0)


def measured_lines(sheet: Datasheet) -> Iterator[str]:
    """Yield lines with the measured values of a datasheet file, and their ratios to limits."""
    shown = None
    for one, kind, term, factor in measured_factors(sheet):
        if one is not shown:
            yield f'measured by {one.by}'
            more = (f'{one.hours:g} h' if one.hours else '', one.condition, one.url)
            yield from (f'  {text}' for text in more if text)
            shown = one
        mean, low, high, unit = _texts(kind, term, *_numbers(one.values[kind][term]))
        share = f', {significant(factor, 2)} of the datasheet' if factor else ''
        yield f'  {kind} {term} {mean} ({low}..{high}) {unit}{share}'
