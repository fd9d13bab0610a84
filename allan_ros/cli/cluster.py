# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings spread over an existing Dask cluster: a worker that dies costs its part at most."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from .console import Console
from .parts import Job, Part, accumulate

CONNECT_S = 10.0
"""Seconds to wait for a scheduler."""


def on_cluster(
    jobs: Sequence[Job],
    address: str,
    console: Console,
    work: Callable[[Job], Part] = accumulate,
) -> Iterator[Part | Finding]:
    """Do the jobs on a cluster whose workers have this package and see the same paths.

    What a dead worker had begun is done by another. A job at which workers die again and again
    (``distributed.scheduler.allowed-failures``) is lost, and a finding comes in its place.

    Raises
    ------
    AllanError
        When Dask is not installed, nobody answers at the address, or a job raised it.
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
    outcomes: dict[Job, Part | Finding] = {}
    with client, console.progress(f'{len(jobs)} on {address}', None) as progress:
        # a result of an earlier analysis is no answer: the recording may have changed
        futures = client.map(work, jobs, pure=False)
        doubtful: list[Job] = []
        for job, future in zip(jobs, futures):
            try:
                part: Part = future.result()
            except KilledWorker:
                doubtful.append(job)
                continue
            outcomes[job] = part
            progress.advance(part.run.provenance.counts.received)
        # a worker takes with it what waits there too: only alone it shows which job is deadly
        for job in doubtful:
            try:
                outcomes[job] = client.submit(work, job, pure=False).result()
            except KilledWorker:
                outcomes[job] = finding('recording_lost', path=job.path)
    yield from (outcomes[job] for job in jobs)
