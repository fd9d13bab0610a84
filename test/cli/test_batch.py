# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A folder of recordings: which files and folders are recordings, and what is written."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allan_ros.cli import batch, outcomes
from allan_ros.cli.analyze import recordings_in
from allan_ros.cli.console import EXIT_FAULT
from allan_ros.cli.main import main
from allan_ros.core.imu import ImuBatch
from allan_ros.readers.cdr import encode_imus
from allan_ros.readers.recording_sums import ReadJob, RecordingSums, read_recording

QUICK = ('--method', 'paper')
"""The fastest method, for tests that do not depend on the fit."""


def test_a_folder_is_one_recording_or_a_batch(tmp_path: Path) -> None:
    def folder(name: str, *files: str) -> str:
        place = tmp_path / name
        for file in files:
            (place / file).parent.mkdir(parents=True, exist_ok=True)
            (place / file).touch()
        place.mkdir(exist_ok=True)
        return str(place)

    for one in (
        folder('bag', 'metadata.yaml', 'bag_0.mcap', 'bag_1.mcap'),
        folder('splits', 'run_0.mcap', 'run_1.mcap'),
        folder('single', 'a.mcap', 'notes.txt'),
        folder('empty'),
        str(tmp_path / 'none.bag'),
    ):
        assert recordings_in(one) == [one]
    tables = folder('tables', 'a.npz', 'b.csv', 'notes.txt')
    assert [Path(p).name for p in recordings_in(tables)] == ['a.npz', 'b.csv']
    table = folder('table', 'a.csv', 'notes.txt')
    assert [Path(p).name for p in recordings_in(table)] == ['a.csv']
    named = folder('named', 'monday.mcap', 'tuesday.mcap')
    assert len(recordings_in(named)) == 2
    bags = folder('bags', 'one/metadata.yaml', 'two/metadata.yaml')
    assert [Path(p).name for p in recordings_in(bags)] == ['one', 'two']
    units = folder('units', 'u1/a.mcap', 'u2/metadata.yaml', 'u3.mcap')
    folder('units/empty')
    assert [Path(p).name for p in recordings_in(units)] == ['u1', 'u2', 'u3.mcap']
    results = folder('results', 'results.json', 'report.html', 'plots/a.png')
    assert recordings_in(results) == [results]


