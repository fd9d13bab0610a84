# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Datasheets of IMUs: YAML files with the figures of a sensor, read as limits in SI.

Figures stand in a file as the datasheet states them, in its own unit; what they mean for N and B is
computed here. A datasheet rarely says which of two customary meanings a number has. Its file says
what is known (``sided``, ``stated_as``); where that is ``unknown`` the limit is the wider of the
two meanings and carries a note, so that an ambiguous datasheet causes no false alarm.

``gyro`` or ``accel`` sets its three axes; a single axis such as ``accel_z`` takes precedence.
A product that carries a known sensor names it (``carries``) and has no figures of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..core.compare import Reference
from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.imu import AXES, SI_UNITS, sensor_of, to_si
from ..core.noise import FLICKER_FLOOR
from .config_files import config_file, config_names, read_yaml

SCHEMA = 'allan_ros/sensor/1'


WALK_KEY = {'gyro': 'arw', 'accel': 'vrw'}
"""sensor -> the key of N as datasheets call it: angle or velocity random walk."""


SIDED = ('one', 'two', 'unknown')

STATED_AS = ('coefficient', 'minimum', 'unknown')


SEEN = ('datasheet', 'secondary')
"""Whether the document itself was read, or another one that quotes it."""


@dataclass(frozen=True)
class Source:
    """Where figures come from.

    Attributes
    ----------
    title, revision, url : str
        The document, its number and revision, and the manufacturer's page; '' where not known.
    seen : 'datasheet', 'secondary' or ''
        Whether the document itself was read, or ``via``, which quotes it; '' where not known.
    via : str
        The document that was read instead, if not the original.
    """

    title: str
    revision: str = ''
    url: str = ''
    seen: str = ''
    via: str = ''

    def __str__(self) -> str:
        return ', '.join(part for part in (self.title, self.revision) if part)


@dataclass(frozen=True)
class Limit:
    """The limit of one term by a datasheet, in SI.

    Attributes
    ----------
    value : float
        The coefficient of the sensor must not lie above it.
    stated : str
        The number and unit of the datasheet.
    note : str
        How the limit follows from the stated number; '' where that is obvious.
    condition : str
        Condition of the number: typical, range, bandwidth; '' where none is stated.
    source : str
        Key of its source.
    """

    value: float
    stated: str
    note: str = ''
    condition: str = ''
    source: str = ''


@dataclass(frozen=True)
class Datasheet:
    """The figures of one IMU by its manufacturer.

    Attributes
    ----------
    name, maker : str
    sources : mapping of key to Source
        The documents of the numbers.
    limits : mapping of axis name to term ('N', 'B') to Limit
        Only what the sources state.
    range, lsb : mapping of axis name to float
        Full scale and step of the values in rad/s and m/s^2, where stated.
    remark : str
        Further remarks for the user, or ''.
    carries : str
        Name of the sensor in it, whose figures these are; '' for a sensor itself.
    """

    name: str
    maker: str
    sources: Mapping[str, Source]
    limits: Mapping[str, Mapping[str, Limit]]
    range: Mapping[str, float]
    lsb: Mapping[str, float]
    remark: str = ''
    carries: str = ''

    def reference(self) -> Reference:
        """Return the limits that coefficients are compared with."""
        return Reference(
            self.name,
            {
                axis: {term: limit.value for term, limit in terms.items()}
                for axis, terms in self.limits.items()
            },
        )


def sensor_names() -> list[str]:
    """Return the names of the datasheets that come with the package, and of the user's own."""
    return config_names('sensors')


def load_sensor(name: str) -> Datasheet:
    """Return a datasheet by its name, or by the path of its file.

    Raises
    ------
    AllanError
        When there is none of that name, or the file is not as it must be.
    """
    path = config_file('sensors', name, 'datasheet')
    fields = Fields(read_yaml(path), str(path))
    return _product(fields) if 'carries' in fields else _datasheet(fields)


def _product(fields: Fields) -> Datasheet:
    """Return the figures of the sensor that a product carries, with the sources of both."""
    fields.schema(SCHEMA)
    _refuse_others(fields, ('schema', 'name', 'maker', 'remark', 'sources', 'carries'))
    name = fields.text('carries')
    try:
        path = config_file('sensors', name, 'datasheet')
    except AllanError as error:
        raise AllanError(f'{fields.where}.carries: {error}') from error
    carried = Fields(read_yaml(path), str(path))
    # This refuses a file that names itself, too.
    if 'carries' in carried:
        raise AllanError(
            f'{fields.where}.carries: {name!r} is not a sensor but carries one: name that one'
        )
    sensor, own = _datasheet(carried), _sources(fields)
    for key in own:
        if key in sensor.sources:
            raise AllanError(
                f'{fields.where}.sources: {key!r} is also a source of {name!r}: use another key'
            )
    return replace(
        sensor,
        name=fields.text('name'),
        maker=fields.text('maker', ''),
        sources={**own, **sensor.sources},
        remark=fields.text('remark', ''),
        carries=sensor.name,
    )


