# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Datasheets of IMUs: YAML files with the figures of a sensor, read as limits of N and B in SI.

File format
-----------
A file contains the figures in the units of the datasheet. The key ``sided`` states whether a noise
density is one- or two-sided. The key ``stated_as`` states whether a bias instability is B or the
minimum of the Allan deviation curve. If one of these keys is ``unknown``, the meaning with the
larger limit is assumed, with a note, so that an ambiguous datasheet causes no false alarm.

The keys ``gyro`` and ``accel`` apply to all axes of the sensor; the key of one axis, such as
``accel_z``, takes precedence. The file of a product that contains a known sensor has no figures:
the key ``carries`` names this sensor.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ..core.check import Check, check_limits, worst_verdict
from ..core.errors import AllanError
from ..core.estimate import Estimate
from ..core.fields import Fields, located, plain
from ..core.findings import Finding, finding, quantity
from ..core.fit.result import TERMS
from ..core.imu import AXES, SI_UNITS, sensor_of
from ..core.noise import FLICKER_FLOOR
from ..core.settings import MAX_FLOAT
from ..readers.files import config_file, config_names, read_yaml

SCHEMA = 'allan_ros/sensor/1'

FROM_MINIMUM = 1.0 / math.sqrt(FLICKER_FLOOR)
"""Factor from the minimum of an Allan deviation curve to the largest possible B. The minimum
is at least sqrt(2 ln2/pi) B = 0.664 B, because white noise and random walk add to the flicker
noise."""

MEANINGS = {
    'sided': {
        'one': (1.0 / math.sqrt(2.0), 'one-sided density, divided by sqrt(2)'),
        'two': (1.0, ''),
        'unknown': (
            1.0,
            'the source does not state whether the density is one- or two-sided: N is this value, '
            'or this value / sqrt(2)',
        ),
    },
    'stated_as': {
        'coefficient': (1.0, ''),
        'minimum': (FROM_MINIMUM, 'minimum of the curve, divided by 0.664'),
        'unknown': (
            FROM_MINIMUM,
            'the source does not state whether this is B or the minimum of the curve: used as the '
            'minimum, divided by 0.664',
        ),
    },
}
"""Key that states the meaning of a number -> value of this key -> (factor, note for the user). The
number times the factor is the limit of N or B. A one-sided density is sqrt(2) N (IEEE Std 952-1997,
C.1.1)."""


@dataclass(frozen=True)
class Source:
    """The document that states the figures of a datasheet file.

    ``seen`` is 'datasheet' if the document itself was read, 'secondary' if the figures come from
    ``via``, which quotes the document, and '' if this is unknown.
    """

    title: str
    revision: str = ''
    url: str = ''
    seen: Literal['', 'datasheet', 'secondary'] = ''
    via: str = ''

    def __str__(self) -> str:
        return ', '.join(part for part in (self.title, self.revision) if part)


@dataclass(frozen=True)
class Limit:
    """The upper limit of one coefficient, in SI, according to a datasheet.

    ``stated`` contains the number and the unit in the datasheet, and ``note`` states how the limit
    was computed from this number. ``condition`` is the condition under which the number applies,
    such as 'typical' or a range of temperature. ``source`` is the key of the document that states
    the number. ``condition`` and ``source`` are '' if they are unknown.
    """

    value: float
    stated: str
    note: str = ''
    condition: str = ''
    source: str = ''


@dataclass(frozen=True)
class Measured:
    """Noise that was measured with one IMU of a model.

    ``values`` maps sensor -> term -> value in SI. ``by`` names the person or organization that
    recorded the data, ``url`` is the address of the recording, ``hours`` is the duration of the
    recording in h, and ``condition`` states the rate and temperature.
    """

    by: str
    url: str = ''
    hours: float = 0.0
    condition: str = ''
    values: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)


