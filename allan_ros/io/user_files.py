# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that a user gives: known noise, filter mappings, and Allan curves of other tools.

Known noise is a YAML or JSON mapping from axes to terms, each a number in the unit of datasheets or
``{value, unit}``. ``gyro`` or ``accel`` sets its three axes; a single axis takes precedence:

    gyro: {N: 0.3, B: {value: 7, unit: deg/h}}
    gyro_z: {N: 0.4}

The truth file of a simulated recording contains such a mapping, in SI, under the key ``noise``.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.fields import Fields, located
from ..core.filters.mapping import Expression, FilterMapping, FilterParameter, check_mapping
from ..core.findings import duration_text
from ..core.fit import AxisFit
from ..core.imu import AXES, DEGREE, SENSORS, SI_UNITS, from_datasheet, sensor_of
from ..core.noise import NoiseTerms
from ..core.simulate import PRESETS, Faults
from .datasheets import load_sensor
from .files import config_file, is_number, read_text, read_yaml, to_json, write_atomic

TRUTH_SCHEMA, FILTER_SCHEMA = 'allan_ros/truth/1', 'allan_ros/filter/1'

TRUTH_SUFFIX = '.truth.json'
"""Suffix of the truth file: the truth of ``name.mcap`` is in ``name.mcap.truth.json``."""

OTHER_TOOL = ('accel_x', 'accel_y', 'accel_z', 'gyro_x', 'gyro_y', 'gyro_z')
"""Columns of a file without a header, as written by allan_variance_ros: gyros in deg/s."""

LARGEST_FILE = 64 * 2**20
"""Largest size in bytes: a curve has about ten thousand lines."""

PUBLISHED = {
    'accelerometer_noise_density': ('accel', 'N'),
    'accelerometer_random_walk': ('accel', 'K'),
    'gyroscope_noise_density': ('gyro', 'N'),
    'gyroscope_random_walk': ('gyro', 'K'),
}
"""Key of a Kalibr file -> sensor and term."""

PLAUSIBLE = 2.0
"""A published value that differs from the curve by more than this factor contradicts it."""

HEALTHY_RISE = 30.0
"""Rise of a curve from its minimum to its end above which the IMU was not at rest."""

AxesNoise = dict[str, NoiseTerms]


def truth_path(recording: str | os.PathLike[str]) -> Path:
    """Return the path of the truth file of a recording."""
    path = Path(recording)
    return path.with_name(path.name + TRUTH_SUFFIX)


def read_noise(path: str | os.PathLike[str]) -> AxesNoise:
    """Return axis -> true terms of a specification or truth file, in SI.

    Axes that are not named have no noise. Raises AllanError that names an invalid entry.
    """
    fields = Fields(read_yaml(Path(path)), str(path))
    if 'noise' in fields:
        fields.schema(TRUTH_SCHEMA)
        fields = fields.fields('noise')
    return with_noise({axis: NoiseTerms() for axis in AXES}, fields)


def with_noise(noise: Mapping[str, NoiseTerms], stated: Fields) -> AxesNoise:
    """Return the noise with the terms of a specification replaced, in SI."""
    stated.only(*SI_UNITS, *AXES)
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
    """Return the noise of a file (``spec``), a preset, or a datasheet, with changes.

    The limits of a datasheet are N and B. Changes (axis or sensor -> term -> value) are in
    datasheet units.
    """
    noise = {axis: NoiseTerms() for axis in AXES}
    if spec:
        noise = read_noise(spec)
    elif preset:
        if preset not in PRESETS:
            raise AllanError(f'preset {preset!r} is unknown: choose one of {", ".join(PRESETS)}')
        noise = with_noise(noise, Fields({**PRESETS[preset]}, f'preset {preset}'))
    elif sensor:
        limits = load_sensor(sensor).values()
        noise = {axis: NoiseTerms(**limits.get(axis, {})) for axis in AXES}
    elif not changes:
        raise AllanError('no noise to simulate: give --preset paper, --sensor, --spec or --gyro ..')
    return with_noise(noise, Fields({**(changes or {})}, 'noise'))


def _terms(stated: Fields, sensor: str) -> dict[str, float]:
    """Return term -> SI value of one axis or sensor."""
    values: dict[str, float] = {}
    stated.only(*SI_UNITS[sensor])
    for term in stated:
        if isinstance(stated.value(term), dict):
            values[term] = stated.fields(term).quantity(SI_UNITS[sensor][term])
        else:
            values[term] = from_datasheet(term, sensor, stated.number(term))
    with located(stated.where):
        NoiseTerms(**values)
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
        'schema': TRUTH_SCHEMA,
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
    write_atomic(path, to_json(document))
    return path


def load_filter(name: str) -> FilterMapping:
    """Return a filter mapping by its name, or by the path of its file."""
    path = config_file('filters', name, 'filter mapping')
    fields = Fields(read_yaml(path), str(path))
    fields.schema(FILTER_SCHEMA)
    parameters = fields.fields('parameters')
    constants = fields.fields('constants') if 'constants' in fields else None
    mapping = FilterMapping(
        fields.text('name'),
        tuple(_parameter(key, parameters.fields(key)) for key in parameters),
        {} if constants is None else {key: constants.number(key) for key in constants},
        fields.number('horizon') if 'horizon' in fields else FilterMapping.horizon,
    )
    with located(str(path)):
        check_mapping(mapping)
    if not mapping.parameters:
        raise AllanError(f'{path}: contains no parameter: add at least one')
    return mapping