@pytest.mark.parametrize(
    'others',
    [['u1.npz', 'u3.npz'], ['u1/results.json'], ['u1/u1.mcap'], ['a.mcap.zstd', 'metadata.yaml']],
)
@pytest.mark.parametrize('document', ['results.json', 'sums.json'])
def test_results_never_hide_the_recordings_in_their_folder(
    tmp_path: Path, others: list[str], document: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for file in (document, *others):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    for verb in ('analyze', 'check'):
        assert main([verb, str(tmp_path)]) == 1
        error = capsys.readouterr().err
        assert error.startswith(f'allan {verb}: {tmp_path}: has the results of an analysis and')
        assert others[-1].split('/')[0] in error and error.count('\n') == 1


@pytest.fixture(scope='module')
def folder(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp('batch')
    for name in ('a', 'b'):
        shutil.copy(recording, place / f'{name}.npz')
    return place


def test_each_has_its_results_and_a_line_in_the_summary(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / 'broken.csv').write_text('nothing\n')
    try:
        assert main(['analyze', str(folder), '-o', str(tmp_path), '--jobs', '2', *QUICK]) == 1
    finally:
        (folder / 'broken.csv').unlink()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(': ')[:2] for line in lines] == [
        *(['measured', name] for name in ('a.npz', 'b.npz')),
        ['error', f'{folder}/broken.csv'],
    ]
    assert (tmp_path / 'a_npz' / 'report.html').is_file()
    rows = list(csv.DictReader((tmp_path / 'summary.csv').open()))
    assert [(row['unit'], row['verdict'], row['exit_code']) for row in rows] == [
        ('a.npz', 'measured', '0'),
        ('b.npz', 'measured', '0'),
        ('broken.csv', 'error', '1'),
    ]
    assert float(rows[0]['gyro_x N [deg/sqrt(h)]']) > 0.0
    assert rows[1]['reason'].startswith('duplicate: it has the samples of a.npz')
    page = (tmp_path / 'index.html').read_text()
    assert 'href="a_npz/report.html"' in page and page.count('<polyline') == 12


def test_a_fault_of_one_recording_does_not_end_the_others(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def faulty(job: ReadJob) -> RecordingSums:
        if job.path.endswith('a.npz'):
            raise ZeroDivisionError('a fault\nin two lines')
        return read_recording(job)

    monkeypatch.setattr(outcomes, 'read_recording', faulty)
    for verb in 'analyze', 'check':
        assert main([verb, str(folder), *QUICK]) == EXIT_FAULT
        first, second, *_ = capsys.readouterr().out.splitlines()
        assert first.startswith(f'error: {folder}/a.npz: internal error of allan_ros')
        assert 'ZeroDivisionError: a fault' in first and 'please report' in first
        assert 'b.npz' in second and 'gyro N' in second


def test_a_process_that_dies_is_an_error_of_the_units_without_outcome(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    for i in range(7):
        shutil.copy(folder / 'a.npz', tmp_path / f'{i}.npz')
    # takes seconds, so that no process is done with it before the processes are killed
    samples = np.random.default_rng(7).normal(size=(2_000_000, 6)) * 1e-3
    np.savez(tmp_path / '7.npz', t=np.arange(len(samples)) * 0.01, imu=samples)
    original = batch.outcomes_of

    def killed(units: Any, args: Any) -> Iterator[outcomes.Outcome]:
        for i, outcome in enumerate(original(units, args)):
            for child in active_children() if i == 0 else ():
                child.kill()
            yield outcome

    monkeypatch.setattr(batch, 'outcomes_of', killed)
    assert main(['analyze', str(tmp_path), '--jobs', '2', *QUICK]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('measured: 0.npz') and len(lines) == 8
    assert lines[-1].startswith(f'error: {tmp_path}/7.npz: a process died, probably because')


def test_json_has_a_line_for_each_recording(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['analyze', str(folder), '--json', *QUICK]) == 0
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [Path(entry['path']).name for entry in documents] == ['a.npz', 'b.npz']
    # both are copies of one recording, which must not be added twice
    assert main(['analyze', *(str(path) for path in sorted(folder.iterdir()))]) == 1
    assert 'give each recording once' in capsys.readouterr().err


def test_fail_on_applies_to_a_batch(folder: Path, sheet: Callable[[float], str]) -> None:
    words = ['analyze', str(folder), '--sensor', sheet(1e-6)]
    assert main(words) == 0
    assert main([*words, '--fail-on', 'error']) == 3
    assert main([*words[:2], '--fail-on', 'error']) == 0


def test_each_imu_topic_of_a_bag_has_its_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.LATEST)
    stamps = 10**18 + np.arange(6000) * 10_000_000
    bag = tmp_path / 'two'
    with rosbag2.Writer(bag, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        for seed, topic in enumerate(('/left/imu', '/right/imu')):
            connection = writer.add_connection(topic, 'sensor_msgs/msg/Imu', typestore=store)
            samples = np.random.default_rng(seed).normal(size=(6000, 6)) * (seed + 1)
            batch = ImuBatch(stamps, samples, frame_id=topic)
            for payload, stamp in zip(encode_imus(batch, 'cdr'), stamps.tolist()):
                writer.write(connection, stamp, payload)
    out = tmp_path / 'out'
    words = ['analyze', str(bag), '-o', str(out), '--no-motion-gate', *QUICK]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(': ')[1] for line in lines] == ['two /left/imu', 'two /right/imu']
    documents = [json.loads((out / f'two_{side}_imu' / 'results.json').read_text())
                 for side in ('left', 'right')]  # fmt: skip
    left, right = (document['axes']['gyro_x']['noise']['N']['value'] for document in documents)
    # N of 6000 samples is known to 2 %, so that 10 % is five standard deviations
    assert right / left == pytest.approx(2.0, rel=0.1)
    assert (out / 'summary.csv').is_file()
    assert main([*words, '--topic', '/right/imu']) == 0
    assert (out / 'results.json').is_file()
    failing = [word for word in words if word not in ('-o', str(out))]
    for more in ([], ['--json'], ['-o', str(tmp_path / 'failed')]):
        assert main([*failing, '--skip', '1h', *more]) == 1  # every topic is too short
