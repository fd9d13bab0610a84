# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compares the drift that a filter expects with the user's own file with the measured drift."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from ..core.errors import AllanError
from ..core.filters.growth import growth_table, predicted_growth
from ..core.imu import AXES, DEGREE, HOUR, SENSORS, UNITS, sensor_of
from ..core.noise import GaussMarkov, Model
from ..core.number_text import significant
from .filter_noise import FilterNoise, notation_of
from .target import ExportOptions, Key, Target

if TYPE_CHECKING:
    from ..results.results import Results

AFTER_S = (1.0, 10.0, 60.0)
"""Times in s after the last correction at which the drift is compared."""

SHOWN_UNITS = {'gyro': (DEGREE, 'deg'), 'accel': (1.0, 'm/s')}
"""Sensor -> SI value and name of the unit of its drift."""

SHOWN_DIGITS = 2
"""Significant digits of a drift."""

ROUNDING_TOLERANCE = 0.01
"""Largest relative difference that the rounding of the numbers in a file explains."""

SMALLEST_STD, LARGEST_STD = 1e-30, 1e15
"""Range of plausible numbers in a file, in any unit; their squares are finite."""

COMMENT_PATTERN = re.compile(r'(?m)^\s*(?:#|//).*|(?s:/\*.*?\*/)|"[^"\n]* [^"\n]*"')
"""Comments of YAML, Python and JSON, and strings with a space."""

NUMBER_PATTERN = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'

EXAMPLE_TARGETS = 'kalibr, openvins or px4'


class Drift(NamedTuple):
    """Standard deviation of the angle (rad) or velocity (m/s) of one axis without correction."""

    axis: str
    after: float  # time since the last correction in s
    file: float  # drift that a filter expects with the numbers of the user's file
    measured: float  # drift of the measured model
    ci95: tuple[float, float] | None  # 95 % interval of ``measured``

    @property
    def ratio(self) -> float:
        """Measured drift / drift that the file expects; infinite if the file expects none."""
        return self.measured / self.file if self.file else math.inf

    @property
    def overconfident(self) -> bool:
        """Whether the file expects a drift below the 95 % interval of the measured drift.

        Without an interval, whether the file expects a drift below the measured drift.
        """
        return self.file < (self.ci95[0] if self.ci95 else self.measured)

    def __str__(self) -> str:
        factor, unit = SHOWN_UNITS[sensor_of(self.axis)]
        file, measured, *ends = (
            f'{significant(x / factor, SHOWN_DIGITS)}'
            for x in (self.file, self.measured, *(self.ci95 or ()))
        )
        interval = f' ({"..".join(ends)})' if ends else ''
        text = f'{self.axis} after {self.after:g} s: your file {file} {unit}, measured {measured}'
        return f'{text}{interval} {unit}, {significant(self.ratio, SHOWN_DIGITS)} times'


def against(
    results: Results, target: Target, text: str, options: ExportOptions = ExportOptions()
) -> tuple[Drift, ...]:
    """Return the drift of each axis according to the user's file and to the measured model.

    Parameters
    ----------
    results : Results
        The measured IMU.
    target : Target
        The target whose file it is.
    text : str
        Text of the user's file, in the format and with the keys that `make_export` writes; other
        keys are ignored.
    options : ExportOptions
        The rate of the filter and the horizon. The bias is assumed to be averaged over the horizon
        before the last correction.

    Raises
    ------
    AllanError
        If the text lacks a number of the target, or the target has no noise model in its file.
    """
    noise = FilterNoise(results, options, target)
    window = noise.horizon
    found = []
    for axis, model in file_models(target, text, noise.rate).items():
        if axis not in results.axes:
            continue
        grown = predicted_growth(model, AFTER_S, window)
        for expected, growth in zip(
            grown, growth_table(results.axes[axis].fit, horizons=AFTER_S, window=window)
        ):
            size, ends = growth.std.value or 0.0, growth.std.ci95
            found.append(Drift(axis, growth.horizon, float(expected), size, ends))
    return tuple(found)


def verdicts(drifts: tuple[Drift, ...]) -> list[str]:
    """Return a sentence for each sensor about the axis and time with the largest ratio."""
    lines = []
    for sensor in dict.fromkeys(sensor_of(one.axis) for one in drifts):
        worst = max((d for d in drifts if sensor_of(d.axis) == sensor), key=lambda d: d.ratio)
        factor = significant(max(worst.ratio, 1.0 / worst.ratio), SHOWN_DIGITS)
        said = f'your file covers the measured drift, by {factor} or more'
        if worst.ratio > 1.0 + ROUNDING_TOLERANCE:
            said = f'a filter with your file is overconfident by {factor}'
            if not worst.overconfident:
                said = f'your file expects {factor} times less than the measured drift, but lies '
                said += 'within its interval'
        lines.append(f'{sensor}: {said} ({worst.axis} after {worst.after:g} s)')
    return lines


def file_models(target: Target, text: str, rate: float) -> Mapping[str, Model]:
    """Return axis -> noise model that a filter assumes with the numbers in the text of its file.

    ``rate`` is the rate of the filter in Hz. Raises AllanError as `against` does.
    """
    whats = {key.what for key in target.keys}
    if not whats & {'K', 'sigma'}:
        raise AllanError(
            f'{target.file_name} has no noise model to compare: give --to for a filter with N and '
            f'the drift of the bias in its file, such as {EXAMPLE_TARGETS}'
        )
    plain = COMMENT_PATTERN.sub('', text)
    values: dict[tuple[str, str], list[float]] = {}
    for key in target.keys:
        if key.what in ('rate', 'topic'):
            continue
        numbers = _si(key, _numbers(plain, key), rate)
        for sensor in SENSORS if key.sensor == '-' else (key.sensor,):
            values.setdefault((sensor, key.what), numbers)
    models = {}
    for sensor, place in SENSORS.items():
        for i, axis in enumerate(AXES[place]):
            one = {w: v[i % len(v)] for (s, w), v in values.items() if s == sensor}
            bias = [(one['sigma'], GaussMarkov(one['common_tau']))] if 'sigma' in one else []
            models[axis] = Model.of(*bias, N=one['N'], K=one.get('K', 0.0))
    return models


def _numbers(plain: str, key: Key) -> list[float]:
    """Return the one or three numbers of a key in a text without comments."""
    name = key.name
    known = re.escape(name)
    values = re.findall(
        rf'(?<![\w.]){known}["\']?\s*[:=,\s]\s*(\[[^\]]*\]|{NUMBER_PATTERN})', plain
    )
    numbers = [
        [float(n) for n in re.findall(NUMBER_PATTERN, value)] for value in dict.fromkeys(values)
    ]
    if len(numbers) != 1 or len(numbers[0]) not in (1, 3):
        what = 'contains no number' if not numbers else 'contains several values'
        raise AllanError(
            f'your file {what} of {name}: give the file of the filter that --to names, with one IMU'
        )
    least = 0.0 if key.what == 'K' else SMALLEST_STD
    if not all(least <= value <= LARGEST_STD for value in numbers[0]):
        raise AllanError(
            f'{name} of your file is {values[0]}: give a number from {least:g} to {LARGEST_STD:g}'
        )
    return numbers[0]


def _si(key: Key, numbers: list[float], rate: float) -> list[float]:
    if key.what in ('N', 'K'):
        notation = notation_of(key)
        return [notation.level(value, rate) for value in numbers]
    factor = HOUR if key.what == 'common_tau' else UNITS[key.unit].factor
    return [value * factor for value in numbers]
