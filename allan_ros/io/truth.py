# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Known noise: specifications for simulations, and the truth file of a simulated recording.

A specification is YAML or JSON: a map from axes to terms, each a number in the unit of datasheets
or ``{value, unit}``. ``gyro`` or ``accel`` sets its three axes; a single axis takes precedence:

    gyro: {N: 0.3, B: {value: 7, unit: deg/h}}
    gyro_z: {N: 0.4}

A truth file has such a specification, in SI, under the key ``noise``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.imu import AXES, SI_UNITS, from_datasheet, sensor_of, to_si
from ..core.noise import NoiseTerms
from ..core.simulate import PRESETS, Faults
from .config_files import read_yaml
from .datasheets import load_sensor
from .files import write_atomic

SCHEMA = 'allan_ros/truth/1'

SUFFIX = '.truth.json'
"""The truth of ``name.mcap`` is in ``name.mcap.truth.json``."""

AxesNoise = dict[str, NoiseTerms]


def truth_path(recording: str | os.PathLike[str]) -> Path:
    """Return the path of the truth file of a recording."""
    path = Path(recording)
    return path.with_name(path.name + SUFFIX)


def read_noise(path: str | os.PathLike[str]) -> AxesNoise:
    """Return axis -> true terms of a specification or truth file, in SI.

    Axes that are not named have no noise.

    Raises
    ------
    AllanError
        When the file is invalid; the message names the place.
    """
    fields = Fields(read_yaml(Path(path)), str(path))
    if 'noise' in fields:
        fields.schema(SCHEMA)
        fields = fields.fields('noise')
    return with_noise({axis: NoiseTerms() for axis in AXES}, fields)


def with_noise(noise: Mapping[str, NoiseTerms], stated: Fields) -> AxesNoise:
    """Return the noise with the terms of a specification replaced, in SI.

    Raises
    ------
    AllanError
        When the specification names an unknown axis, term or unit, or an impossible value.
    """
    for name in stated:
        if name not in (*SI_UNITS, *AXES):
            raise AllanError(
                f'{stated.where}: {name!r} is unknown, use gyro, accel or {", ".join(AXES)}'
            )
    return {
        axis: replace(
            noise[axis],
            **{
                term: value
                for name in (sensor_of(axis), axis)
                if name in stated
                for term, value in _terms(stated.fields(name), sensor_of(axis)).items()
            },
        )
        for axis in AXES
    }


def stated_noise(
    preset: str = '',
    sensor: str = '',
    spec: str = '',
    changes: Mapping[str, Mapping[str, float]] | None = None,
) -> AxesNoise:
    """Return the noise of an IMU from a preset, a datasheet or a file, with single changes.

    Parameters
    ----------
    preset : str
        A name of `core.simulate.PRESETS`.
    sensor : str
        A datasheet, whose limits are N and B.
    spec : str
        Path of a specification; it goes before ``preset`` and ``sensor``.
    changes : mapping of axis or sensor to term to value
        Terms that replace those above, in datasheet units.

    Raises
    ------
    AllanError
        When nothing is stated, or what is stated is impossible.
    """
    noise = {axis: NoiseTerms() for axis in AXES}
    if spec:
        noise = read_noise(spec)
    elif preset:
        if preset not in PRESETS:
            raise AllanError(f'preset {preset!r} is unknown: choose one of {", ".join(PRESETS)}')
        noise = with_noise(noise, Fields({**PRESETS[preset]}, f'preset {preset}'))
    elif sensor:
        stated = {
            axis: {
                term: {'value': limit.value, 'unit': SI_UNITS[sensor_of(axis)][term]}
                for term, limit in of_axis.items()
            }
            for axis, of_axis in load_sensor(sensor).limits.items()
        }
        noise = with_noise(noise, Fields(stated, f'sensor {sensor}'))
    elif not changes:
        raise AllanError('no noise to simulate: give --preset paper, --sensor, --spec or --gyro ..')
    return with_noise(noise, Fields({**(changes or {})}, 'noise'))


def _terms(stated: Fields, sensor: str) -> dict[str, float]:
    """Return term -> SI value of one axis or sensor."""
    values: dict[str, float] = {}
    for term in stated:
        if term not in SI_UNITS[sensor]:
            known = ', '.join(SI_UNITS[sensor])
            raise AllanError(f'{stated.where}: {term!r} is unknown, use {known}')
        if stated.holds_object(term):
            quantity = stated.fields(term)
            value, unit = quantity.number('value'), quantity.text('unit')
            try:
                values[term] = to_si(value, unit, SI_UNITS[sensor][term])
            except AllanError as error:
                raise AllanError(f'{quantity.where}: {error}') from error
        else:
            values[term] = from_datasheet(term, sensor, stated.number(term))
    try:
        NoiseTerms(**values)
    except AllanError as error:
        raise AllanError(f'{stated.where}: {error}') from error
    return values


def write_truth(
    recording: str | os.PathLike[str],
    noise: Mapping[str, NoiseTerms],
    *,
    seconds: float,
    rate: float,
    seed: int,
    faults: Faults,
) -> Path:
    """Write the truth file of a recording, atomically, and return its path."""
    changed = {k: v for k, v in asdict(faults).items() if v != getattr(Faults(), k)}
    document: dict[str, Any] = {
        'schema': SCHEMA,
        'seconds': seconds,
        'rate_hz': rate,
        'seed': seed,
        'faults': changed,
        'noise': {
            axis: {
                term: {'value': value, 'unit': SI_UNITS[sensor_of(axis)][term]}
                for term, value in asdict(terms).items()
            }
            for axis, terms in noise.items()
        },
    }
    path = truth_path(recording)
    write_atomic(path, json.dumps(document, indent=1) + '\n')
    return path
