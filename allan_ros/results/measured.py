# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare results with N and B that others measured with IMUs of the same model.

The file of a datasheet lists these values under ``measured``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from ..core.check import Check, Judgement
from ..core.estimate import Estimate, significant
from ..core.imu import AXES, DATASHEET_UNITS, SENSORS, UNITS
from .datasheets import Datasheet, Measured
from .results import Results

CATALOGUE_UNITS = {('accel', 'N'): 'ug/sqrt(Hz)'}
"""(Sensor, term) -> unit in the list ``measured``, where it differs from `DATASHEET_UNITS`."""

CHANGE_WORDS: dict[Judgement, str] = {'alike': 'typical', 'higher': 'noisier', 'lower': 'quieter'}
"""Verdict of a comparison with other IMUs of the same model -> word for it in texts."""


def measured_values(results: Results) -> dict[tuple[str, str], Estimate]:
    """Return (sensor, term) -> N or B in SI, for each term that the axes of the sensor resolve.

    A term is excluded if a measured axis of the sensor does not resolve the term, or has no 95 %
    interval of the term. The value is the root mean square of the values of the measured axes. The
    interval extends over the intervals of all these axes.
    """
    estimates = {}
    for sensor, term in ((sensor, term) for sensor in SENSORS for term in 'NB'):
        names = [axis for axis in AXES[SENSORS[sensor]] if axis in results.axes]
        axis_estimates = [results.axes[axis].fit.noise[term] for axis in names]
        intervals = [
            estimate.ci95
            for estimate in axis_estimates
            if estimate.status == 'estimated' and estimate.ci95
        ]
        if intervals and len(intervals) == len(axis_estimates):
            rms = math.sqrt(
                sum((estimate.value or 0.0) ** 2 for estimate in axis_estimates)
                / len(axis_estimates)
            )
            low, high = min(ends[0] for ends in intervals), max(ends[1] for ends in intervals)
            estimates[sensor, term] = Estimate(rms, (low, high))
    return estimates


def _value_texts(sensor: str, term: str, *values: float, digits: int = 3) -> tuple[str, ...]:
    """Return values of a term as texts in the unit of the list ``measured``, then this unit.

    ``values`` are in SI.
    """
    unit = CATALOGUE_UNITS.get((sensor, term), DATASHEET_UNITS[sensor][term])
    return *(significant(value / UNITS[unit].factor, digits) for value in values), unit


def _numbers(estimate: Estimate) -> tuple[float, float, float]:
    """Return the value and the two ends of its 95 % interval; each is NaN if it is unknown."""
    return estimate.value or math.nan, *(estimate.ci95 or (math.nan, math.nan))


def measured_entry(results: Results) -> str:
    """Return N and B as YAML text, for the list ``measured`` in the file of a datasheet."""
    terms: dict[str, list[str]] = {}
    for (sensor, term), estimate in measured_values(results).items():
        value, low, high, unit = _value_texts(sensor, term, *_numbers(estimate), digits=4)
        text = f'      {term}: {{value: {value}, low: {low}, high: {high}, unit: {unit}}}'
        terms.setdefault(f'    {sensor}:', []).append(text)
    return '\n'.join(
        [
            'measured:',
            '  - by: your name or organization',
            '    url: where the recording or the results can be found',
            f'    hours: {results.duration_s / 3600.0:.3g}',
            f'    condition: {results.rate_hz:.4g} Hz, temperature, serial number',
            *(line for heading, texts in terms.items() for line in (heading, *texts)),
        ]
    )


def measured_check_text(check: Check) -> str:
    """Return a check of `against_measured` as a sentence."""
    low, high = check.measured.ci95 or (math.nan, math.nan)
    numbers = (check.measured.value, low, high, check.lower, check.upper)
    known_numbers = (math.nan if number is None else number for number in numbers)
    value, low_text, high_text, lowest, highest, unit = _value_texts(
        check.axis, check.quantity, *known_numbers
    )
    return (
        f'{check.axis} {check.quantity} {CHANGE_WORDS[check.verdict]}: {value} '
        f'({low_text}..{high_text}) {unit}, {check.reference}: {lowest}..{highest}'
    )


def against_measured(sheet: Datasheet, results: Results) -> list[Check]:
    """Compare N and B with the values that others measured with IMUs of the same model.

    There is a check for each N and B of `measured_values`, if the file of the datasheet contains an
    interval of this term. `Check.axis` is the name of the sensor. The limits of a check are the
    smallest and the largest end of the 95 % intervals that others measured. The verdict is 'alike'
    if the interval of the results overlaps the range between these limits, else 'lower' or
    'higher'.
    """
    checks = []
    for (sensor, term), value in measured_values(results).items():
        estimates = [
            entry.values[sensor][term]
            for entry in sheet.measured
            if term in entry.values.get(sensor, {})
        ]
        intervals = [estimate.ci95 for estimate in estimates if estimate.ci95]
        if intervals and value.ci95:
            low, high = min(ends[0] for ends in intervals), max(ends[1] for ends in intervals)
            verdict: Judgement = 'lower' if value.ci95[1] < low else 'alike'
            verdict = 'higher' if value.ci95[0] > high else verdict
            units = '1 unit' if len(estimates) == 1 else f'{len(estimates)} units'
            checks.append(Check(sensor, term, units, value, low, high, verdict=verdict))
    return checks


def measured_factors(sheet: Datasheet) -> Iterator[tuple[Measured, str, str, float | None]]:
    """Yield each measured value of a datasheet file as (measurement, sensor, term, ratio).

    The ratio is the measured value divided by the limit of the datasheet for the x axis; None if
    the datasheet states no such limit.
    """
    limits = sheet.values()
    for entry in sheet.measured:
        for sensor, terms in entry.values.items():
            for term, value in terms.items():
                limit = limits.get(f'{sensor}_x', {}).get(term)
                yield entry, sensor, term, (value.value or 0.0) / limit if limit else None


def known_factors(sheets: Iterable[Datasheet]) -> tuple[float, float]:
    """Return the smallest and the largest ratio of a measured N or B to the limit of a datasheet.

    Both ratios are 1 if no measured value has such a limit.
    """
    ratios = [ratio for sheet in sheets for *_, ratio in measured_factors(sheet) if ratio]
    return min(ratios, default=1.0), max(ratios, default=1.0)


def measured_lines(sheet: Datasheet) -> Iterator[str]:
    """Yield lines with the measured values in a datasheet file and their ratios to the limits."""
    shown_entry = None
    for entry, sensor, term, ratio in measured_factors(sheet):
        if entry is not shown_entry:
            yield f'measured by {entry.by}'
            details = (f'{entry.hours:g} h' if entry.hours else '', entry.condition, entry.url)
            yield from (f'  {text}' for text in details if text)
            shown_entry = entry
        value, low, high, unit = _value_texts(sensor, term, *_numbers(entry.values[sensor][term]))
        ratio_text = f', {significant(ratio, 2)} times the datasheet' if ratio else ''
        yield f'  {sensor} {term} {value} ({low}..{high}) {unit}{ratio_text}'
