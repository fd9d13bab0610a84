# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read files of the user: noise to simulate, filter mappings, and Allan curves of other tools.

The noise of an IMU is a YAML or JSON mapping from axes to coefficients. A coefficient is a number
in datasheet units, or ``{value, unit}``. ``gyro`` and ``accel`` apply to three axes, and a single
axis takes precedence:

    gyro: {N: 0.3, B: {value: 7, unit: deg/h}}
    gyro_z: {N: 0.4}

The truth file that is written next to a simulated recording contains such a mapping under the key
``noise``.
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

COLUMNS_WITHOUT_HEADER = ('accel_x', 'accel_y', 'accel_z', 'gyro_x', 'gyro_y', 'gyro_z')
"""Columns after tau of a file without a header, as allan_variance_ros writes it."""

LARGEST_FILE = 64 * 2**20
"""Largest size of a curve file in bytes."""

PUBLISHED = {
    'accelerometer_noise_density': ('accel', 'N'),
    'accelerometer_random_walk': ('accel', 'K'),
    'gyroscope_noise_density': ('gyro', 'N'),
    'gyroscope_random_walk': ('gyro', 'K'),
}
"""Key of a Kalibr file -> sensor and term of its value."""

PLAUSIBLE = 2.0
"""Factor between a published value and the curve above which they contradict each other."""

HEALTHY_RISE = 30.0
"""Ratio of the end of a curve to its minimum above which the IMU was not at rest."""

AxesNoise = dict[str, NoiseTerms]


def truth_path(recording: str | os.PathLike[str]) -> Path:
    """Return the path of the file that states the true noise of a simulated recording."""
    path = Path(recording)
    return path.with_name(path.name + TRUTH_SUFFIX)


def read_noise(path: str | os.PathLike[str]) -> AxesNoise:
    """Read the noise of an IMU from a YAML or JSON file: axis -> coefficients in SI.

    The truth file of a simulated recording is accepted, too. Axes that are not named have no noise.
    Raises AllanError with the position of an invalid entry.
    """
    fields = Fields(read_yaml(Path(path)), str(path))
    if 'noise' in fields:
        fields.schema(TRUTH_SCHEMA)
        fields = fields.fields('noise')
    return with_noise({axis: NoiseTerms() for axis in AXES}, fields)


def with_noise(noise: Mapping[str, NoiseTerms], stated: Fields) -> AxesNoise:
    """Replace coefficients of the noise (axis -> coefficients in SI) by those in ``stated``."""
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
    """Return the noise to simulate: axis -> coefficients in SI.

    It is read from the file ``spec``, else from the preset, else from the datasheet ``sensor``,
    which states N and B. Then ``changes`` (axis or sensor -> term -> value in datasheet units)
    replace single coefficients. Raises AllanError if nothing is given or a name is unknown.
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
    """Return the stated coefficients of one axis or sensor: term -> value in SI."""
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
    """Write the true noise and faults of a simulated recording next to it, and return the path.

    ``noise`` maps axes to coefficients in SI. The file also contains the duration in s, the sample
    rate in Hz, the seed, and the faults that differ from their defaults.
    """
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
    """Read a filter mapping, given its name or the path of its .yaml file.

    Raises AllanError if the name is unknown or the file is invalid.
    """
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
    """Allan deviation curves: averaging times in s, (points,), and axis -> deviations in SI,
    (points,)."""

    tau: NDArray[np.float64]
    adev: Mapping[str, NDArray[np.float64]]


def read_curves(path: str | Path, gyro_unit: str = '') -> Curves:
    """Read Allan deviation curves from a text file.

    Columns are separated by commas, semicolons or spaces. The header names them ``tau`` (s) and
    axes; other columns are ignored. A file without a header has the columns tau, accel_x, accel_y,
    accel_z, gyro_x, gyro_y and gyro_z.

    ``gyro_unit`` is 'rad/s' or 'deg/s'. By default it is rad/s with a header and deg/s without.
    Raises AllanError if the columns are missing or not numeric.
    """
    rows = [_cells_of(line) for line in read_text(path, LARGEST_FILE).splitlines() if line.strip()]
    names = ['tau', *COLUMNS_WITHOUT_HEADER]
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
    """Read the values of a Kalibr file: (sensor, term) -> value in SI.

    Raises AllanError if it contains none.
    """
    text, found = read_text(path, LARGEST_FILE), {}
    for key, of in PUBLISHED.items():
        match = re.search(rf'^\s*{key}\s*:\s*([-+.\deE]+)', text, re.MULTILINE)
        if match and is_number(match[1]):
            found[of] = float(match[1])
    if not found:
        raise AllanError(f'{path}: contains none of {", ".join(PUBLISHED)}')
    return found


def contradictions(
    curves: Curves, fits: Mapping[str, AxisFit], published: Mapping[tuple[str, str], float]
) -> list[str]:
    """Return messages on curves that show motion and published values that contradict a curve.

    ``fits`` are the coefficients that were fitted to the curves, by axis. ``published`` are values
    in SI that another program determined, by (sensor, term).
    """
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


def _cells_of(line: str) -> list[str]:
    line = line.strip().rstrip(',;')
    cells = re.split('[,;]', line) if ',' in line or ';' in line else line.split()
    return [cell.strip() for cell in cells]


def _column_name(cell: str) -> str:
    """Return the name of a column without its unit, in lower case."""
    name = cell.strip().strip('"').lower().split('[')[0].split('(')[0].strip('_ ')
    return 'tau' if name in ('tau', 'tau_s', 'period', 'time') else name.removesuffix('_adev')
