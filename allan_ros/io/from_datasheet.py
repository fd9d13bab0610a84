# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files for filters from a datasheet alone, and values that were measured with known sensors.

The noise model has the N and B of the datasheet, with one-sided densities and minima of curves
converted as `datasheets` describes. N and K of a file come from its reduced-order model, so that
K follows from B: it covers the error growth of N and B over the horizon of the filter.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..core.compare import Change
from ..core.errors import AllanError
from ..core.findings import finding
from ..core.fit import TERMS, AxisFit, Coefficient
from ..core.fit.model import model_of_terms
from ..core.imu import AXES, DATASHEET_UNITS, SENSORS, UNITS, ImuIdentity
from ..core.noise import FLICKER_FLOOR
from ..core.settings import expect
from .axis_result import AxisResult
from .datasheets import Datasheet, MeasuredValue, load_sensor, sensor_names
from .exporters import FROM_DATASHEET
from .files import PATH, public
from .format import significant
from .readers import SourceInfo
from .recorded import Provenance
from .results import Results

DEFAULT_RATE_HZ = 200.0
"""Rate of an IMU in files from a datasheet, unless the user states it."""

CROSSING_S = 10.0
"""Averaging time in s at which flicker noise equals white noise, if a datasheet states no B. Of the
sensors that were measured, it is 7 to 200 s; a shorter time gives a larger B."""

SHOWN = {('gyro', 'N'): 'deg/sqrt(h)', ('accel', 'N'): 'ug/sqrt(Hz)'}
"""Unit of a measured value in the catalogue, if it differs from `DATASHEET_UNITS`."""


STATED = tuple((kind, term) for kind in SENSORS for term in 'NB')
"""Sensor and term of the figures of a datasheet."""


@dataclass(frozen=True)
class Sensor:
    """A type of IMU of which the datasheet is known.

    Attributes
    ----------
    datasheet : Datasheet
        The figures of the manufacturer, and values that were measured.

    Examples
    --------
    >>> import allan_ros as ar
    >>> imu = ar.sensor('bmi088')
    >>> imu.datasheet.name
    'BMI088'
    >>> text = imu.export('openvins', filter_rate=400.0)
    >>> 'from the datasheet of BMI088 and not measured' in text, 'update_rate: 400.0' in text
    (True, True)
    """

    datasheet: Datasheet

    def results(self, rate: float = DEFAULT_RATE_HZ) -> Results:
        """Return the noise model of the datasheet for an IMU with a rate in Hz.

        Raises AllanError if the datasheet states no N of an axis of a sensor.
        """
        values, sheet = self.datasheet.values(), self.datasheet
        unknown = Coefficient(None, status='not_observable')
        axes, assumed = {}, []
        for axis, terms in values.items():
            if 'N' not in terms:
                raise AllanError(
                    f'{sheet.name} states no N of {axis}: record the sensor at rest and use '
                    'allan analyze'
                )
            if 'B' not in terms:
                assumed.append(axis)
            flicker = terms['N'] / math.sqrt(FLICKER_FLOOR * CROSSING_S)
            known = {'N': Coefficient(terms['N']), 'B': Coefficient(terms.get('B', flicker))}
            noise = {term: known.get(term, unknown) for term in TERMS}
            fit = AxisFit(noise, model_of_terms(noise))
            axes[axis] = AxisResult(1.0 / rate, fit, name=axis)
        low, high = known_factors()
        found = [finding('from_datasheet', name=sheet.name, low=low, high=high)]
        if assumed:
            found.append(finding('bias_not_stated', tuple(assumed), time=CROSSING_S))
        stated = [f'{one} {one.url}'.strip() for one in sheet.sources.values()]
        stated += [
            f'{kind} {term} stated {limit.stated}{f" ({limit.note})" if limit.note else ""}'
            for kind, term in STATED
            if (limit := sheet.limits.get(f'{kind}_x', {}).get(term))
        ]
        return Results(
            ImuIdentity(sheet.name),
            FROM_DATASHEET,
            1.0 / rate,
            0,
            0.0,
            0,
            axes,
            Provenance(tuple(SourceInfo(text, '', '', '') for text in stated)),
            tuple(found),
        )

    def export(
        self, target: str, path: str | os.PathLike[str] | None = None, **options: Any
    ) -> str:
        """Return the text of a file for a filter or simulator, with the noise of the datasheet.

        The arguments are the same as in `Results.export`. ``filter_rate`` is also the rate of the
        IMU; the default is 200 Hz.
        """
        return self.results(options.get('filter_rate') or DEFAULT_RATE_HZ).export(
            target, path, **options
        )


