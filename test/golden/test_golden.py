# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every number of several recordings is as stored (``make golden`` stores them)."""

from __future__ import annotations

import math

import pytest
from golden.harness import RECORDINGS, Difference, differences, measure, read


@pytest.mark.parametrize('name', RECORDINGS)
def test_results_are_as_stored(name: str) -> None:
    if not RECORDINGS[name].is_present:
        pytest.skip('skipped: no shared data')
    changed = differences(read(name), measure(name))
    listed = '\n'.join(map(str, changed[:40]))
    assert not changed, f'{len(changed)} differences; the first:\n{listed}'


def test_differences_name_the_path_and_both_values() -> None:
    before = {'a/N': [1.0, 2.0], 'a/growth/1 s': [1.0], 'gone': ['x'], 'level': 'healthy'}
    after = {'a/N': [1.0, 2.1], 'a/growth/1 s': [1.0005], 'level': 'failed', 'new': [3.0]}
    assert differences(before, before) == []
    assert differences(before, after) == [
        Difference('a/N', 2.0, 2.1, pytest.approx(0.1 / 2.1)),
        Difference('gone', ['x'], 'absent'),
        Difference('level', 'healthy', 'failed'),
        Difference('new', 'absent', [3.0]),
    ]
    measured = {'axes/gyro_x/curve/adev': [1.0]}, {'axes/gyro_x/curve/adev': [1.0 + 2e-9]}
    fitted = {'axes/gyro_x/N': [1.0]}, {'axes/gyro_x/N': [1.0 + 2e-6]}
    assert differences(*measured) and differences(*fitted, strict=True)
    assert differences(*fitted) == []
    assert differences({'a': [1.0]}, {'a': ['nan']}) == [Difference('a', 1.0, 'nan', math.inf)]
    assert differences({'a': [1.0], 'status/imu/level': [0.0]}, {'a': [1.0]}) == []  # without ROS
