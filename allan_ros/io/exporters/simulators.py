# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export targets with the complete process model, and simulators.

The document ``allan_ros/state_space/1`` has for each axis under ``axes``: the levels ``white``,
``walk`` and ``gauss_markov`` in SI; ``discrete``, the matrices of
`allan_ros.core.filters.reductions.StateSpace` at one rate; and ``reductions``, the parameters of
filters with fewer states. A simulator with a single Gauss-Markov bias gets the process whose error
growth is closest to that of the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from ...core.filters.noise_parameters import Level, reduce_axis
from ...core.filters.reductions import STATES, Horizons, Reduction, StateSpace
from ...core.imu import SI_UNITS, UNITS, sensor_of
from . import (
    INS_HORIZON_S,
    SIMULATOR_HORIZON_S,
    VIO_HORIZON_S,
    Entry,
    Row,
    Target,
    rows,
)
from .forms import JsonForm, LineForm, XmlForm
from .model import FilterNoise, converter, rounded

SCHEMA = 'allan_ros/state_space/1'

CONTENT = 'exact discrete state space of the fitted processes (IEEE Std 952; van Loan 1978)'

MATRIX_DIGITS = 12
"""Significant digits of the matrices: diagonal elements of Phi are close to 1."""


def _spaces(noise: FilterNoise) -> Iterator[tuple[str, StateSpace, tuple[Level, ...]]]:
    """Yield each axis, its state space, and the levels of N and K from which it is computed."""
    inflate = noise.options.inflate
    for axis in noise.results.axes:
        reduced = noise.reduction(axis, 'processes', expect_walk=True)
        one = reduced.reduction
        processes = tuple((rounded(inflate * s), rounded(tau)) for s, tau in one.gauss_markov)
        space = StateSpace(rounded(inflate * one.white), rounded(inflate * one.walk), processes)
        yield axis, space, tuple(reduced.levels.values())


def _document(noise: FilterNoise) -> Iterator[Entry]:
    yield Entry(('schema',), SCHEMA)
    yield Entry(('rate_hz',), noise.rate)
    for axis, space, levels in _spaces(noise):
        limits = [level.term for level in levels if level.is_limit]
        yield Entry(('axes', axis), _axis(noise, axis, space, limits), levels=levels)


def _axis(noise: FilterNoise, axis: str, space: StateSpace, limits: list[str]) -> dict[str, Any]:
    """Return the object of one axis in the state space document."""
    result = noise.results.axes[axis]
    processes = [f'gauss_markov {i}' for i in range(len(space.gauss_markov))]
    step = 1.0 / noise.rate
    reductions = [
        reduce_axis(axis, result.fit, states, Horizons.up_to(horizon)).reduction
        for horizon in dict.fromkeys((VIO_HORIZON_S, INS_HORIZON_S, noise.horizons.high))
        for states in STATES
    ]
    return {
        'unit': SI_UNITS[sensor_of(axis)]['B'],
        **_levels(space),
        'ramp': rounded(result.fit.selected.terms.R),
        'limits': limits,
        'discrete': {
            'states': ['integral', 'walk', *processes],
            'step': step,
            'Phi': rounded(space.transition(step).tolist(), MATRIX_DIGITS),
            'Qd': rounded(space.noise(step).tolist(), MATRIX_DIGITS),
            'R': rounded(space.sample_variance(noise.rate)),
        },
        'reductions': [
            {
                'states': one.states,
                'horizon': list(one.horizons),
                **_levels(one),
                'ratio': rounded(one.ratio),
            }
            for one in reductions
        ],
        'growth': [
            {
                'horizon': one.horizon,
                'window': one.window,
                'std': rounded(one.std),
                'ci95': one.ci95 and rounded(one.ci95),
            }
            for one in result.growth
        ],
    }


def _levels(model: Reduction | StateSpace) -> dict[str, Any]:
    pairs = rounded(model.gauss_markov)
    return {
        'white': rounded(model.white),
        'walk': rounded(model.walk),
        'gauss_markov': [{'sigma': sigma, 'tau': tau} for sigma, tau in pairs],
    }


def _module(noise: FilterNoise) -> Iterator[Entry]:
    spaces = list(_spaces(noise))
    axes = {
        axis: {
            'white': space.white,
            'walk': space.walk,
            'gauss_markov': rounded(space.gauss_markov),
        }
        for axis, space, _ in spaces
    }
    yield Entry(('AXES',), axes, levels=tuple(level for *_, levels in spaces for level in levels))


