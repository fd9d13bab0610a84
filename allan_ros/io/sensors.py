# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Datasheets of IMUs: YAML files that say what a sensor should be, read into SI limits.

A datasheet rarely says which of two customary meanings a number has. Its file says what is known
(``sided``, ``stated_as``); where that is ``unknown`` the limit is the wider of the two meanings and
carries a note, so that no good sensor is blamed for an ambiguous datasheet.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.terms import FLICKER_FLOOR
from ..core.units import SI_UNITS, to_si

SCHEMA = 'allan_ros/sensor/1'

MAX_BYTES = 100_000
"""A datasheet file is a page; more is another file."""

WALK_KEY = {'gyro': 'arw', 'accel': 'vrw'}
"""sensor -> the key of N as datasheets call it: angle or velocity random walk."""

SIDED = ('one', 'two', 'unknown')
STATED_AS = ('coefficient', 'minimum', 'unknown')


@dataclass(frozen=True)
class Limit:
    """What a datasheet says of one term, in SI.

    Attributes
    ----------
    value : float
        The coefficient of the sensor must not lie above it.
    stated : str
        The number and unit of the datasheet.
    note : str
        How the one became the other, where that needs saying; else ''.
    """

    value: float
    stated: str
    note: str = ''


@dataclass(frozen=True)
class Datasheet:
    """One IMU as its maker describes it.

    Attributes
    ----------
    name : str
    sources : tuple of str
        Document and revision of every number.
    limits : mapping of sensor ('gyro', 'accel') to term ('N', 'B') to Limit
        Only what the sources state.
    range, lsb : mapping of sensor to float
        Full scale and step of the values in rad/s and m/s^2, where stated.
    """

    name: str
    sources: tuple[str, ...]
    limits: Mapping[str, Mapping[str, Limit]]
    range: Mapping[str, float]
    lsb: Mapping[str, float]


def sensor_names() -> list[str]:
    """Return the names of the datasheets that come with the package."""
    return config_names('sensors')


def load_sensor(name: str) -> Datasheet:
    """Return a datasheet by the name of one that comes with the package, or by its path.

    Raises
    ------
    AllanError
        When there is none of that name, or the file is not as it must be.
    """
    path = config_file('sensors', name, 'datasheet')
    return _datasheet(Fields(read_yaml(path), str(path)))


