# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Datasheets of IMUs: YAML files with the figures of a sensor, read as limits of N and B in SI.

A file contains the figures in the units of the datasheet. A noise density may be one- or two-sided,
and a bias instability may be B or the minimum of the curve. The file states which (``sided``,
``stated_as``). If it is ``unknown``, the larger of the two limits is used, with a note, so that an
ambiguous datasheet causes no false alarm.

The keys ``gyro`` and ``accel`` apply to three axes; a single axis such as ``accel_z`` takes
precedence. The file of a product that contains a known sensor names this sensor (``carries``) and
has no figures.
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
from ..readers.files import config_file, config_names, read_yaml

SCHEMA = 'allan_ros/sensor/1'

FROM_MINIMUM = 1.0 / math.sqrt(FLICKER_FLOOR)
"""Factor from the minimum of a curve to the largest possible B. The minimum is at least
sqrt(2 ln2/pi) B = 0.664 B, because white noise and random walk add to it."""

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
"""Key that states the meaning of a number -> its value -> factor from the number to N or B, and a
note. A one-sided density is sqrt(2) N (IEEE Std 952-1997, C.1.1)."""


@dataclass(frozen=True)
class Source:
    """The document that states the figures of a datasheet file.

    ``seen`` is 'datasheet' if the document itself was read, and 'secondary' if the figures come
    from ``via``, which quotes it; '' if unknown.
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

    ``stated`` is the number and unit in the datasheet, and ``note`` tells how the limit was
    computed from it. ``condition`` is the condition of the number (typical, range, bandwidth), and
    ``source`` the key of its source. Each is '' if unknown.
    """

    value: float
    stated: str
    note: str = ''
    condition: str = ''
    source: str = ''


@dataclass(frozen=True)
class Measured:
    """Noise that was measured with one unit of a sensor: sensor -> term -> value in SI.

    ``by`` names who recorded it, ``url`` the recording, ``condition`` rate and temperature.
    """

    by: str
    url: str = ''
    hours: float = 0.0
    condition: str = ''
    values: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)


def measured_from_document(fields: Fields) -> Measured:
    """Return an entry of the list ``measured`` in the file of a sensor."""
    fields.only('by', 'url', 'hours', 'condition', *SI_UNITS)
    values: dict[str, dict[str, Estimate]] = {}
    for sensor in (name for name in SI_UNITS if name in fields):
        terms = fields.fields(sensor)
        for term in terms:
            one = terms.fields(term)
            one.only('value', 'low', 'high', 'unit')
            factor = one.quantity(SI_UNITS[sensor][term]) / one.number('value')
            value, low, high = (one.number(key) * factor for key in ('value', 'low', 'high'))
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
        A remark for the user.
    carries : str
        Name of the sensor inside a product, such as a camera; '' if the IMU is the sensor itself.
    measured : tuple of Measured
        Values that were measured with units of this sensor.

    Examples
    --------
    >>> import allan_ros as ar
    >>> imu = ar.sensor('bmi088')
    >>> imu.name, round(imu.values()['gyro_x']['N'], 6)  # rad/s/sqrt(Hz)
    ('BMI088', 0.000173)
    >>> text = imu.export('openvins', filter_rate=400.0)
    >>> 'from the datasheet of BMI088 and not measured' in text, 'update_rate: 400.0' in text
    (True, True)
    >>> [round(one.hours, 1) for one in ar.sensor('adis16405').measured]
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
        """Return axis -> term -> limit in SI."""
        return {
            axis: {term: limit.value for term, limit in terms.items()}
            for axis, terms in self.limits.items()
        }


BELOW = 3.0
"""Measured white noise below the figure of a datasheet by more than this factor is implausible."""


def against_datasheet(
    noise: Mapping[str, Mapping[str, Estimate]], datasheet: Datasheet, margin: float
) -> tuple[Check, ...]:
    """Compare the coefficients (axis -> term -> coefficient) with the limits of a datasheet.

    A coefficient is 'exceeds' its limit if its complete 95 % interval lies above the limit by the
    fraction ``margin``. A coefficient without a limit is left out.
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

    The text states the measured coefficient, or the least deviation if only the ratio is known, and
    the fraction ``margin``; ``axes`` are the axes to which the finding applies.
    """
    is_term, measured = check.tau is None, check.measured
    kind = (sensor_of(check.axis), check.quantity if is_term else 'B')
    value = None
    if is_term and measured.value is not None:
        value = quantity(measured.value, *kind, measured.ci95)
    return finding(
        'exceeds_limit',
        axes,
        term=check.quantity if is_term else 'The Allan deviation',
        tau=check.tau,
        value=value,
        least=None if value else quantity(check.at_least * check.limit, *kind),
        limit=quantity(check.limit, *kind),
        reference=check.reference,
        margin=margin,
    )


