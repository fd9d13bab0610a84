# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of simulators whose noise model is white noise and one bias process.

A simulated sensor should behave like the measured one: the bias process is the one whose error
growth follows that of the model, as far above as below it. `state_space` has the simulators that
run the complete model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

from ...core.imu import SI_UNITS, UNITS
from .convention import SIMULATOR_HORIZON_S, Convention, Entry
from .json_form import JsonForm
from .model import FilterNoise, rounded
from .target import Target
from .text_forms import PythonForm, XmlForm

SDF_SENSORS = {'angular_velocity': 'gyro', 'linear_acceleration': 'accel'}


def _gazebo(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the noise elements of SDF's <imu>.

    Gazebo steps the bias with the variance sigma_b^2 tau/2 (1 - exp(-2 dt/tau)): its stationary
    standard deviation is sigma_b sqrt(tau/2). With 'gaussian_quantized' it rounds the sample to
    multiples of the precision, which adds precision^2/12 to the variance.
    """
    for element, sensor in SDF_SENSORS.items():
        unit = SI_UNITS[sensor]['B']
        (white,) = noise.keyed({'stddev': (sensor, 'N')}, 'std')
        bias = noise.process(sensor)
        driving_words = f'of {sensor} [{unit}/sqrt(s)] = sigma sqrt(2 / tau): {bias.words}'
        for i, (name, axis) in enumerate(noise.axes_of(sensor).items()):
            path = ('imu', element, name[-1], 'noise')
            said = i == 0  # the words are about all three axes
            step, turn_on = axis.rounding, axis.turn_on
            yield Entry((*path, '@type'), 'gaussian_quantized' if step else 'gaussian')
            yield Entry((*path, 'mean'), 0.0)
            # at least half of the variance, lest rounding stops the noise altogether
            variance = white.value[i] ** 2
            stddev = math.sqrt(max(variance - (step or 0.0) ** 2 / 12.0, variance / 2.0))
            words = f'of {sensor} {white.words}' if said else ''
            yield Entry((*path, 'stddev'), rounded(stddev), words, white.is_limit)
            if turn_on:
                words = (
                    f'of {name} [{unit}]: scatter of the means of {turn_on.recordings} recordings'
                )
                sigma = rounded(noise.options.inflate * turn_on.std)
                yield Entry((*path, 'bias_stddev'), sigma, words)
            driving = rounded(bias.sigma[i] * math.sqrt(2.0 / bias.tau[i]))
            yield Entry(
                (*path, 'dynamic_bias_stddev'),
                driving,
                driving_words if said else '',
                findings=bias.findings,
            )
            yield Entry((*path, 'dynamic_bias_correlation_time'), rounded(bias.tau[i]))
            if step:
                words = f'of {name} [{unit}]: step of the samples; stddev is without its rounding'
                yield Entry((*path, 'precision'), rounded(step), words)


def _px4_sitl(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the elements of the Gazebo IMU plugin of PX4 and RotorS.

    The random walk is the density that drives a Gauss-Markov bias, sigma sqrt(2/tau).
    """
    for name, sensor in (('gyroscope', 'gyro'), ('accelerometer', 'accel')):
        bias = noise.process(sensor)
        yield from noise.keyed({f'{name}NoiseDensity': (sensor, 'N')}, parent=('plugin',))
        walk = rounded(bias.sigma[0] * math.sqrt(2.0 / bias.tau[0]))
        words = f'[{SI_UNITS[sensor]["K"]}] = sigma sqrt(2 / tau): {bias.words}'
        yield Entry(('plugin', f'{name}RandomWalk'), walk, words, findings=bias.findings)
        yield Entry(('plugin', f'{name}BiasCorrelationTime'), rounded(bias.tau[0]), '[s]')
        known = [a.turn_on for a in noise.axes_of(sensor).values() if a.turn_on]
        turn_on = max((one.std for one in known), default=0.0)
        words = f'[{SI_UNITS[sensor]["B"]}]: worst scatter of the means of recordings'
        sigma = rounded(noise.options.inflate * turn_on)
        yield Entry(('plugin', f'{name}TurnOnBiasSigma'), sigma, words if known else '')


AIRSIM_TAU_S = {'gyro': 500.0, 'accel': 800.0}
"""Defaults of AirSim; only stability / sqrt(tau) matters."""


def _airsim(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the Imu settings of AirSim, whose bias is a random walk of stability / sqrt(tau)."""
    parent = ('DefaultSensors', 'Imu')
    yield Entry((*parent, 'SensorType'), 2)
    yield Entry((*parent, 'Enabled'), True)
    for sensor, white, white_unit, stability, unit in (
        ('gyro', 'AngularRandomWalk', 'deg/sqrt(h)', 'GyroBiasStability', 'deg/h'),
        ('accel', 'VelocityRandomWalk', 'mg/sqrt(Hz)', 'AccelBiasStability', 'ug'),
    ):
        yield from noise.keyed({white: (sensor, 'N')}, white_unit, parent)
        tau = AIRSIM_TAU_S[sensor]
        yield noise.entry(
            (*parent, stability),
            noise.level(sensor, 'K'),
            f'K sqrt({tau:g} s)',
            unit,
            partial(_stability, tau, UNITS[unit].factor),
        )
        yield Entry((*parent, f'{stability}Tau'), tau)


def _stability(tau: float, unit: float, walk: float, rate: float) -> float:
    return walk * math.sqrt(tau) / unit


def _gnss_ins_sim(noise: FilterNoise) -> Iterator[Entry]:
    """Yield the dictionary that gnss-ins-sim takes as the accuracy of an IMU."""
    yield from noise.keyed({'gyro_arw': ('gyro', 'N')}, 'deg/sqrt(h)')
    yield from noise.keyed({'accel_vrw': ('accel', 'N')}, 'm/s/sqrt(h)')
    for sensor, unit in (('gyro', 'deg/h'), ('accel', 'm/s^2')):
        bias = noise.process(sensor)
        yield Entry((f'{sensor}_b',), [0.0, 0.0, 0.0])
        sigma = [rounded(value / UNITS[unit].factor) for value in bias.sigma]
        words = f'[{unit}]: {bias.words}'
        yield Entry((f'{sensor}_b_stability',), sigma, words, findings=bias.findings)
        yield Entry((f'{sensor}_b_corr',), [rounded(tau) for tau in bias.tau], '[s]')


def _convention(
    text: str, three: bool = True, horizon_s: float = SIMULATOR_HORIZON_S
) -> Convention:
    return Convention(text, three, None, horizon_s, walk=False, bound=False)


SIMULATORS = {
    'gazebo': Target(
        'gazebo_imu.sdf',
        _convention(
            'standard deviation per sample, and a Gauss-Markov bias of the driving density '
            'dynamic_bias_stddev (gz-sensors, src/GaussianNoiseModel.cc)'
        ),
        _gazebo,
        XmlForm(),
        notes=(
            'put it into <sensor type="imu">; f must be its update_rate',
            'bias_stddev (turn-on bias) needs results of several recordings; precision is written '
            'where rounding makes more than a tenth of the white noise',
        ),
    ),
    'px4_sitl': Target(
        'px4_sitl_imu.xml',
        _convention(
            'continuous time; the bias is a Gauss-Markov process of this driving density '
            '(PX4-SITL_gazebo-classic and RotorS, src/gazebo_imu_plugin.cpp)',
            three=False,
        ),
        _px4_sitl,
        XmlForm(),
        notes=('copy the elements into <plugin name="gazebo_imu_plugin" ...>',),
    ),
    'airsim': Target(
        'airsim_settings.json',
        _convention(
            'white noise in deg/sqrt(h) and mg/sqrt(Hz); bias as a random walk of '
            'BiasStability / sqrt(BiasStabilityTau) (AirLib/include/sensors/imu/ImuSimple.hpp)',
            three=False,
            horizon_s=30.0,
        ),
        _airsim,
        JsonForm(),
        notes=('merge it into settings.json',),
    ),
    'gnss_ins_sim': Target(
        'gnss_ins_sim_imu.py',
        _convention(
            'deg/sqrt(h), m/s/sqrt(h), and a Gauss-Markov bias of the standard deviation '
            'b_stability (gnss_ins_sim/pathgen/pathgen.py, bias_drift; sim/imu_model.py)'
        ),
        _gnss_ins_sim,
        PythonForm(
            "imu_err['{key}'] = np.array({value})",
            before='\nimport numpy as np\n\nimu_err = {}\n',
        ),
        notes=('imu = imu_model.IMU(accuracy=imu_err, axis=6)',),
    ),
}
"""Name -> target."""
