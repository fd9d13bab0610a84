# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export targets with the complete process model, and simulators.

The document ``allan_ros/state_space/2`` has for each axis under ``axes``: the levels ``white``,
``walk`` and ``gauss_markov`` in SI, and the matrices of
`allan_ros.core.filters.reductions.StateSpace` at one rate. A simulator with a single Gauss-Markov
bias gets the process whose error growth is closest to that of the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import chain

from ...core.filters.reductions import StateSpace
from ...core.imu import SI_UNITS, sensor_of
from . import INS_HORIZON_S, SIMULATOR_HORIZON_S, Key, Row, Target, Value
from .model import FilterNoise, rounded
from .text import json_form, line_form, xml_form

SCHEMA = 'allan_ros/state_space/2'

CONTENT = 'exact discrete state space of the fitted processes (IEEE Std 952; van Loan 1978)'

MATRIX_DIGITS = 12
"""Significant digits of the matrices: diagonal elements of Phi are close to 1."""


def _axes(noise: FilterNoise) -> dict[str, tuple[StateSpace, dict[str, Value]]]:
    """Return the state space of each axis, and its levels as they are written."""
    found = {}
    for axis in noise.results.axes:
        model, inflate = noise.reduction(axis, 'processes').model, noise.options.inflate
        processes = [[rounded(inflate * sigma), rounded(tau)] for sigma, tau in model.gauss_markov]
        white, walk = (rounded(inflate * level) for level in (model.terms.N, model.terms.K))
        space = StateSpace(white, walk, tuple((sigma, tau) for sigma, tau in processes))
        found[axis] = space, {'white': white, 'walk': walk, 'gauss_markov': processes}
    return found


def _document(noise: FilterNoise) -> Iterator[Row]:
    yield Row(('schema',), SCHEMA)
    yield Row(('rate_hz',), noise.rate)
    step = 1.0 / noise.rate
    for axis, (space, written) in _axes(noise).items():
        levels = tuple(noise.reduction(axis, 'processes').levels.values())
        document = {
            'unit': SI_UNITS[sensor_of(axis)]['B'],
            **written,
            'ramp': rounded(noise.results.axes[axis].fit.model.terms.R),
            'limits': [level.term for level in levels if level.is_limit],
            'Phi': rounded(space.transition(step).tolist(), MATRIX_DIGITS),
            'Qd': rounded(space.noise(step).tolist(), MATRIX_DIGITS),
            'R': rounded(space.sample_variance(noise.rate)),
        }
        yield Row(('axes', axis), document, levels=levels)


def _module(noise: FilterNoise) -> Iterator[Row]:
    axes = {axis: written for axis, (_, written) in _axes(noise).items()}
    levels = (noise.reduction(axis, 'processes').levels.values() for axis in axes)
    yield Row(('AXES',), axes, levels=tuple(chain(*levels)))


_CODE = '''

class ImuNoise:
    """Simulated noise of all axes; the result of a call is added to ideal samples."""

    def __init__(self, rng=None):
        self.rng = rng or np.random.default_rng()
        self.bias = {
            axis: [0.0, *(sigma * self.rng.standard_normal() for sigma, _ in noise['gauss_markov'])]
            for axis, noise in AXES.items()
        }

    def __call__(self, dt):
        """Return the noise of the next sample of each axis, dt s after the last one."""
        sample = {}
        for axis, noise in AXES.items():
            bias, draw = self.bias[axis], self.rng.standard_normal
            bias[0] += noise['walk'] * math.sqrt(dt) * draw()
            for i, (sigma, tau) in enumerate(noise['gauss_markov'], 1):
                driven = sigma * math.sqrt(-math.expm1(-2 * dt / tau))
                bias[i] = math.exp(-dt / tau) * bias[i] + driven * draw()
            sample[axis] = sum(bias) + noise['white'] / math.sqrt(dt) * draw()
        return sample

    def add(self, angular_velocity, linear_acceleration, dt):
        """Return the two vectors (x, y, z) with noise added."""
        sample = self(dt)
        gyro, accel = (
            np.array([sample.get(f'{sensor}_{axis}', 0.0) for axis in 'xyz'])
            for sensor in ('gyro', 'accel')
        )
        return np.asarray(angular_velocity) + gyro, np.asarray(linear_acceleration) + accel
'''