@public
def sensor(name: str | os.PathLike[str]) -> Sensor:
    """Return a type of IMU, given the name of its datasheet or the path of its .yaml file.

    Raises
    ------
    AllanError
        If the name is unknown, or the file is invalid.

    Examples
    --------
    >>> import allan_ros as ar
    >>> [round(one.hours, 1) for one in ar.sensor('adis16405').datasheet.measured]
    [2.0, 2.0, 2.7]
    """
    expect(PATH, 'a name or a path', name=name)
    return Sensor(load_sensor(os.fspath(name)))


def known_factors() -> tuple[float, float]:
    """Return the smallest and the largest ratio of a measured N or B to its datasheet."""
    ratios = [
        value.value / limits[term]
        for sheet in map(load_sensor, sensor_names())
        for one in sheet.measured
        for kind, values in one.values.items()
        for term, value in values.items()
        if term in (limits := sheet.values().get(f'{kind}_x', {}))
    ]
    return min(ratios, default=1.0), max(ratios, default=1.0)


def measured_values(results: Results) -> dict[tuple[str, str], MeasuredValue]:
    """Return (sensor, term) -> measured value in SI of N and B, if all axes resolve it."""
    found = {}
    for kind, term in STATED:
        names = [axis for axis in AXES[SENSORS[kind]] if axis in results.axes]
        known = [results.axes[axis].fit.noise[term] for axis in names]
        ends = [one.ci95 for one in known if one.status == 'estimated' and one.ci95]
        if ends and len(ends) == len(known):
            mean = math.sqrt(sum((one.value or 0.0) ** 2 for one in known) / len(known))
            low, high = min(e[0] for e in ends), max(e[1] for e in ends)
            found[kind, term] = MeasuredValue(mean, low, high)
    return found


def _text(kind: str, term: str, *values: float) -> tuple[str, ...]:
    """Return the values of a term as text, followed by the unit of the catalogue."""
    unit = SHOWN.get((kind, term), DATASHEET_UNITS[kind][term])
    return *(significant(value / UNITS[unit].factor, 3) for value in values), unit


class AgainstMeasured(NamedTuple):
    """N or B of one unit beside the values that were measured with units of the same sensor."""

    sensor: str  # gyro or accel
    term: str
    value: MeasuredValue
    low: float  # ends of the intervals of all measured units, SI
    high: float
    units: int  # number of measured units

    @property
    def verdict(self) -> Change:
        """'alike' if the intervals overlap, else whether the unit is 'higher' or 'lower'."""
        if self.value.low > self.high:
            return 'higher'
        return 'lower' if self.value.high < self.low else 'alike'

    def __str__(self) -> str:
        ends = (*self.value, self.low, self.high)
        value, low, high, least, most, unit = _text(self.sensor, self.term, *ends)
        number = '1 unit has' if self.units == 1 else f'{self.units} units have'
        word = {'alike': 'typical', 'higher': 'noisier', 'lower': 'quieter'}[self.verdict]
        return (
            f'{self.sensor} {self.term} {word}: {value} ({low}..{high}) {unit}, {number} '
            f'{least}..{most}'
        )


def against_measured(sheet: Datasheet, results: Results) -> list[AgainstMeasured]:
    """Compare each resolved N and B with the values that were measured with units of a sensor."""
    found = []
    for (kind, term), value in measured_values(results).items():
        known = [e.values[kind][term] for e in sheet.measured if term in e.values.get(kind, {})]
        if known:
            low, high = min(k.low for k in known), max(k.high for k in known)
            found.append(AgainstMeasured(kind, term, value, low, high, len(known)))
    return found


def measured_lines(sheet: Datasheet) -> Iterator[str]:
    """Yield a line for each measured value of a sensor, with its ratio to the datasheet."""
    limits = sheet.values()
    for one in sheet.measured:
        yield f'measured by {one.by}'
        more = (f'{one.hours:g} h' if one.hours else '', one.condition, one.url)
        yield from (f'  {text}' for text in more if text)
        for kind, terms in one.values.items():
            for term, value in terms.items():
                mean, low, high, unit = _text(kind, term, *value)
                text = f'  {kind} {term} {mean} ({low}..{high}) {unit}'
                if limit := limits.get(f'{kind}_x', {}).get(term):
                    text += f', {significant(value.value / limit, 2)} of the datasheet'
                yield text
