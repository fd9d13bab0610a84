# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A results folder always belongs to one analysis, also after a failure at any step."""

from __future__ import annotations

import contextlib
import json
import os
import threading
from pathlib import Path

import pytest

import allan_ros as ar
from allan_ros.core.errors import AllanError
from allan_ros.readers.files import PathLock
from allan_ros.results.documents import SUMS, load
from allan_ros.view.result_files import write_result_files

FILTERS = ('imu.yaml', 'kalibr_imu_chain.yaml')


@pytest.fixture(scope='module')
def runs() -> list[ar.Results]:
    return [ar.analyze(ar.simulate(hours=0.05, rate=50, seed=i)) for i in (1, 2)]


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def without_report(files: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in files.items() if name != 'report.html'}


def test_nothing_changes_when_drawing_or_the_disk_fails(
    runs: list[ar.Results], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_result_files(tmp_path, runs[0], targets=['openvins'])
    before = content(tmp_path)

    def fails(*_: object, **__: object) -> None:
        raise OSError(28, 'No space left on device')

    for place in ('allan_ros.view.result_files.render_report', 'allan_ros.readers.files.os.fsync'):
        with monkeypatch.context() as patch:
            patch.setattr(place, fails)
            with pytest.raises((AllanError, OSError)):
                write_result_files(tmp_path, runs[1], targets=['openvins'])
        assert content(tmp_path) == before


@pytest.mark.parametrize('renames', range(6))
def test_no_filter_file_is_of_another_analysis_than_the_report(
    renames: int, runs: list[ar.Results], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_result_files(tmp_path, runs[0], targets=['openvins'])
    old = content(tmp_path)
    done = []

    def interrupted(self: Path, target: Path) -> None:
        if len(done) == renames:
            raise KeyboardInterrupt
        done.append(target)
        os.replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, 'replace', interrupted)
        with contextlib.suppress(KeyboardInterrupt):
            write_result_files(tmp_path, runs[1], targets=['openvins'])
    new = content(tmp_path)
    assert not [name for name in new if name.endswith('.part')]
    for name in FILTERS:
        others = [n for n in new if n not in FILTERS and n in old and new[n] == old[n]]
        assert name not in new or (new[name] != old[name] and not others) or new == old


def test_files_of_an_earlier_analysis_do_not_stay(runs: list[ar.Results], tmp_path: Path) -> None:
    mine = tmp_path / 'notes.txt'
    mine.write_text('keep')
    write_result_files(tmp_path, runs[0], targets=['openvins'])
    assert set(FILTERS) <= set(content(tmp_path))
    gyro = ar.analyze(ar.simulate(hours=0.05, rate=50).samples[:, :3], rate=50)
    results, paths = write_result_files(tmp_path, gyro)
    assert 'file_left_out' in {f.id for f in results.findings}
    names = {path.name for path in paths}
    assert set(content(tmp_path)) == names | {'notes.txt'}
    assert 'imu.yaml' not in names
    assert set(json.loads((tmp_path / 'results.json').read_text())['files']) == names


def test_two_runs_into_one_folder_wait_for_each_other(
    runs: list[ar.Results], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = []
    for i, run in enumerate(runs):
        write_result_files(tmp_path / f'{i}', run)
        alone.append(without_report(content(tmp_path / f'{i}')))
    folder = tmp_path / 'both'
    folder.mkdir()
    lock = PathLock(folder / 'results.json')
    assert lock.acquire() == ''
    threads = [threading.Thread(target=write_result_files, args=(folder, run)) for run in runs]
    for thread in threads:
        thread.start()
    assert list(content(folder)) == ['.results.json.lock']
    lock.release()
    for thread in threads:
        thread.join()
    assert without_report(content(folder)) in alone
    assert lock.acquire() == ''
    monkeypatch.setattr('allan_ros.view.result_files.LOCK_WAIT_S', 0.0)
    with pytest.raises(AllanError, match=f'process {os.getpid()} is writing to this folder'):
        write_result_files(folder, runs[0])
    lock.release()


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='no FIFOs on this system')
def test_special_files_are_not_replaced(runs: list[ar.Results], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'report.html')
    with pytest.raises(AllanError, match='regular file'):
        write_result_files(tmp_path, runs[0])
    assert [path.name for path in tmp_path.iterdir()] == ['report.html']


def test_a_kill_between_two_files_is_noticed(runs: list[ar.Results], tmp_path: Path) -> None:
    """New sums beside old results, as after a kill between the renames."""
    runs[0].save(tmp_path)
    assert load(tmp_path).recorded is not None
    document = json.loads((tmp_path / SUMS).read_text())
    document['sums'] = document['sums'] * 2
    (tmp_path / SUMS).write_text(json.dumps(document))
    with pytest.raises(AllanError, match='of different analyses: analyze'):
        load(tmp_path)
