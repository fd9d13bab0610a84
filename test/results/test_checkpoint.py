# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A checkpoint is read back completely, set aside when damaged, and never overwrites another."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path

import numpy as np
import pytest

from allan_ros.core.allan.document import sums_to_document
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.checkpoint import Checkpoint


def sums_of(frame_id: str = 'imu', period_ns: int = 10**7, axes: slice = slice(0, 6)):
    accumulator = ImuStream()
    noise = np.full((3000, 6), np.nan)
    noise[:, axes] = np.random.default_rng(0).normal(size=(3000, 6))[:, axes]
    stamps = 10**18 + np.arange(3000) * period_ns
    accumulator.update(ImuBatch(stamps, noise, frame_id=frame_id))
    return accumulator.result().sums


LOG = logging.getLogger('test')

Sums = tuple[AllanSums, ...]


@pytest.fixture
def sums() -> Sums:
    return sums_of()


@pytest.fixture
def opened():
    """Return a function that opens a checkpoint; the one opened before is closed first."""
    last: list[Checkpoint] = []

    def open_checkpoint(path: Path) -> Checkpoint:
        if last:
            last.pop().close()
        last.append(Checkpoint(path, LOG))
        return last[0]

    yield open_checkpoint
    for checkpoint in last:
        checkpoint.close()


def save(checkpoint: Checkpoint, sums: Sums) -> bool:
    """Add the sums of this run to the file, and return whether it was written."""
    return checkpoint.save(checkpoint.total(sums, Provenance()))


def test_sums_are_saved_and_loaded(tmp_path: Path, sums: Sums, opened) -> None:
    path = tmp_path / 'folder' / 'sums.json'
    save(opened(path), ())
    assert not path.exists()
    assert save(opened(path), sums)
    loaded = opened(path)
    assert [sums_to_document(s) for s in loaded.earlier[0]] == [sums_to_document(s) for s in sums]
    assert loaded.findings == ()


def in_unit(factor: float) -> Sums:
    """Return the sums of an IMU at rest whose acceleration has another unit."""
    accumulator = ImuStream()
    samples = np.random.default_rng(0).normal(0.0, 1e-3, (3000, 6)) + [0, 0, 0, 0, 0, 9.8]
    samples[:, 3:] *= factor
    accumulator.update(ImuBatch(10**18 + np.arange(3000) * 10**7, samples, frame_id='imu'))
    return accumulator.result().sums


def test_sums_in_g_and_in_si_are_never_added(tmp_path: Path, opened) -> None:
    path, previous = tmp_path / 'sums.json', tmp_path / 'sums.json.previous'
    in_g, in_si = in_unit(1 / 9.80665), in_unit(1.0)
    assert save(opened(path), in_g)
    checkpoint = opened(path)
    assert checkpoint.total(in_si, Provenance())[0] == in_si
    assert [f.id for f in checkpoint.findings] == ['checkpoint_unit']
    assert save(checkpoint, in_si) and previous.exists()
    checkpoint = opened(path)
    assert checkpoint.total(in_g, Provenance())[0] == in_g
    assert not save(checkpoint, in_g) and 'unit of measurement' in str(checkpoint.refused)
    # the unit becomes right in this run
    assert save(checkpoint, in_si) and checkpoint.refused is None
    assert max(s.samples for s in opened(path).earlier[0]) == 6000


def test_sums_of_a_wrong_unit_that_cannot_be_renamed_are_not_overwritten(
    tmp_path: Path, opened
) -> None:
    path, obstacle = tmp_path / 'sums.json', tmp_path / 'sums.json.previous'
    in_g, in_si = in_unit(1 / 9.80665), in_unit(1.0)
    assert save(opened(path), in_g)
    content = path.read_bytes()
    obstacle.mkdir()
    checkpoint = opened(path)
    assert checkpoint.total(in_si, Provenance())[0] == in_si
    assert not save(checkpoint, in_si) and path.read_bytes() == content
    assert [f.id for f in checkpoint.findings] == ['checkpoint_refused']


