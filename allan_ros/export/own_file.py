# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare the measured drift with the drift that the user's own configuration file predicts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from ..core.errors import AllanError
from ..core.estimate import significant
from ..core.filters.growth import growth_table
from ..core.imu import AXES, DEGREE, HOUR, SENSORS, UNITS, sensor_of
from ..core.noise import GaussMarkov, Model
from .filter_noise import FilterNoise, notation_of
from .target import ExportOptions, Key, Target

if TYPE_CHECKING:
    from ..results.results import Results

AFTER_S = (1.0, 10.0, 60.0)
"""Times in s after the last correction at which the drift is compared."""

DRIFT_UNITS = {'gyro': (DEGREE, 'deg'), 'accel': (1.0, 'm/s')}
"""Sensor -> SI value and name of the unit in which its drift is shown."""

SHOWN_DIGITS = 2
"""Number of significant digits of a drift in a text."""

ROUNDING_TOLERANCE = 0.01
"""Largest relative difference between two drifts that can be due to rounded numbers in a file."""

SMALLEST_STD, LARGEST_STD = 1e-30, 1e15
"""Range of accepted numbers in a file, in any unit; K may also be 0. The square of an accepted
number is finite."""

COMMENT_PATTERN = re.compile(r'(?m)^\s*(?:#|//).*|(?s:/\*.*?\*/)|"[^"\n]* [^"\n]*"')
"""Pattern of lines that begin with # or //, of comments between /* and */, and of quoted strings
that contain a space. All of these are removed from a file before its numbers are read."""

NUMBER_PATTERN = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'

EXAMPLE_TARGETS = 'kalibr, openvins or px4'


class Drift(NamedTuple):
    """Standard deviation of the angle error (rad) or velocity error (m/s) of one axis."""

    axis: str
    after: float  # time since the last correction in s
    file: float  # drift that a state estimator expects with the numbers in the user's file
    measured: float  # drift that the measured noise model predicts
    ci95: tuple[float, float] | None  # 95 % interval of ``measured``

    @property
    def ratio(self) -> float:
        """Measured drift divided by the drift that the file predicts.

        The ratio is infinite if the file predicts no drift.
        """
        return self.measured / self.file if self.file else math.inf

    @property
    def overconfident(self) -> bool:
        """Whether the file predicts a drift below the 95 % interval of the measured drift.

        Without an interval, whether the file predicts a drift below the measured drift.
        """
        return self.file < (self.ci95[0] if self.ci95 else self.measured)

    def __str__(self) -> str:
        factor, unit = DRIFT_UNITS[sensor_of(self.axis)]
        file, measured, *interval_ends = (
            f'{significant(x / factor, SHOWN_DIGITS)}'
            for x in (self.file, self.measured, *(self.ci95 or ()))
        )
        interval = f' ({"..".join(interval_ends)})' if interval_ends else ''
        text = f'{self.axis} after {self.after:g} s: your file {file} {unit}, measured {measured}'
        return f'{text}{interval} {unit}, {significant(self.ratio, SHOWN_DIGITS)} times'


def compare_drifts(
    results: Results, target: Target, text: str, options: ExportOptions = ExportOptions()
) -> tuple[Drift, ...]:
    """Return the drift of each measured axis according to the user's file and to the model.

    An axis for which the noise model predicts no drift is omitted.

    Parameters
    ----------
    results : Results
        The measured IMU.
    target : Target
        The target to which the user's file belongs.
    text : str
        Text of the user's file, in the format and with the keys that `make_export` writes; other
        keys are ignored.
    options : ExportOptions
        The rate of the state estimator and the horizon. It is assumed that the bias was averaged
        over a time as long as the horizon before the last correction.

    Raises
    ------
    AllanError
        If the text lacks a number of the target, or contains several values or an invalid value of
        this number; if the file of the target states no drift of the bias; or if the noise model
        predicts no drift of any axis. Also under the conditions of the constructor of
        `FilterNoise`.
    """
    noise = FilterNoise(results, options, target)
    window = noise.horizon
    drifts = []
    for axis, model in file_models(target, text, noise.rate).items():
        if axis not in results.axes:
            continue
        expected_drifts = model.growth(AFTER_S, window)
        for expected, growth in zip(
            expected_drifts, growth_table(results.axes[axis].fit, horizons=AFTER_S, window=window)
        ):
            if growth.std.value:
                std, ci95 = growth.std.value, growth.std.ci95
                drifts.append(Drift(axis, growth.horizon, float(expected), std, ci95))
    if not drifts:
        raise AllanError(
            'the results contain no measured noise of an axis in the file: record longer at rest'
        )
    return tuple(drifts)


