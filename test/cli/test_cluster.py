# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings spread over processes and a cluster: the same sums, also when workers are killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from allan_ros.cli.cluster import on_cluster
from allan_ros.cli.console import Console
from allan_ros.cli.main import main
from allan_ros.core.allan.document import sums_to_document
from allan_ros.core.errors import AllanError
from allan_ros.core.findings import Finding
from allan_ros.readers.recording_sums import (
    ReadJob,
    RecordingSums,
    read_in_processes,
    read_in_turn,
    read_recording,
)


@pytest.fixture(scope='module')
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return three short recordings of one IMU."""
    folder = tmp_path_factory.mktemp('runs')
    paths = [str(folder / f'{seed}.npz') for seed in range(3)]
    for seed, path in enumerate(paths):
        how = ['--preset', 'paper', '--hours', '0.02', '--rate', '50', '--seed', str(seed)]
        start = str(1577836800 + 3600 * seed)
        assert main(['simulate', path, *how, '--start', start]) == 0
    return paths


def jobs_of(paths: list[str]) -> list[ReadJob]:
    return [ReadJob(path) for path in paths]


def documents(parts: Iterable[Any]) -> list[Any]:
    """Return the sums of all parts as plain values."""
    return [sums_to_document(sums) for part in parts for sums in part.sums]


def shown(paths: list[str], capsys: pytest.CaptureFixture[str], *how: str) -> str:
    """Return the output of an analysis."""
    assert main(['analyze', *paths, '--method', 'paper', *how]) == 0
    return capsys.readouterr().out


def test_several_processes_give_the_result_of_one(
    recordings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = jobs_of(recordings)
    assert documents(read_in_processes(jobs, 2, Console())) == documents(
        read_in_turn(jobs, Console())
    )
    assert shown(recordings, capsys, '--jobs', '2') == shown(recordings, capsys)


def test_an_error_in_one_process_is_reported(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / 'wrong.npz'
    wrong.write_bytes(b'PK\x03\x04 and nothing more')
    assert main(['analyze', recordings[0], str(wrong), '--jobs', '2']) == 1
    said = capsys.readouterr().err
    assert said.startswith(f'allan analyze: {wrong}: ') and said.count('\n') == 1
    assert main(['analyze', recordings[0], '--jobs', '0']) == 1


@pytest.fixture(scope='module')
def cluster() -> Iterator[Any]:
    """Yield a cluster of two worker processes. It gives up a recording after two of its workers
    have died.
    """
    distributed = pytest.importorskip('distributed')
    dask = pytest.importorskip('dask')
    settings = {
        'distributed.scheduler.allowed-failures': 1,
        # on a busy machine a worker restarts more slowly than the cluster waits by default
        'distributed.deploy.lost-worker-timeout': '10 minutes',
    }
    with dask.config.set(settings), distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as local:  # fmt: skip
        yield local


def test_a_cluster_gives_the_sums_of_one_process(
    cluster: Any, recordings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    jobs, address = jobs_of(recordings), cluster.scheduler_address
    assert documents(on_cluster(jobs, address, Console())) == documents(
        read_in_turn(jobs, Console())
    )
    assert shown(recordings, capsys, '--scheduler', address) == shown(recordings, capsys)
    gone, *others = on_cluster(jobs_of(['/gone.npz', recordings[0]]), address, Console())
    assert isinstance(gone, AllanError) and 'no such file' in str(gone)
    assert len(documents(others)) == 1
    assert main(['analyze', '/gone.npz', recordings[0], '--scheduler', address]) == 1
    assert 'no such file' in capsys.readouterr().err


def deadly(victim: str, deaths: Path, times: int) -> Callable[[ReadJob], RecordingSums]:
    """Return a job function that kills its worker the first ``times`` times it reads ``victim``."""

    def work(job: ReadJob) -> RecordingSums:
        if job.path == victim and len(list(deaths.iterdir())) < times:
            (deaths / str(os.getpid())).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return read_recording(job)

    return work


def test_a_dead_worker_is_replaced(cluster: Any, recordings: list[str], tmp_path: Path) -> None:
    work, jobs = deadly(recordings[1], tmp_path, 1), jobs_of(recordings)
    parts = on_cluster(jobs, cluster.scheduler_address, Console(), work)
    assert documents(parts) == documents(map(read_recording, jobs))
    assert len(list(tmp_path.iterdir())) == 1


def test_a_recording_that_kills_all_workers_is_a_finding(
    cluster: Any, recordings: list[str], tmp_path: Path
) -> None:
    work, jobs = deadly(recordings[1], tmp_path, 100), jobs_of(recordings[1:2])
    (lost,) = on_cluster(jobs, cluster.scheduler_address, Console(), work)
    assert isinstance(lost, Finding) and lost.id == 'recording_lost'
    assert lost.values['path'] == recordings[1]


def test_a_scheduler_that_does_not_answer_is_reported(
    recordings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('distributed')
    monkeypatch.setattr('allan_ros.cli.cluster.CONNECT_S', 0.5)
    with pytest.raises(AllanError, match='no Dask scheduler answers at tcp://127'):
        list(on_cluster(jobs_of(recordings), 'tcp://127.0.0.1:9', Console()))


def test_a_cluster_without_workers_is_not_waited_for(
    recordings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip('distributed')
    monkeypatch.setattr('allan_ros.cli.cluster.CONNECT_S', 2.0)
    with distributed.LocalCluster(
        n_workers=0, processes=False, dashboard_address=None
    ) as empty, pytest.raises(AllanError, match='has no worker: start workers'):  # fmt: skip
        list(on_cluster(jobs_of(recordings[:1]), empty.scheduler_address, Console()))
