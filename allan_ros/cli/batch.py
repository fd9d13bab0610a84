# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Analysis of several units: results for each, and a summary of all.

Recordings are read in this process, in several processes, or on a Dask cluster.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..api import is_document
from ..core.errors import AllanError, one_line
from ..core.estimate import value_text
from ..core.fields import plain
from ..core.findings import SEVERITIES, Finding, by_consequence, finding
from ..core.fit.interpretation import ADVISED_TERMS
from ..core.imu import SENSORS, sensor_of, shown_unit
from ..readers import topics_of
from ..readers.files import write_atomic
from ..readers.recorded import ReadJob, RecordingSums, add_recordings, read_recording
from ..results.analysis import analyze_recorded
from ..results.documents import load, load_sums, results_to_document
from ..results.references import compared
from ..results.results import Results
from ..results.verdict import WORDS, Verdict, finding_text
from ..view.coefficient_table import NUMBERS, coefficient_list
from ..view.settings import ResultSettings
from ..view.table import Record, csv_text, records
from .console import EXIT_ERROR, EXIT_FAULT, Console, colored, fault_text, painted
from .options import settings_of
from .tables import LEVEL_COLORS

EXIT_FAILED, EXIT_UNJUDGED = 3, 4

WORST_FIRST = (EXIT_FAULT, EXIT_FAILED, EXIT_ERROR, EXIT_UNJUDGED, 0)
"""Exit codes of units; the first one that occurs is the exit code of all."""

MOST_NAMED = 10
"""Largest number of units that are named for each verdict in the totals."""


@dataclass(frozen=True)
class Unit:
    """One IMU in a batch: its name in the summary, and the jobs that read its recordings."""

    name: str
    jobs: Sequence[ReadJob]

    @property
    def path(self) -> str:
        """The path of the first recording."""
        return self.jobs[0].path


@dataclass(frozen=True)
class Outcome:
    """The results of one unit, or the reason why there are none."""

    unit: Unit
    results: Results | None = None
    error: str = ''
    code: int = EXIT_ERROR  # exit code if there are no results


def run_batch(jobs: Sequence[ReadJob], args: argparse.Namespace) -> int:
    """Analyze each recording, write its files, print one line for each, and write a summary.

    The exit code is the worst of the recordings.
    """
    console, outcomes, codes = Console.of(args), [], []
    if args.output:
        from ..view.result_files import made_folder

        made_folder(Path(args.output))
    for outcome in _outcomes([Unit(n, [job]) for n, job in zip(names_of(jobs), jobs)], args):
        outcomes.append(outcome)
        codes.append(outcome.code)
        if outcome.results is not None:
            codes[-1] = exit_code_of(outcome.results, args.fail_on)
        if console.json:
            console.line(_batch_document(outcome, args.units))
        elif not (console.quiet and args.output):
            _print_unit(outcome, *_verdict_on(outcome, args.units), '', args)
    found = [f for outcome in outcomes if outcome.results for f in outcome.results.findings]
    for elsewhere in [f for f in found if f.id == 'sensor_elsewhere'][:1]:
        console.say(str(elsewhere))
    if args.output:
        write_atomic(Path(args.output) / SUMMARY, _csv(outcomes, args.units))
        console.say(f'written to {args.output}: one folder each, {SUMMARY}')
    return _worst(codes)


def run_check(units: Sequence[Unit], args: argparse.Namespace) -> int:
    """Print one line for each unit as it finishes, and the totals; return the worst exit code."""
    console, codes = Console.of(args), []
    known: dict[object, str] = {}
    named: dict[str, list[str]] = {}
    for outcome in _outcomes(units, args):
        code, word, verdict, note = _judged(outcome, args, known)
        codes.append(code)
        named.setdefault(word, []).append(Path(outcome.unit.name).name)
        if console.json:
            console.line(_check_document(outcome, code, verdict, note))
        elif outcome.results is None and len(units) == 1 and code == EXIT_ERROR:
            raise AllanError(outcome.error)
        elif not console.quiet:
            _print_unit(outcome, word, verdict, note, args)
            for reason in verdict.reasons if console.verbose else ():
                print(f'  {reason}')
    if len(units) > 1 and console.json:
        totals = {word: len(names) for word, names in named.items()}
        console.line({'units': len(units), 'totals': totals, 'exit_code': _worst(codes)})
    elif len(units) > 1 and not console.quiet:
        texts = [_total(*each) for each in sorted(named.items(), key=lambda each: -len(each[1]))]
        print(f'{len(units)} units: {", ".join(texts)}')
    return _worst(codes)