_CODE = '''

def matrices(axis, dt):
    """Return Phi and Qd of (integral, walk, Gauss-Markov ...) over dt s, and R of one sample."""
    noise = AXES[axis]
    n, k = noise['white'], noise['walk']
    size = 2 + len(noise['gauss_markov'])
    phi, q = np.eye(size), np.zeros((size, size))
    phi[0, 1] = dt
    q[0, 0] = n * n * dt + k * k * dt**3 / 3
    q[0, 1] = q[1, 0] = k * k * dt**2 / 2
    q[1, 1] = k * k * dt
    for i, (sigma, tau) in enumerate(noise['gauss_markov'], 2):
        x = dt / tau
        phi[i, i], phi[0, i] = math.exp(-x), -tau * math.expm1(-x)
        if x > 0.05:
            growth = 2 * x + 4 * math.expm1(-x) - math.expm1(-2 * x)
        else:
            growth = x**3 * (2 / 3 - x * (0.5 - x * (7 / 30 - x / 12)))
        q[0, 0] += (sigma * tau) ** 2 * growth
        q[0, i] = q[i, 0] = sigma**2 * tau * math.expm1(-x) ** 2
        q[i, i] = -(sigma**2) * math.expm1(-2 * x)
    return phi, q, n * n / dt


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


def _gazebo(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the noise elements of <imu> in SDF.

    In each step, Gazebo adds noise of the variance sigma_b^2 tau/2 (1 - exp(-2 dt/tau)) to the
    bias: its stationary standard deviation is sigma_b sqrt(tau/2). With 'gaussian_quantized' it
    rounds samples to multiples of the precision, which adds precision^2/12 to the variance.
    """
    for element, sensor in (('angular_velocity', 'gyro'), ('linear_acceleration', 'accel')):
        unit = SI_UNITS[sensor]['B']
        white = noise.row_entry(Row('stddev', sensor, 'N', 'std'))
        bias = noise.process(sensor)
        # these texts refer to all three axes
        white_words = f'of {sensor} {white.words}'
        driving_words = f'of {sensor} [{unit}/sqrt(s)] = sigma sqrt(2 / tau): {bias.words}'
        for i, (name, axis) in enumerate(noise.axes_of(sensor).items()):
            path = ('imu', element, name[-1], 'noise')
            step, turn_on = axis.rounding, axis.turn_on
            yield Entry((*path, '@type'), 'gaussian_quantized' if step else 'gaussian')
            yield Entry((*path, 'mean'), 0.0)
            # at least half of the variance, so that rounding does not suppress the noise completely
            variance = white.value[i] ** 2
            stddev = math.sqrt(max(variance - (step or 0.0) ** 2 / 12.0, variance / 2.0))
            yield Entry((*path, 'stddev'), rounded(stddev), white_words, white.levels)
            if turn_on:
                words = (
                    f'of {name} [{unit}]: scatter of the means of {turn_on.recordings} recordings'
                )
                sigma = rounded(noise.options.inflate * turn_on.std)
                yield Entry((*path, 'bias_stddev'), sigma, words)
            driving = Entry((*path, 'dynamic_bias_stddev'), rounded(bias.driving[i]), driving_words)
            yield replace(driving, levels=bias.levels, findings=bias.findings)
            yield Entry((*path, 'dynamic_bias_correlation_time'), rounded(bias.tau[i]))
            if step:
                words = f'of {name} [{unit}]: step of the samples; stddev is without its rounding'
                yield Entry((*path, 'precision'), rounded(step), words)
            white_words = driving_words = ''


AIRSIM_ROWS = {
    'gyro': ('AngularRandomWalk', 'deg/sqrt(h)', 'GyroBiasStability', 'deg/h', 500.0),
    'accel': ('VelocityRandomWalk', 'mg/sqrt(Hz)', 'AccelBiasStability', 'ug', 800.0),
}
"""Sensor -> key and unit of N, key and unit of the bias, and AirSim's default of tau in s. Only
stability / sqrt(tau) has an effect."""


def _airsim(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the Imu settings of AirSim, whose bias is a random walk: K = stability / sqrt(tau)."""
    parent = noise.target.parent
    yield Entry((*parent, 'SensorType'), 2)
    yield Entry((*parent, 'Enabled'), True)
    for sensor, (white, white_unit, stability, unit, tau) in AIRSIM_ROWS.items():
        yield noise.row_entry(Row(white, sensor, 'N', white_unit))
        walk, path = noise.level(sensor, 'K'), (*parent, stability)
        scaled = converter(UNITS[unit].factor / math.sqrt(tau))
        yield noise.entry(path, walk, f'K sqrt({tau:g} s)', unit, scaled)
        yield Entry((*parent, f'{stability}Tau'), tau)


_simulator = partial(Target, horizon_s=SIMULATOR_HORIZON_S, walk=False, bound=False)

_FORM = LineForm('{key} = {value}', before='\nimport math\n\nimport numpy as np\n\n', after=_CODE)


_complete = partial(Target, three=True, horizon_s=INS_HORIZON_S, walk=False)


def _python(file_name: str, convention: str, *notes: str) -> Target:
    return _complete(file_name, convention, _FORM, entries=_module, notes=notes)


SIMULATORS = {
    'state_space': _complete(
        'state_space.json',
        f'{CONTENT}; states (integral, walk, Gauss-Markov ...), R = N^2 f',
        JsonForm(),
        entries=_document,
        notes=(
            'walk is a state even if it is 0: it represents the turn-on bias',
            'walk covers a ramp and slow sinusoids over the horizon, because they have no '
            'states; if K is not resolved, it contains 15 % of the expected K^2',
        ),
    ),
    'state_space_python': _python(
        'imu_state_space.py', CONTENT, 'AXES holds N, K and (sigma, tau) of each axis in SI'
    ),
    'isaac_sim': _python(
        'isaac_sim_imu_noise.py',
        f'{CONTENT}; the IMU sensor of Isaac Sim adds no noise, so a script adds it to its reading',
        'noise = ImuNoise(); frame = imu.get_current_frame(); gyro, accel = '
        "noise.add(frame['ang_vel'], frame['lin_acc'], physics_dt)",
    ),
    'webots': _python(
        'webots_imu_noise.py',
        f'{CONTENT}; the lookupTable of the Gyro and Accelerometer nodes scales noise with the '
        'value (no noise at rest), so the controller adds it',
        'noise = ImuNoise(); gyro, accel = noise.add(gyro.getValues(), accelerometer.getValues(), '
        'timestep / 1000)',
    ),
    'gazebo': _simulator(
        'gazebo_imu.sdf',
        'standard deviation per sample, and a Gauss-Markov bias of the driving density '
        'dynamic_bias_stddev (gz-sensors, src/GaussianNoiseModel.cc)',
        XmlForm(),
        entries=_gazebo,
        notes=(
            'put it into <sensor type="imu">; f must be its update_rate',
            'bias_stddev (turn-on bias) needs results of several recordings; precision is written '
            'where rounding causes more than a tenth of the white noise',
        ),
        three=True,
    ),
    'px4_sitl': _simulator(
        'px4_sitl_imu.xml',
        'continuous time; the bias is a Gauss-Markov process of this driving density '
        '(PX4-SITL_gazebo-classic and RotorS, src/gazebo_imu_plugin.cpp)',
        XmlForm(),
        rows("""
        gyroscopeNoiseDensity             gyro   N
        gyroscopeRandomWalk               gyro   driving  rad/s^2/sqrt(Hz)
        gyroscopeBiasCorrelationTime      gyro   tau      s
        gyroscopeTurnOnBiasSigma          gyro   turn_on  rad/s
        accelerometerNoiseDensity         accel  N
        accelerometerRandomWalk           accel  driving  m/s^3/sqrt(Hz)
        accelerometerBiasCorrelationTime  accel  tau      s
        accelerometerTurnOnBiasSigma      accel  turn_on  m/s^2
        """),
        parent=('plugin',),
        notes=('copy the elements into <plugin name="gazebo_imu_plugin" ...>',),
    ),
    'airsim': Target(
        'airsim_settings.json',
        'white noise in deg/sqrt(h) and mg/sqrt(Hz); bias as a random walk of '
        'BiasStability / sqrt(BiasStabilityTau) (AirLib/include/sensors/imu/ImuSimple.hpp)',
        JsonForm(),
        entries=_airsim,
        parent=('DefaultSensors', 'Imu'),
        notes=('merge it into settings.json',),
        walk=False,
        bound=False,
    ),
    'gnss_ins_sim': _simulator(
        'gnss_ins_sim_imu.py',
        'deg/sqrt(h), m/s/sqrt(h), and a Gauss-Markov bias of the standard deviation '
        'b_stability (gnss_ins_sim/pathgen/pathgen.py, bias_drift; sim/imu_model.py)',
        LineForm(
            "imu_err['{key}'] = np.array({value})",
            before='\nimport numpy as np\n\nimu_err = {}\n',
        ),
        rows("""
        gyro_arw           gyro   N      deg/sqrt(h)
        accel_vrw          accel  N      m/s/sqrt(h)
        gyro_b             gyro   zero
        gyro_b_stability   gyro   sigma  deg/h
        gyro_b_corr        gyro   tau    s
        accel_b            accel  zero
        accel_b_stability  accel  sigma  m/s^2
        accel_b_corr       accel  tau    s
        """),
        notes=('imu = imu_model.IMU(accuracy=imu_err, axis=6)',),
        three=True,
    ),
}
"""Name -> target."""
