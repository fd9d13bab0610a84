# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read recordings on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..readers.recording_sums import ReadJob, RecordingSums, read_recording
from .console import Console

CONNECT_S = 10.0
"""Longest time in s to wait for a scheduler, and for its first worker."""


def on_cluster(
    jobs: Sequence[ReadJob],
    address: str,
    console: Console,
    work: Callable[[ReadJob], RecordingSums] = read_recording,
) -> Iterator[RecordingSums | Finding | Exception]:
    """Run ``work`` for each job on a Dask cluster, and yield the results or errors.

    The workers need this package, and the recordings at the same paths. If a worker crashes, other
    workers repeat the jobs of that worker. A job fails if it crashes several workers
    (``distributed.scheduler.allowed-failures``).

    Parameters
    ----------
    jobs : sequence of ReadJob
        The recordings to read.
    address : str
        Address of the scheduler, such as tcp://host:8786.
    console : Console
        Shows the progress.
    work : function of a ReadJob
        Returns the Allan sums of a recording.

    Yields
    ------
    RecordingSums, Finding or Exception
        For each job, in the order of the jobs: its Allan sums, a finding if the job crashed its
        workers, or the exception that ``work`` raised.

    Raises
    ------
    AllanError
        When Dask is not installed, or no scheduler with workers answers at ``address``.
    """
    try:
        from distributed import Client, KilledWorker
        from distributed import TimeoutError as Unanswered
    except ImportError as error:
        raise AllanError(
            '--scheduler needs Dask, which is not installed: pip install "allan_ros[dask]"'
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError, ImportError) as error:
        raise AllanError(
            f'no Dask scheduler answers at {address}: check the address and the scheduler'
        ) from error
    with client, console.progress(f'{len(jobs)} on {address}', None) as progress:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except Unanswered as error:
            raise AllanError(
                f'the cluster at {address} has no worker: start workers with allan_ros'
            ) from error
        # pure=False, because a recording may have changed since an earlier analysis of this job
        for job, future in zip(jobs, client.map(work, jobs, pure=False)):
            try:
                recorded: RecordingSums = future.result()
            except KilledWorker:
                yield finding('recording_lost', path=job.path)
                continue
            except Exception as error:  # an error in one recording must not end the other jobs
                yield error
                continue
            progress.advance(recorded.provenance.counts.received)
            yield recorded
