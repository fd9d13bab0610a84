# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Limits are in seconds: the sample rate of an IMU does not change what is found."""

from functools import lru_cache

import numpy as np
import pytest
from support.streams import START, accumulate

from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.stream.motion import WINDOW_S
from allan_ros.core.stream.pipeline import ImuStream

RATES = (20, 200, 2000, 20_000)
DENSITY = np.array([1e-4] * 3 + [2e-3] * 3)
LEVEL = np.array([0.01, -0.02, 0.0, 0.1, 0.0, 9.8])


@lru_cache
def found(rate):
    """Return the findings, the events and the segments of one minute and a half."""
    n = 90 * rate
    t = np.arange(n) / rate
    x = LEVEL + DENSITY * rate**0.5 * np.random.default_rng(rate).standard_normal((n, 6))
    # of a hand: 1 s and 3 s long, back at the same place, and 14 s long, with another tilt
    for begin, length in ((30.2, 1.0), (38.3, 3.0), (50.1, 14.0)):
        inside = (t >= begin) & (t < begin + length)
        phase = 2 * np.pi * np.round(1.5 * length + 1) * (t[inside] - begin) / length
        x[inside] += np.outer(np.sin(phase), [0.3, 0.2, 0.1, 3.0, 2.0, 1.0])
    x[t >= 64.1] += [0.0, 0.0, 0.0, 0.3, 0.0, 0.0]
    frozen = slice(round(75 * rate), round(78 * rate))
    x[frozen, 4] = x[frozen.start, 4]
    kept = (t < 45.0) | (t >= 45.5)  # a gap
    times = START + np.rint(np.arange(n) * 1e9 / rate).astype(np.int64)
    result = accumulate(times[kept], x[kept], (1 << 16,))
    since = [(event.kind, (event.start_ns - START) * 1e-9) for event in result.health.events]
    ends = [s + e.duration_s for (_, s), e in zip(since, result.health.events)]
    return result, since, ends


@pytest.mark.parametrize('rate', RATES)
def test_a_scenario_gives_the_same_findings_at_every_rate(rate):
    result, events, ends = found(rate)
    window = max(WINDOW_S, 16 / rate)  # a window has at least 16 samples
    kinds = ['shock', 'shock', 'motion', 'stuck']
    assert [kind for kind, _ in events] == kinds
    starts = [time for _, time in events]
    assert starts == pytest.approx([30.2, 38.3, 50.1, 75.0], abs=2 * window)
    assert ends == pytest.approx([31.2, 41.3, 64.1, 78.0], abs=2 * window)
    assert {f.id for f in result.findings} == {'gaps', 'shocks', 'motion', 'tilted', 'stuck'}
    segments = [(s.start_ns - START) * 1e-9 for s in result.segments]
    # 2 s after a motion are not used
    assert segments == pytest.approx([0.0, 45.5, 66.1, 80.0], abs=2 * window)
    assert [s.cut for s in result.segments] == ['', 'gap', 'motion', 'stuck']
    (sums,) = result.sums
    assert sums.axes == AXES
    # 1000 samples at 20 Hz: sd of the variance is 5.5 %, 5 sigma: false alarm 6e-7
    assert sums.avar[0] / (DENSITY**2 * rate) == pytest.approx(1.0, abs=0.28)


@pytest.mark.parametrize('rate', [20, 50, 100, 1000])
def test_a_rate_is_known_after_the_same_time(rate):
    """This is 11 s or 256 samples, whichever is longer, but at most 1024 samples."""
    n = 40 * rate
    x = LEVEL + DENSITY * rate**0.5 * np.random.default_rng(rate).standard_normal((n, 6))
    stream, known = ImuStream(), []
    times = START + np.arange(n) * (10**9 // rate)
    for at in range(0, n, rate):
        stream.update(ImuBatch(times[at : at + rate], x[at : at + rate]))
        known.append(stream._present.sensors != ())
    assert known.index(True) + 1 <= 13