def test_without_a_path_nothing_is_kept(sums: Sums, opened) -> None:
    checkpoint = opened('')
    total = checkpoint.total(sums, Provenance())
    assert total == (sums, Provenance()) and not checkpoint.save(total)
    assert checkpoint.start_over(total) == '' and checkpoint.findings == ()


def test_a_locked_path_is_not_changed(tmp_path: Path, sums: Sums, opened) -> None:
    path = tmp_path / 'sums.json'
    first, second = opened(path), Checkpoint(path, LOG)
    assert [f.id for f in second.findings] == ['checkpoint_in_use']
    assert not save(second, sums) and not path.exists()
    assert save(first, sums) and path.exists() and first.findings == ()
    second.close()


@pytest.mark.parametrize(
    'content',
    ['', '{"schema"', '[]', '{"schema": "allan_ros/sums_file/2"}', 'null', '\x00' * 100],
)
def test_a_broken_file_is_put_aside(tmp_path: Path, sums: Sums, opened, content: str) -> None:
    path = tmp_path / 'sums.json'
    for number in ('', '1'):
        path.write_text(content)
        checkpoint = opened(path)
        assert checkpoint.earlier[0] == () and checkpoint.refused is None
        assert checkpoint.loaded.id == 'checkpoint_corrupt'
        assert (tmp_path / f'sums.json.corrupt{number}').read_text() == content
    assert save(checkpoint, sums)
    assert opened(path).earlier[0]


def test_a_file_of_another_version_is_not_changed(tmp_path: Path, sums: Sums, opened) -> None:
    path = tmp_path / 'sums.json'
    content = json.dumps({'schema': 'allan_ros/sums_file/99'})
    path.write_text(content)
    checkpoint = opened(path)
    assert 'sums_file/99' in str(checkpoint.refused)
    assert checkpoint.total(sums, Provenance())[0] == sums and not save(checkpoint, sums)
    assert path.read_text() == content


