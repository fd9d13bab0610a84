# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Streams of samples with every kind of fault, and their results."""

import itertools

import numpy as np

from allan_ros.core.imu import LARGEST, ImuBatch
from allan_ros.core.settings import SegmenterSettings
from allan_ros.core.stream.pipeline import ImuStream

from .sums import assert_identical

PERIOD = 5_000_000
START = 10**18


def still(n, seed=0):
    """Return stamps and samples of an IMU at rest, 200 Hz."""
    noise = np.random.default_rng(seed).normal(size=(n, 6)) * 1e-3
    return START + np.arange(n) * PERIOD, noise + [0.01, 0.02, 0.03, 0.0, 0.0, 9.8]


def accumulate(times, samples, chunks=(4096,), record=None, frames=None, **settings_):
    """Return the result of a stream after samples, in chunks of the given lengths (repeated)."""
    stream, at = ImuStream(SegmenterSettings(**settings_)), 0
    frames = np.array([''] * len(times) if frames is None else frames)
    for length in itertools.cycle(chunks):
        rows = slice(at, at + length)
        other = np.flatnonzero(frames[rows] != frames[at]) if at < len(times) else []
        rows = slice(at, at + int(other[0])) if len(other) else rows
        if at >= len(times):
            break
        part = None if record is None else record[rows]
        stream.update(ImuBatch(times[rows], samples[rows], part, str(frames[at])))
        at = rows.stop
    stream.end()
    return stream.result()


def assert_same(a, b):
    assert a.health == b.health and a.findings == b.findings and a.segments == b.segments
    assert len(a.sums) == len(b.sums)
    for x, y in zip(a.sums, b.sums):
        assert_identical(x, y)


def ids(result):
    return {f.id for f in result.findings}


def assert_accounted(result):
    """Check that every received or interpolated sample is counted exactly once."""
    c = result.health.counts
    fates = c.used + c.skipped + c.other_frame + c.not_finite + c.duplicate + c.backward
    noise = c.noise_increased + c.noise_decreased
    assert c.received + c.interpolated == fates + c.untimed + c.moving + c.stuck + noise


def swing(i):
    """Return a rotation of 0.3 Hz up to 0.5 rad/s at the samples i."""
    return 0.5 * np.sin(2 * np.pi * 0.3 * i / 200)


def repeated(samples, share, rng):
    """Return samples of which a share at random repeats the previous one."""
    fresh = rng.random(len(samples)) >= share
    fresh[:1] = True
    return samples[np.maximum.accumulate(np.where(fresh, np.arange(len(samples)), 0))]


