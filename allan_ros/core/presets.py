# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""IMUs worth simulating by name; needs only the standard library."""

from __future__ import annotations

from collections.abc import Mapping

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
"""name -> axis -> term -> coefficient in the unit of `units.DATASHEET_UNITS`."""