def measured_from_document(fields: Fields) -> Measured:
    """Return an entry of the list ``measured`` in a datasheet file.

    Raises AllanError if the entry is invalid.
    """
    fields.allow_only('by', 'url', 'hours', 'condition', *SI_UNITS)
    values: dict[str, dict[str, Estimate]] = {}
    for sensor in (name for name in SI_UNITS if name in fields):
        terms = fields.fields(sensor)
        terms.allow_only(*SI_UNITS[sensor])
        for term in terms:
            entry = terms.fields(term)
            entry.allow_only('value', 'low', 'high', 'unit')
            stated = entry.number('value', 1.0 / MAX_FLOAT)
            factor = entry.quantity(SI_UNITS[sensor][term]) / stated
            value, low, high = (entry.number(key) * factor for key in ('value', 'low', 'high'))
            values.setdefault(sensor, {})[term] = Estimate(value, (low, high))
    return fields.record(Measured, values=values)


@dataclass(frozen=True)
class Datasheet:
    """The figures that the manufacturer of an IMU states.

    Attributes
    ----------
    name, maker : str
        Name of the IMU, and of its manufacturer.
    sources : mapping of key to Source
        The documents that state the figures.
    limits : mapping of axis name to term ('N', 'B') to Limit
        Upper limits of the coefficients that the sources state.
    remark : str
        A remark for the user; '' for none.
    carries : str
        Name of the sensor in a product such as a camera; '' if the IMU is the sensor itself.
    measured : tuple of Measured
        Noise that was measured with IMUs of this model.

    Examples
    --------
    >>> import allan_ros as ar
    >>> imu = ar.sensor('bmi088')
    >>> imu.name, round(imu.values()['gyro_x']['N'], 6)  # rad/s/sqrt(Hz)
    ('BMI088', 0.000173)
    >>> text = imu.export('openvins', filter_rate=400.0)
    >>> 'from the datasheet of BMI088 and not measured' in text, 'update_rate: 400.0' in text
    (True, True)
    >>> [round(entry.hours, 1) for entry in ar.sensor('adis16405').measured]
    [2.0, 2.0, 2.7]
    """

    name: str
    maker: str
    sources: Mapping[str, Source]
    limits: Mapping[str, Mapping[str, Limit]]
    remark: str = ''
    carries: str = ''
    measured: tuple[Measured, ...] = ()

    def values(self) -> dict[str, dict[str, float]]:
        """Return the limits in SI: axis -> term ('N', 'B') -> value."""
        return {
            axis: {term: limit.value for term, limit in terms.items()}
            for axis, terms in self.limits.items()
        }


IMPLAUSIBLE_RATIO = 3.0
"""Ratio of N in a datasheet to the measured N, above which the measured N is implausibly small."""


def against_datasheet(
    noise: Mapping[str, Mapping[str, Estimate]], datasheet: Datasheet, margin: float
) -> tuple[Check, ...]:
    """Compare coefficients with the limits of a datasheet.

    A coefficient exceeds its limit if its complete 95 % interval lies above limit * (1 + margin).
    The result contains only coefficients with a limit.

    Parameters
    ----------
    noise : mapping of axis to term to Estimate
        The coefficients in SI.
    datasheet : Datasheet
        The limits.
    margin : float
        Fraction by which a coefficient may exceed its limit.
    """
    return tuple(
        check_limits(
            axis,
            term,
            datasheet.name,
            terms[term].magnitude,
            upper=datasheet.limits[axis][term].value,
            margin=margin,
        )
        for axis, terms in noise.items()
        for term in TERMS
        if term in datasheet.limits.get(axis, {})
    )


