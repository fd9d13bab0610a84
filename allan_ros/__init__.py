# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures the noise of an IMU: Allan sums, five coefficients, honest intervals."""

__version__ = '0.1.0'
