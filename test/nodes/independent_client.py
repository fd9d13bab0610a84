# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A DDS client without ROS: publishes Imu, receives /diagnostics and prints it as JSON.

usage: independent_client.py DOMAIN SAMPLES

Topic and type names are those of ROS 2 topics on the wire
(design.ros2.org/articles/topic_and_service_names.html): ``rt/<topic>`` and
``<package>::msg::dds_::<Type>_``.
"""

import json
import sys
import time
from dataclasses import dataclass

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PERIOD_NS = 5_000_000
PATIENCE_S = 60.0


@dataclass
class Time(IdlStruct, typename='builtin_interfaces::msg::dds_::Time_'):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename='std_msgs::msg::dds_::Header_'):
    stamp: Time
    frame_id: str


@dataclass
class Quaternion(IdlStruct, typename='geometry_msgs::msg::dds_::Quaternion_'):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Vector3(IdlStruct, typename='geometry_msgs::msg::dds_::Vector3_'):
    x: float64
    y: float64
    z: float64


@dataclass
class Imu(IdlStruct, typename='sensor_msgs::msg::dds_::Imu_'):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class KeyValue(IdlStruct, typename='diagnostic_msgs::msg::dds_::KeyValue_'):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename='diagnostic_msgs::msg::dds_::DiagnosticStatus_'):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename='diagnostic_msgs::msg::dds_::DiagnosticArray_'):
    header: Header
    status: sequence[DiagnosticStatus]


def listen(reader: DataReader, heard: dict[str, DiagnosticStatus]) -> None:
    """Receive the pending statuses, or wait for a moment."""
    for message in reader.take(100):
        heard |= {status.name: status for status in message.status}
    time.sleep(0.1)


def told(heard: dict[str, DiagnosticStatus]) -> dict[str, str]:
    """Return the status of the input."""
    return {v.key: v.value for s in heard.values() if 'input' in s.name for v in s.values}


def main(domain: int, samples: int) -> None:
    """Publish, then wait until the statuses report all samples and an axis."""
    participant = DomainParticipant(domain)
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(5000))
    writer = DataWriter(participant, Topic(participant, 'rt/imu/data', Imu), qos=qos)
    reader = DataReader(participant, Topic(participant, 'rt/diagnostics', DiagnosticArray), qos=qos)
    deadline = time.monotonic() + PATIENCE_S
    heard: dict[str, DiagnosticStatus] = {}
    # discovered on both sides
    while not (
        writer.get_matched_subscriptions() and told(heard).get('publishers', 'none') != 'none'
    ):
        if time.monotonic() > deadline:
            raise SystemExit('nobody listens')
        listen(reader, heard)
    rng, unknown, start = np.random.default_rng(0), [0.0] * 9, time.time_ns()
    for i in range(samples):
        sec, nanosec = divmod(start + i * PERIOD_NS, 10**9)
        gyro, accel = rng.normal(0.0, 1e-3, 3).tolist(), rng.normal(0.0, 1e-2, 3).tolist()
        header = Header(Time(sec, nanosec), 'independent')
        level = Quaternion(0.0, 0.0, 0.0, 1.0)
        writer.write(Imu(header, level, unknown, Vector3(*gyro), unknown, Vector3(*accel), unknown))
    while time.monotonic() < deadline:
        listen(reader, heard)
        done = told(heard).get('used [samples]') == str(samples)
        if done and any('N ' in s.message for s in heard.values()):
            break
    print(
        json.dumps(
            {
                name: {'message': s.message, 'values': {v.key: v.value for v in s.values}}
                for name, s in heard.items()
            }
        )
    )


if __name__ == '__main__':
    main(int(sys.argv[1]), int(sys.argv[2]))
