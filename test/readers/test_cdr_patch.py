# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Patched messages: only the two covariances change."""

from __future__ import annotations

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.imu import ImuBatch
from allan_ros.readers.cdr import (
    CovariancePatch,
    MalformedMessage,
    encode_imus,
    frame_id_of,
    imu_dtype,
)

GYRO, ACCEL = (1e-6, 2e-6, 3e-6), (4e-4, 5e-4, 6e-4)
BOTH = {'gyro': GYRO, 'accel': ACCEL}


def message(frame_id: str = 'imu_link', order: str = '<', absent: slice | None = None) -> bytes:
    samples = np.arange(1.0, 7.0)[None] * 1e-3
    if absent is not None:
        samples[:, absent] = np.nan
    batch = ImuBatch(np.array([123_456_789_012]), samples, frame_id=frame_id)
    return bytes(encode_imus(batch, 'cdr', order)[0])


def view(payload: bytes | bytearray, frame_id: str = 'imu_link', order: str = '<') -> np.ndarray:
    dtype = imu_dtype('cdr', order, len(frame_id.encode()) + 1, len(payload))
    return np.frombuffer(payload, dtype)


def with_covariance(payload: bytes, sensor: str, value: float, at: int = 0) -> bytes:
    changed = bytearray(payload)
    view(changed)[f'{sensor}_covariance'][0, at] = value
    return bytes(changed)


@given(st.text(max_size=30), st.sampled_from('<>'), st.binary(max_size=5))
def test_only_the_two_covariances_change(frame_id, order, padding):
    payload = message(frame_id, order) + padding
    patched = CovariancePatch(BOTH).patch(payload)
    assert len(patched) == len(payload)
    before, after = (view(p, frame_id, order) for p in (payload, patched))
    np.testing.assert_array_equal(after['gyro_covariance'][0].reshape(3, 3), np.diag(GYRO))
    np.testing.assert_array_equal(after['accel_covariance'][0].reshape(3, 3), np.diag(ACCEL))
    changed = {i for i, (a, b) in enumerate(zip(payload, patched)) if a != b}
    fields = before.dtype.fields
    allowed = {
        i
        for name in ('gyro_covariance', 'accel_covariance')
        for i in range(fields[name][1], fields[name][1] + 72)
    }
    assert changed and changed <= allowed


def test_an_absent_sensor_stays_absent_even_when_overwriting():
    payload = message(absent=slice(0, 3))
    for overwrite in (False, True):
        after = view(CovariancePatch(BOTH, overwrite).patch(payload))
        assert after['gyro_covariance'][0].tolist() == [-1.0] + [0.0] * 8
        assert after['accel_covariance'][0, 4] == 5e-4
        nan = with_covariance(message(), 'gyro', np.nan)
        assert np.isnan(view(CovariancePatch(BOTH, overwrite).patch(nan))['gyro_covariance'][0, 0])


@pytest.mark.parametrize('at', range(9))
def test_a_covariance_of_the_driver_is_kept_unless_overwritten(at):
    payload = with_covariance(message(), 'accel', 0.25, at)
    kept = view(CovariancePatch(BOTH).patch(payload))
    assert kept['accel_covariance'][0, at] == 0.25 and kept['gyro_covariance'][0, 0] == 1e-6
    overwritten = view(CovariancePatch(BOTH, overwrite=True).patch(payload))
    assert overwritten['accel_covariance'][0].tolist() == np.diag(ACCEL).ravel().tolist()


def test_messages_with_nothing_to_fill_are_returned_unchanged():
    payload = message()
    assert CovariancePatch({}).patch(payload) is payload
    assert CovariancePatch(BOTH, frame_id='other').patch(payload) is payload
    assert CovariancePatch(BOTH, frame_id='imu_link').patch(payload) is not payload
    full = CovariancePatch(BOTH).patch(payload)
    assert CovariancePatch(BOTH).patch(full) is full
    assert CovariancePatch(BOTH, overwrite=True).patch(full) == full


def test_one_sensor_can_be_left_and_negative_zeros_are_zeros():
    payload = with_covariance(message(), 'accel', -0.0)
    after = view(CovariancePatch({'accel': ACCEL}).patch(payload))
    assert not after['gyro_covariance'].any() and after['accel_covariance'][0, 8] == 6e-4


def test_invalid_imu_messages_are_rejected():
    whole = message()
    endless = bytearray(whole)
    struct.pack_into('<I', endless, 12, 0xFFFFFFF0)
    longer = bytearray(whole)
    struct.pack_into('<I', longer, 12, 60)
    xcdr2 = b'\0\x07' + whole[2:]
    for bad in (b'', b'\0', whole[:8], whole[:-1], bytes(endless), bytes(longer), xcdr2, b'\7' * 9):
        with pytest.raises(MalformedMessage):
            CovariancePatch(BOTH).patch(bad)
        with pytest.raises(MalformedMessage):
            frame_id_of(bad)


@given(st.binary(max_size=400))
def test_any_bytes_are_patched_or_rejected(payload):
    with contextlib.suppress(MalformedMessage):
        assert len(CovariancePatch(BOTH).patch(payload)) == len(payload)


def test_the_frame_is_read():
    assert frame_id_of(message('bäse/imu', '>')) == 'bäse/imu'
    assert frame_id_of(message('')) == ''
