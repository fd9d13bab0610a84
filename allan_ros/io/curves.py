# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Allan curves in text files, also those of other tools, and values published with them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.fit import AxisFit
from ..core.imu import AXES, SENSORS

OTHER_TOOL = ('accel_x', 'accel_y', 'accel_z', 'gyro_x', 'gyro_y', 'gyro_z')
"""Columns of a file without a header, as allan_variance_ros writes them: gyros in deg/s."""

LARGEST_FILE = 64 * 2**20
"""Bytes: a curve has some ten thousand lines."""

PUBLISHED = {
    'accelerometer_noise_density': ('accel', 'N'),
    'accelerometer_random_walk': ('accel', 'K'),
    'gyroscope_noise_density': ('gyro', 'N'),
    'gyroscope_random_walk': ('gyro', 'K'),
}
"""Key of a Kalibr file -> sensor and term."""

PLAUSIBLE = 2.0
"""A published value further than this factor from the curve contradicts it."""

HEALTHY_RISE = 30.0
"""Rise of a curve from its minimum to its end, above which the IMU was not at rest."""


@dataclass(frozen=True)
class Curves:
    """Allan deviations by axis.

    Attributes
    ----------
    tau : (points,) float64 array
        Averaging times in s.
    adev : mapping of axis to (points,) float64 array
        In SI.
    """

    tau: NDArray[np.float64]
    adev: Mapping[str, NDArray[np.float64]]


def read_curves(path: str | Path, gyro_unit: str = '') -> Curves:
    """Return the curves of a text file.

    Parameters
    ----------
    path : path
        Columns separated by commas or spaces: averaging time in s, then deviations. With a header,
        its names are ``tau`` and axes (others are ignored); without one there are six axes in the
        order of `OTHER_TOOL`.
    gyro_unit : 'rad/s' or 'deg/s'
        rad/s by default with a header, else deg/s.

    Raises
    ------
    AllanError
        When the file cannot be read as such a table.
    """
    path = Path(path)
    try:
        if not path.is_file():
            raise AllanError(f'{path}: no such file')
        if path.stat().st_size > LARGEST_FILE:
            raise AllanError(f'{path}: is too large for a curve: check the path')
        lines = [line for line in path.read_text().splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise AllanError(f'{path}: cannot be read ({error})') from None
    rows = [_cells(line) for line in lines]
    names = ['tau', *OTHER_TOOL]
    has_header = bool(rows) and not _is_number(rows[0][0])
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
    scale = math.pi / 180.0 if (gyro_unit or ('rad/s' if has_header else 'deg/s')) == 'deg/s' else 1
    adev = {
        axis: values[:, names.index(axis)] * (scale if axis in AXES[SENSORS['gyro']] else 1.0)
        for axis in AXES
        if axis in names
    }
    if not adev:
        raise AllanError(f'{path}: no column is named {", ".join(AXES)}')
    return Curves(values[:, names.index('tau')], adev)


def read_published(path: str | Path) -> dict[tuple[str, str], float]:
    """Return the values of a Kalibr file by (sensor, term), in SI.

    Raises
    ------
    AllanError
        When the file cannot be read or has none of the keys.
    """
    try:
        text = Path(path).read_text()[:LARGEST_FILE]
    except (OSError, UnicodeDecodeError) as error:
        raise AllanError(f'{path}: cannot be read ({error})') from None
    found = {}
    for key, of in PUBLISHED.items():
        match = re.search(rf'^\s*{key}\s*:\s*([-+.\deE]+)', text, re.MULTILINE)
        if match and _is_number(match[1]):
            found[of] = float(match[1])
    if not found:
        raise AllanError(f'{path}: has none of {", ".join(PUBLISHED)}')
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
            out.append(
                f'{axis} rises {rise:.0f} times from {curves.tau[least]:.3g} s to '
                f'{curves.tau[-1]:.3g} s: the IMU was not at rest, or its temperature changed.'
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
    """Return the cells of a line: between commas or semicolons if it has any, else spaces."""
    line = line.strip().rstrip(',;')
    cells = re.split('[,;]', line) if ',' in line or ';' in line else line.split()
    return [cell.strip() for cell in cells]


def _column_name(cell: str) -> str:
    """Return a header's name without unit, in lower case."""
    name = cell.strip().strip('"').lower().split('[')[0].split('(')[0].strip('_ ')
    return 'tau' if name in ('tau', 'tau_s', 'period', 'time') else name.removesuffix('_adev')


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