def verdicts(drifts: tuple[Drift, ...]) -> list[str]:
    """Return for each sensor a sentence on the axis and time with the largest `Drift.ratio`."""
    lines = []
    for sensor in dict.fromkeys(sensor_of(drift.axis) for drift in drifts):
        worst_drift = max((d for d in drifts if sensor_of(d.axis) == sensor), key=lambda d: d.ratio)
        factor = significant(max(worst_drift.ratio, 1.0 / worst_drift.ratio), SHOWN_DIGITS)
        sentence = f'your file covers the measured drift by a factor of {factor} or more'
        if worst_drift.ratio > 1.0 + ROUNDING_TOLERANCE:
            sentence = f'a filter with your file is overconfident by a factor of {factor}'
            if not worst_drift.overconfident:
                sentence = f'your file expects a drift {factor} times below the measured drift, '
                sentence += 'but within the 95 % interval'
        lines.append(f'{sensor}: {sentence} ({worst_drift.axis} after {worst_drift.after:g} s)')
    return lines


def file_models(target: Target, text: str, rate: float) -> Mapping[str, Model]:
    """Return axis -> noise model that a state estimator assumes with the numbers in its file.

    ``text`` is the text of the file, and ``rate`` is the rate of the state estimator in Hz. Raises
    AllanError if the text lacks a number of the target, or contains several values or an invalid
    value of this number, or if the file of the target states no drift of the bias.
    """
    quantities = {key.what for key in target.keys}
    if not quantities & {'K', 'sigma'}:
        raise AllanError(
            f'{target.file_name} has no noise model to compare: give --to for a filter with N and '
            f'the drift of the bias in its file, such as {EXAMPLE_TARGETS}'
        )
    text_without_comments = COMMENT_PATTERN.sub('', text)
    values: dict[tuple[str, str], list[float]] = {}
    for key in target.keys:
        if key.what in ('rate', 'topic'):
            continue
        numbers = _si(key, _numbers(text_without_comments, key), rate)
        for sensor in SENSORS if key.sensor == '-' else (key.sensor,):
            values.setdefault((sensor, key.what), numbers)
    models = {}
    for sensor, rows in SENSORS.items():
        for i, axis in enumerate(AXES[rows]):
            axis_values = {
                quantity: v[i % len(v)] for (s, quantity), v in values.items() if s == sensor
            }
            bias = (
                [(axis_values['sigma'], GaussMarkov(axis_values['common_tau']))]
                if 'sigma' in axis_values
                else []
            )
            models[axis] = Model.of(*bias, N=axis_values['N'], K=axis_values.get('K', 0.0))
    return models


def _numbers(text_without_comments: str, key: Key) -> list[float]:
    """Return the one or three numbers of a key in a text without comments."""
    name = key.name
    key_pattern = re.escape(name)
    value_texts = re.findall(
        rf'(?<![\w.]){key_pattern}["\']?\s*[:=,\s]\s*(\[[^\]]*\]|{NUMBER_PATTERN})',
        text_without_comments,
    )
    numbers = [
        [float(n) for n in re.findall(NUMBER_PATTERN, value)]
        for value in dict.fromkeys(value_texts)
    ]
    if len(numbers) != 1 or len(numbers[0]) not in (1, 3):
        problem = 'contains no number' if not numbers else 'contains several values'
        raise AllanError(
            f'your file {problem} of {name}: give the file of the filter that --to names, '
            'with one IMU'
        )
    smallest = 0.0 if key.what == 'K' else SMALLEST_STD
    if not all(smallest <= value <= LARGEST_STD for value in numbers[0]):
        raise AllanError(
            f'{name} of your file is {value_texts[0]}: give a number from {smallest:g} to '
            f'{LARGEST_STD:g}'
        )
    return numbers[0]


def _si(key: Key, numbers: list[float], rate: float) -> list[float]:
    if key.what in ('N', 'K'):
        notation = notation_of(key)
        return [notation.level(value, rate) for value in numbers]
    factor = HOUR if key.what == 'common_tau' else UNITS[key.unit].factor
    return [value * factor for value in numbers]
