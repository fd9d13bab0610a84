# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compute the content of files that are too complex for a table of keys, such as files for Gazebo.

A simulator that models the bias by one Gauss-Markov process gets the process whose error growth is
closest to the error growth of the noise model.

State-space document
--------------------
The key ``axes`` of the document ``allan_ros/state_space/3`` contains for each axis the levels
``white``, ``walk`` and ``processes`` in SI, and the matrices of
`allan_ros.core.filters.state_space.StateSpace` for one rate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from ..core.errors import AllanError
from ..core.estimate import LIMIT_DIGITS, VALUE_DIGITS, Estimate, significant
from ..core.filters.noise_parameters import FilterLevel
from ..core.filters.state_space import StateSpace
from ..core.imu import AXES, SI_UNITS, sensor_of
from ..core.noise import Model
from .filter_noise import NOTATIONS, FilterNoise, Notation, clamped, rounded
from .target import ANY_NODE, Key, Row

SCHEMA = 'allan_ros/state_space/3'

MATRIX_DIGITS = 12
"""Number of significant digits of a matrix: many, because the diagonal of Phi is close to 1."""


def state_space_rows(noise: FilterNoise) -> Iterator[Row]:
    """Yield the rows of the state-space document: schema, rate, and one row for each axis."""
    yield Row(('schema',), SCHEMA)
    yield Row(('rate_hz',), noise.rate)
    step = 1.0 / noise.rate
    for axis, result in noise.results.axes.items():
        factors = noise.factors[sensor_of(axis)]
        reduction = noise.reduction(axis, 'processes')
        model, levels = reduction.model, tuple(reduction.levels.values())
        processes = [
            (rounded(factors['K'] * part.value), type(part.process)(*rounded(part.process.shape)))
            for part in model.shaped.parts
        ]
        white, walk = (rounded(factors[term] * model.value(term)) for term in 'NK')
        space = StateSpace(white, walk, tuple(processes))
        document = {
            'unit': SI_UNITS[sensor_of(axis)]['B'],
            'white': white,
            'walk': walk,
            'processes': [
                {'process': process.name, process.coefficient: value, **process.numbers}
                for value, process in processes
            ],
            'ramp': rounded(result.fit.model.value('R')),
            'limits': [level.estimate.name for level in levels if level.is_limit],
            'Phi': rounded(space.transition(step).tolist(), MATRIX_DIGITS),
            'Qd': rounded(space.noise(step).tolist(), MATRIX_DIGITS),
            'R': rounded(space.sample_variance(noise.rate)),
        }
        yield Row(('axes', axis), document, levels=levels)


def gazebo_rows(noise: FilterNoise) -> Iterator[Row]:
    """Yield the rows of the noise elements of <imu> in an SDF file for Gazebo.

    In each step dt, Gazebo adds noise of the variance sigma_b^2 tau/2 (1 - exp(-2 dt/tau)) to the
    bias, with sigma_b = dynamic_bias_stddev and tau = dynamic_bias_correlation_time. The stationary
    standard deviation of the bias is sigma_b sqrt(tau/2). With the type 'gaussian_quantized',
    Gazebo rounds samples to multiples of the precision, which adds precision^2/12 to the variance.
    """
    for element, sensor in (('angular_velocity', 'gyro'), ('linear_acceleration', 'accel')):
        unit = SI_UNITS[sensor]['B']
        white, bias, time = (
            noise.row(Key(name, sensor, quantity, notation))
            for name, quantity, notation in (
                ('stddev', 'N', 'std'),
                ('dynamic_bias_stddev', 'driving', f'{unit}/sqrt(s)'),
                ('dynamic_bias_correlation_time', 'tau', 's'),
            )
        )
        # the two texts describe all three axes, so they are written only for the first axis
        white_words, bias_words = (f'of {sensor} {row.words}' for row in (white, bias))
        for i, (name, axis) in enumerate(noise.axes_of(sensor).items()):
            path = ('imu', element, name[-1], 'noise')
            step, turn_on = axis.rounding, axis.turn_on
            yield Row((*path, '@type'), 'gaussian_quantized' if step else 'gaussian')
            yield Row((*path, 'mean'), 0.0)
            # at least half of the variance remains, so that rounding does not suppress all noise
            variance = white.value[i] ** 2
            stddev = math.sqrt(max(variance - (step or 0.0) ** 2 / 12.0, variance / 2.0))
            yield Row((*path, white.key), rounded(stddev), white_words, levels=white.levels)
            if turn_on and turn_on.scatter.value:
                words = (
                    f'of {name} [{unit}]: scatter of the means of {turn_on.recordings} recordings'
                )
                sigma = rounded(noise.factors[sensor]['K'] * turn_on.scatter.value)
                yield Row((*path, 'bias_stddev'), sigma, words)
            yield replace(
                bias, path=(*path, bias.key), value=bias.value[i], words=bias_words, unit=''
            )
            yield Row((*path, time.key), time.value[i])
            if step:
                words = (
                    f'of {name} [{unit}]: step to which samples are rounded; stddev excludes this'
                )
                yield Row((*path, 'precision'), rounded(step), words)
            white_words = bias_words = ''


MADGWICK_FACTOR = math.sqrt(3.0 / 4.0)
"""Ratio of the gain of the Madgwick filter to the gyro error (S. O. H. Madgwick, An efficient
orientation filter for inertial and inertial/magnetic sensor arrays, 2010, section on filter
gains)."""