def exceeds_limit(check: Check, margin: float, axes: tuple[str, ...]) -> Finding:
    """Return the finding that a coefficient or an Allan deviation exceeds a limit.

    Parameters
    ----------
    check : Check
        The comparison. For an Allan deviation, or a coefficient without a value, the finding states
        the limit times the lower end of the interval of the ratio instead of a value.
    margin : float
        Fraction by which the coefficient or the Allan deviation may exceed the limit.
    axes : tuple of str
        Axes to which the finding applies.
    """
    is_term, measured = check.tau is None, check.measured
    sensor_and_term = (sensor_of(check.axis), check.quantity if is_term else 'B')
    value = None
    if is_term and measured.value is not None:
        value = quantity(measured.value, *sensor_and_term, measured.ci95)
    return finding(
        'exceeds_limit',
        axes,
        term=check.quantity if is_term else 'The Allan deviation',
        tau=check.tau,
        value=value,
        least=None if value else quantity(check.at_least * check.limit, *sensor_and_term),
        limit=quantity(check.limit, *sensor_and_term),
        reference=check.reference,
        margin=margin,
    )


def below_typical(check: Check, axes: tuple[str, ...]) -> Finding | None:
    """Return the finding that N is implausibly far below the limit of a datasheet.

    Returns None unless the complete 95 % interval of N lies below the limit divided by
    `IMPLAUSIBLE_RATIO`.
    """
    ratio_ci95 = check.ratio.ci95 if check.ratio.resolved else None
    if check.quantity != 'N' or ratio_ci95 is None:
        return None
    if not 0.0 < ratio_ci95[1] * IMPLAUSIBLE_RATIO < 1.0:
        return None
    sensor_and_term, value = (sensor_of(check.axis), 'N'), check.measured.value
    return finding(
        'below_typical',
        axes,
        value=quantity(value, *sensor_and_term, check.measured.ci95),
        limit=quantity(check.limit, *sensor_and_term),
        times=check.limit / value if value else None,
        reference=check.reference,
    )


def sheet_to_document(sheet: Datasheet, checks: Sequence[Check], margin: float) -> dict[str, Any]:
    """Return a datasheet and the checks of `against_datasheet` as an object of results.json.

    ``margin`` is the fraction by which a coefficient may exceed a limit in the checks.
    """
    axes: dict[str, dict[str, Any]] = {}
    for check in checks:
        limit = plain(sheet.limits[check.axis][check.quantity])
        axes.setdefault(check.axis, {})[check.quantity] = {
            'limit': limit.pop('value'),
            'unit': SI_UNITS[sensor_of(check.axis)][check.quantity],
            **limit,
            'verdict': check.verdict,
        }
    return {
        'name': sheet.name,
        'maker': sheet.maker,
        'remark': sheet.remark,
        'margin': margin,
        'verdict': worst_verdict(checks),
        'sources': plain(sheet.sources),
        'axes': axes,
    }


def sheet_from_document(fields: Fields) -> Datasheet:
    """Return the datasheet in the object ``datasheet`` of results.json.

    The object contains only the limits of axes that were measured. Raises AllanError if the object
    is invalid.
    """
    sources = fields.fields('sources')
    limits: dict[str, dict[str, Limit]] = {}
    axes = fields.fields('axes')
    for axis in axes:
        terms = axes.fields(axis)
        terms.allow_only(*TERMS)
        for term in terms:
            limit_fields = terms.fields(term)
            limit = limit_fields.record(Limit, value=limit_fields.number('limit'))
            limits.setdefault(axis, {})[term] = limit
    sources_by_key = {key: _source(sources.fields(key)) for key in sources}
    name, maker, remark = (fields.text(key) for key in ('name', 'maker', 'remark'))
    return Datasheet(name, maker, sources_by_key, limits, remark)


def sensor_names() -> list[str]:
    """Return the names of the datasheets of the package and of the user."""
    return config_names('sensors')