def read_yaml(path: Path) -> Any:
    """Return what a small YAML (or JSON) file holds.

    Raises
    ------
    AllanError
        When it cannot be read or parsed, or is over 100 kB.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise AllanError(f'{path}: over {MAX_BYTES} bytes, this is no file of settings')
        return yaml.load(path.read_text(encoding='utf-8'), _Loader)
    except OSError as error:
        raise AllanError(f'{path}: cannot be read ({error.strerror}): check the path') from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        where = ' '.join(str(error).split())
        raise AllanError(f'{path}: is not YAML ({where[:120]}): mend it there') from error


# YAML 1.1 takes 1e-4 for a word because it has no point; people, and JSON, mean a number.
_Loader: Any = type('_Loader', (yaml.SafeLoader,), {})
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?[0-9]+[eE][-+]?[0-9]+$'), list('-+0123456789')
)


def config_names(kind: str) -> list[str]:
    """Return the names of the files of a kind that come with the package."""
    return sorted({path.stem for folder in config_folders(kind) for path in folder.glob('*.yaml')})


def config_file(kind: str, name: str, called: str) -> Path:
    """Return the file of that name that comes with the package, or the path that was given.

    Raises
    ------
    AllanError
        When there is none of that name; ``called`` is what such a file is to the user.
    """
    path = Path(name)
    if path.suffix.lower() in ('.yaml', '.yml'):
        return path
    for folder in config_folders(kind):
        found = folder / f'{name.lower()}.yaml'
        if found.is_file():
            return found
    raise AllanError(
        f'no {called} {name!r}: choose one of {", ".join(config_names(kind))}, '
        'or give the path of a .yaml file'
    )


def config_folders(kind: str) -> list[Path]:
    """Return ``config/<kind>`` of a checkout, or of wherever the package is installed."""
    here = Path(__file__).resolve()
    checkout = here.parents[2] / 'config' / kind
    installed = [parent / 'share' / 'allan_ros' / 'config' / kind for parent in here.parents]
    return [folder for folder in (checkout, *installed) if folder.is_dir()]


def _datasheet(fields: Fields) -> Datasheet:
    fields.schema(SCHEMA)
    _refuse_others(fields, ('schema', 'name', 'sources', *WALK_KEY))
    limits: dict[str, dict[str, Limit]] = {}
    ranges: dict[str, float] = {}
    steps: dict[str, float] = {}
    sources = tuple(str(source) for source in fields.sequence('sources'))
    if not sources:
        raise AllanError(f'{fields.where}.sources is empty: name the document of the numbers')
    for sensor, walk in WALK_KEY.items():
        stated = fields.optional_fields(sensor)
        if stated is None:
            continue
        _refuse_others(stated, (walk, 'noise_density', 'bias_instability', 'range', 'lsb'))
        units = SI_UNITS[sensor]
        limits[sensor] = {}
        # Where both are stated, the random walk is N itself and needs no guess.
        if walk in stated:
            limits[sensor]['N'] = _walk(stated.fields(walk), units['N'])
        elif 'noise_density' in stated:
            limits[sensor]['N'] = _density(stated.fields('noise_density'), units['N'])
        if 'bias_instability' in stated:
            limits[sensor]['B'] = _bias(stated.fields('bias_instability'), units['B'])
        for key, into in (('range', ranges), ('lsb', steps)):
            if key in stated:
                into[sensor] = _quantity(stated.fields(key), units['B'])[0]
    return Datasheet(fields.text('name'), sources, limits, ranges, steps)


def _walk(fields: Fields, unit: str) -> Limit:
    return Limit(*_quantity(fields, unit))


def _density(fields: Fields, unit: str) -> Limit:
    """Return N from a noise density: a one-sided one is sqrt(2) N (IEEE Std 952-1997, C.1.1)."""
    value, stated = _quantity(fields, unit, 'sided')
    sided = fields.choice('sided', SIDED)
    if sided == 'one':
        return Limit(value / math.sqrt(2.0), stated, 'one-sided density, divided by sqrt(2)')
    if sided == 'two':
        return Limit(value, stated)
    return Limit(
        value * math.sqrt(2.0), stated, 'one- or two-sided is not said: widened by sqrt(2)'
    )


def _bias(fields: Fields, unit: str) -> Limit:
    """Return B from a bias instability, which may be the coefficient or the curve's minimum."""
    value, stated = _quantity(fields, unit, 'stated_as')
    stated_as = 'coefficient'
    if 'stated_as' in fields:
        stated_as = fields.choice('stated_as', STATED_AS)
    if stated_as == 'coefficient':
        return Limit(value, stated)
    said = {
        'minimum': 'minimum of the curve, divided by 0.664',
        'unknown': 'B or the minimum of the curve is not said: widened by 1/0.664',
    }
    return Limit(value / math.sqrt(FLICKER_FLOOR), stated, said[stated_as])


def _quantity(fields: Fields, unit: str, *others: str) -> tuple[float, str]:
    """Return a ``{value, unit}`` in SI, and as it is written."""
    _refuse_others(fields, ('value', 'unit', *others))
    value, written = fields.number('value'), fields.text('unit')
    if not value > 0.0:
        raise AllanError(f'{fields.where}.value is {value:g}: a positive number is expected')
    try:
        return to_si(value, written, unit), f'{value:g} {written}'
    except AllanError as error:
        raise AllanError(f'{fields.where}: {error}') from error


def _refuse_others(fields: Fields, known: tuple[str, ...]) -> None:
    for key in fields:
        if key not in known:
            raise AllanError(f'{fields.where}: {key!r} is unknown, use {", ".join(known)}')