def madgwick_rows(noise: FilterNoise) -> Iterator[Row]:
    """Yield the rows of the parameters gain and zeta of the Madgwick filter, for the horizon h.

    The gain is sqrt(3/4) times the error of the gyro. This error consists of the Allan deviation at
    h without quantization and vibration, and of the bias if the bias is known. The bias counts as
    an error because the filter does not estimate it without a magnetometer.

    zeta is sqrt(3/4) times the drift of the bias per second. This drift is R if R is resolved on
    every axis, else K / sqrt(h), because a random walk moves by K sqrt(h) within h. Gain and zeta
    are written for the axis with the largest value.
    """
    horizon, axes = noise.horizon, noise.axes_of('gyro')
    factors = noise.factors['gyro']
    gains, white_levels = [], []
    for axis, result in axes.items():
        bias, white_level = noise.bias.get(axis, 0.0), noise.level(axis, 'N')

        def gain(model: Model, density: float, bias: float = bias) -> float:
            drift = math.sqrt(float(model.changed(N=0.0).drift.avar([horizon])[0]))
            white = density / math.sqrt(horizon)
            return MADGWICK_FACTOR * math.hypot(factors['N'] * white, factors['K'] * drift, bias)

        models_at_ends = result.fit.models_at_ends()
        low, high = (
            map(gain, models_at_ends, white_level.interval) if models_at_ends else (0.0, math.inf)
        )
        value = gain(result.fit.model, white_level.value)
        estimate = Estimate(
            value, (low, high), value, white_level.estimate.status, name='gain', axis=axis
        )
        gains.append(FilterLevel(estimate))
        white_levels.append(white_level)
    largest_gain, white_level = max(zip(gains, white_levels), key=lambda levels: levels[0].value)
    words = f'[rad/s] = sqrt(3/4) times the Allan deviation at h = {horizon:g} s'
    words += f'{" and the bias" if noise.bias else ""}: '
    words += ', '.join(f'{level.estimate.axis} {level.value:.3g}' for level in gains)
    value, interval = rounded(largest_gain.value), largest_gain.interval
    row = Row((*ANY_NODE, 'gain'), value, words, 'rad/s', interval, (white_level,))
    yield clamped(row, 0.0, 1.0)
    term, formula, scale = 'R', 'sqrt(3/4) |R|', MADGWICK_FACTOR
    if not all(result.fit.noise['R'].status == 'estimated' for result in axes.values()):
        term, formula = 'K', f'sqrt(3/4) K / sqrt(h) with h = {horizon:g} s'
        scale = MADGWICK_FACTOR / math.sqrt(horizon)
    notation = Notation(formula, 'rad/s^2', factor=1.0 / scale)
    zeta = noise.level_row((*ANY_NODE, 'zeta'), 'gyro', term, notation)
    yield clamped(zeta, -1.0, 1.0)


def covariance_rows(noise: FilterNoise) -> Iterator[Row]:
    """Yield a row for each sensor with the covariance matrix of a sample, as in sensor_msgs/Imu.

    The nine elements of the matrix are written row by row. The diagonal contains N^2 times the rate
    of each axis.
    """
    for name, sensor in (('angular_velocity', 'gyro'), ('linear_acceleration', 'accel')):
        path = (*ANY_NODE, f'{name}_covariance')
        row = noise.level_row(path, sensor, 'N', NOTATIONS['variance'])
        x, y, z = row.value
        yield replace(row, value=[x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z])


def temperature_rows(noise: FilterNoise) -> Iterator[Row]:
    """Yield the rows of the bias over temperature: T0, b0 (of the gyro only), b1 and b2.

    A sensor is excluded if one of its axes has no temperature model. b1 and b2 are 0 on axes where
    the effect of the temperature is not resolved. Raises AllanError if both sensors are excluded.
    """
    sensors = noise.results.temperature_models
    complete_models = {s: models for s, models in sensors.items() if len(models) == len(AXES) / 2}
    if not complete_models:
        raise AllanError(
            'no bias over temperature in these results: record while the temperature rises and '
            'falls by 3 K or more'
        )
    first_model = next(iter(next(iter(complete_models.values())).values()))
    temperature_range = f'{first_model.lowest:.1f} to {first_model.highest:.1f} degC'
    words = f'[degC]: T0 of the model, which was measured at {temperature_range}'
    yield Row(
        ('reference',),
        first_model.reference,
        words,
        'degC',
        (first_model.lowest, first_model.highest),
    )
    for sensor, models in complete_models.items():
        # b0 of an accelerometer is not written, because it contains gravity
        for i, coefficient in enumerate(('b0', 'b1', 'b2')[sensor == 'accel' :], sensor == 'accel'):
            unit = SI_UNITS[sensor]['B'] + ('', '/K', '/K^2')[i]
            values_and_intervals = [
                (getattr(m, coefficient), getattr(m, f'{coefficient}_ci95'))
                for m in models.values()
            ]
            are_written = [not i or model.resolved for model in models.values()]
            axis_texts = (
                f'{name} {significant(value, VALUE_DIGITS)}, 95 % interval '
                f'{significant(low, LIMIT_DIGITS)}..{significant(high, LIMIT_DIGITS)}'
                f'{"" if is_written else " (not resolved: written as 0)"}'
                for name, is_written, (value, (low, high)) in zip(
                    models, are_written, values_and_intervals
                )
            )
            values = rounded(
                [value if w else 0.0 for w, (value, _) in zip(are_written, values_and_intervals)]
            )
            widest_interval = max(
                (ends for _, ends in values_and_intervals), key=lambda ends: ends[1] - ends[0]
            )
            yield Row(
                (f'{sensor}_{coefficient}',),
                values,
                f'[{unit}]: {"; ".join(axis_texts)}',
                unit,
                widest_interval,
            )
