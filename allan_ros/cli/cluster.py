# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read recordings on an existing Dask cluster; jobs of a worker that dies are repeated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..io.recorded import ReadJob, RecordingSums, read_recording
from .console import Console

CONNECT_S = 10.0
"""Seconds to wait for a scheduler."""

ASK_S = 30.0
"""Seconds between two checks that the cluster has workers."""

ALONE_S = 120.0
"""Seconds without any worker after which the job fails: a cluster restarts dead workers within
seconds, on a busy machine within a minute."""


def on_cluster(
    jobs: Sequence[ReadJob],
    address: str,
    console: Console,
    work: Callable[[ReadJob], RecordingSums] = read_recording,
) -> Iterator[RecordingSums | Finding]:
    """Do the jobs on a cluster whose workers have this package and see the same paths.

    Jobs of a worker that dies are repeated by another. A job that kills several workers
    (``distributed.scheduler.allowed-failures``) is given up and replaced by a finding.

    Raises
    ------
    AllanError
        When Dask is not installed, no scheduler answers at the address, it has no workers, or a job
        raised the error.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise AllanError(
            '--scheduler needs Dask, which is not installed: pip install "allan_ros[dask]"'
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError, ImportError) as error:
        raise AllanError(
            f'no Dask scheduler answers at {address}: check the address and that it runs'
        ) from error
    outcomes: dict[ReadJob, RecordingSums | Finding] = {}
    with client, console.progress(f'{len(jobs)} on {address}', None) as progress:
        # a result of an earlier analysis is no answer: the recording may have changed
        futures = client.map(work, jobs, pure=False)
        doubtful: list[ReadJob] = []
        for job, future in zip(jobs, futures):
            try:
                recorded = _made(client, future)
            except KilledWorker:
                doubtful.append(job)
                continue
            outcomes[job] = recorded
            progress.advance(recorded.provenance.counts.received)
        # a dying worker also loses its queued jobs: running alone shows which job is the cause
        for job in doubtful:
            try:
                outcomes[job] = _made(client, client.submit(work, job, pure=False))
            except KilledWorker:
                outcomes[job] = finding('recording_lost', path=job.path)
    yield from (outcomes[job] for job in jobs)


def _made(client: Any, future: Any) -> RecordingSums:
    """Wait for a job as long as there are workers, and return its result."""
    from distributed import TimeoutError as Unfinished

    alone = 0.0
    while alone < ALONE_S:
        try:
            made: RecordingSums = future.result(timeout=ASK_S)
            return made
        except Unfinished:
            if future.status == 'error':  # a timeout of the job itself, such as a remote disk
                raise
            alone = 0.0 if client.nthreads() else alone + ASK_S
    raise AllanError(
        f'the cluster at {client.scheduler.address} has no worker: start workers with '
        'allan_ros, or check their logs for the reason'
    )
