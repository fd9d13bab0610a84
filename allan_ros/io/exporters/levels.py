# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One number a sensor out of three axes: which axis, measured or limit, and how wide it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ... import __version__
from ...core.batch import AXES, SENSORS
from ...core.errors import AllanError
from ...core.parameters import check, parameter
from ...core.units import SI_UNITS
from ..results import Results
from ..shown import LIMIT_DIGITS, VALUE_DIGITS, duration_text, significant


@dataclass(frozen=True)
class ExportOptions:
    """What a user may set of a file for a filter."""

    axis_rule: str = parameter(
        'worst',
        'Which axis speaks for a sensor: the worst of three, or their root mean square.',
        choices=('worst', 'mean'),
    )
    inflate: float = parameter(
        1.0,
        'Factor on every noise level; 5 to 20 is customary where vibration and model errors come '
        'on top of the noise at rest.',
        low=1.0,
        high=1000.0,
    )
    strict: bool = parameter(
        False, 'Refuse to write a level that is not observable, instead of its 95 % upper limit.'
    )
    topic: str = parameter('', 'The Imu topic to name in the file; empty: that of the recording.')

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class Level:
    """The level of one term of one sensor, in SI.

    Attributes
    ----------
    value : float
        Above 0; with the inflation in it.
    comment : str
        Where it comes from: axis, interval or limit.
    """

    value: float
    comment: str


def sensor_level(results: Results, sensor: str, term: str, options: ExportOptions) -> Level:
    """Return the level of a term that the three axes of a sensor share.

    An axis where the term is not observable counts with its 95 % upper limit, which is safe.

    Raises
    ------
    AllanError
        When the sensor is absent, an axis has neither value nor limit, or only a limit and the
        options are strict.
    """
    axes = [axis for axis in AXES[SENSORS[sensor]] if axis in results.axes]
    if not axes:
        raise AllanError(f'no {sensor} in these results: this file needs gyro and accel')
    levels = {axis: _axis_level(results, axis, term, options.strict) for axis in axes}
    unit = SI_UNITS[sensor][term]
    if options.axis_rule == 'mean':
        value = math.sqrt(sum(v * v for v, _ in levels.values()) / len(levels))
        words = '; '.join(f'{axis} {what}' for axis, (_, what) in levels.items())
    else:
        axis = max(levels, key=lambda name: levels[name][0])
        value, words = levels[axis][0], f'{axis} {levels[axis][1]}'
    return Level(value * options.inflate, f'{term} [{unit}] of {words}')


def header(results: Results, what: str, convention: str, options: ExportOptions) -> list[str]:
    """Return the comment lines (without their mark) that every file starts with."""
    sources = [source.path for source in results.provenance.sources]
    shown = ', '.join(sources[:3]) + (f' and {len(sources) - 3} more' if len(sources) > 3 else '')
    return [
        f'{what}, measured by allan_ros {__version__} (method {results.method})',
        f'from {shown or "sums"}: {duration_text(results.duration_s)} at rest, '
        f'{significant(results.rate_hz, 5)} Hz',
        f'convention: {convention}',
        f'axis rule: {options.axis_rule}; inflation: x{options.inflate:g}',
    ]


def _axis_level(results: Results, axis: str, term: str, strict: bool) -> tuple[float, str]:
    coefficient = results.axes[axis].fit.noise[term]
    value, limit = coefficient.value, coefficient.upper95
    if coefficient.status == 'estimated' and value is not None and value > 0.0:
        words = significant(value, VALUE_DIGITS)
        if coefficient.ci95 is not None:
            low, high = (significant(end, VALUE_DIGITS) for end in coefficient.ci95)
            words += f', 95 % interval {low} .. {high}'
        return value, words
    if limit is None or not 0.0 < limit < math.inf:
        raise AllanError(
            f'{term} of {axis} has neither a value nor a limit: record longer, or fit by method gls'
        )
    if strict:
        raise AllanError(
            f'{term} of {axis} is not observable (below {significant(limit, LIMIT_DIGITS)}): '
            'record longer, or write the limit by leaving out --strict'
        )
    return limit, f'not observable: 95 % upper limit {significant(limit, LIMIT_DIGITS)}'