def _total(word: str, names: Sequence[str]) -> str:
    """Return the number of units with a verdict, and their names unless they are healthy."""
    if word == WORDS['healthy'].lower():
        return f'{len(names)} {word}'
    more = f' and {len(names) - MOST_NAMED} more' if len(names) > MOST_NAMED else ''
    return one_line(f'{len(names)} {word} ({", ".join(names[:MOST_NAMED])}{more})')


def _print_unit(
    outcome: Outcome, word: str, verdict: Verdict, note: str, args: argparse.Namespace
) -> None:
    line = one_line(f'{word}: {_unit_text(outcome, verdict, note, args.units)}')
    level = 'failed' if word == WORDS['failed'].lower() else verdict.level
    print(painted(line, word, LEVEL_COLORS[level], colored(sys.stdout)), flush=True)


def _worst(codes: Iterator[int] | Sequence[int]) -> int:
    return min(codes, key=WORST_FIRST.index)


def _verdict_on(outcome: Outcome, units: str) -> tuple[str, Verdict]:
    """Return the verdict on a unit and its word, which is 'error' without results."""
    if outcome.results is None:
        return 'error', Verdict('unknown', outcome.error, (), ())
    verdict = outcome.results.verdicts[units]
    return WORDS[verdict.level].lower(), verdict


def _judged(
    outcome: Outcome, args: argparse.Namespace, known: dict[object, str]
) -> tuple[int, str, Verdict, str]:
    """Return exit code, word and verdict of a unit, and a note if it repeats an earlier one.

    ``known`` maps the samples and serial numbers of earlier units to their names.
    """
    (word, verdict), results = _verdict_on(outcome, args.units), outcome.results
    if results is None:
        return outcome.code, word, verdict, ''
    code = 0
    if verdict.level == 'failed' or fails(results, args.fail_on):
        code = EXIT_FAILED
    elif verdict.level in ('measured', 'unknown'):
        code = EXIT_UNJUDGED
    note = ''
    values = [c.value for axis in results.axes.values() for c in axis.fit.noise.values()]
    samples = (results.samples, *values) if any(values) else None
    for key, what in ((samples, 'the samples'), (results.identity.hardware_id, 'the serial')):
        if key and known.setdefault(key, outcome.unit.name) != outcome.unit.name:
            note = note or f'duplicate: it has {what} of {known[key]}'
    if note and not code:
        code = EXIT_UNJUDGED  # one of the two was not measured
    words = {EXIT_FAILED: WORDS['failed'], EXIT_UNJUDGED: WORDS['unknown']}
    word = words.get(code, word).lower()
    return code, word, verdict, note


def _unit_text(outcome: Outcome, verdict: Verdict, note: str, units: str) -> str:
    """Return name, serial number, reason and N of a unit as one line."""
    results = outcome.results
    if results is None:
        return outcome.error
    serial = results.identity.hardware_id
    numbers = []
    for sensor in SENSORS:
        unit = shown_unit(sensor, 'N', units)
        noise = [a.fit.noise for axis, a in results.axes.items() if sensor_of(axis) == sensor]
        cells = [value_text(terms['N'], unit) for terms in noise]
        numbers += [f'{sensor} N {" ".join(cells)} {unit.name}'] if cells else []
    # a warning is stated if it caused the verdict, an error such as wrong units always
    stated = ('error', 'warning') if verdict.level == 'attention' else ('error',)
    found = [f for f in by_consequence(results.findings) if f.severity in stated][:1]
    reasons = [
        f.remedy
        if f.message in verdict.summary
        else f'{finding_text(f, results, units)} {f.remedy}'
        for f in found
    ]
    sentences = (text.rstrip('.') for text in (verdict.summary, *reasons))
    parts = (note, *sentences, ', '.join(numbers))
    name = f'{outcome.unit.name}, serial {serial}' if serial else outcome.unit.name
    return f'{name}: {"; ".join(filter(None, parts))}'