def reversed_by(i, places):
    i = i[: len(i) // places * places]
    return i // places * places + places - 1 - i % places


# name -> ids of the findings (None if they depend on chance), and a function
KEPT = {  # samples that arrive, in the order of arrival
    'nothing': ('', lambda i, g: i),
    'drops': ('interpolated', lambda i, g: i[g.random(len(i)) > 0.02]),
    'many drops': (None, lambda i, g: i[g.random(len(i)) > 0.3]),
    'gap': ('gaps', lambda i, g: np.delete(i, slice(3000, 3500))),
    'third missing': ('rate_assumed', lambda i, g: i[i % 3 != 1]),
    'swapped': ('reordered', lambda i, g: reversed_by(i, 8)),
    'late': ('reordered', lambda i, g: np.argsort(i + 20 * (g.random(len(i)) < 0.01))),
    'twice': ('duplicates', lambda i, g: np.repeat(i, 2)),
}
TIMES = {
    'jitter': (None, lambda t, i, g: np.sort(t + g.integers(-1_000_000, 1_000_000, len(t)))),
    'scatter': (None, lambda t, i, g: t + g.normal(0.0, 0.2 * PERIOD, len(t)).astype(int)),
    'disorder': (None, lambda t, i, g: t + g.integers(-6_000_000, 6_000_000, len(t))),
    'bursts': ('bursty_stamps', lambda t, i, g: START + i // 8 * 8 * PERIOD),
    'two clocks': (
        'stamps_mixed bursty_stamps backward_stamps clock_jumps rate_assumed',
        lambda t, i, g: t + (g.random(len(t)) < 0.3) * 350_000_000,
    ),
    'microseconds': ('stamps_unit', lambda t, i, g: (t + 7 * 10**17) // 1000),
    'clock back': ('clock_jumps backward_stamps', lambda t, i, g: t - (i > 4000) * 3600 * 10**9),
    'clock forth': (None, lambda t, i, g: t + (i > 4000) * 3600 * 10**9),
    'rate': ('rate_changed', lambda t, i, g: t + np.maximum(0, i - 4100) * PERIOD),
    'no stamps': ('stamps_missing nothing_left', lambda t, i, g: t * 0),
    **{
        f'since {start} ns': ('', lambda t, i, g, start=start: t - START + start)
        for start in (0, 10**9, 10**12, 10**15)
    },
}
VALUES = {
    'nan': ('not_finite', lambda x, i, g: np.where(g.random(x.shape) < 0.001, np.nan, x)),
    'impossible': (
        'not_finite',
        lambda x, i, g: np.where(g.random(x.shape) < 0.001, 1.1 * LARGEST, x),
    ),
    'nan first': (None, lambda x, i, g: np.where(i > 3000, x, np.nan)),
    'motion': ('motion', lambda x, i, g: x + g.normal(size=x.shape) * (i % 5000 < 900)),
    'shocks': ('shocks', lambda x, i, g: x + g.normal(size=x.shape) * (i % 1500 < 90)[::-1]),
    'starts in motion': (
        'relearned motion',
        lambda x, i, g: x + g.normal(size=x.shape) * (i < 4500) / 9,
    ),
    'drives first': ('motion', lambda x, i, g: x + swing(i) * (i < 7000)),
    'drives': ('never_still nothing_left', lambda x, i, g: x + swing(i)),
    'spikes': ('spikes', lambda x, i, g: x + 0.02 * (g.random(x.shape) < 0.002)),
    'noise_increased': (None, lambda x, i, g: x + 0.02 * g.normal(size=x.shape) * (i > 1500)),
    'stuck': ('stuck', lambda x, i, g: x[np.minimum(i[:, 0], 5001)]),
    'held': ('held', lambda x, i, g: np.hstack([x[:, :3], x[i[:, 0] * 5 // 8, 3:]])),
    'zero filled': ('zero_filled', lambda x, i, g: x * (i % 2 == np.arange(6) // 3)),
    'repeats': ('repeated', lambda x, i, g: repeated(x, 0.2, g)),
    'repeats of each sensor': (
        'repeated',
        lambda x, i, g: np.hstack([repeated(x[:, :3], 0.2, g), repeated(x[:, 3:], 0.5, g)]),
    ),
    'no accel': ('sensor_absent', lambda x, i, g: x * [1, 1, 1, np.nan, np.nan, np.nan]),
    'no axis': (
        'axis_absent',
        lambda x, i, g: x * [1, g.choice([np.nan, np.inf, 1e305]), 1, 1, 1, 1],
    ),
    'zero gyro': ('sensor_all_zero', lambda x, i, g: x * [0, 0, 0, 1, 1, 1]),
    'constant': ('no_noise gyro_unit accel_scale', lambda x, i, g: x * 0 + 3.0),
    # coarse sensors, by their resolution in standard deviations: equal samples are no repeats
    **{
        f'coarse {step}': ('', lambda x, i, g, lsb=step * 1e-3: np.round(x / lsb) * lsb)
        for step in (0.1, 0.5, 1.0, 2.0, 3.0)
    },
    'coarse gyro': (
        '',
        lambda x, i, g: np.hstack([np.round(200 * (x - 0.02))[:, :3] * 1e-3, x[:, 3:]]),
    ),
}
FAULTS = {**KEPT, **TIMES, **VALUES}


def faulty(name, n, seed=0):
    """Return stamps and samples of an IMU with a fault."""
    (t, x), i, rng = still(n, seed), np.arange(n), np.random.default_rng(seed + 1)
    make = FAULTS[name][1]
    if name in KEPT:
        kept = make(i, rng)
        return t[kept], x[kept]
    return (make(t, i, rng), x) if name in TIMES else (t, make(x, i[:, None], rng))
