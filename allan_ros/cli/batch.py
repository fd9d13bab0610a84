# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Analysis of separate recordings or topics: results for each, and a summary of all.

Recordings are read in this process, in several processes, or on a Dask cluster.
"""

from __future__ import annotations

import argparse
import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import product
from pathlib import Path
from typing import Any

from ..api import ResultSettings, fit_recorded
from ..core.errors import AllanError, one_line
from ..core.findings import SEVERITIES, Finding, finding
from ..core.fit.interpretation import ADVISED_TERMS
from ..core.imu import SENSORS, sensor_of
from ..io.documents import results_to_document
from ..io.files import write_atomic
from ..io.format import known_numbers, markdown_rows, shown_unit, value_text
from ..io.plot_style import PictureSettings
from ..io.readers.recording import topics_of
from ..io.recorded import ReadJob, RecordingSums, read_recording
from ..io.results import Results
from ..io.verdict import WORDS, verdict_of
from .console import Console
from .main import RECORDINGS
from .options import settings_of

EXIT_FAILED = 3

METADATA = 'metadata.yaml'

STORAGES = ('.mcap', '.db3')
"""Suffixes of files that can be parts of a split bag."""

SPLIT = re.compile(r'^(.*)_\d+$')
"""Name of a part of a split bag without suffix: rosbag2 appends a number."""


@dataclass(frozen=True)
class Outcome:
    """The results of one recording, or the reason why there are none."""

    path: str
    name: str  # name of the file, with the topic if the recording has several
    results: Results | None = None
    error: str = ''

    @property
    def folder(self) -> str:
        """Name of the folder for its files."""
        return folder_name(self.name)


def recordings_in(path: str) -> list[str]:
    """Return the paths of all recordings in a folder, or only ``path`` if it is one recording.

    A folder is one recording if it has a metadata.yaml, or contains only one bag or its numbered
    parts.
    """
    folder = Path(path)
    if not folder.is_dir() or (folder / METADATA).exists():
        return [path]
    children = sorted(folder.iterdir())
    files = [child for child in children if child.suffix.lower() in RECORDINGS and child.is_file()]
    bags = [child for child in children if child.is_dir() and (child / METADATA).is_file()]
    splits = {match[1] for file in files if (match := SPLIT.match(file.stem))}
    one_bag = len(splits) < 2 and all(
        file.suffix in STORAGES and (len(files) == 1 or SPLIT.match(file.stem)) for file in files
    )
    if one_bag and not bags:
        return [path]
    return [str(each) for each in (*bags, *files)]


def run_batch(jobs: Sequence[ReadJob], args: argparse.Namespace) -> int:
    """Analyze each recording, write its files, and print and write a summary of all.

    The exit code is 3 if ``--fail-on`` applies to any recording, 1 if any could not be analyzed,
    else 0.
    """
    console = Console.of(args)
    outcomes: list[Outcome] = []
    with console.progress(f'{len(jobs)} recordings', len(jobs)) as progress:
        for outcome in _outcomes(jobs, args):
            outcomes.append(outcome)
            progress.advance(1)
    units = args.units
    if args.output:
        for name, text_of in zip(SUMMARY, (_csv, _markdown, _html)):
            write_atomic(Path(args.output) / name, text_of(outcomes, units))
    if console.json:
        console.document({'recordings': [_document(outcome, units) for outcome in outcomes]})
    else:
        print(_markdown(outcomes, units), end='')
    if args.output:
        console.say(f'written to {args.output}: one folder each, {", ".join(SUMMARY)}')
    if any(o.results is not None and fails(o.results, args.fail_on) for o in outcomes):
        return EXIT_FAILED
    return 1 if any(outcome.error for outcome in outcomes) else 0


def fails(results: Results, severity: str | None) -> bool:
    """Return whether ``--fail-on`` applies: a finding of this severity, or an exceeded limit."""
    if severity is None:
        return False
    enough = SEVERITIES[: SEVERITIES.index(severity) + 1]
    return results.verdict.level == 'failed' or any(f.severity in enough for f in results.findings)


def _outcomes(jobs: Sequence[ReadJob], args: argparse.Namespace) -> Iterator[Outcome]:
    """Yield the outcomes in the order of the jobs; several processes or a cluster may run them."""
    names = names_of(jobs)
    if args.scheduler:
        read = on_cluster(jobs, args.scheduler, Console.of(args))
        for job, name, recorded in zip(jobs, names, read):
            if isinstance(recorded, Finding):
                yield Outcome(job.path, name, error=str(recorded))
            else:
                yield analyze_one(job, name, args, recorded)
        return
    if min(args.jobs, len(jobs)) == 1:
        yield from map(analyze_one, jobs, names, [args] * len(jobs))
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(min(args.jobs, len(jobs)), mp_context=get_context('spawn')) as pool:
        yield from pool.map(analyze_one, jobs, names, [args] * len(jobs))


def analyze_one(
    job: ReadJob, name: str, args: argparse.Namespace, recorded: RecordingSums | None = None
) -> Outcome:
    """Fit one recording, write its files to its folder, and return its results or the error.

    ``name`` is the name of the recording in the summary. ``recorded`` has its sums; if None, the
    recording is read.
    """
    outcome = Outcome(job.path, name)
    folder = Path(args.output) / outcome.folder if args.output else None
    try:
        results, _ = fit_and_write(recorded or read_recording(job), args, folder)
    except AllanError as error:
        return replace(outcome, error=str(error))
    return replace(outcome, results=results)


def fit_and_write(
    recorded: RecordingSums, args: argparse.Namespace, folder: str | Path | None
) -> tuple[Results, list[str]]:
    """Fit the sums; write the files if ``folder`` is given. Return results and file names."""
    console, settings = Console.of(args), settings_of(ResultSettings, args)
    with console.timed(f'fitted by {settings.method}'):
        results = fit_recorded(recorded, settings)
    if not folder:
        return results, []
    from ..io.result_files import write_result_files

    with console.timed('drawn and written'):
        results, paths = write_result_files(
            folder,
            results,
            command=args.command_line,
            units=settings.units,
            targets=settings.export,
            pictures=settings_of(PictureSettings, args),
        )
    return results, sorted(path.name for path in paths)


def split_by_topic(jobs: Sequence[ReadJob]) -> list[ReadJob]:
    """Replace each job for a bag without a selected topic by one job for each Imu topic."""
    separate = []
    for job in jobs:
        topics = [] if job.reading.topic else topics_of(job.path)
        each = [replace(job, reading=replace(job.reading, topic=topic)) for topic in topics]
        separate += each if len(each) > 1 else [job]
    return separate


def names_of(jobs: Sequence[ReadJob]) -> list[str]:
    """Return a unique name for each job: its file name, followed by the topic if needed."""
    names: list[str] = []
    for job in jobs:
        several = sum(other.path == job.path for other in jobs) > 1
        name = Path(job.path).name + (f' {job.reading.topic}' if several else '')
        taken, number, one = {folder_name(other) for other in names}, 1, name
        while folder_name(one) in taken:
            number += 1
            one = f'{name} {number}'
        names.append(one)
    return names


def folder_name(name: str) -> str:
    """Return a name with all characters except letters, digits, +, - and _ replaced by _."""
    return re.sub(r'[^\w+-]+', '_', name)


SUMMARY = ('summary.csv', 'summary.md', 'summary.html')
"""Files of the summary, next to the folders of the recordings."""

COLUMNS = (
    'recording', 'verdict', 'hours', 'axis', 'term', 'value', 'low95', 'high95', 'upper95', 'unit',
)  # fmt: skip


def _csv(outcomes: Sequence[Outcome], units: str) -> str:
    """Return a CSV table with one row for each coefficient of each recording."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator='\n')
    writer.writerow(COLUMNS)
    for outcome in outcomes:
        name = one_line(outcome.name)
        if outcome.results is None:
            writer.writerow([name, 'error', *[''] * (len(COLUMNS) - 2)])
            continue
        level, hours = outcome.results.verdict.level, f'{outcome.results.duration_s / 3600.0:.4g}'
        for axis, result in outcome.results.axes.items():
            for term, c in result.fit.noise.items():
                unit = shown_unit(axis, term, units)
                numbers = ('' if n is None else f'{n:g}' for n in known_numbers(c, unit))
                writer.writerow([name, level, hours, axis, term, *numbers, unit.name])
    return file.getvalue()


