# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a simulated recording, and presets of sensors; `core.simulate` applies them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .errors import AllanError
from .settings import check, parameter


@dataclass(frozen=True)
class Faults:
    """Faults of a simulated IMU; none by default.

    Raises
    ------
    AllanError
        When a value lies outside its range.
    """

    warmup_gyro: float = parameter(
        0.0, 'offset at the start that decays as the sensor warms up', unit='rad/s'
    )
    warmup_accel: float = parameter(
        0.0, 'offset at the start that decays as the sensor warms up', unit='m/s^2'
    )
    warmup_time: float = parameter(
        300.0, 'time in which the warm-up offset decays to 1/e', unit='s', low=1e-3
    )
    gauss_markov_gyro: float = parameter(
        0.0, 'standard deviation of an added Gauss-Markov noise', unit='rad/s', low=0.0
    )
    gauss_markov_accel: float = parameter(
        0.0, 'standard deviation of an added Gauss-Markov noise', unit='m/s^2', low=0.0
    )
    gauss_markov_time: float = parameter(
        300.0, 'correlation time of the added Gauss-Markov noise', unit='s', low=1e-6
    )
    vibration_gyro: float = parameter(
        0.0, 'amplitude of a vibration line on each gyro axis', unit='rad/s', low=0.0
    )
    vibration_accel: float = parameter(
        0.0, 'amplitude of a vibration line on each accelerometer axis', unit='m/s^2', low=0.0
    )
    vibration_frequency: float = parameter(
        1.0, 'frequency of the vibration line', unit='Hz', low=1e-9
    )
    bumps: int = parameter(0, 'how many knocks, at random times', low=0)
    bump_gyro: float = parameter(0.5, 'first amplitude of a knock', unit='rad/s', low=0.0)
    bump_accel: float = parameter(5.0, 'first amplitude of a knock', unit='m/s^2', low=0.0)
    bump_frequency: float = parameter(8.0, 'ringing of a knock', unit='Hz', low=1e-9)
    bump_decay: float = parameter(
        0.2, 'time in which the ringing decays to 1/e', unit='s', low=1e-6
    )
    motion: tuple[tuple[float, float], ...] = parameter(
        (), 'periods of motion, each (start, length)', unit='s'
    )
    motion_gyro: float = parameter(0.5, 'amplitude of the motion', unit='rad/s', low=0.0)
    motion_accel: float = parameter(1.0, 'amplitude of the motion', unit='m/s^2', low=0.0)
    low_pass: float = parameter(
        0.0, 'corner of a first-order low-pass filter in the sensor; 0: none', unit='Hz', low=0.0
    )
    accel_rate: float = parameter(
        0.0,
        'rate at which the accelerometer is read; samples are repeated in between; 0: every sample',
        unit='Hz',
        low=0.0,
    )
    lsb_gyro: float = parameter(0.0, 'step of the gyro values; 0: none', unit='rad/s', low=0.0)
    lsb_accel: float = parameter(
        0.0, 'step of the accelerometer values; 0: none', unit='m/s^2', low=0.0
    )
    gaps: tuple[tuple[float, float], ...] = parameter(
        (), 'periods without samples, each (start, length)', unit='s'
    )
    drop: float = parameter(0.0, 'probability that a sample is lost', low=0.0, high=1.0)
    jitter: float = parameter(
        0.0, 'standard deviation of the stamps about the true times', unit='s', low=0.0
    )
    burst: float = parameter(
        0.0,
        'longest silence of a host that reads samples in bursts and stamps them then; 0: none',
        unit='s',
        low=0.0,
    )

    def __post_init__(self) -> None:
        check(self)
        for name in ('motion', 'gaps'):
            for start, length in getattr(self, name):
                if not (start >= 0.0 and length > 0.0):
                    raise AllanError(
                        f'{name}: a period of {length} s at {start} s: give a start of at least 0 '
                        'and a positive length'
                    )


PRESETS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    # Gyro: Cong, Wang, Yan 2019, table 1, the ADIS16475-3 they measured. Accelerometer: B such that
    # the curve's minimum, 0.664 B, is the 3.6 ug of the ADIS16475 data sheet (Rev. D, features);
    # its N, in no source at hand, is one usual for its class.
    'paper': {
        'gyro_x': {'Q': 0.138, 'N': 0.242, 'B': 5.237, 'K': 31.807, 'R': 76.242},
        'gyro_y': {'Q': 0.124, 'N': 0.168, 'B': 4.972, 'K': 8.169, 'R': 11.068},
        'gyro_z': {'Q': 0.100, 'N': 0.245, 'B': 6.058, 'K': 50.568, 'R': 66.250},
        'accel_x': {'N': 0.012, 'B': 5.42},
        'accel_y': {'N': 0.012, 'B': 5.42},
        'accel_z': {'N': 0.012, 'B': 5.42},
    },
}
"""name -> axis -> term -> coefficient in the unit of `imu.DATASHEET_UNITS`."""
