# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise of an IMU from its recordings.

An input is a rosbag2 folder, .mcap, .db3, ROS 1 .bag, .csv, .tsv, .npz, .npy or .ulg. Several
inputs must be recordings of the same IMU: their sums are added. A folder of separate recordings is
analyzed as a batch: each recording has its own results, and a summary lists all. The same applies
to a bag with several Imu topics.

  allan analyze my_bag -o results
  allan analyze monday.mcap tuesday.mcap -o results --export openvins,px4
  allan analyze folder_of_recordings -o results --jobs 2
  allan analyze table.csv --columns t,gx,gy,gz,ax,ay,az --gyro-unit deg/s
  allan analyze my_bag --json | jq .axes.gyro_x.noise.N.value
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..api import ResultSettings, fit_recorded
from ..core.errors import AllanError
from ..core.findings import Finding
from ..core.imu import sensor_of
from ..core.settings import SegmenterSettings, check_rate
from ..io.datasheets import load_sensor
from ..io.documents import RESULTS, load, load_sums, results_to_document
from ..io.exporters import target_of
from ..io.plot_style import PictureSettings, check_pictures
from ..io.readers.recording import ReadOptions
from ..io.recorded import ReadJob, RecordingSums, add_recordings, read_in_processes, read_in_turn
from ..io.results import Results
from ..io.verdict import WORDS, verdict_of
from .batch import (
    EXIT_FAILED,
    fails,
    fit_and_write,
    on_cluster,
    recordings_in,
    run_batch,
    split_by_topic,
)
from .console import Console, colored, painted, width
from .options import Command, Settings, settings_of
from .tables import LEVEL_COLORS, findings_lines, results_lines

EXIT_UNKNOWN = 1

EXITS = {EXIT_FAILED: 'with --fail-on: a finding of that severity, or a limit exceeded'}
"""Exit codes in addition to those of every verb."""

FAIL_ON = f"""
--fail-on {{warning,error}}  exit with {EXIT_FAILED} at a finding of this severity, or if a limit of
    the datasheet or the earlier run is exceeded
"""

WRITTEN = (
    '-o --output DIR  folder for results, plots and report (default: none)',
    Settings('result', ResultSettings),
    FAIL_ON,
    Settings('pictures', PictureSettings),
)
"""Options of the results and of the written files."""

READ = (
    """
    --rate HZ [0]  sample rate, to check the stamps, or to replace missing stamps
    --hardware-id TEXT []  serial number of the IMU; sums with different numbers are never added
    """,
    Settings('data at rest', SegmenterSettings, ['declared_rate']),
    Settings('reading', ReadOptions, ['rate_hz']),
)
"""Options for reading recordings and selecting the data at rest."""

SEVERAL = """
inputs INPUT...  recording, or a folder of them
several recordings:
  --jobs N [1]  read N recordings in parallel
  --merge  add the sums of all recordings of a folder; by default each recording has its own
    results and a line in the summary
  --scheduler ADDRESS  read on the Dask cluster of this scheduler, for example tcp://host:8786; its
    workers must see the same paths
"""


def read_jobs(
    paths: Sequence[str], args: argparse.Namespace, with_context: bool = False
) -> list[ReadJob]:
    """Return a job for each recording, with the reading options of the command line.

    ``with_context`` also requests the data of a report: signal, spectrum and temperature.
    """
    check_rate(args.rate)
    reading = settings_of(ReadOptions, args, rate_hz=args.rate)
    segmenter = settings_of(SegmenterSettings, args, declared_rate=args.rate)
    return [ReadJob(path, reading, segmenter, args.hardware_id, with_context) for path in paths]


def run(args: argparse.Namespace) -> int:
    """Analyze the recordings, write the files, and print the results; return the exit code."""
    check_result_arguments(args)
    if args.jobs < 1:
        raise AllanError(f'--jobs {args.jobs}: give the number of processes, at least 1')
    console = Console.of(args)
    paths = [path for given in args.inputs for path in recordings_in(given)]
    jobs = read_jobs(paths, args, bool(args.output))
    console.detail(f'settings: {_settings_text(jobs[0].reading, jobs[0].segmenter)}')
    if not args.merge and (len(paths) == 1 or len(paths) > len(args.inputs)):
        separate = split_by_topic(jobs)
        if len(separate) > 1:
            return run_batch(separate, args)
    outcomes = list(_read_all(jobs, args, console))
    failed = [outcome for outcome in outcomes if isinstance(outcome, Finding)]
    recordings = [outcome for outcome in outcomes if not isinstance(outcome, Finding)]
    if not recordings:
        raise AllanError('; '.join(str(finding) for finding in failed))
    for recorded in recordings:
        console.detail(_recording_text(recorded))
    return show_results(add_recordings(recordings).with_findings(failed), args)


def check_result_arguments(args: argparse.Namespace) -> None:
    """Raise AllanError if an option for the fit or the files is invalid; nothing is read."""
    _check_references(settings_of(ResultSettings, args))
    check_pictures(settings_of(PictureSettings, args))
    for name in args.export:
        target_of(name)
    if args.export and not args.output:
        raise AllanError('--export needs a folder: give one with -o')


def _check_references(settings: ResultSettings) -> None:
    """Raise AllanError if the datasheet or the earlier run cannot be read."""
    if settings.sensor:
        load_sensor(settings.sensor)
    if settings.baseline:
        load(settings.baseline)


