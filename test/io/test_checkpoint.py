# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A checkpoint is read back whole, put aside when broken, and never written over another's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from allan_ros.core.accumulator import ImuAccumulator
from allan_ros.core.batch import ImuBatch
from allan_ros.core.errors import AllanError
from allan_ros.core.sums_document import sums_to_document
from allan_ros.io.checkpoint import Checkpoint
from allan_ros.io.results import Provenance


@pytest.fixture
def sums():
    accumulator = ImuAccumulator()
    noise = np.random.default_rng(0).normal(size=(3000, 6))
    accumulator.update(ImuBatch(10**18 + np.arange(3000) * 10**7, noise, frame_id='imu'))
    return accumulator.result().sums


def test_what_was_saved_is_loaded(tmp_path: Path, sums):
    path = tmp_path / 'sums.json'
    Checkpoint(path).save(sums, Provenance())
    loaded = Checkpoint(path)
    assert [sums_to_document(s) for s in loaded.sums] == [sums_to_document(s) for s in sums]
    assert loaded.loaded is None and not loaded.kept


def test_nothing_is_written_for_no_sums(tmp_path: Path):
    Checkpoint(tmp_path / 'sums.json').save((), Provenance())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    'content',
    ['', '{"schema"', '[]', '{"schema": "allan_ros/sums_file/1"}', 'null', '\x00' * 100],
)
def test_a_broken_file_is_put_aside(tmp_path: Path, sums, content):
    path = tmp_path / 'sums.json'
    for number in ('', '1'):
        path.write_text(content)
        checkpoint = Checkpoint(path)
        assert checkpoint.sums == () and not checkpoint.kept
        assert checkpoint.loaded.id == 'checkpoint_corrupt'
        assert (tmp_path / f'sums.json.corrupt{number}').read_text() == content
    checkpoint.save(sums, Provenance())
    assert Checkpoint(path).sums


def test_a_file_of_another_version_is_left_alone(tmp_path: Path, sums):
    path = tmp_path / 'sums.json'
    content = json.dumps({'schema': 'allan_ros/sums_file/99'})
    path.write_text(content)
    checkpoint = Checkpoint(path)
    assert checkpoint.kept and 'sums_file/99' in str(checkpoint.loaded)
    checkpoint.save(sums, Provenance())
    assert path.read_text() == content


def test_a_refused_file_is_left_alone(tmp_path: Path, sums):
    path = tmp_path / 'sums.json'
    Checkpoint(path).save(sums, Provenance())
    content = path.read_bytes()
    checkpoint = Checkpoint(path)
    checkpoint.refuse('it is of another IMU')
    assert checkpoint.sums == ()
    checkpoint.save(sums, Provenance())
    checkpoint.set_aside()
    assert path.read_bytes() == content


def test_a_folder_that_is_not_there_is_found_at_once(tmp_path: Path):
    with pytest.raises(AllanError, match='cannot be written'):
        Checkpoint(tmp_path / 'missing' / 'sums.json').try_to_write()
    Checkpoint(tmp_path / 'sums.json').try_to_write()
    assert list(tmp_path.iterdir()) == []