def _check_document(outcome: Outcome, code: int, verdict: Verdict, note: str) -> dict[str, Any]:
    """Return the verdict on one unit, with N, B and K in SI, as a JSON object."""
    document: dict[str, Any] = {'name': outcome.unit.name, 'path': outcome.unit.path}
    if outcome.results is None:
        return {**document, 'exit_code': code, 'level': 'error', 'summary': outcome.error}
    axes = {
        axis: {term: result.fit.noise[term].value for term in ADVISED_TERMS}
        for axis, result in outcome.results.axes.items()
    }
    document['serial'] = outcome.results.identity.hardware_id
    document |= {'exit_code': code, **plain(verdict), 'note': note, 'axes': axes}
    # a duplicate is not judged, and --fail-on fails a unit, whatever its numbers are
    if code == EXIT_FAILED or note:
        document['level'] = 'failed' if code == EXIT_FAILED else 'unknown'
    return document


def fails(results: Results, severity: str | None) -> bool:
    """Return whether ``--fail-on`` applies: a finding of this severity, or an exceeded limit."""
    if severity is None:
        return False
    enough = SEVERITIES[: SEVERITIES.index(severity) + 1]
    return results.verdict.level == 'failed' or any(f.severity in enough for f in results.findings)


def exit_code_of(results: Results, fail_on: str | None) -> int:
    """Return the exit code of an analysis: 3 if ``fail_on`` applies, 1 if nothing is measured."""
    if fails(results, fail_on):
        return EXIT_FAILED
    known = (c for axis in results.axes.values() for c in axis.fit.noise.values())
    return 0 if any(c.value is not None for c in known) else EXIT_ERROR


def _outcomes(units: Sequence[Unit], args: argparse.Namespace) -> Iterator[Outcome]:
    """Yield the outcomes in the order of the units; several processes or a cluster may run them."""
    if getattr(args, 'scheduler', None):
        read = on_cluster([unit.jobs[0] for unit in units], args.scheduler, Console.of(args))
        for unit, recorded in zip(units, read):
            yield outcome_of(unit, args, recorded)
        return
    if min(args.jobs, len(units)) == 1:
        yield from map(outcome_of, units, [args] * len(units))
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(min(args.jobs, len(units)), mp_context=get_context('spawn')) as pool:
        yield from pool.map(outcome_of, units, [args] * len(units))


def outcome_of(
    unit: Unit,
    args: argparse.Namespace,
    recorded: RecordingSums | Finding | Exception | None = None,
) -> Outcome:
    """Read and fit one unit, write its files if a folder is given, and return results or error.

    ``recorded`` has its sums, or the reason why there are none; if None, its recordings are read.
    """
    output = getattr(args, 'output', None)
    settings = settings_of(ResultSettings, args)
    try:
        if is_document(unit.path) and not output:
            results = load(unit.path, settings.method)
            references = settings.sensor, settings.baseline, settings.stated_margin
            return Outcome(unit, compared(results, *references))
        if recorded is None:
            recorded = add_recordings(
                load_sums(job.path) if is_document(job.path) else read_recording(job)
                for job in unit.jobs
            )
        elif isinstance(recorded, Exception):
            raise recorded
        elif isinstance(recorded, Finding):
            raise AllanError(str(recorded))
        folder = Path(output) / folder_name(unit.name) if output else None
        return Outcome(unit, fit_and_write(recorded, args, folder)[0])
    except AllanError as error:
        return Outcome(unit, error=str(error))
    except OSError as error:
        return Outcome(unit, error=one_line(f'{unit.path}: {error}: check the path and the disk'))
    except MemoryError:
        return Outcome(unit, error=f'{unit.path}: not enough memory: use fewer --jobs')
    except Exception as error:  # a fault of one unit must not end the batch
        return Outcome(unit, error=one_line(f'{unit.path}: {fault_text(error)}'), code=EXIT_FAULT)


