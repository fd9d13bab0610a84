# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check one IMU: one line and an exit code, for production lines and continuous integration.

The input is a recording, a results.json or the folder of an analysis. It is compared with the
datasheet of --sensor, with the accepted earlier run of --baseline, or with both. The exit code is 0
for healthy, 1 if it could not be judged (no reference, too little data), 3 if it failed.

  allan check my_bag --sensor adis16475-3
  allan check today.mcap --baseline accepted/results.json --fail-on warning
  allan check results --sensor my_imu.yaml --json | jq .level
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ..api import ResultSettings, fit_recorded
from ..io.datasheets import load_sensor
from ..io.documents import load
from ..io.recorded import add_recordings, read_in_turn
from ..io.results import Results
from ..io.verdict import verdict_of
from .analyze import EXIT_FAILED, add_fail_on, add_reading_arguments, fails, read_jobs
from .console import Console, coloured, painted
from .options import add_settings, settings_of
from .tables import LEVEL_COLOURS

EXIT_UNKNOWN = 1

EXITS = {EXIT_FAILED: 'checked and failed'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument('inputs', nargs='+', metavar='INPUT', help='a recording, or its results')
    add_settings(parser, 'result', ResultSettings, without=['export'])
    add_fail_on(parser)
    add_reading_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Read, fit, check, and print one line."""
    settings = settings_of(ResultSettings, args)
    if settings.sensor:
        load_sensor(settings.sensor)  # a wrong name is reported before hours are read
    if settings.baseline:
        load(settings.baseline)
    console = Console.of(args)
    results = _results(args, settings, console)
    verdict = verdict_of(results, units=settings.units)
    code = 0
    if verdict.level == 'failed' or fails(verdict, results, args.fail_on):
        code = EXIT_FAILED
    elif verdict.level == 'unknown':
        code = EXIT_UNKNOWN
    if console.json:
        console.document({'inputs': args.inputs, 'exit_code': code, **verdict.to_document()})
    elif not console.quiet:
        word = 'failed' if code == EXIT_FAILED else verdict.level
        line = f'{word}: {args.inputs[0]}: {verdict.summary}'
        print(painted(line, word, LEVEL_COLOURS[verdict.level], coloured(sys.stdout)))
        for reason in verdict.reasons if console.verbose else ():
            print(f'  {reason}')
    return code


def _results(args: argparse.Namespace, settings: ResultSettings, console: Console) -> Results:
    """Return the results of a document, or of recordings, which are read and fitted."""
    first = Path(args.inputs[0])
    if len(args.inputs) == 1 and (first.suffix == '.json' or (first / 'results.json').is_file()):
        results = load(first, settings.method)
        return results.compared(settings.sensor, settings.baseline, settings.margin)
    recorded = read_in_turn(read_jobs(args.inputs, args), console)
    return fit_recorded(add_recordings(recorded), settings)
