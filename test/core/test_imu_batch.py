# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches are equal if their samples are equal."""

import numpy as np

from allan_ros.core.imu import ImuBatch


def test_batches_compare_by_value():
    stamps, samples = np.arange(3), np.full((3, 6), np.nan)
    samples[:, 0] = [1.0, 2.0, 3.0]
    a = ImuBatch(stamps, samples)
    assert a == ImuBatch(stamps.copy(), samples.copy()) and a != 'a batch'
    assert a[:2] != a and a[1:] != a[:2]
    assert a != ImuBatch(stamps, samples, frame_id='other')
    recorded = ImuBatch(stamps, samples, stamps + 5)
    assert a != recorded and recorded == ImuBatch(stamps, samples, stamps + 5)
    assert recorded != ImuBatch(stamps, samples, stamps + 6)