def show_results(recorded: RecordingSums, args: argparse.Namespace) -> int:
    """Fit the sums of recordings, write the files to ``--output``, and print the results.

    The exit code is 3 if ``--fail-on`` applies, 1 if nothing could be computed, else 0.
    """
    console, settings = Console.of(args), settings_of(ResultSettings, args)
    results, names = fit_and_write(recorded, args, args.output)
    written = f'written to {args.output}: {", ".join(names)}' if names else ''
    verdict = verdict_of(results, units=settings.units)
    if console.json:
        console.document(results_to_document(results, units=settings.units))
        if not console.quiet:
            lines = findings_lines(results, settings.units, width(), colored(sys.stderr), True)
            print('\n'.join(lines).strip(), file=sys.stderr)
        if written:
            console.say(written)
    elif not (console.quiet and written):
        style = width(), colored(sys.stdout), console.verbose
        print('\n'.join(results_lines(results, verdict, settings.units, *style)))
        if written:
            print(f'\n{written}')
    if fails(results, args.fail_on):
        return EXIT_FAILED
    known = (c for axis in results.axes.values() for c in axis.fit.noise.values())
    return 0 if any(c.value is not None for c in known) else 1


def _read_all(
    jobs: Sequence[ReadJob], args: argparse.Namespace, console: Console
) -> Iterator[RecordingSums | Finding]:
    """Read the recordings in this process, in several processes, or on a cluster."""
    if args.scheduler:
        return on_cluster(jobs, args.scheduler, console)
    if min(args.jobs, len(jobs)) > 1:
        return read_in_processes(jobs, args.jobs, console)
    return read_in_turn(jobs, console)


def _settings_text(*settings: Any) -> str:
    values = {name: value for s in settings for name, value in asdict(s).items()}
    return ', '.join(f'{name}={value!r}' for name, value in values.items())


def _recording_text(recorded: RecordingSums) -> str:
    """Return one line with path, sample counts, format and topic of a recording."""
    (source,) = recorded.provenance.sources
    what = ' '.join(word for word in (source.topic, source.type) if word)
    # one entry for sensors with the same number of samples
    used = {f'{s.samples:,}': sensor_of(s.axes[0]) for s in recorded.sums}
    each = (f'{number} of {sensor}' if len(used) > 1 else number for number, sensor in used.items())
    return (
        f'{source.path}: {recorded.provenance.counts.received:,} samples from {source.storage}'
        f'{f", {what}" if what else ""}; {", ".join(each)} used'
    )


def check(args: argparse.Namespace) -> int:
    """Analyze the input, or load its results, and print the verdict; return the exit code."""
    settings = settings_of(ResultSettings, args)
    _check_references(settings)
    console = Console.of(args)
    results = _input_results(args, settings, console)
    verdict = verdict_of(results, units=settings.units)
    code = 0
    if verdict.level == 'failed' or fails(results, args.fail_on):
        code = EXIT_FAILED
    elif verdict.level == 'unknown':
        code = EXIT_UNKNOWN
    if console.json:
        console.document({'inputs': args.inputs, 'exit_code': code, **verdict.to_document()})
    elif not console.quiet:
        word = WORDS['failed' if code == EXIT_FAILED else verdict.level].lower()
        line = f'{word}: {args.inputs[0]}: {verdict.summary}'
        print(painted(line, word, LEVEL_COLORS[verdict.level], colored(sys.stdout)))
        for reason in verdict.reasons if console.verbose else ():
            print(f'  {reason}')
    return code


def _input_results(args: argparse.Namespace, settings: ResultSettings, console: Console) -> Results:
    """Load the results of the only input, or read and fit the recordings."""
    first = Path(args.inputs[0])
    if len(args.inputs) == 1 and (first.suffix == '.json' or (first / RESULTS).is_file()):
        results = load(first, settings.method)
        return results.compared(settings.sensor, settings.baseline, settings.stated_margin)
    recorded = read_in_turn(read_jobs(args.inputs, args), console)
    return fit_recorded(add_recordings(recorded), settings)


def merge(args: argparse.Namespace) -> int:
    """Add the sums in the input files, fit them, write the files, and print the results."""
    check_result_arguments(args)
    return show_results(add_recordings(map(load_sums, args.inputs)), args)


CHECK = """
Check one IMU: one line and an exit code, for production tests and continuous integration.

The input is a recording, a results.json or the folder of an analysis. It is compared with the
datasheet of --sensor, with the accepted earlier run of --baseline, or with both.

  allan check my_bag --sensor adis16475-3
  allan check today.mcap --baseline accepted/results.json --fail-on warning
  allan check results --sensor my_imu.yaml --json | jq .level
"""

MERGE = """
Add the Allan variance sums of recordings of one IMU and fit the total.

An input is the folder of an analysis, its sums.json, or a checkpoint of a node. The result equals
that of one analysis of all recordings, up to rounding.

  allan merge monday tuesday -o both
  allan merge monday/sums.json ~/.ros/imu.json
"""

COMMANDS = {
    'analyze': Command(__doc__ or '', [SEVERAL, *WRITTEN, *READ], run, EXITS),
    'check': Command(
        CHECK,
        [
            'inputs INPUT...  a recording, or its results',
            Settings('result', ResultSettings, ['export']),
            FAIL_ON,
            *READ,
        ],
        check,
        {
            0: 'healthy, or usable with care (a warning)',
            EXIT_UNKNOWN: 'not judged (no reference, too little data), or an error you can fix',
            EXIT_FAILED: 'failed',
        },
    ),
    'merge': Command(
        MERGE,
        ['inputs SUMS...  sums.json of one recording, or its folder', *WRITTEN],
        merge,
        EXITS,
    ),
}
