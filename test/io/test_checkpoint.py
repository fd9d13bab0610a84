# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A checkpoint is read back completely, set aside when damaged, and never overwrites another."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from allan_ros.core.allan.document import sums_to_document
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.io.checkpoint import Checkpoint
from allan_ros.io.recorded import Provenance


def sums_of(frame_id: str = 'imu', period_ns: int = 10**7, axes: slice = slice(0, 6)):
    accumulator = ImuStream()
    noise = np.full((3000, 6), np.nan)
    noise[:, axes] = np.random.default_rng(0).normal(size=(3000, 6))[:, axes]
    stamps = 10**18 + np.arange(3000) * period_ns
    accumulator.update(ImuBatch(stamps, noise, frame_id=frame_id))
    return accumulator.result().sums


@pytest.fixture
def sums():
    return sums_of()


def test_what_was_saved_is_loaded(tmp_path: Path, sums):
    path = tmp_path / 'sums.json'
    Checkpoint(path).save(sums, Provenance())
    loaded = Checkpoint(path)
    assert [sums_to_document(s) for s in loaded.sums] == [sums_to_document(s) for s in sums]
    assert loaded.loaded is None and loaded.refused is None


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
        assert checkpoint.sums == () and checkpoint.refused is None
        assert checkpoint.loaded.id == 'checkpoint_corrupt'
        assert (tmp_path / f'sums.json.corrupt{number}').read_text() == content
    checkpoint.save(sums, Provenance())
    assert Checkpoint(path).sums


def test_a_file_of_another_version_is_left_alone(tmp_path: Path, sums):
    path = tmp_path / 'sums.json'
    content = json.dumps({'schema': 'allan_ros/sums_file/99'})
    path.write_text(content)
    checkpoint = Checkpoint(path)
    assert 'sums_file/99' in str(checkpoint.refused)
    assert checkpoint.add(sums) == sums
    checkpoint.save(sums, Provenance())
    assert path.read_text() == content


STRANGERS = [sums_of('other'), sums_of(period_ns=2 * 10**7)]


@pytest.mark.parametrize('stranger', STRANGERS, ids=['another IMU', 'another rate'])
def test_a_file_of_another_imu_is_left_alone_until_its_own_is_back(tmp_path: Path, sums, stranger):
    path = tmp_path / 'sums.json'
    Checkpoint(path).save(sums, Provenance())
    content = path.read_bytes()
    checkpoint = Checkpoint(path)
    assert checkpoint.add(stranger) == stranger
    assert 'do not add' in str(checkpoint.refused)
    checkpoint.save(stranger, Provenance())
    assert path.read_bytes() == content
    total = checkpoint.add(sums)
    assert checkpoint.refused is None and total[0].samples == 2 * sums[0].samples
    checkpoint.save(total, Provenance())
    assert Checkpoint(path).sums[0].samples == total[0].samples


@pytest.mark.parametrize('stranger', STRANGERS, ids=['another IMU', 'another rate'])
def test_what_this_run_saved_is_left_alone_too(tmp_path: Path, sums, stranger):
    path = tmp_path / 'sums.json'
    checkpoint = Checkpoint(path)
    checkpoint.save(checkpoint.add(sums), Provenance())
    content = path.read_bytes()
    checkpoint.save(checkpoint.add(stranger), Provenance())
    assert path.read_bytes() == content and checkpoint.refused is not None
    checkpoint.resume()  # as after a reset: what the file holds is not in this run any more
    assert checkpoint.add(sums)[0].samples == 2 * sums[0].samples


def test_a_file_that_was_moved_away_is_refused_no_more(tmp_path: Path, sums):
    path = tmp_path / 'sums.json'
    for content in (None, json.dumps({'schema': 'allan_ros/sums_file/99'})):
        Checkpoint(path).save(sums_of('other'), Provenance())
        if content:
            path.write_text(content)
        checkpoint = Checkpoint(path)
        assert checkpoint.add(sums) == sums and checkpoint.refused is not None
        path.rename(tmp_path / 'moved.json')
        assert checkpoint.add(sums) == sums and checkpoint.refused is None
        checkpoint.save(sums, Provenance())
        assert Checkpoint(path).sums[0].identity == sums[0].identity
        path.unlink()


def test_a_sensor_that_comes_later_is_no_stranger(tmp_path: Path, sums):
    checkpoint = Checkpoint(tmp_path / 'sums.json')
    for known in (sums_of(axes=slice(0, 3)), sums):
        checkpoint.save(checkpoint.add(known), Provenance())
    assert checkpoint.refused is None
    assert Checkpoint(checkpoint.path).sums[0].axes == sums[0].axes


