# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A fixed results document with levels that are easy to compute by hand."""

from __future__ import annotations

import json

import pytest
from support.exports import warmed

from allan_ros.core.estimate import Estimate
from allan_ros.core.fit.result import AxisFit, model_of_terms
from allan_ros.core.imu import AXES, ImuIdentity
from allan_ros.core.stream.health import Segment
from allan_ros.readers import SourceInfo
from allan_ros.readers.files import to_json
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.axis_result import AxisResult
from allan_ros.results.documents import results_from_document, results_to_document
from allan_ros.results.results import Results

RATE = 200.0
SHARES = {'x': 0.6, 'y': 0.8, 'z': 1.0}
"""Level of each axis relative to its sensor: z is the worst."""

LEVELS = {'gyro': {'N': 1e-3, 'B': 1e-4, 'K': 1e-5}, 'accel': {'N': 2e-3, 'B': 3e-4, 'K': 2e-5}}
"""In SI. K of accel_z is not resolved and its limit is 3e-5."""

START_NS = 1_700_000_000 * 10**9
"""2023-11-14 22:13:20 UTC."""


def measured(value: float) -> Estimate:
    return Estimate(value, (0.9 * value, 1.1 * value), 1.08 * value)


def hidden(limit: float) -> Estimate:
    return Estimate(None, None, limit, 'not_observable')


def axis_fit(axis: str) -> AxisFit:
    sensor, letter = axis.split('_')
    noise = {term: measured(v * SHARES[letter]) for term, v in LEVELS[sensor].items()}
    if axis == 'accel_z':
        noise['K'] = hidden(3e-5)
    noise = {'Q': hidden(1e-7), 'R': hidden(1e-8), **noise}
    return AxisFit(noise, model_of_terms(noise))


@pytest.fixture(scope='session')
def known_results() -> Results:
    """Return the fixed results, as read from their document."""
    source = SourceInfo('runs/one.mcap', '/imu/data', 'sensor_msgs/msg/Imu', 'mcap')
    results = Results(
        ImuIdentity('imu_link', ''),
        'likelihood',
        1.0 / RATE,
        1_440_000,
        7200.0,
        1,
        {axis: AxisResult(1.0 / RATE, axis_fit(axis)) for axis in AXES},
        Provenance((source,), (Segment(START_NS, 1_440_000, 7200.0),)),
        (),
    )
    return results_from_document(json.loads(to_json(results_to_document(warmed(results)))))