def _gazebo(noise: FilterNoise) -> Iterator[Row]:
    """Yield the noise elements of <imu> in SDF.

    In each step, Gazebo adds noise of the variance sigma_b^2 tau/2 (1 - exp(-2 dt/tau)) to the
    bias: its stationary standard deviation is sigma_b sqrt(tau/2). With 'gaussian_quantized' it
    rounds samples to multiples of the precision, which adds precision^2/12 to the variance.
    """
    for element, sensor in (('angular_velocity', 'gyro'), ('linear_acceleration', 'accel')):
        unit = SI_UNITS[sensor]['B']
        white, bias, time = (
            noise.row(Key(name, sensor, what, of))
            for name, what, of in (
                ('stddev', 'N', 'std'),
                ('dynamic_bias_stddev', 'driving', f'{unit}/sqrt(s)'),
                ('dynamic_bias_correlation_time', 'tau', 's'),
            )
        )
        # these texts refer to all three axes
        white_words, bias_words = (f'of {sensor} {row.words}' for row in (white, bias))
        for i, (name, axis) in enumerate(noise.axes_of(sensor).items()):
            path = ('imu', element, name[-1], 'noise')
            step, turn_on = axis.rounding, axis.turn_on
            yield Row((*path, '@type'), 'gaussian_quantized' if step else 'gaussian')
            yield Row((*path, 'mean'), 0.0)
            # at least half of the variance, so that rounding does not suppress the noise completely
            variance = white.value[i] ** 2
            stddev = math.sqrt(max(variance - (step or 0.0) ** 2 / 12.0, variance / 2.0))
            yield Row((*path, white.key), rounded(stddev), white_words, levels=white.levels)
            if turn_on and turn_on.std:
                words = (
                    f'of {name} [{unit}]: scatter of the means of {turn_on.recordings} recordings'
                )
                sigma = rounded(noise.options.inflate * turn_on.std)
                yield Row((*path, 'bias_stddev'), sigma, words)
            yield replace(
                bias, path=(*path, bias.key), value=bias.value[i], words=bias_words, unit=''
            )
            yield Row((*path, time.key), time.value[i])
            if step:
                words = f'of {name} [{unit}]: step of the samples; stddev is without its rounding'
                yield Row((*path, 'precision'), rounded(step), words)
            white_words = bias_words = ''


_complete = partial(Target, three=True, horizon_s=INS_HORIZON_S, walk=False)

_python = partial(
    _complete,
    form=line_form(
        '{key} = {value}', before='\nimport math\n\nimport numpy as np\n\n', after=_CODE
    ),
    rows=_module,
)


SIMULATORS = {
    'state_space': _complete(
        'state_space.json',
        f'{CONTENT}; Phi, Qd: a step of 1/rate_hz of (integral, walk, Gauss-Markov ...); '
        'R = N^2 f: variance of a sample',
        json_form,
        rows=_document,
        notes=(
            'walk is a state even if it is 0: it represents the turn-on bias',
            'walk covers a ramp and slow sinusoids over the horizon, because they have no '
            'states; if K is not resolved, it contains 15 % of the expected K^2',
        ),
    ),
    'isaac_sim': _python(
        'isaac_sim_imu_noise.py',
        f'{CONTENT}; the IMU sensor of Isaac Sim adds no noise, so a script adds it to its reading',
        notes=(
            'noise = ImuNoise(); frame = imu.get_current_frame(); gyro, accel = '
            "noise.add(frame['ang_vel'], frame['lin_acc'], physics_dt)",
        ),
    ),
    'webots': _python(
        'webots_imu_noise.py',
        f'{CONTENT}; the lookupTable of the Gyro and Accelerometer nodes scales noise with the '
        'value (no noise at rest), so the controller adds it',
        notes=(
            'noise = ImuNoise(); gyro, accel = noise.add(gyro.getValues(), '
            'accelerometer.getValues(), timestep / 1000)',
        ),
    ),
    'gazebo': Target(
        'gazebo_imu.sdf',
        'standard deviation per sample, and a Gauss-Markov bias of the driving density '
        'dynamic_bias_stddev (gz-sensors, src/GaussianNoiseModel.cc)',
        xml_form,
        rows=_gazebo,
        notes=(
            'put it into <sensor type="imu">; f must be its update_rate',
            'bias_stddev (turn-on bias) needs results of several recordings; precision is written '
            'where rounding causes more than a tenth of the white noise',
        ),
        three=True,
        horizon_s=SIMULATOR_HORIZON_S,
        walk=False,
        bound=False,
    ),
}
"""Name -> target."""
