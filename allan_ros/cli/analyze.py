# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The verbs `analyze` and `check`, which read recordings."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path

from ..api.analysis import ResultSettings, is_document
from ..core.errors import AllanError, one_line
from ..core.findings import Finding
from ..core.imu import sensor_of
from ..core.settings import SegmenterSettings, check_rate
from ..export import target_of
from ..readers import FORMATS, SUFFIXES, ReadOptions
from ..readers.recording import BAG_SUFFIXES, METADATA, listed
from ..readers.recording_sums import (
    ReadJob,
    RecordingSums,
    add_recordings,
    read_in_processes,
    read_in_turn,
)
from ..readers.serials import SerialRule
from ..results.datasheets import load_sensor
from ..results.documents import RESULTS, load, load_sums
from ..results.plan import load_plan
from ..view.batch_files import SUMMARY
from ..view.finding_text import finding_line
from ..view.result_document import result_document
from ..view.verdict_text import verdict_of
from .batch import MOST_NAMED, run_batch, run_check, unread_units
from .cluster import on_cluster
from .console import EXIT_ERROR, Console, colored, width
from .options import Command, Option, Settings, settings_of
from .outcomes import (
    EXIT_FAILED,
    EXIT_UNJUDGED,
    BatchItem,
    exit_code_of,
    fit_and_write,
    names_of,
    split_by_topic,
)
from .result_lines import findings_lines, results_lines

EXITS = {
    0: 'done, even if a finding is an error',
    EXIT_FAILED: 'with --fail-on: a finding of this or a higher severity, or an exceeded limit',
}
"""Exit code of `analyze` -> meaning; other exit codes mean the same for all verbs."""

FAIL_ON = (
    Option(
        ('--fail-on',),
        f'exit with {EXIT_FAILED} at a finding of this or a higher severity, or if a limit of the '
        'datasheet or the earlier run is exceeded',
        '{warning,error}',
        choices=('warning', 'error'),
    ),
)

READ: tuple[Option | Settings, ...] = (
    Option(
        ('--rate',),
        'sample rate, with which the stamps are compared, and from which missing stamps are '
        'computed',
        'HZ',
        parse=float,
        default=0.0,
    ),
    Option(
        ('--hardware-id',),
        'serial number of the IMU; Allan sums of an axis are added only if these numbers agree',
        'TEXT',
        default='',
    ),
    Settings('data at rest', SegmenterSettings, ['declared_rate', 'motion_ratio', 'rate_limit']),
    Settings('reading', ReadOptions, ['rate_hz']),
)
"""Options for reading recordings and selecting the data at rest."""

INPUTS = (
    Option(
        ('inputs',),
        'recording, Allan sums of an earlier analysis, or a folder of recordings',
        'INPUT',
        nargs='+',
    ),
    Option(
        ('-o', '--output'),
        'folder for the results and the report (default: none)',
        'DIR',
    ),
    Option(
        ('--overwrite',),
        'replace results of another recording, and files that allan_ros did not write, in this '
        'folder',
    ),
    Option(('--jobs',), 'read N recordings in parallel', 'N', parse=int, default=1),
    Option(
        ('--scheduler',),
        'read on the Dask cluster of this scheduler, for example tcp://host:8786; its workers '
        'must see the same paths',
        'ADDRESS',
    ),
)

STORAGES = ('.mcap', '.db3')
"""Suffixes of bag files, which can be parts of a split bag."""

SPLIT = re.compile(r'^(.*)_(0|[1-9]\d*)$')
"""Pattern of the name, without suffix, of one file of a split bag. rosbag2 appends the number of
the file, from 0 on, to the name of the bag."""


