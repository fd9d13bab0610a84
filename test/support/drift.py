# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of a simulated gyro, with an effect added."""

import numpy as np

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.noise import NoiseTerms
from allan_ros.core.simulate import simulate_axis

SENSORS = ((0, 1, 2),)
AXES = ('gyro_x', 'gyro_y', 'gyro_z')
DEG_H = np.pi / 180 / 3600
NOISE = NoiseTerms(N=0.242 * np.pi / 180 / 60, B=5.2 * DEG_H)
SECONDS = 7200


def sums_of_noise(terms, seed, seconds=SECONDS, early=0.0, rate=1.0):
    """Return the sums of three axes of noise with an early part added.

    Samples are simulated at 1 Hz and get stamps at ``rate``.
    """
    rng = np.random.default_rng(seed)
    y = np.stack([simulate_axis(seconds, 1.0, terms, rng) for _ in AXES], axis=1)
    engine = RunningSums(axes=AXES)
    y += np.reshape(early, (-1, 1))
    engine.update(y, 0, round((seconds - 1) * 1e9 / rate))
    engine.end_segment()
    return engine.sums
