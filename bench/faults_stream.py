# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the sensor and its driver: wrong contents, and lost or reordered messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from fault_harness import Row, Trial, fault
from online_nodes import Client
from still_stream import Stream

from allan_ros.core.imu import ImuBatch

HOUR_NS = 3600 * 10**9


def _with_samples(block: ImuBatch, edit: Callable[[np.ndarray], None]) -> ImuBatch:
    samples = block.samples.copy()
    edit(samples)
    return replace(block, samples=samples)


@fault()
def nan_burst(client: Client, folder: Path) -> Row:
    """Gyro x is NaN for 5 s."""
    trial = Trial(client, folder)

    def edit(samples: np.ndarray) -> None:
        samples[:, 0] = np.nan

    trial.faulty(lambda block: _with_samples(block, edit), 5.0)
    return trial.row('NaN in one axis for 5 s')


@fault()
def stuck(client: Client, folder: Path) -> Row:
    """Accel y is stuck at one value."""
    trial = Trial(client, folder)

    def edit(samples: np.ndarray) -> None:
        samples[:, 4] = 0.25

    trial.faulty(lambda block: _with_samples(block, edit), 10.0)
    return trial.row('one axis stuck for 10 s')


@fault()
def louder(client: Client, folder: Path) -> Row:
    """The noise of gyro z rises by 50 % after two minutes."""
    trial = Trial(client, folder)
    trial.spin(110.0)

    def edit(samples: np.ndarray) -> None:
        samples[:, 2] *= 1.5

    trial.faulty(lambda block: _with_samples(block, edit), 40.0)
    return trial.row('noise of gyro z x 1.5 for 40 s after 2 min')


@fault()
def unplugged(client: Client, folder: Path) -> Row:
    """The driver runs without its IMU."""
    trial = Trial(client, folder)
    with trial.fault():
        trial.stream.silent = True
        trial.spin(10.0)
        trial.stream.silent = False
    return trial.row('IMU unplugged for 10 s, the driver lives')


@fault()
def loss_5(client: Client, folder: Path) -> Row:
    """The driver loses 5 % of its samples."""
    return _loss(client, folder, 0.05)


@fault()
def loss_30(client: Client, folder: Path) -> Row:
    """The driver loses 30 % of its samples."""
    return _loss(client, folder, 0.30)


def _loss(client: Client, folder: Path, share: float) -> Row:
    trial, rng = Trial(client, folder), np.random.default_rng(2)

    def some(block: ImuBatch) -> ImuBatch:
        keep = rng.random(len(block)) >= share
        return block[keep]

    trial.faulty(some, 20.0)
    return trial.row(f'the driver loses {share:.0%} at random for 20 s')


@fault()
def reordered(client: Client, folder: Path) -> Row:
    """Messages are reordered, as by UDP over several routes."""
    trial, rng = Trial(client, folder), np.random.default_rng(3)

    def shuffled(block: ImuBatch) -> ImuBatch:
        order = np.argsort(np.arange(len(block)) + rng.uniform(0.0, 3.0, len(block)))
        return block[order]

    trial.faulty(shuffled, 10.0)
    return trial.row('messages overtake each other by up to 3 places for 10 s')


@fault()
def duplicated(client: Client, folder: Path) -> Row:
    """Each message is sent twice."""
    trial = Trial(client, folder)

    def twice(block: ImuBatch) -> ImuBatch:
        rows = np.repeat(np.arange(len(block)), 2)
        return block[rows]

    trial.faulty(twice, 10.0)
    return trial.row('every message twice for 10 s')


@fault()
def rate_changed(client: Client, folder: Path) -> Row:
    """The rate is halved and restored."""
    trial = Trial(client, folder)
    trial.spin(30.0)

    def half(block: ImuBatch) -> ImuBatch:
        return block[::2]

    trial.faulty(half, 20.0)
    return trial.row('rate halved for 20 s after 40 s')


@fault()
def stamps_forward(client: Client, folder: Path) -> Row:
    """The clock of the stamps is set forward permanently."""
    return _stamps_step(client, folder, 'forward', HOUR_NS)


@fault()
def stamps_back(client: Client, folder: Path) -> Row:
    """The clock of the stamps is set back permanently."""
    return _stamps_step(client, folder, 'back', -HOUR_NS)


def _stamps_step(client: Client, folder: Path, where: str, step_ns: int) -> Row:
    trial = Trial(client, folder)
    with trial.fault():
        trial.stream.change = lambda block: replace(block, stamps_ns=block.stamps_ns + step_ns)
    return trial.row(f'header stamps step {where} by 1 h')


@fault()
def stamps_there_and_back(client: Client, folder: Path) -> Row:
    """The clock of the stamps is set forward and, 10 s later, back."""
    trial = Trial(client, folder)
    trial.faulty(lambda block: replace(block, stamps_ns=block.stamps_ns + HOUR_NS), 10.0)
    return trial.row('header stamps 1 h ahead for 10 s')


@fault()
def frame_renamed(client: Client, folder: Path) -> Row:
    """The frame_id changes for a while."""
    trial = Trial(client, folder)
    trial.faulty(lambda block: replace(block, frame_id='imu_2'), 8.0)
    return trial.row('frame_id changed for 8 s')


@fault()
def frame_for_good(client: Client, folder: Path) -> Row:
    """Another IMU replaces the first permanently."""
    trial = Trial(client, folder)
    with trial.fault():
        trial.stream.change = lambda block: replace(block, frame_id='imu_2')
        trial.spin(8.0)
    return trial.row('frame_id changed for good')


@fault()
def second_publisher(client: Client, folder: Path) -> Row:
    """Another IMU publishes on the same topic."""
    return _two_publishers(client, folder, 'imu', 'of the same frame_id')


@fault()
def second_publisher_other_frame(client: Client, folder: Path) -> Row:
    """Another IMU publishes on the same topic, with its own frame_id."""
    return _two_publishers(client, folder, 'imu_2', 'of another frame_id')


def _two_publishers(client: Client, folder: Path, frame_id: str, words: str) -> Row:
    trial = Trial(client, folder)
    with trial.fault():
        other = Stream(frame_id=frame_id, seed=9)
        other.begin()
        trial.spin(10.0)
        other.end()
        other.close()
    note = f'{other.sent} of the other were sent'
    return trial.row(f'a second publisher for 10 s, {words}', note, same=False)


@fault()
def swapped(client: Client, folder: Path) -> Row:
    """Two IMUs swap topics, as after a reboot that changes the order of the devices."""
    ros = ('input.topics:=[imu/data, imu/b]', 'input.labels:=[left, right]')
    other: list[Stream] = []

    def streams() -> Stream:
        other.append(Stream('imu/b', 'imu_b', seed=5))
        other[0].begin()
        return Stream()

    trial = Trial(client, folder, ros, stream=streams, label='left')
    with trial.fault():
        trial.stream.change = lambda block: replace(block, frame_id='imu_b')
        other[0].change = lambda block: replace(block, frame_id='imu')
        trial.spin(8.0)
    row = trial.row('two IMUs swapped for good')
    other[0].end()
    return row
