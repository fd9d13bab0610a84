# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parsers of exported files, and the numbers that the files must contain.

The numbers are computed by hand from the coefficients of the fixed results.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from allan_ros.core.estimate import Estimate
from allan_ros.core.fit.result import SlowNoise, TemperatureModel, model_of_terms
from allan_ros.core.noise import GaussMarkov, Model, Part
from allan_ros.export import ExportOptions, make_export
from allan_ros.export.targets import TARGETS
from allan_ros.results.axis_result import AxisResult
from allan_ros.results.results import Results


def near(value: Any) -> Any:
    """Return an object that equals ``value`` to the six digits that the files contain."""
    return pytest.approx(value, rel=2e-6)


def read_yaml(text: str) -> Any:
    return yaml.safe_load(text.removeprefix('%YAML:1.0\n'))


def read_lines(text: str) -> dict[str, float]:
    """Return key -> number of a parameter file of PX4 or ArduPilot."""
    rows = [line.replace(',', '\t').split('\t') for line in text.splitlines() if line[0] != '#']
    return {
        row[-3] if len(row) > 2 else row[0]: float(row[-2 if len(row) > 2 else 1]) for row in rows
    }


def run_python(text: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(text, names)
    return names


def read_gazebo(text: str) -> dict[str, float]:
    noise = ElementTree.fromstring(text).find('angular_velocity/z/noise')
    return {element.tag: float(element.text or '') for element in noise or ()}


NODE = ('/**', 'ros__parameters')

READERS: dict[str, tuple[Callable[[str], Any], tuple[str, ...]]] = {
    'kalibr': (read_yaml, ()),
    'openvins': (read_yaml, ('imu0',)),
    'vins_fusion': (read_yaml, ()),
    'orb_slam3': (read_yaml, ()),
    'lio_sam': (read_yaml, NODE),
    'fast_lio': (read_yaml, (*NODE, 'mapping')),
    'fast_livo2': (read_yaml, ('imu',)),
    'point_lio': (read_yaml, ('mapping',)),
    'glim': (json.loads, ('sensors',)),
    'lvi_sam': (read_yaml, ('lvi_sam',)),
    'gtsam': (run_python, ()),
    'basalt': (json.loads, ('value0',)),
    'msckf_vio': (read_yaml, ('noise',)),
    'px4': (read_lines, ()),
    'ardupilot': (read_lines, ()),
    'kf_gins': (read_yaml, ('imunoise',)),
    'pyins': (run_python, ()),
    'imu_filter_madgwick': (read_yaml, NODE),
    'covariance': (read_yaml, NODE),
    'temperature': (read_yaml, ()),
    'state_space': (json.loads, ('axes', 'accel_z')),
    'gazebo': (read_gazebo, ()),
}
"""Target -> parser of its file, and the keys of the mappings that contain the numbers."""

TABLE = """
# N and K unchanged: 1e-3, 1e-5 (gyro) and 2e-3, limit 3e-5 (accelerometer)
kalibr accelerometer_noise_density 2e-3 accelerometer_random_walk 3e-5
kalibr gyroscope_noise_density 1e-3 gyroscope_random_walk 1e-5 update_rate 200
openvins accelerometer_noise_density 2e-3 accelerometer_random_walk 3e-5
openvins gyroscope_noise_density 1e-3 gyroscope_random_walk 1e-5 update_rate 200
orb_slam3 IMU.NoiseGyro 1e-3 IMU.NoiseAcc 2e-3 IMU.GyroWalk 1e-5 IMU.AccWalk 3e-5 IMU.Frequency 200
lio_sam imuAccNoise 2e-3 imuGyrNoise 1e-3 imuAccBiasN 3e-5 imuGyrBiasN 1e-5
lvi_sam imuAccNoise 2e-3 imuGyrNoise 1e-3 imuAccBiasN 3e-5 imuGyrBiasN 1e-5
msckf_vio gyro 1e-3 acc 2e-3 gyro_bias 1e-5 acc_bias 3e-5
state_space white 2e-3
# the walk of the accelerometer, over sqrt(10)
glim imu_acc_noise 2e-3 imu_gyro_noise 1e-3 imu_bias_noise 9.48683e-6
# 0.6, 0.8 and 1 times the level
basalt imu_update_rate 200 accel_noise_std 1.2e-3,1.6e-3,2e-3 gyro_noise_std 6e-4,8e-4,1e-3
basalt accel_bias_std 1.2e-5,1.6e-5,3e-5 gyro_bias_std 6e-6,8e-6,1e-5
pyins gyro_noise 6e-4,8e-4,1e-3 accel_noise 1.2e-3,1.6e-3,2e-3
pyins gyro_bias_walk 6e-6,8e-6,1e-5 accel_bias_walk 1.2e-5,1.6e-5,3e-5
# their squares
gtsam accelerometerCovariance 1.44e-6,2.56e-6,4e-6 gyroscopeCovariance 3.6e-7,6.4e-7,1e-6
gtsam biasAccCovariance 1.44e-10,2.56e-10,9e-10 biasOmegaCovariance 3.6e-11,6.4e-11,1e-10
# 1e-3 rad/sqrt(s) is 180/pi 60 times that in deg/sqrt(h), 3.43775; 2e-3 m/s/sqrt(s) is 0.12
# m/s/sqrt(h). The bias is tested elsewhere.
kf_gins arw 2.06265,2.75020,3.43775 vrw 0.072,0.096,0.12
# times sqrt(200) = 14.1421; squares times and over 200
vins_fusion acc_n 0.0282843 gyr_n 0.0141421 acc_w 4.24264e-4 gyr_w 1.41421e-4
gazebo stddev 0.0141421 mean 0
fast_lio acc_cov 8e-4 gyr_cov 2e-4 b_acc_cov 1.8e-7 b_gyr_cov 2e-8
fast_livo2 gyr_cov 2e-4 acc_cov 8e-4
point_lio imu_meas_omg_cov 2e-4 imu_meas_acc_cov 8e-4
point_lio gyr_cov_input 2e-4 acc_cov_input 8e-4 b_gyr_cov 2e-8 b_acc_cov 1.8e-7
covariance angular_velocity_covariance 7.2e-5,0,0,0,1.28e-4,0,0,0,2e-4
covariance linear_acceleration_covariance 2.88e-4,0,0,0,5.12e-4,0,0,0,8e-4
# times sqrt(100), the step of EKF2; times sqrt(1 / 0.012) = 9.12871, the step of EK3
px4 EKF2_GYR_NOISE 0.01 EKF2_ACC_NOISE 0.02 EKF2_GYR_B_NOISE 1e-4 EKF2_ACC_B_NOISE 3e-4
ardupilot EK3_GYRO_P_NSE 9.12871e-3 EK3_ACC_P_NSE 0.0182574
ardupilot EK3_GBIAS_P_NSE 9.12871e-5 EK3_ABIAS_P_NSE 2.73861e-4
# -1e-5, times 0.6, 0.8 and 1; 1e-7 for each
temperature reference 25 gyro_b0 6e-4,8e-4,1e-3
temperature gyro_b1 -6e-6,0,-1e-5 gyro_b2 1e-7,0,1e-7
temperature accel_b1 -6e-6,-8e-6,-1e-5 accel_b2 1e-7,1e-7,1e-7
# sqrt(3/4 (1e-6/10 + 0.441271 1e-8 + 1e-10 10/3)) and sqrt(3/4) 1e-5 / sqrt(10)
imu_filter_madgwick gain 2.80285e-4 zeta 2.73861e-6
"""


def _expected() -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {name: {} for name in READERS}
    for line in re.findall(r'(?m)^\w.*', TABLE):
        name, *words = line.split()
        for key, value in zip(words[::2], words[1::2]):
            parts = [float(part) for part in value.split(',')]
            found[name][key] = parts if len(parts) > 1 else parts[0]
    return found


EXPECTED = _expected()
"""Target -> key -> number, or three numbers of x, y, z."""

FIXED = {
    *(key.name for target in TARGETS.values() for key in target.keys if key.what == 'rate'),
    *EXPECTED['temperature'],
}
"""Entries that are not noise levels."""


def warmed(results: Results, shares: Sequence[float] = (0.6, 0.8, 1.0)) -> Results:
    """Return the results with a known bias over temperature of each axis."""
    hidden = Estimate(None, None, 1e-5, 'not_observable')
    slow = SlowNoise(hidden, hidden)
    axes = {}
    for i, (name, axis) in enumerate(results.axes.items()):
        b0, b1 = 1e-3 * shares[i % 3], -1e-5 * shares[i % 3]
        ends = [(value - 2e-6, value + 2e-6) for value in (b0, b1, 1e-7, 0.0)]
        values = b0, ends[0], b1, ends[1], 1e-7, ends[2], 0.0, ends[3]
        model = TemperatureModel(25.0, 20.0, 40.0, *values, 0.01, i != 1, 0.5, 10.0, slow, slow)
        axes[name] = replace(axis, temperature=model)
    return replace(results, axes=axes)


def numbers(results: Results, name: str, **options: Any) -> dict[str, Any]:
    """Return the numbers of an exported file as its reader parses them.

    The default is the file of the coefficients as measured.
    """
    options = {'fidelity': 'coefficients', **options}
    read, path = READERS[name]
    found = read(make_export(results, name, ExportOptions(**options)).text)
    for key in path:
        found = found[key]
    return found


def refitted(
    result: AxisResult, noise: Mapping[str, Estimate], processes: Sequence[Part] | None = None
) -> AxisResult:
    """Return the result of an axis with these coefficients replaced, and with these processes."""
    noise = {**result.fit.noise, **noise}
    parts = result.fit.model.shaped.parts if processes is None else processes
    model = Model((*model_of_terms(noise).parts, *parts))
    return replace(result, fit=replace(result.fit, noise=noise, model=model))


def with_coefficient(results: Results, axis: str, term: str, coefficient: Estimate) -> Results:
    changed = refitted(results.axes[axis], {term: coefficient})
    return replace(results, axes={**results.axes, axis: changed})


def scaled(results: Results, factor: float, axis: str = 'gyro_z') -> Results:
    """Return the results with N of one axis changed by a factor."""
    n = results.axes[axis].fit.noise['N']
    low, high = n.ci95
    changed = Estimate(n.value * factor, (low * factor, high * factor))
    return with_coefficient(results, axis, 'N', changed)


def with_process(results: Results, axis: str, sigma: float, hours: float) -> Results:
    """Return the results with a Gauss-Markov process of ``sigma`` and ``hours`` added to one
    axis.
    """
    seconds = 3600.0 * hours
    ends = ((0.8 * seconds, 1.3 * seconds),)
    part = Part(GaussMarkov(seconds), sigma, (0.9 * sigma, 1.1 * sigma), ends)
    changed = refitted(results.axes[axis], {}, [part])
    return replace(results, axes={**results.axes, axis: changed})
