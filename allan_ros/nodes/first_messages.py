# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures the sample rate and the mean angular rate of an IMU before a noise model is known."""

from __future__ import annotations

import math

import numpy as np

from ..core.estimate import Estimate
from ..core.imu import AXES, NANOSECONDS, SENSORS, Floats
from ..readers.cdr import MalformedMessage, decode_imus

FIRST_RATE_HZ, RATE_S = 1000.0, 1.0
"""Sample rate in Hz that is assumed for the first messages, and shortest time in s over which the
rate is measured. Covariances from a datasheet increase with the sample rate. Few IMUs are faster
than the assumed rate, so the covariances of the first messages are usually too large."""


class FirstMessages:
    """Measures the sample rate and the mean angular rate of an IMU from some of its messages.

    ``rate_hz`` is the largest sample rate in Hz, according to the stamps, in the measured periods
    of at least `RATE_S`; before the end of the first period, it is `FIRST_RATE_HZ`. ``bias`` is
    gyro axis -> mean of all processed finite angular rates in rad/s, with its standard error. The
    means are updated at the start of each period. At rest, a mean is an estimate of the bias. If
    the IMU turns, it is usually larger than the bias.
    """

    def __init__(self) -> None:
        self.rate_hz = FIRST_RATE_HZ
        self.bias: dict[str, Estimate] = {}
        # message count, and stamp in ns, at the start of the present period
        self._window: tuple[int, int] | None = None
        self._count = 0  # number of messages at the last call of `update`
        self._has_rate = False
        # number, sum and sum of squares of the processed angular rates
        self._number, self._total, self._squares = 0, np.zeros(3), np.zeros(3)

    def update(self, count: int, latest: bytes | None) -> None:
        """Process the latest message, which is None before the first message.

        ``count`` is the number of messages received so far. A malformed message is ignored.
        """
        if latest is None or count == self._count:
            return
        self._count = count
        try:
            decoded = decode_imus([latest], 'cdr')
        except MalformedMessage:
            return
        stamp = int(decoded.stamps_ns[0])
        if np.isfinite(rates := decoded.samples[0, SENSORS['gyro']]).all():
            self._add(rates)
        start_count, start_stamp = self._window or (count, stamp)
        seconds = (stamp - start_stamp) / NANOSECONDS
        # a new period begins after a jump of the stamps or a pause
        if self._window is None or not 0.0 <= seconds < 10.0 * RATE_S:
            self._window = count, stamp
        elif seconds >= RATE_S:
            rate = (count - start_count) / seconds
            self.rate_hz = max(rate, self.rate_hz) if self._has_rate else rate
            self._window, self._has_rate = (count, stamp), True
        else:
            return
        self.bias = self._mean()

    def _add(self, rates: Floats) -> None:
        self._number += 1
        self._total += rates
        self._squares += rates**2

    def _mean(self) -> dict[str, Estimate]:
        """Return gyro axis -> mean angular rate in rad/s; empty before the first finite rates."""
        if not self._number:
            return {}
        mean = self._total / self._number
        variance = np.maximum(self._squares / self._number - mean**2, 0.0) / self._number
        axes = AXES[SENSORS['gyro']]
        return {a: Estimate.normal(float(m), math.sqrt(v)) for a, m, v in zip(axes, mean, variance)}