def recordings_in(path: str, files_are_units: bool = False) -> list[str]:
    """Return the paths of the recordings in a folder, or only ``path`` if it is one recording.

    A folder is one recording if it has a metadata.yaml, or if the only recording in it is a bag of
    one .mcap or .db3 file, or of numbered files of these formats. With ``files_are_units``,
    numbered files without metadata.yaml are separate recordings. A subfolder is a recording if it
    contains a metadata.yaml or files of a bag. If a folder contains folders with a results.json and
    no recording, the paths of these folders are returned. A folder that is itself the result of an
    analysis, or contains nothing to read, is returned as it is, too. The paths are sorted, with the
    folders of bags before the files.

    Raises AllanError if a folder is the result of an analysis, and also contains recordings or
    folders with a results.json: only some of them would be read.
    """
    folder = Path(path)
    if not folder.is_dir():
        return [path]
    children = sorted(folder.iterdir())
    files = [child for child in children if child.suffix.lower() in SUFFIXES and child.is_file()]
    files = [file for file in files if file.name != SUMMARY]
    bags = [child for child in children if _contains_a_bag(child)]
    analyses = [child for child in children if (child / RESULTS).is_file()]
    metadata = [child for child in children if child.name == METADATA]
    if is_document(folder):
        if others := [*bags, *files, *metadata, *analyses]:
            names = listed([child.name for child in others], MOST_NAMED)
            raise AllanError(
                f'{path}: has the results of an analysis and also {names}: move the results to '
                'another folder, or give the recordings instead of this folder'
            )
        return [path]
    if metadata:
        return [path]
    if _is_one_bag(files, files_are_units) and not bags:
        return [str(each) for each in analyses] if analyses and not files else [path]
    return [str(each) for each in (*bags, *files)]


def _contains_a_bag(path: Path) -> bool:
    """Return whether a path is a folder that contains a metadata.yaml or files of a bag."""
    try:
        return any(child.name.endswith((METADATA, *BAG_SUFFIXES)) for child in path.iterdir())
    except OSError:  # the path is a file or an unreadable folder
        return False


def _is_one_bag(files: Sequence[Path], files_are_units: bool) -> bool:
    """Return whether the names of the files suggest that together they are one bag.

    The suffix of each file must be in `STORAGES`. Several files must be named NAME_0, NAME_1 and so
    on, without a missing number; with ``files_are_units``, they are never one bag. Returns True if
    there are no files.
    """
    if not all(file.suffix in STORAGES for file in files):
        return False
    if files_are_units or len(files) < 2:
        return len(files) < 2
    splits = [match for file in files if (match := SPLIT.match(file.stem))]
    numbers = sorted(int(match[2]) for match in splits)
    return len({match[1] for match in splits}) == 1 and numbers == list(range(len(files)))


def read_jobs(
    paths: Sequence[str], args: argparse.Namespace, with_context: bool = False
) -> list[ReadJob]:
    """Return a job for each recording, with the reading options of the command line.

    Parameters
    ----------
    paths : sequence of str
        Paths of the recordings.
    args : Namespace
        Arguments of the command line.
    with_context : bool
        Whether the signals and events for a report are read, too.

    Raises
    ------
    AllanError
        When an option is invalid.
    """
    check_rate(args.rate)
    if args.jobs < 1:
        raise AllanError(f'--jobs {args.jobs}: give the number of processes, at least 1')
    reading = settings_of(ReadOptions, args, rate_hz=args.rate)
    segmenter = settings_of(SegmenterSettings, args, declared_rate=args.rate)
    if args.serial_from and args.hardware_id:
        raise AllanError(
            '--hardware-id and --serial-from both state serial numbers: give only one of them'
        )
    return [ReadJob(path, reading, segmenter, args.hardware_id, with_context) for path in paths]


def run(args: argparse.Namespace) -> int:
    """Analyze the recordings, write the files, and print the results; return the exit code."""
    _check_references(settings_of(ResultSettings, args))
    for name in args.export:
        target_of(name)
    for name in ('export', 'plots'):
        if getattr(args, name) and not args.output:
            raise AllanError(f'--{name} needs a folder: give one with -o')
    console = Console.of(args)
    paths = [path for input_path in args.inputs for path in recordings_in(input_path)]
    jobs = read_jobs(paths, args, bool(args.output))
    if len(paths) == 1 or (len(paths) > len(args.inputs) and not are_two_sensors(jobs)):
        topic_jobs = split_by_topic(jobs)
        if len(topic_jobs) > 1:
            return run_batch(topic_jobs, args)
    if args.serial_from:
        rule = SerialRule(args.serial_from)
        jobs = [replace(job, hardware_id=rule.serial_of(job.path)) for job in jobs]
    earlier_sums = [load_sums(job.path) for job in jobs if is_document(job.path)]
    read_outcomes = list(
        _read_all([job for job in jobs if not is_document(job.path)], args, console)
    )
    lost_recordings = [outcome for outcome in read_outcomes if isinstance(outcome, Finding)]
    recordings = [outcome for outcome in read_outcomes if not isinstance(outcome, Finding)]
    if not recordings and not earlier_sums:
        raise AllanError('; '.join(finding_line(finding) for finding in lost_recordings))
    return show_results(
        add_recordings([*recordings, *earlier_sums]).with_findings(lost_recordings), args
    )


