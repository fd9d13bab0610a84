# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Test plans: limits for a production test of an IMU at rest, read from a YAML file.

    schema: allan_ros/plan/1
    name: line 4
    gyro:
      N: {lower: 0.1, upper: 0.36, unit: deg/sqrt(h)}
      bias: {lower: -0.5, upper: 0.5, unit: deg/s, at: 25}
      bandwidth: {lower: 40, unit: Hz}
    accel_z: {N: {upper: 25, unit: ug/sqrt(Hz)}}
    gravity: {lower: 9.75, upper: 9.86, unit: m/s^2}
    orientation: {up: [0, 0, 1], upper: 2, unit: deg}
    rate: {lower: 99, upper: 101, unit: Hz}
    duration: {lower: 600, unit: s}

The keys ``gyro`` and ``accel`` apply to all axes of the sensor; the key of one axis, such as
``accel_z``, takes precedence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from ..core.allan.at_rest import AtRest
from ..core.check import MARGIN, Check, check_limits
from ..core.errors import AllanError, one_line
from ..core.estimate import UNKNOWN, Estimate
from ..core.fields import Fields, located
from ..core.imu import (
    AXES,
    DATASHEET_UNITS,
    SENSORS,
    SI_UNITS,
    STANDARD_GRAVITY,
    UNITS,
    sensor_of,
    to_si,
)
from ..readers.files import expanded, read_yaml
from .datasheets import IMPLAUSIBLE_RATIO, Datasheet

if TYPE_CHECKING:
    from .results import Results

SCHEMA = 'allan_ros/plan/1'

PER_KELVIN = '/K'

AXIS_UNITS: Mapping[str, Mapping[str, str]] = {
    sensor: {
        **units,
        'bias': units['B'],
        'drift': units['B'],
        'temperature_drift': units['B'] + PER_KELVIN,
        'bandwidth': 'Hz',
    }
    for sensor, units in SI_UNITS.items()
}
"""Sensor -> quantity of an axis that a plan can limit -> its SI unit."""

IMU_UNITS: Mapping[str, str] = {
    'gravity': 'm/s^2',
    'orientation': 'deg',
    'rate': 'Hz',
    'duration': 's',
    'used': '',
    'temperature': 'degC',
}
"""Quantity of the whole IMU that a plan can limit -> its unit."""

SCALES: Mapping[str, Mapping[str, float]] = {
    's': {'s': 1.0, 'min': 60.0, 'h': 3600.0},
    'Hz': {'Hz': 1.0, 'kHz': 1e3},
    'deg': {'deg': 1.0},
    'degC': {'degC': 1.0},
    '': {'': 1.0, '%': 0.01},
}
"""Unit of a quantity -> unit that a plan may state -> factor from the stated unit to the unit of
the quantity. Units in `UNITS` are not repeated here."""

ABOUT_THE_DATA = ('duration', 'used', 'temperature')
"""Quantities of the recording, not of the IMU. If such a quantity lies outside its limits, the
verdict of its check is 'undecided' instead of 'exceeds'."""

SIGNED = ('bias', 'temperature_drift')
"""Quantities of an axis that can be negative, and therefore need both limits."""

NEAR_K = 3.0
"""Largest accepted difference in K between the temperature at which a limit applies and the
temperature of the recording, if no model of the bias covers the temperature of the limit."""


@dataclass(frozen=True)
class Limits:
    """Limits of one quantity in SI; a temperature is in degC, and the orientation in deg.

    ``lower`` or ``upper`` is None if there is no such limit. ``unit`` is the unit in which the plan
    states the limits, and ``scale`` is the factor from this unit to the unit of both limits.
    ``at`` is the temperature in degC at which a bias is judged; None for the temperature of the
    recording.
    """

    lower: float | None
    upper: float | None
    unit: str
    scale: float = 1.0
    at: float | None = None