def fit_and_write(
    recorded: RecordingSums, args: argparse.Namespace, folder: str | Path | None
) -> tuple[Results, list[str]]:
    """Fit the sums; write the files if ``folder`` is given. Return results and file names."""
    settings = settings_of(ResultSettings, args)
    results = analyze_recorded(recorded, settings.method)
    results = compared(results, settings.sensor, settings.baseline, settings.margin)
    if not folder:
        return results, []
    from ..view.result_files import write_result_files

    results, paths = write_result_files(
        folder,
        results,
        command=args.command_line,
        units=settings.units,
        targets=settings.export,
        plots=settings.plots,
        overwrite=args.overwrite,
    )
    return results, sorted(path.name for path in paths)


def split_by_topic(jobs: Sequence[ReadJob]) -> list[ReadJob]:
    """Replace each job for a bag without a selected topic by one job for each Imu topic."""
    separate = []
    for job in jobs:
        chosen = job.reading.topic or job.reading.accel_topic
        topics = [] if chosen else topics_of(job.path)
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


SUMMARY = 'summary.csv'
"""File of the summary, next to the folders of the recordings."""

COLUMNS = (
    *('recording', 'serial', 'verdict', 'reason', 'hours'),
    *('axis', 'term', *NUMBERS, 'unit'),
)
"""Columns of the summary."""


def _csv(outcomes: Sequence[Outcome], units: str) -> str:
    """Return a CSV table with one row for each coefficient of each recording."""
    rows: list[Record] = []
    for outcome in outcomes:
        name, results = one_line(outcome.unit.name), outcome.results
        if results is None:
            error = one_line(outcome.error)
            rows.append({'recording': name, 'verdict': 'error', 'reason': error})
            continue
        verdict = results.verdicts[units]
        known: Record = {
            'recording': name,
            'serial': results.identity.hardware_id,
            'verdict': verdict.level,
            'reason': one_line(verdict.summary),
            'hours': f'{results.duration_s / 3600.0:.4g}',
        }
        rows += [{**known, **row} for row in records(coefficient_list(results.noise, units))]
    return csv_text(rows, COLUMNS)


def _batch_document(outcome: Outcome, units: str) -> dict[str, object]:
    if outcome.results is None:
        return {'path': outcome.unit.path, 'name': outcome.unit.name, 'error': outcome.error}
    verdict = plain(outcome.results.verdicts[units])
    results = results_to_document(outcome.results, curves=False)
    named = {'path': outcome.unit.path, 'name': outcome.unit.name}
    return {**named, 'verdict': verdict, 'results': results}


CONNECT_S = 10.0
"""Longest time in s to wait for a scheduler and for its first worker."""


def on_cluster(
    jobs: Sequence[ReadJob],
    address: str,
    console: Console,
    work: Callable[[ReadJob], RecordingSums] = read_recording,
) -> Iterator[RecordingSums | Finding | Exception]:
    """Run ``work`` for each job on a Dask cluster; yield its sums, or why there are none.

    The workers need this package and the same paths. If a worker crashes, another one repeats its
    jobs. A job fails if it crashes several workers (``distributed.scheduler.allowed-failures``).
    Raises AllanError when Dask is not installed, or no scheduler with workers answers at
    ``address``.
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
            f'no Dask scheduler answers at {address}: check the address and that it runs'
        ) from error
    with client, console.progress(f'{len(jobs)} on {address}', None) as progress:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except Unanswered as error:
            raise AllanError(
                f'the cluster at {address} has no worker: start workers with allan_ros'
            ) from error
        # not pure: a recording may have changed since an earlier analysis with the same job
        for job, future in zip(jobs, client.map(work, jobs, pure=False)):
            try:
                recorded: RecordingSums = future.result()
            except KilledWorker:
                yield finding('recording_lost', path=job.path)
                continue
            except Exception as error:  # one recording does not end the others
                yield error
                continue
            progress.advance(recorded.provenance.counts.received)
            yield recorded