def are_two_sensors(jobs: Sequence[ReadJob]) -> bool:
    """Return whether the jobs read two tables: one of a gyro, and one of an accelerometer.

    Phone apps write such pairs of tables.
    """
    suffixes = FORMATS['table'].suffixes
    if len(jobs) != 2 or not all(Path(job.path).suffix.lower() in suffixes for job in jobs):
        return False
    sensors = []
    for job in jobs:
        # if the table cannot be opened, the error is reported when its samples are read
        with suppress(AllanError):
            recording = job.open()
            sensors.append({sensor_of(axis) for axis in recording.axes})
            recording.close()
    return sensors in ([{'gyro'}, {'accel'}], [{'accel'}, {'gyro'}])


def _check_references(settings: ResultSettings) -> None:
    """Raise AllanError if the datasheet or an earlier run in the settings cannot be read."""
    if settings.sensor:
        load_sensor(settings.sensor)
    for path in filter(None, (settings.baseline, settings.noise)):
        load(path)


def show_results(recorded: RecordingSums, args: argparse.Namespace) -> int:
    """Fit the Allan sums of recordings, write the files to ``--output``, and print the results.

    Returns the exit code: 3 if ``--fail-on`` applies, 1 if no coefficient could be computed or a
    requested export file was not written, else 0.
    """
    console, settings = Console.of(args), settings_of(ResultSettings, args)
    results, names = fit_and_write(recorded, args, args.output)
    missing_files = {target_of(name).file_name for name in args.export} - {*names}
    written_text = one_line(f'written to {args.output}: {", ".join(names)}') if names else ''
    if console.json:
        console.document(result_document(results, settings.units))
        if not console.quiet:
            lines = findings_lines(results, settings.units, width(), colored(sys.stderr), True)
            print('\n'.join(lines).strip(), file=sys.stderr)
        if written_text:
            console.say(written_text)
    elif not (console.quiet and written_text):
        verdict = verdict_of(results, settings.units)
        style = width(), colored(sys.stdout), console.verbose
        print('\n'.join(results_lines(results, verdict, settings.units, *style)))
        if written_text:
            print(f'\n{written_text}')
    for finding in results.findings:
        if finding.id == 'file_left_out' and finding.values['file'] in missing_files:
            print(f'allan analyze: {finding_line(finding)}', file=sys.stderr)
    return exit_code_of(results, args.fail_on) or (EXIT_ERROR if missing_files else 0)


def _read_all(
    jobs: Sequence[ReadJob], args: argparse.Namespace, console: Console
) -> Iterator[RecordingSums | Finding]:
    """Yield the Allan sums of each recording.

    The recordings are read in this process, in several processes, or on a cluster. If workers of a
    cluster crashed while they read a recording, a finding is yielded instead of the Allan sums.
    Raises AllanError if a recording cannot be read; on a cluster, the exception of the worker.
    """
    if args.scheduler and jobs:
        for recorded in on_cluster(jobs, args.scheduler, console):
            if isinstance(recorded, Exception):
                raise recorded
            yield recorded
        return
    if min(args.jobs, len(jobs)) > 1:
        yield from read_in_processes(jobs, args.jobs, console)
    else:
        yield from read_in_turn(jobs, console)