def below_typical(check: Check, axes: tuple[str, ...]) -> Finding | None:
    """Return the finding that N is implausibly far below the figure of a datasheet, or None."""
    ends = check.ratio.ci95 if check.ratio.resolved else None
    if check.quantity != 'N' or ends is None or not 0.0 < ends[1] * BELOW < 1.0:
        return None
    kind, value = (sensor_of(check.axis), 'N'), check.measured.value
    return finding(
        'below_typical',
        axes,
        value=quantity(value, *kind, check.measured.ci95),
        limit=quantity(check.limit, *kind),
        times=check.limit / value if value else None,
        reference=check.reference,
    )


def sheet_to_document(sheet: Datasheet, checks: Sequence[Check], margin: float) -> dict[str, Any]:
    """Return a datasheet and the checks of `against_datasheet` as JSON, for results.json."""
    axes: dict[str, dict[str, Any]] = {}
    for c in checks:
        limit = plain(sheet.limits[c.axis][c.quantity])
        axes.setdefault(c.axis, {})[c.quantity] = {
            'limit': limit.pop('value'),
            'unit': SI_UNITS[sensor_of(c.axis)][c.quantity],
            **limit,
            'verdict': c.verdict,
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
    """Read the datasheet in the object ``datasheet`` of results.json."""
    sources = fields.fields('sources')
    limits: dict[str, dict[str, Limit]] = {}
    axes = fields.fields('axes')
    for axis in axes:
        terms = axes.fields(axis)
        terms.only(*TERMS)
        for term in terms:
            f = terms.fields(term)
            limits.setdefault(axis, {})[term] = f.record(Limit, value=f.number('limit'))
    stated = {key: _source(sources.fields(key)) for key in sources}
    name, maker, remark = (fields.text(key) for key in ('name', 'maker', 'remark'))
    return Datasheet(name, maker, stated, limits, remark)


def sensor_names() -> list[str]:
    """Return the names of the datasheets of the package and of the user."""
    return config_names('sensors')


def load_sensor(name: str) -> Datasheet:
    """Read a datasheet, given its name or the path of its .yaml file.

    Raises AllanError if the name is unknown or the file is invalid.
    """
    fields = _file(name)
    if 'carries' not in fields:
        return _datasheet(fields)
    # a product: the figures of its sensor, with the sources of both files
    fields.schema(SCHEMA)
    fields.only('schema', 'name', 'maker', 'remark', 'sources', 'carries')
    with located(f'{fields.where}.carries'):
        # rejects the file of another product, and so itself
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
    fields.only('schema', 'name', 'maker', 'remark', 'sources', 'measured', *SI_UNITS, *AXES)
    sources = _sources(fields)
    limits: dict[str, dict[str, Limit]] = {}
    for axis in AXES:
        for name in (sensor_of(axis), axis):
            part = fields.optional_fields(name)
            if part is not None:
                limits[axis] = limits.get(axis, {}) | _limits(part, sensor_of(axis), sources)
    name, maker, remark = fields.text('name'), fields.text('maker', ''), fields.text('remark', '')
    stated = fields.each('measured') if 'measured' in fields else ()
    measured = tuple(map(measured_from_document, stated))
    return Datasheet(name, maker, sources, limits, remark, measured=measured)


def _sources(fields: Fields) -> dict[str, Source]:
    stated = fields.fields('sources')
    sources = {key: _source(stated.fields(key)) for key in stated}
    if not sources:
        raise AllanError(
            f'{fields.where}.sources is empty: name the document that states the figures'
        )
    return sources


def _source(fields: Fields) -> Source:
    fields.only('title', 'revision', 'url', 'seen', 'via')
    return fields.record(Source)


def _limits(fields: Fields, sensor: str, sources: Collection[str]) -> dict[str, Limit]:
    walk, units = ('arw' if sensor == 'gyro' else 'vrw'), SI_UNITS[sensor]
    fields.only(walk, 'noise_density', 'bias_instability')
    limits = {}
    # If both are stated, the random walk is N itself, and no assumption is needed.
    for key, term, meaning in (
        ('noise_density', 'N', 'sided'),
        (walk, 'N', ''),
        ('bias_instability', 'B', 'stated_as'),
    ):
        if key in fields:
            limits[term] = _quantity(fields.fields(key), units[term], sources, meaning)
    return limits


def _quantity(fields: Fields, unit: str, sources: Collection[str], meaning: str = '') -> Limit:
    """Read an object ``{value, unit, condition, source}`` as a limit in SI.

    ``meaning`` is a key of `MEANINGS` that the object must contain, too; '' for none.
    """
    fields.only('value', 'unit', 'condition', 'source', *([meaning] if meaning else []))
    factor, note = 1.0, ''
    if meaning:
        factor, note = MEANINGS[meaning][fields.choice(meaning, tuple(MEANINGS[meaning]))]
    value = fields.number('value')
    if not value > 0.0:
        raise AllanError(f'{fields.where}.value is {value:g}: a positive number is expected')
    source = next(iter(sources))
    if 'source' in fields or len(sources) > 1:
        source = fields.choice('source', tuple(sources))
    stated = f'{value:g} {fields.text("unit")}'
    return Limit(fields.quantity(unit) * factor, stated, note, fields.text('condition', ''), source)