def test_problems_are_logged_as_text(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / 'sums.json'
    checkpoints = []
    for content in ('damaged', '{"schema": "allan_ros/sums_file/99"}', ''):
        path.write_text(content)
        checkpoints.append(Checkpoint(path, LOG, lambda f: f'text of {f.id}'))
        if content == 'damaged':
            checkpoints[-1].close()
    for checkpoint in checkpoints[1:]:
        checkpoint.close()
    expected = ['checkpoint_corrupt', 'checkpoint_refused', 'checkpoint_in_use']
    assert [record.message for record in caplog.records] == [f'text of {id}' for id in expected]


OTHER_IMUS = [sums_of('other'), sums_of(period_ns=2 * 10**7)]
NAMES = ['another IMU', 'another rate']


@pytest.mark.parametrize('other', OTHER_IMUS, ids=NAMES)
def test_a_file_of_another_imu_is_left_alone_until_its_own_is_back(
    tmp_path: Path, sums: Sums, other: Sums, opened
) -> None:
    path = tmp_path / 'sums.json'
    save(opened(path), sums)
    content = path.read_bytes()
    checkpoint = opened(path)
    assert checkpoint.total(other, Provenance())[0] == other
    assert 'cannot be added' in str(checkpoint.refused)
    assert not save(checkpoint, other) and path.read_bytes() == content
    assert save(checkpoint, sums) and checkpoint.refused is None
    assert checkpoint.earlier[0][0].samples == sums[0].samples
    # a reset keeps the file, but its sums no longer belong to this run
    assert checkpoint.start_over(checkpoint.total(other, Provenance())) == ''
    assert checkpoint.total(sums, Provenance())[0][0].samples == 3 * sums[0].samples
    assert opened(path).earlier[0][0].samples == 2 * sums[0].samples


def test_a_file_that_was_moved_away_is_rejected_no_more(tmp_path: Path, sums: Sums, opened) -> None:
    path = tmp_path / 'sums.json'
    for content in (None, json.dumps({'schema': 'allan_ros/sums_file/99'})):
        save(opened(path), sums_of('other'))
        if content:
            path.write_text(content)
        checkpoint = opened(path)
        assert not save(checkpoint, sums) and checkpoint.refused is not None
        path.rename(tmp_path / 'moved.json')
        assert save(checkpoint, sums) and checkpoint.refused is None
        assert opened(path).earlier[0][0].identity == sums[0].identity
        path.unlink()


def test_a_sensor_that_starts_later_belongs_to_the_same_imu(
    tmp_path: Path, sums: Sums, opened
) -> None:
    checkpoint = opened(tmp_path / 'sums.json')
    assert save(checkpoint, sums_of(axes=slice(0, 3))) and save(checkpoint, sums)
    assert checkpoint.refused is None
    assert opened(tmp_path / 'sums.json').earlier[0][0].axes == sums[0].axes


def test_a_reset_renames_the_file(tmp_path: Path, sums: Sums, opened) -> None:
    path = tmp_path / 'sums.json'
    checkpoint = opened(path)
    previous = checkpoint.start_over(checkpoint.total(sums, Provenance()))
    assert previous == f'{path}.previous' and not path.exists()
    assert opened(Path(previous)).earlier[0] == sums


def test_a_folder_that_cannot_be_created_is_reported_at_once(tmp_path: Path, opened) -> None:
    (tmp_path / 'file').write_text('')
    found = [f.id for f in opened(tmp_path / 'file' / 'sums.json').findings]
    assert found == ['checkpoint_unwritable']


def special(kind: str, path: Path) -> None:
    """Create something at the path that is not a regular file."""
    if kind == 'folder':
        path.mkdir()
    elif kind == 'FIFO':
        os.mkfifo(path)
    elif kind == 'link to a FIFO':
        os.mkfifo(fifo := path.with_name(f'fifo of {path.name}'))
        path.symlink_to(fifo)
    else:
        path.symlink_to('/dev/zero')


SPECIAL = ('folder', 'FIFO', 'link to a FIFO', 'link to a device')
FIFOS = pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no FIFOs on this system')


@FIFOS
@pytest.mark.parametrize('kind', SPECIAL)
def test_special_files_are_not_changed(kind: str, tmp_path: Path, sums: Sums, opened) -> None:
    path = tmp_path / 'sums.json'
    special(kind, path)
    before = os.lstat(path)
    checkpoint = opened(path)
    assert 'give a regular file' in str(checkpoint.refused)
    total = checkpoint.total(sums, Provenance())
    assert total[0] == sums and not checkpoint.save(total) and not checkpoint.start_over(total)
    assert os.path.samestat(before, os.lstat(path))
    assert not [p for p in tmp_path.iterdir() if 'corrupt' in p.name or 'previous' in p.name]
    path = tmp_path / 'later.json'  # special after it was saved
    assert save(opened(path), sums)
    path.unlink()
    special(kind, path)
    assert not save(opened(path), sums) and not path.is_file()


def test_a_damaged_file_that_cannot_be_renamed_is_not_changed(
    tmp_path: Path, sums: Sums, opened, monkeypatch
) -> None:
    path = tmp_path / 'sums.json'
    path.write_text('damaged')
    move = Path.replace

    def denied(draft: Path, to: Path) -> Path:
        if draft == path:
            raise PermissionError(13, 'Permission denied')
        return move(draft, to)

    monkeypatch.setattr(Path, 'replace', denied)
    checkpoint = opened(path)
    assert checkpoint.loaded is None and 'is not JSON' in str(checkpoint.refused)
    assert not save(checkpoint, sums)
    assert path.read_text() == 'damaged'
    path.unlink()
    checkpoint = opened(path)
    assert checkpoint.start_over(checkpoint.total(sums, Provenance())) == ''
    assert 'cannot be renamed to sums.json.previous (Permission' in str(checkpoint.findings[0])