def _rows(outcomes: Sequence[Outcome], units: str) -> Iterator[list[str]]:
    """Yield a row for each recording: verdict, hours, and N, B and K of all axes."""
    for outcome in outcomes:
        results, cells = outcome.results, [one_line(outcome.name)]
        if results is None:
            cells += ['error', one_line(outcome.error)]
            yield cells + [''] * (len(_head(units)) - len(cells))
            continue
        cells += [WORDS[results.verdict.level].lower(), f'{results.duration_s / 3600.0:.3g}']
        for sensor, term in product(SENSORS, ADVISED_TERMS):
            unit = shown_unit(sensor, term, units)
            noise = [a.fit.noise for name, a in results.axes.items() if sensor_of(name) == sensor]
            cells.append(' / '.join(value_text(n[term], unit) for n in noise) or '-')
        yield cells


def _head(units: str) -> list[str]:
    terms = [
        f'{sensor} {term} x / y / z [{shown_unit(sensor, term, units).name}]'
        for sensor, term in product(SENSORS, ADVISED_TERMS)
    ]
    return ['recording', 'verdict', 'hours', *terms]


def _markdown(outcomes: Sequence[Outcome], units: str) -> str:
    return markdown_rows([_head(units), *_rows(outcomes, units)])


def _html(outcomes: Sequence[Outcome], units: str) -> str:
    """Return the summary as an HTML page with a link to each report."""
    body = ''
    for outcome, row in zip(outcomes, _rows(outcomes, units)):
        name, *cells = row
        link = f'<a href="{escape(outcome.folder)}/report.html">{escape(name)}</a>'
        first = link if outcome.results is not None else escape(name)
        body += f'<tr><th>{first}</th>{"".join(f"<td>{escape(c)}</td>" for c in cells)}</tr>\n'
    head = ''.join(f'<th>{escape(text)}</th>' for text in _head(units))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Summary</title>'
        '<meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        '<style>body{font:1rem system-ui,sans-serif;margin:2rem}table{border-collapse:collapse}'
        'th,td{text-align:left;padding:.4rem .8rem .4rem 0;border-bottom:1px solid #ccc}</style>'
        f'</head><body><h1>{len(outcomes)} recordings</h1><table><thead><tr>{head}</tr></thead>'
        f'<tbody>{body}</tbody></table></body></html>\n'
    )