@dataclass(frozen=True)
class Plan:
    """The limits of a production test.

    Attributes
    ----------
    name : str
        Name of the plan, for texts.
    axes : mapping of axis to quantity to Limits
        Limits of the quantities of each axis.
    whole : mapping of quantity to Limits
        Limits of quantities of the whole IMU, and of quantities of the recording.
    up : (3,) or None
        Unit vector of the measured acceleration at rest in the frame of the IMU; None if the plan
        does not state the orientation.

    Examples
    --------
    >>> import allan_ros as ar
    >>> plan = plan_from_document({
    ...     'schema': 'allan_ros/plan/1', 'name': 'demo',
    ...     'gyro': {'N': {'upper': 0.3, 'unit': 'deg/sqrt(h)'}},
    ...     'rate': {'lower': 60, 'unit': 'Hz'},
    ... }, 'demo.yaml')
    >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
    >>> [(c.axis, c.quantity, c.verdict) for c in plan.checks(results)][:2]
    [('', 'rate', 'exceeds'), ('gyro_x', 'N', 'within')]
    >>> plan.unchecked(results)[:2]
    ['gyro Q', 'gyro B']
    """

    name: str
    axes: Mapping[str, Mapping[str, Limits]]
    whole: Mapping[str, Limits] = field(default_factory=dict)
    up: tuple[float, float, float] | None = None

    def checks(self, results: Results) -> tuple[Check, ...]:
        """Return a check of each quantity that the plan limits.

        Checks of the whole IMU come first, because they often explain the checks of single axes.
        The verdict is 'undecided' for a quantity that the results do not contain.
        """
        checks: list[Check] = []
        for quantity, limits in self.whole.items():
            measured_and_note = self._of_imu(results, quantity)
            checks.append(self._check('', quantity, limits, *measured_and_note))
        for axis, quantities in self.axes.items():
            for quantity, limits in quantities.items():
                measured_and_note = self._of_axis(results, axis, quantity, limits)
                checks.append(self._check(axis, quantity, limits, *measured_and_note))
        return tuple(checks)

    def limits_of(self, check: Check) -> Limits:
        """Return the limits in this plan with which a check was made."""
        return self.axes[check.axis][check.quantity] if check.axis else self.whole[check.quantity]

    def _check(
        self, axis: str, quantity: str, limits: Limits, measured: Estimate, note: str
    ) -> Check:
        lower_and_upper = limits.lower, limits.upper
        check = check_limits(axis, quantity, self.name, measured, *lower_and_upper, note=note)
        if check.verdict == 'exceeds' and quantity in ABOUT_THE_DATA:
            return replace(check, verdict='undecided')
        return check

    def unchecked(self, results: Results) -> list[str]:
        """Return the names of quantities that the plan does not limit, such as 'gyro B', 'rate'."""
        names = []
        for sensor, where in SENSORS.items():
            measured_axes = [axis for axis in AXES[where] if axis in results.axes]
            for quantity in AXIS_UNITS[sensor] if measured_axes else ():
                unlimited_axes = [
                    axis for axis in measured_axes if quantity not in self.axes.get(axis, {})
                ]
                no_axis_is_limited = len(unlimited_axes) == len(measured_axes)
                names += (
                    [f'{sensor} {quantity}']
                    if no_axis_is_limited
                    else [f'{a} {quantity}' for a in unlimited_axes]
                )
        return names + [quantity for quantity in IMU_UNITS if quantity not in self.whole]

    def _of_axis(
        self, results: Results, axis: str, quantity: str, limits: Limits
    ) -> tuple[Estimate, str]:
        if axis not in results.axes:
            return UNKNOWN, 'this axis was not measured'
        result = results.axes[axis]
        if quantity in SI_UNITS[sensor_of(axis)]:
            return result.fit.noise[quantity].magnitude, ''
        rest: AtRest | None = result.at_rest
        if rest is None:
            return UNKNOWN, ''
        if quantity == 'temperature_drift':
            if rest.slope is None:
                return UNKNOWN, 'the temperature varied too little or is unknown'
            return rest.slope, ''
        if quantity != 'bias':
            return _exact(getattr(rest, quantity))
        gravity = self._gravity_on(axis)
        if limits.at is None:
            return _exact(rest.mean - gravity)
        model = result.temperature
        if model is not None and model.lowest <= limits.at <= model.highest:
            return _exact(float(model.bias(np.array(limits.at))) - gravity)
        if rest.temperature is None:
            return UNKNOWN, 'the temperature was not recorded'
        if abs(rest.temperature - limits.at) > NEAR_K:
            return UNKNOWN, f'the temperature was {rest.temperature:.1f} degC'
        return _exact(rest.mean - gravity)

    def _gravity_on(self, axis: str) -> float:
        """Return the gravity in m/s^2 that an axis of the accelerometer measures at rest.

        Returns 0 for an axis of the gyro, and if the plan does not state the orientation.
        """
        if sensor_of(axis) == 'gyro' or self.up is None:
            return 0.0
        limits = self.whole.get('gravity')
        gravity = STANDARD_GRAVITY
        if limits is not None and limits.lower is not None and limits.upper is not None:
            gravity = 0.5 * (limits.lower + limits.upper)
        return gravity * self.up['xyz'.index(axis[-1])]

    def _of_imu(self, results: Results, quantity: str) -> tuple[Estimate, str]:
        if quantity == 'rate':
            return _exact(results.rate_hz)
        if quantity == 'duration':
            return _exact(results.duration_s)
        if quantity == 'used':
            return _exact(used_share(results))
        rests = {name: axis.at_rest for name, axis in results.axes.items() if axis.at_rest}
        if quantity == 'temperature':
            temperatures = [
                rest.temperature for rest in rests.values() if rest.temperature is not None
            ]
            return _exact(temperatures[0]) if temperatures else (UNKNOWN, 'it was not recorded')
        means = [rests[axis].mean for axis in AXES[SENSORS['accel']] if axis in rests]
        if len(means) < 3:
            return UNKNOWN, 'the accelerometer was not measured'
        norm = math.hypot(*means)
        if quantity == 'gravity':
            return _exact(norm)
        up_component = sum(a * u for a, u in zip(means, self.up or (0.0, 0.0, 0.0)))
        return _exact(
            math.degrees(math.acos(max(-1.0, min(1.0, up_component / norm)))) if norm else None
        )