def check(args: argparse.Namespace) -> int:
    """Print the decision about each unit (one IMU), and return the worst exit code of the units."""
    _check_references(settings_of(ResultSettings, args))
    if args.plan:
        load_plan(args.plan)
    if args.serial_from:
        SerialRule(args.serial_from)
    units: dict[str, list[str]] = {}
    paths_of_inputs = {path: recordings_in(path, files_are_units=True) for path in args.inputs}
    for path in chain.from_iterable(paths_of_inputs.values()):
        bag = Path(path).parent
        is_split = Path(path).suffix in STORAGES and (bag / METADATA).is_file()
        paths = units.setdefault(str(bag) if is_split else path, [])
        paths += [] if path in paths else [path]
    if args.hardware_id and len(units) > 1:
        raise AllanError(
            '--hardware-id is the number of one IMU: check each unit by itself, or use '
            '--serial-from'
        )
    jobs = [read_jobs(paths, args, bool(args.output)) for paths in units.values()]
    short_names = names_of([unit_jobs[0] for unit_jobs in jobs])
    unread_outcomes = [
        outcome
        for folder, paths in paths_of_inputs.items()
        # if the folder has recordings, they are read again
        if all(path == folder or is_document(path) for path in paths)
        for outcome in unread_units(folder)
    ]
    return run_check(
        [BatchItem(*unit) for unit in zip(units, jobs, short_names)], args, unread_outcomes
    )


ANALYZE_TEXT = f"""
Measure the noise of an IMU from its recordings.

An input is a rosbag2 folder, a file ({', '.join(SUFFIXES)}), or
the Allan sums of an earlier analysis: its folder, sums.json, or the checkpoint of a node. Several
inputs must be of the same IMU: their Allan sums are added. A folder of separate recordings is a
batch: each recording has its own results, and a summary lists all recordings. The same applies to a
bag with several Imu topics, unless several inputs are given.

  allan analyze my_bag -o results
  allan analyze monday.mcap results_of_tuesday -o results --export openvins,px4
  allan analyze folder_of_recordings -o results --jobs 2
  allan analyze table.csv --columns t,gx,gy,gz,ax,ay,az --gyro-unit deg/s
  allan analyze my_bag --json | jq .axes.gyro_x.noise.N.value
"""

CHECK_TEXT = """
Check IMUs for production tests and continuous integration: one line for each unit, the totals, and
an exit code. A unit passes only if every limit is met and nothing makes it suspect.

An input is a recording, a results.json, the folder of an analysis, or a folder of these. Each
recording and each analysis is one unit; the files of a split bag are one unit together. A unit is
compared with the limits of --plan, with the datasheet of --sensor, and with the accepted earlier
run of --baseline, if they are given.
`allan sensors NAME --as-plan` prints a plan to start with.

  allan check my_bag --sensor adis16475-3
  allan check units --plan line4.yaml -o lot7
  allan check units/*.mcap --baseline accepted/results.json --fail-on warning --jobs 2
  allan check units --sensor my_imu.yaml --json > verdicts.jsonl
"""

SERIAL_FROM = (
    Option(
        ('--serial-from',),
        'serial numbers of several units: name:PATTERN (a regular expression for the file name, '
        'of which the first group is used), column:NAME (of a table), or metadata:KEY (custom '
        'data of a rosbag2)',
        'RULE',
        default='',
    ),
)

CHECK_INPUTS = (
    Option(
        ('inputs',), 'recording of one unit, its results, or a folder of units', 'INPUT', nargs='+'
    ),
    Option(
        ('--plan',),
        'test plan: a YAML file with limits of N, B, K, bias, rate ...',
        'FILE',
        default='',
    ),
    Option(
        ('-o', '--output'),
        'folder for the results of each unit, summary.csv and index.html (default: none)',
        'DIR',
        default='',
    ),
    Option(
        ('--overwrite',),
        'replace results of another recording, and files that allan_ros did not write, in this '
        'folder',
    ),
    Option(('--jobs',), 'check N units in parallel', 'N', parse=int, default=1),
)

ANALYZE = Command(
    ANALYZE_TEXT,
    [*INPUTS, *SERIAL_FROM, Settings('result', ResultSettings), *FAIL_ON, *READ],
    run,
    EXITS,
)

CHECK = Command(
    CHECK_TEXT,
    [
        *CHECK_INPUTS,
        *SERIAL_FROM,
        Settings('result', ResultSettings, ['export', 'plots']),
        *FAIL_ON,
        *READ,
    ],
    check,
    {
        0: 'every unit meets every limit, and nothing makes it suspect',
        EXIT_FAILED: 'a unit failed; of several units, the first of 70, 3, 1 and 4 that occurs '
        'is the exit code',
        EXIT_UNJUDGED: 'a unit is not judged: there are too few data, a warning, or nothing to '
        'compare with',
    },
)
