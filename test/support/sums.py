# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of samples, and their comparison bit for bit."""

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.imu import ImuIdentity

TICK_NS = 10_000_000


def feed(engine, samples, chunks=None, first=0):
    """Pass samples to the engine in chunks of the given lengths (repeated), with stamps every 10
    ms.
    """
    at = 0
    for i in range(len(samples)):
        if at >= len(samples):
            return
        size = len(samples) if chunks is None else max(1, chunks[i % len(chunks)])
        part = samples[at : at + size]
        start = first + at * TICK_NS
        engine.update(part, start, start + (len(part) - 1) * TICK_NS)
        at += size


def sums_of(samples, chunks=None, cuts=(), axes=None):
    """Return the sums of samples that are split into segments at the given rows."""
    axes = axes or tuple(f'axis_{i}' for i in range(samples.shape[1]))
    engine = RunningSums(ImuIdentity('imu'), axes)
    at = 0
    for cut in (*sorted(cuts), len(samples)):
        feed(engine, samples[at:cut], chunks, at * TICK_NS)
        engine.end_segment()
        at = cut
    return engine.sums


def assert_identical(a: AllanSums, b: AllanSums) -> None:
    """Check that all numbers of the two are equal, bit for bit."""
    assert a == b