def _exact(value: float | None) -> tuple[Estimate, str]:
    return (UNKNOWN if value is None else Estimate(value, (value, value))), ''


def used_share(results: Results) -> float | None:
    """Return the number of used samples divided by the number of used, excluded and lost samples.

    Interpolated samples count as used, not as lost. Returns None if there are no samples.
    """
    counts = results.provenance.counts
    excluded = counts.skipped + counts.other_frame + counts.not_finite + counts.untimed
    excluded += counts.duplicate + counts.backward + counts.moving + counts.stuck
    excluded += counts.noise_increased + counts.noise_decreased
    excluded += max(counts.lost - counts.interpolated, 0)
    total = counts.used + excluded
    return counts.used / total if total else None


def load_plan(path: str | Path) -> Plan:
    """Read a test plan from a YAML or JSON file.

    Raises AllanError if the file cannot be read or an entry is invalid; the message states the
    position of the entry.
    """
    return plan_from_document(read_yaml(expanded(path)), str(path))


def plan_from_document(document: object, where: str) -> Plan:
    """Return the test plan in a document; ``where`` is the name of the document in error messages.

    Raises AllanError if an entry is invalid; the message states the position of the entry.
    """
    fields = Fields(document, where)
    fields.schema(SCHEMA)
    fields.allow_only('schema', 'name', 'remark', *SENSORS, *AXES, *IMU_UNITS)
    axes: dict[str, dict[str, Limits]] = {}
    for axis in AXES:
        for name in (sensor_of(axis), axis):
            stated_limits = fields.optional_fields(name)
            if stated_limits is not None:
                units = AXIS_UNITS[sensor_of(axis)]
                stated_limits.allow_only(*units)
                axis_limits = {
                    key: _limits(stated_limits.fields(key), key, units[key])
                    for key in stated_limits
                }
                axes[axis] = axes.get(axis, {}) | axis_limits
    whole, up = {}, None
    for quantity, unit in IMU_UNITS.items():
        stated_limits = fields.optional_fields(quantity)
        if stated_limits is not None:
            whole[quantity] = _limits(stated_limits, quantity, unit)
            if quantity == 'orientation':
                up = _direction(stated_limits)
    if not axes and not whole:
        raise AllanError(f'{where} has no limits: state some, such as "rate: {{lower: 99 ...}}"')
    for axis, limits in axes.items():
        if sensor_of(axis) == 'accel' and 'bias' in limits and up is None:
            raise AllanError(
                f'{where}: the bias of an accelerometer needs orientation.up, the direction of '
                'the measured acceleration at rest: state it, such as [0, 0, 1] with z up'
            )
    return Plan(fields.text('name', '') or Path(where).stem, axes, whole, up)


def _limits(fields: Fields, quantity: str, unit: str) -> Limits:
    """Return the limits in an object with the keys lower, upper and unit.

    One of the two limits may be missing, unless ``quantity`` is in `SIGNED`. Raises AllanError if
    the object is invalid.
    """
    optional_keys = {'bias': ('at',), 'orientation': ('up',)}.get(quantity, ())
    fields.allow_only('lower', 'upper', 'unit', *optional_keys)
    unit_name = fields.text('unit', '' if unit == '' else unit)
    scale = _scale(unit_name, unit, fields.where)
    lower, upper = (fields.number(k) * scale if k in fields else None for k in ('lower', 'upper'))
    if lower is None and upper is None:
        raise AllanError(f'{fields.where} has no limit: state lower, upper or both')
    if quantity in SIGNED and (lower is None or upper is None):
        raise AllanError(f'{fields.where}: {quantity} can be negative: state lower and upper')
    if lower is not None and upper is not None and lower > upper:
        raise AllanError(f'{fields.where}: lower is above upper: exchange them')
    return Limits(lower, upper, unit_name, scale, fields.number('at') if 'at' in fields else None)