def test_drafts_of_a_killed_process_are_removed(tmp_path: Path):
    left = [tmp_path / f'.{name}.{"0a" * 16}.part' for name in ('imu.json', 'imu.json.trial')]
    others = [tmp_path / f'.right.json.{"0a" * 16}.part', tmp_path / '.imu.json.notes.part']
    for path in (*left, *others):
        path.write_text('{"sums": [')
    Checkpoint(tmp_path / 'imu.json').remove_drafts()
    assert sorted(tmp_path.iterdir()) == sorted(others)


def test_a_folder_that_is_not_there_is_found_at_once(tmp_path: Path):
    with pytest.raises(AllanError, match='cannot be written'):
        Checkpoint(tmp_path / 'missing' / 'sums.json').try_to_write()
    Checkpoint(tmp_path / 'sums.json').try_to_write()
    assert list(tmp_path.iterdir()) == []


def special(kind: str, path: Path) -> None:
    """Create something at the path that is not a regular file."""
    if kind == 'folder':
        path.mkdir()
    elif kind == 'FIFO':
        os.mkfifo(path)
    elif kind == 'link to a FIFO':
        os.mkfifo(path.with_name('fifo'))
        path.symlink_to(path.with_name('fifo'))
    else:
        path.symlink_to('/dev/zero')


SPECIAL = ('folder', 'FIFO', 'link to a FIFO', 'link to a device')


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no FIFOs on this system')
@pytest.mark.parametrize('kind', SPECIAL)
def test_what_is_no_regular_file_is_left_alone(kind: str, tmp_path: Path, sums) -> None:
    path = tmp_path / 'sums.json'
    special(kind, path)
    before = os.lstat(path)
    checkpoint = Checkpoint(path)
    assert 'give a regular file' in str(checkpoint.refused)
    assert checkpoint.add(sums) == sums
    checkpoint.save(sums, Provenance())
    with pytest.raises(AllanError, match='regular file'):
        checkpoint.set_aside()
    assert os.path.samestat(before, os.lstat(path))
    assert not [p for p in tmp_path.iterdir() if 'corrupt' in p.name or 'previous' in p.name]


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no FIFOs on this system')
@pytest.mark.parametrize('kind', SPECIAL)
def test_nothing_is_renamed_onto_what_is_no_regular_file(kind: str, tmp_path: Path, sums) -> None:
    path = tmp_path / 'sums.json'
    checkpoint = Checkpoint(path)
    checkpoint.save(sums, Provenance())
    special(kind, tmp_path / 'sums.json.previous')
    with pytest.raises(AllanError, match='regular file'):
        checkpoint.set_aside()
    assert Checkpoint(path).sums == sums


@pytest.mark.parametrize('name', ['sums.json', 'sums.json.previous'])
def test_a_path_that_cannot_be_examined_is_an_error_of_ours(name: str, tmp_path: Path, sums):
    path, loop = tmp_path / 'sums.json', tmp_path / name
    Checkpoint(path).save(sums, Provenance())
    checkpoint = Checkpoint(path)
    loop.unlink(missing_ok=True)
    loop.symlink_to(loop)  # examining it fails for every user
    with pytest.raises(AllanError, match='cannot be renamed'):
        checkpoint.set_aside()
    assert loop.is_symlink()


def test_a_damaged_file_that_cannot_be_renamed_is_left_alone(tmp_path: Path, sums, monkeypatch):
    def denied(path: Path, to: Path) -> None:
        raise PermissionError(13, 'Permission denied')

    path = tmp_path / 'sums.json'
    path.write_text('damaged')
    monkeypatch.setattr(Path, 'replace', denied)
    checkpoint = Checkpoint(path)
    assert checkpoint.loaded is None and 'is not JSON' in str(checkpoint.refused)
    assert checkpoint.add(sums) == sums
    checkpoint.save(sums, Provenance())
    assert path.read_text() == 'damaged'
    with pytest.raises(AllanError, match=r'cannot be renamed to sums.json.previous \(Permission'):
        checkpoint.set_aside()


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no FIFOs on this system')
def test_a_file_that_becomes_a_fifo_is_not_replaced(tmp_path: Path, sums) -> None:
    path = tmp_path / 'sums.json'
    checkpoint = Checkpoint(path)
    checkpoint.save(sums, Provenance())
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(AllanError, match='regular file'):
        checkpoint.save(sums, Provenance())
    assert path.is_fifo()
    assert [p.name for p in tmp_path.iterdir()] == ['sums.json']