def _document(outcome: Outcome, units: str) -> dict[str, object]:
    if outcome.results is None:
        return {'path': outcome.path, 'error': outcome.error}
    verdict = verdict_of(outcome.results, units=units).to_document()
    results = results_to_document(outcome.results, curves=False)
    return {'path': outcome.path, 'verdict': verdict, 'results': results}


CONNECT_S = 10.0
"""Longest time in s to wait for a scheduler."""

WORKER_CHECK_S = 30.0
"""Time in s between two checks that the cluster has workers."""

NO_WORKER_S = 120.0
"""Time in s without any worker after which a job fails. A cluster restarts dead workers within
seconds, on a busy machine within a minute."""


def on_cluster(
    jobs: Sequence[ReadJob],
    address: str,
    console: Console,
    work: Callable[[ReadJob], RecordingSums] = read_recording,
) -> Iterator[RecordingSums | Finding]:
    """Run ``work`` for each job on a Dask cluster; yield its sums, or a finding if it failed.

    The workers need this package and the same paths. If a worker crashes, another one repeats its
    jobs. A job fails if it crashes several workers (``distributed.scheduler.allowed-failures``).
    Raises AllanError when Dask is not installed, or no scheduler with workers answers at
    ``address``.
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
        # not pure: a recording may have changed since an earlier analysis with the same job
        futures = client.map(work, jobs, pure=False)
        interrupted: list[ReadJob] = []
        for job, future in zip(jobs, futures):
            try:
                recorded = _result(client, future)
            except KilledWorker:
                interrupted.append(job)
                continue
            outcomes[job] = recorded
            progress.advance(recorded.provenance.counts.received)
        # a crash also loses the queued jobs of the worker: repeat each alone to find the cause
        for job in interrupted:
            try:
                outcomes[job] = _result(client, client.submit(work, job, pure=False))
            except KilledWorker:
                outcomes[job] = finding('recording_lost', path=job.path)
    yield from (outcomes[job] for job in jobs)


def _result(client: Any, future: Any) -> RecordingSums:
    """Wait for the result of a job; raise AllanError after `NO_WORKER_S` without workers."""
    from distributed import TimeoutError as Unfinished

    waited = 0.0
    while waited < NO_WORKER_S:
        try:
            made: RecordingSums = future.result(timeout=WORKER_CHECK_S)
            return made
        except Unfinished:
            # a timeout of the job itself, for example of a remote disk
            if future.status == 'error':
                raise
            waited = 0.0 if client.nthreads() else waited + WORKER_CHECK_S
    raise AllanError(
        f'the cluster at {client.scheduler.address} has no worker: start workers with '
        'allan_ros, or check their logs for the reason'
    )