def load_sensor(name: str) -> Datasheet:
    """Read a datasheet, given its name or the path of its .yaml file.

    Raises AllanError if the name is unknown, or the file cannot be read or is invalid.
    """
    fields = _file(name)
    if 'carries' not in fields:
        return _datasheet(fields)
    # a product, such as a camera, has the figures of its sensor and the sources of both files
    fields.schema(SCHEMA)
    fields.allow_only('schema', 'name', 'maker', 'remark', 'sources', 'carries')
    with located(f'{fields.where}.carries'):
        # the file that the key `carries` names must not have this key: products are not nested
        sensor = _datasheet(_file(fields.text('carries')))
    return replace(
        sensor,
        name=fields.text('name'),
        maker=fields.text('maker', ''),
        sources={**_sources(fields), **sensor.sources},
        remark=fields.text('remark', ''),
        carries=sensor.name,
    )


def _file(name: str) -> Fields:
    path = config_file('sensors', name, 'datasheet')
    return Fields(read_yaml(path), str(path))


def _datasheet(fields: Fields) -> Datasheet:
    fields.schema(SCHEMA)
    fields.allow_only('schema', 'name', 'maker', 'remark', 'sources', 'measured', *SI_UNITS, *AXES)
    sources = _sources(fields)
    limits: dict[str, dict[str, Limit]] = {}
    for axis in AXES:
        for name in (sensor_of(axis), axis):
            stated_limits = fields.optional_fields(name)
            if stated_limits is not None:
                limits[axis] = limits.get(axis, {}) | _limits(
                    stated_limits, sensor_of(axis), sources
                )
    name, maker, remark = fields.text('name'), fields.text('maker', ''), fields.text('remark', '')
    measured_entries = fields.each('measured') if 'measured' in fields else ()
    measured = tuple(map(measured_from_document, measured_entries))
    return Datasheet(name, maker, sources, limits, remark, measured=measured)


def _sources(fields: Fields) -> dict[str, Source]:
    source_fields = fields.fields('sources')
    sources = {key: _source(source_fields.fields(key)) for key in source_fields}
    if not sources:
        raise AllanError(
            f'{fields.where}.sources is empty: name the document that states the figures'
        )
    return sources


def _source(fields: Fields) -> Source:
    fields.allow_only('title', 'revision', 'url', 'seen', 'via')
    return fields.record(Source)


def _limits(fields: Fields, sensor: str, sources: Collection[str]) -> dict[str, Limit]:
    walk_key, units = ('arw' if sensor == 'gyro' else 'vrw'), SI_UNITS[sensor]
    fields.allow_only(walk_key, 'noise_density', 'bias_instability')
    limits = {}
    # A random walk takes precedence over a noise density, because the random walk is N itself,
    # whereas a density may be one- or two-sided.
    for key, term, meaning in (
        ('noise_density', 'N', 'sided'),
        (walk_key, 'N', ''),
        ('bias_instability', 'B', 'stated_as'),
    ):
        if key in fields:
            limits[term] = _quantity(fields.fields(key), units[term], sources, meaning)
    return limits


def _quantity(fields: Fields, unit: str, sources: Collection[str], meaning: str = '') -> Limit:
    """Convert an object with the keys value, unit, condition and source to a limit in SI.

    ``unit`` is the SI unit of the limit. ``meaning`` is a key of `MEANINGS` that the object must
    contain in addition; '' for none. Raises AllanError if the object is invalid.
    """
    fields.allow_only('value', 'unit', 'condition', 'source', *([meaning] if meaning else []))
    factor, note = 1.0, ''
    if meaning:
        factor, note = MEANINGS[meaning][fields.choice(meaning, tuple(MEANINGS[meaning]))]
    value = fields.number('value')
    if not value > 0.0:
        raise AllanError(f'{fields.where}.value is {value:g}: a positive number is expected')
    source = next(iter(sources))
    if 'source' in fields or len(sources) > 1:
        source = fields.choice('source', tuple(sources))
    stated_text = f'{value:g} {fields.text("unit")}'
    return Limit(
        fields.quantity(unit) * factor, stated_text, note, fields.text('condition', ''), source
    )
