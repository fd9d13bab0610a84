# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of two IMUs are told from coarse samples of one."""

import numpy as np
import pytest

from allan_ros.core.stream.sensors import are_interleaved


@pytest.mark.parametrize('step', [0.5, 1.0, 2.0, 3.0, 4.0, 6.0])
@pytest.mark.parametrize('mean', [0.0, 0.25, 0.5])
def test_coarse_samples_are_not_those_of_two_imus(step, mean):
    noise = np.random.default_rng(1).standard_normal((6, 2000))
    of_two = noise + 30.0 * (np.random.default_rng(2).random(2000) < 0.5)
    assert not are_interleaved(np.round(noise / step + mean) * step)
    assert are_interleaved(np.round(of_two / step + mean) * step)
