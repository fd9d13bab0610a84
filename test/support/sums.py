# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of samples, and their comparison bit for bit."""

import numpy as np

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.imu import ImuIdentity

TICK_NS = 10_000_000


def feed(running, samples, chunks=None, first=0, interpolated=None):
    """Pass samples in chunks of the given lengths (repeated), with stamps every 10 ms."""
    at = i = 0
    while at < len(samples):
        size = len(samples) if chunks is None else max(1, chunks[i % len(chunks)])
        part = samples[at : at + size]
        start = (first + at) * TICK_NS
        mask = None if interpolated is None else interpolated[at : at + size]
        running.update(part, start, start + (len(part) - 1) * TICK_NS, mask)
        at, i = at + size, i + 1


def sums_of(samples, chunks=None, cuts=(), axes=None, interpolated=None):
    """Return the sums of samples that are split into segments at the given rows."""
    axes = axes or tuple(f'axis_{i}' for i in range(samples.shape[1]))
    running = RunningSums(ImuIdentity('imu'), axes)
    at = 0
    for cut in (*sorted(cuts), len(samples)):
        mask = None if interpolated is None else interpolated[at:cut]
        feed(running, samples[at:cut], chunks, at, mask)
        running.end_segment()
        at = cut
    return running.sums


def noise(n, seed=0, axes=2):
    """Return white noise with a random walk, (n, axes), near 9.8."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, axes)) + 0.01 * rng.normal(size=(n, axes)).cumsum(axis=0) + 9.8


def assert_identical(a: AllanSums, b: AllanSums) -> None:
    """Check that all numbers of the two are equal, bit for bit."""
    assert a == b