def _datasheet(fields: Fields) -> Datasheet:
    fields.schema(SCHEMA)
    _refuse_others(fields, ('schema', 'name', 'maker', 'remark', 'sources', *SI_UNITS, *AXES))
    sources = _sources(fields)
    limits: dict[str, dict[str, Limit]] = {}
    ranges: dict[str, float] = {}
    steps: dict[str, float] = {}
    for axis in AXES:
        for name in (sensor_of(axis), axis):
            part = fields.optional_fields(name)
            if part is None:
                continue
            limits[axis] = limits.get(axis, {}) | _limits(part, sensor_of(axis), tuple(sources))
            for key, into in (('range', ranges), ('lsb', steps)):
                if key in part:
                    into[axis] = _plain(part.fields(key), SI_UNITS[sensor_of(axis)]['B'], sources)
    return Datasheet(
        fields.text('name'),
        fields.text('maker', ''),
        sources,
        limits,
        ranges,
        steps,
        fields.text('remark', ''),
    )


def _sources(fields: Fields) -> dict[str, Source]:
    stated = fields.fields('sources')
    sources = {key: _source(stated.fields(key)) for key in stated}
    if not sources:
        raise AllanError(f'{fields.where}.sources is empty: name the document it is from')
    return sources


def _source(fields: Fields) -> Source:
    _refuse_others(fields, ('title', 'revision', 'url', 'seen', 'via'))
    seen = fields.choice('seen', SEEN) if 'seen' in fields else ''
    revision, url, via = (fields.text(key, '') for key in ('revision', 'url', 'via'))
    return Source(fields.text('title'), revision, url, seen, via)


def _limits(fields: Fields, sensor: str, sources: tuple[str, ...]) -> dict[str, Limit]:
    """Return term -> limit of one sensor or axis."""
    walk, units = WALK_KEY[sensor], SI_UNITS[sensor]
    _refuse_others(fields, (walk, 'noise_density', 'bias_instability', 'range', 'lsb'))
    limits = {}
    if 'noise_density' in fields:
        limits['N'] = _density(fields.fields('noise_density'), units['N'], sources)
    # Where both are stated, the random walk is N itself and needs no guess.
    if walk in fields:
        limits['N'] = _quantity(fields.fields(walk), units['N'], sources)
    if 'bias_instability' in fields:
        limits['B'] = _bias(fields.fields('bias_instability'), units['B'], sources)
    return limits


def _density(fields: Fields, unit: str, sources: tuple[str, ...]) -> Limit:
    """Return N from a noise density: a one-sided one is sqrt(2) N (IEEE Std 952-1997, C.1.1)."""
    sided = fields.choice('sided', SIDED)
    factor, note = {
        'one': (1.0 / math.sqrt(2.0), 'one-sided density, divided by sqrt(2)'),
        'two': (1.0, ''),
        'unknown': (
            1.0,
            'the source does not state one- or two-sided: N is this, or this / sqrt(2)',
        ),
    }[sided]
    return _quantity(fields, unit, sources, 'sided', factor=factor, note=note)


def _bias(fields: Fields, unit: str, sources: tuple[str, ...]) -> Limit:
    """Return B from a bias instability, which may be the coefficient or the curve's minimum.

    The minimum of a curve is at least sqrt(2 ln2/pi) B = 0.664 B: white noise and random walk
    add to it.
    """
    stated_as = fields.choice('stated_as', STATED_AS)
    from_minimum = 1.0 / math.sqrt(FLICKER_FLOOR)
    factor, note = {
        'coefficient': (1.0, ''),
        'minimum': (from_minimum, 'minimum of the curve, divided by 0.664'),
        'unknown': (
            from_minimum,
            'the source does not state B or minimum: treated as the minimum, divided by 0.664',
        ),
    }[stated_as]
    return _quantity(fields, unit, sources, 'stated_as', factor=factor, note=note)


def _plain(fields: Fields, unit: str, sources: Mapping[str, Source]) -> float:
    return _quantity(fields, unit, tuple(sources)).value


def _quantity(
    fields: Fields,
    unit: str,
    sources: tuple[str, ...],
    *others: str,
    factor: float = 1.0,
    note: str = '',
) -> Limit:
    """Return a ``{value, unit, condition, source}`` in SI times a factor, and as it is written.

    The source may be left out where there is only one.
    """
    _refuse_others(fields, ('value', 'unit', 'condition', 'source', *others))
    value, written = fields.number('value'), fields.text('unit')
    if not value > 0.0:
        raise AllanError(f'{fields.where}.value is {value:g}: a positive number is expected')
    source = sources[0]
    if 'source' in fields or len(sources) > 1:
        source = fields.choice('source', sources)
    try:
        in_si = to_si(value, written, unit)
    except AllanError as error:
        raise AllanError(f'{fields.where}: {error}') from error
    condition = fields.text('condition', '')
    return Limit(in_si * factor, f'{value:g} {written}', note, condition, source)


def _refuse_others(fields: Fields, known: tuple[str, ...]) -> None:
    for key in fields:
        if key not in known:
            raise AllanError(f'{fields.where}: {key!r} is unknown, use {", ".join(known)}')
