# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of CDR messages: equal to rosbags' own (de)serializer, message by message."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allan_ros.core.imu import ImuBatch
from allan_ros.readers.cdr import IMU_TYPE, MalformedMessage, decode_imus, encode_imus

rosbags_typesys = pytest.importorskip('rosbags.typesys')
ROS2 = rosbags_typesys.get_typestore(rosbags_typesys.Stores.ROS2_HUMBLE)
ROS1 = rosbags_typesys.get_typestore(rosbags_typesys.Stores.ROS1_NOETIC)
NEVER_NS = 2**31 * 10**9

# (stamps, samples, frames, which messages are big-endian)
messages = st.integers(1, 12).flatmap(
    lambda n: st.tuples(
        arrays(np.int64, n, elements=st.integers(0, NEVER_NS - 1)),
        arrays(np.float64, (n, 6), elements=st.floats(allow_nan=False)),
        st.lists(
            st.text(st.characters(exclude_characters='\0', codec='utf-8'), max_size=20),
            min_size=n,
            max_size=n,
        ),
        st.lists(st.booleans(), min_size=n, max_size=n),
    )
)


def reference(store: Any, encoding: str, payload: bytes) -> tuple[int, list[float], str]:
    """Return stamp, axes and frame of one message as rosbags reads it."""
    deserialize = store.deserialize_ros1 if encoding == 'ros1' else store.deserialize_cdr
    imu = deserialize(payload, IMU_TYPE)
    rate, force = imu.angular_velocity, imu.linear_acceleration
    axes = [rate.x, rate.y, rate.z, force.x, force.y, force.z]
    stamp = imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec
    return stamp, axes, imu.header.frame_id


@settings(max_examples=60, deadline=None)
@given(messages)
@pytest.mark.parametrize('encoding', ['cdr', 'ros1'])
def test_any_mixture_decodes_as_rosbags_does(encoding: Any, drawn: Any) -> None:
    stamps, samples, frames, big = drawn
    payloads = []
    for row, frame in enumerate(frames):
        order = '>' if big[row] and encoding == 'cdr' else '<'
        one = ImuBatch(stamps[row : row + 1], samples[row : row + 1], None, frame)
        payloads += [bytes(payload) for payload in encode_imus(one, encoding, order)]
    decoded = decode_imus(payloads, encoding)
    np.testing.assert_array_equal(decoded.stamps_ns, stamps)
    np.testing.assert_array_equal(decoded.samples, samples)
    assert [decoded.frame_ids[code] for code in decoded.frames] == frames
    store = ROS1 if encoding == 'ros1' else ROS2
    for row, payload in enumerate(payloads):
        stamp, axes, frame = reference(store, encoding, payload)
        assert (stamp, frame) == (stamps[row], frames[row])
        np.testing.assert_array_equal(axes, samples[row])


def imu_message(store: Any, covariance: float) -> Any:
    """Return an Imu of rosbags whose gyro covariance begins with that number."""
    types = store.types
    vector = types['geometry_msgs/msg/Vector3'](1.0, 2.0, 3.0)
    zeros = np.zeros(9)
    return types[IMU_TYPE](
        types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](7, 8), 'imu'),
        types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0),
        zeros,
        vector,
        np.array([covariance] + [0.0] * 8),
        vector,
        zeros,
    )


@pytest.mark.parametrize('covariance', [-1.0, np.nan])
@pytest.mark.parametrize(
    'x, kept', [(1.0, True), (0.0, False), (np.nan, False), (np.inf, False), (5e-324, True)]
)
def test_valid_data_are_kept_with_any_covariance(covariance: float, x: float, kept: bool) -> None:
    message = imu_message(ROS2, covariance)
    good = bytes(ROS2.serialize_cdr(message, IMU_TYPE))
    message.angular_velocity = type(message.angular_velocity)(x, 0.0, 0.0)
    payload = bytes(ROS2.serialize_cdr(message, IMU_TYPE))
    decoded = decode_imus([good, payload], 'cdr')
    assert decoded.kept == {'gyro': 1 + kept}
    assert np.isnan(decoded.samples[:, :3]).all(axis=1).tolist() == [False, not kept]
    np.testing.assert_array_equal(decoded.samples[:, 3:], [[1.0, 2.0, 3.0]] * 2)


def test_an_absent_sensor_is_decoded_as_absent() -> None:
    samples = np.array([[np.nan, np.nan, np.nan, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0, np.nan, 6.0]])
    batch = ImuBatch(np.array([1, 2]), samples, None, '')
    for encoding in ('cdr', 'ros1'):
        decoded = decode_imus(encode_imus(batch, encoding), encoding)
        np.testing.assert_array_equal(decoded.samples, samples)


@pytest.mark.parametrize(
    'spoil, says',
    [
        (lambda good: good[:100], 'too few'),
        (lambda good: b'', 'too few'),
        (lambda good: b'\x00\x07' + good[2:], 'not plain CDR'),
        (
            lambda good: good[:12] + struct.pack('<I', 1002) + good[16:] + bytes(900),
            'has 1002 bytes',
        ),
        (lambda good: good[:12] + b'\xff\xff\xff\x7f' + good[16:], 'has 2147483647 bytes'),
    ],
)
def test_invalid_imu_messages_are_named_by_their_position(spoil: Any, says: str) -> None:
    batch = ImuBatch(np.arange(3), np.ones((3, 6)), None, 'imu')
    payloads = [bytes(payload) for payload in encode_imus(batch, 'cdr')]
    payloads[1] = spoil(payloads[1])
    with pytest.raises(MalformedMessage, match=says) as caught:
        decode_imus(payloads, 'cdr')
    assert caught.value.index == 1
