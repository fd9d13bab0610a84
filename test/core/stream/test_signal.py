# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The envelope of a signal: exact for any chunking, with a limited number of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.signal import MAX_BINS, SignalEnvelope, summarize_signal


def batch_of(samples: np.ndarray, period_ns: int = 10_000_000) -> ImuBatch:
    return ImuBatch(np.arange(len(samples), dtype=np.int64) * period_ns, samples)


def envelope_of(batch: ImuBatch, chunk: int) -> SignalEnvelope:
    envelope = SignalEnvelope()
    for at in range(0, len(batch), chunk):
        envelope.update(batch[at : at + chunk])
    return envelope


@pytest.mark.parametrize('n', [1, 2, MAX_BINS - 1, MAX_BINS, MAX_BINS + 1, 9 * MAX_BINS + 5])
def test_each_span_holds_the_extremes_of_its_samples(n: int) -> None:
    samples = np.random.default_rng(n).normal(size=(n, 6))
    envelope = envelope_of(batch_of(samples), 1000)
    step = 1
    while -(-n // step) > MAX_BINS:
        step *= 2
    parts = [samples[at : at + step] for at in range(0, n, step)]
    known = envelope.statistics()
    assert np.array_equal(known['low'], [part.min(axis=0) for part in parts])
    assert np.array_equal(known['high'], [part.max(axis=0) for part in parts])
    assert np.allclose(known['total'], [part.sum(axis=0) for part in parts], atol=1e-9)
    squares = np.diff(samples, axis=0, prepend=samples[:1]) ** 2  # 0 before the first sample
    sums = [squares[at : at + step].sum(axis=0) for at in range(0, n, step)]
    assert np.allclose(known['square'], sums, atol=1e-9)
    assert known['count'].sum() == samples.size and known['pairs'].sum() == samples.size - 6
    assert np.allclose(envelope.time_s, np.arange(0, n, step) * 0.01, rtol=0, atol=1e-9)


@given(chunk=st.integers(1, 6000), n=st.integers(1, 12_000))
def test_chunking_does_not_change_the_result(chunk: int, n: int) -> None:
    batch = batch_of(np.random.default_rng(n).normal(size=(n, 6)))
    one, other = envelope_of(batch, n), envelope_of(batch, chunk)
    for name, values in one.statistics().items():
        assert np.allclose(values, other.statistics()[name], rtol=1e-12, atol=1e-9), name
    assert np.array_equal(one.time_s, other.time_s)


def test_absent_values_stay_absent_and_gaps_are_skipped() -> None:
    samples = np.ones((4 * MAX_BINS, 6))
    samples[:, 3:] = np.nan
    samples[7, 0] = np.nan
    envelope = envelope_of(batch_of(samples), 777)
    known = envelope.statistics()
    assert np.all(known['low'][:, :3] == 1.0)
    assert np.all(np.isnan(known['high'][:, 3:]))


def test_constant_stamps_are_replaced_by_record_times() -> None:
    n = 100
    record = np.arange(n, dtype=np.int64) * 10**9
    envelope = SignalEnvelope()
    envelope.update(ImuBatch(np.zeros(n, np.int64), np.zeros((n, 6)), record))
    assert envelope.time_s[-1] == 99.0


def test_the_accelerometer_of_another_topic_with_equal_stamps_keeps_its_bins() -> None:
    samples = np.random.default_rng(0).normal(size=(2 * MAX_BINS + 10, 6))
    gyro, accel = envelope_of(batch_of(samples), 999), envelope_of(batch_of(2.0 * samples), 999)
    joined, alone = gyro.with_accel(accel).statistics(), accel.statistics()
    for name in ('low', 'high', 'total', 'count'):
        assert np.array_equal(joined[name][:, 3:], alone[name][:, 3:]), name


@pytest.mark.parametrize('n', [2, 3, 7])
def test_a_short_recording_between_long_recordings_keeps_the_common_time_axis(n: int) -> None:
    numbers = [4 * MAX_BINS, n, 4 * MAX_BINS]
    signals = [envelope_of(batch_of(np.ones((number, 6))), 4096) for number in numbers]
    summary = summarize_signal(signals, [], 100)
    assert summary is not None and len(summary.starts) == 3
    assert (np.diff(summary.time_s) > 0.0).all()
    # a recording is at most as long as its samples and an incomplete group of bins
    assert summary.starts[2] - summary.starts[1] <= 1.5 * n * 0.01 + 1e-9