def _parameter(name: str, fields: Fields) -> FilterParameter:
    fields.only('sensor', 'axis', 'expression', 'limits', 'unit')
    limits = fields.interval('limits') if 'limits' in fields else FilterParameter.limits
    with located(fields.where):
        expression = Expression(fields.text('expression'))
    rule = fields.text('axis', 'worst')
    return FilterParameter(name, fields.text('sensor'), expression, rule, limits)


class Curves(NamedTuple):
    """Averaging times in s, (points,), and a mapping of axis to Allan deviations in SI,
    (points,)."""

    tau: NDArray[np.float64]
    adev: Mapping[str, NDArray[np.float64]]


def read_curves(path: str | Path, gyro_unit: str = '') -> Curves:
    """Return the curves of a text file: averaging times in s, then deviations.

    Columns are separated by commas, semicolons or spaces. With a header, the names are ``tau`` and
    axes (others are ignored), and gyros are in rad/s unless ``gyro_unit`` is 'deg/s'. Without a
    header, there are six axes in the order of `OTHER_TOOL`, and gyros are in deg/s by default.
    """
    rows = [_cells(line) for line in read_text(path, LARGEST_FILE).splitlines() if line.strip()]
    names = ['tau', *OTHER_TOOL]
    has_header = bool(rows) and not is_number(rows[0][0])
    if has_header:
        names, rows = [_column_name(cell) for cell in rows[0]], rows[1:]
    rows = [row for row in rows if row[0][:1] != '#']
    width = len(names)
    if 'tau' not in names or not rows or any(len(row) < width for row in rows):
        raise AllanError(f'{path}: give columns tau and axes ({", ".join(AXES)}) or 7 columns')
    try:
        values = np.array([row[:width] for row in rows], float)
    except ValueError as error:
        raise AllanError(f'{path}: {error}') from None
    scale = DEGREE if (gyro_unit or ('rad/s' if has_header else 'deg/s')) == 'deg/s' else 1
    adev = {
        axis: values[:, names.index(axis)] * (scale if axis in AXES[SENSORS['gyro']] else 1.0)
        for axis in AXES
        if axis in names
    }
    if not adev:
        raise AllanError(f'{path}: no column is named {", ".join(AXES)}')
    return Curves(values[:, names.index('tau')], adev)


def read_published(path: str | Path) -> dict[tuple[str, str], float]:
    """Return the values of a Kalibr file by (sensor, term), in SI."""
    text, found = read_text(path, LARGEST_FILE), {}
    for key, of in PUBLISHED.items():
        match = re.search(rf'^\s*{key}\s*:\s*([-+.\deE]+)', text, re.MULTILINE)
        if match and is_number(match[1]):
            found[of] = float(match[1])
    if not found:
        raise AllanError(f'{path}: contains none of {", ".join(PUBLISHED)}')
    return found


def doubts(
    curves: Curves, fits: Mapping[str, AxisFit], published: Mapping[tuple[str, str], float]
) -> list[str]:
    """Return the inconsistencies of the curves and the published values, one sentence each."""
    out = []
    for axis, adev in curves.adev.items():
        least = int(np.argmin(adev))
        rise = float(adev[-1] / adev[least])
        if rise > HEALTHY_RISE:
            start, end = (duration_text(float(curves.tau[i]), 3) for i in (least, -1))
            out.append(
                f'{axis} rises {rise:.0f} times from {start} to {end}: the IMU was not at rest, or '
                'its temperature changed.'
            )
    for (sensor, term), value in published.items():
        coefficients = [f.noise[term] for axis, f in fits.items() if axis.startswith(sensor)]
        high = [c.ci95[1] if c.ci95 else c.upper95 for c in coefficients]
        low = [c.ci95[0] for c in coefficients if c.ci95]
        highest = max((h for h in high if h is not None), default=math.inf)
        if value > PLAUSIBLE * highest:
            out.append(
                f'The published {term} of the {sensor} is {value / highest:.2g} times the largest '
                'that the curve allows.'
            )
        elif low and PLAUSIBLE * value < min(low):
            out.append(
                f'The published {term} of the {sensor} is {min(low) / value:.2g} times smaller '
                'than the curve shows.'
            )
    return out


def _cells(line: str) -> list[str]:
    """Return the cells of a line, separated by commas or semicolons if there are any, else by
    spaces."""
    line = line.strip().rstrip(',;')
    cells = re.split('[,;]', line) if ',' in line or ';' in line else line.split()
    return [cell.strip() for cell in cells]


def _column_name(cell: str) -> str:
    """Return the name of a column without its unit, in lower case."""
    name = cell.strip().strip('"').lower().split('[')[0].split('(')[0].strip('_ ')
    return 'tau' if name in ('tau', 'tau_s', 'period', 'time') else name.removesuffix('_adev')