def _scale(stated: str, unit: str, where: str) -> float:
    """Return the factor from the stated unit to ``unit``; raise AllanError if there is none."""
    if unit in SCALES:
        if stated in SCALES[unit]:
            return SCALES[unit][stated]
        possible_units = ', '.join(repr(name) for name in SCALES[unit])
        raise AllanError(
            f'{where}: unit {stated!r:.40} cannot be used here: use one of {possible_units}'
        )
    with located(where):
        if not unit.endswith(PER_KELVIN):
            return to_si(1.0, stated, unit)
        numerator = stated.removesuffix(PER_KELVIN)
        if numerator == stated:
            possible_units = ', '.join(
                f'{n}{PER_KELVIN}' for n, u in UNITS.items() if u.si == unit[:-2]
            )
            raise AllanError(
                f'unit {stated!r:.40} cannot be used here: use one of {possible_units}'
            )
        return to_si(1.0, numerator, unit.removesuffix(PER_KELVIN))


def _direction(fields: Fields) -> tuple[float, float, float]:
    vector = fields.numbers('up')
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not 0.0 < length < math.inf:
        raise AllanError(
            f'{fields.where}.up is not a direction: give three numbers, as in [0, 0, 1]'
        )
    x, y, z = (vector / length).tolist()
    return x, y, z


def plan_text(sheet: Datasheet) -> str:
    """Return a test plan as YAML text, with limits of N and B that follow from a datasheet.

    The upper limits are `Datasheet.limits`, increased by the fraction `MARGIN`. The lower limits of
    N are `Datasheet.limits` divided by `IMPLAUSIBLE_RATIO`. All these limits are rounded to three
    digits. The plan also has usual limits for gravity and for the share of used samples. Limits
    that the user must state, such as the sample rate, are comments.
    """
    lines = [
        f'# Test plan from the datasheet of {one_line(sheet.name)}.',
        '# Upper limits: limits that follow from the figures in the datasheet, plus '
        f'{100.0 * MARGIN:.0f} %.',
        '# Lower limit of N: a third of the limit that follows from the datasheet. A smaller N is',
        '# due to a wrong unit of measurement or a low-pass filter.',
        f'schema: {SCHEMA}',
        yaml.safe_dump({'name': sheet.name}, allow_unicode=True, width=10**6).rstrip(),
    ]
    for sensor, where in SENSORS.items():
        stated_axes = [axis for axis in AXES[where] if axis in sheet.limits]
        axes_are_equal = (
            len({str(_values(sheet, axis)) for axis in stated_axes}) == 1 and len(stated_axes) == 3
        )
        for name, axis in (
            [(sensor, stated_axes[0])] if axes_are_equal else [(a, a) for a in stated_axes]
        ):
            lines.append(f'{name}:')
            for term, limit in sheet.limits[axis].items():
                unit = DATASHEET_UNITS[sensor][term]
                number = limit.value / UNITS[unit].factor
                lower = f'lower: {number / IMPLAUSIBLE_RATIO:.3g}, ' if term == 'N' else ''
                upper = f'upper: {number * (1.0 + MARGIN):.3g}'
                lines.append(f'  {term}: {{{lower}{upper}, unit: {unit}}}')
    return '\n'.join([*lines, *TO_COMPLETE, ''])


TO_COMPLETE = (
    'gravity: {lower: 9.7, upper: 9.9, unit: m/s^2}',
    'used: {lower: 95, unit: "%"}  # share of the samples that are used',
    '# State these limits, too:',
    '# rate: {lower: 99, upper: 101, unit: Hz}',
    '# duration: {lower: 10, unit: min}',
    '# orientation: {up: [0, 0, 1], upper: 2, unit: deg}  # upward direction in the IMU frame',
    '# temperature: {lower: 20, upper: 30, unit: degC}',
    '# and, under the key gyro, accel or an axis:',
    '#   K: {upper: 60, unit: deg/h^1.5}',
    '#   bias: {lower: -0.5, upper: 0.5, unit: deg/s, at: 25}',
    '#   drift: {upper: 0.05, unit: deg/s}  # largest minus smallest of up to 16 means',
    '#   temperature_drift: {lower: -0.01, upper: 0.01, unit: deg/s/K}',
    '#   bandwidth: {lower: 40, unit: Hz}',
)
"""Lines of a plan with limits that a datasheet does not state."""


def _values(sheet: Datasheet, axis: str) -> dict[str, float]:
    return {term: limit.value for term, limit in sheet.limits[axis].items()}
