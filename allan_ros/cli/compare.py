# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""List significant differences between recordings, or from a datasheet.

An input is a results.json, a sums.json, the folder of an analysis, a recording, or sensor:NAME for
a datasheet. Recordings are compared with the first one, and with each datasheet. --method applies
to recordings and sums; a results.json is not fitted again.

  allan compare monday tuesday
  allan compare run1 run2 --label cold --label warm -o compared
  allan compare results sensor:adis16475-3 --fail-on-difference
  allan compare reference today --within 5% --fail-on-difference
  allan compare left.mcap right.mcap top.mcap --common
"""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import api
from ..api import ResultSettings
from ..core.errors import AllanError
from ..io.common import common_lines
from ..io.comparison import (
    comparison_document,
    inflation_document,
    write_comparison,
)
from ..io.files import to_json, write_atomic, write_together
from ..io.format import check_plots
from ..io.result_files import made_folder
from .console import Console, width
from .options import Command, Settings
from .tables import comparison_lines

SENSOR_PREFIX = 'sensor:'

EXIT_DIFFERENT = 3

EXITS = {EXIT_DIFFERENT: 'with --fail-on-difference: a significant difference, or a limit exceeded'}


def run(args: argparse.Namespace) -> int:
    """Compare the inputs, print the comparison, and write the files; return the exit code."""
    console = Console.of(args)
    _check_folder(args)
    if args.common:
        return _common(args, console)
    if args.topic or args.accel_topic:
        raise AllanError('--topic and --accel-topic need --common: analyze one topic, then compare')
    given = [text for text in args.inputs if text.startswith(SENSOR_PREFIX)]
    comparison = api.compare(
        *(text for text in args.inputs if text not in given),
        labels=args.label,
        sensor=[text[len(SENSOR_PREFIX) :] for text in given] + args.sensor,
        margin=args.margin,
        within=args.within or 0.0,
        method=args.method,
        observer=console,
    )
    if console.json:
        console.document(comparison_document(comparison))
    elif not (console.quiet and args.output):
        print('\n'.join(comparison_lines(comparison, args.units, width())))
    if args.output:
        written = write_comparison(args.output, comparison, args.units, args.plots)
        console.say(f'written to {args.output}: {", ".join(path.name for path in written)}')
    return EXIT_DIFFERENT if args.fail_on_difference and comparison.differs else 0


def _common(args: argparse.Namespace, console: Console) -> int:
    """Print and write the noise that the IMUs have in common; return the exit code."""
    default = ResultSettings()
    judged = args.sensor or args.within or args.fail_on_difference or args.margin != default.margin
    if judged or args.method != default.method:
        raise AllanError(
            '--common judges and fits nothing: omit --sensor, --within, --fail-on-difference, '
            '--margin and --method'
        )
    for text in args.inputs:
        if text.startswith(SENSOR_PREFIX) or api.is_document(text):
            raise AllanError(
                f'{text}: --common needs the samples: give recordings, not results or datasheets'
            )
    topics = {'topic': args.topic, 'accel_topic': args.accel_topic}
    common = api.common(*args.inputs, labels=args.label, **topics)
    if console.json:
        console.document(common.document())
    elif not (console.quiet and args.output):
        print('\n'.join(common_lines(common, args.units)))
    if args.output:
        files: dict[str, str | bytes] = {'common.json': to_json(common.document())}
        if args.plots:
            from ..io.plots import rendered

            files |= rendered({'common': common.plot()}, args.plots)
        write_together(made_folder(Path(args.output)), files)
        console.say(f'written to {args.output}: {", ".join(files)}')
    return 0


def _check_folder(args: argparse.Namespace) -> None:
    """Raise AllanError if a format of figures is unknown, or no folder is given for figures."""
    check_plots(args.plots)
    if args.plots and not args.output:
        raise AllanError('--plots needs a folder: give one with -o')


def inflate(args: argparse.Namespace) -> int:
    """Print and write how much running motors increase the noise; return the exit code."""
    console = Console.of(args)
    if not 0.0 < args.horizon < float('inf'):
        raise AllanError(f'--horizon {args.horizon:g}: give a time above 0 s')
    _check_folder(args)
    inflation = api.inflate(args.rest, args.running, horizon=args.horizon, observer=console)
    if console.json:
        console.document(inflation_document(inflation))
    elif not (console.quiet and args.output):
        print(inflation)
    if args.output:
        written = write_comparison(args.output, inflation.comparison, args.units, args.plots)
        path = written[0].parent / 'inflation.json'
        write_atomic(path, to_json(inflation_document(inflation)))
        names = ', '.join(one.name for one in (path, *written))
        console.say(f'written to {args.output}: {names}')
    return 0


INFLATE = """
Measure what running motors add to the noise of a robot at rest.

REST is the robot at rest with its motors off, RUNNING the robot at rest with its motors on, each as
a results.json, the folder of an analysis, or a recording. The output is N and K for a filter, their
increase as a factor, and the ratio of the Allan deviations.

  allan inflate rest/results.json motors_on/results.json
  allan inflate rest_bag motors_on_bag -o inflation
"""

COMPARE_OPTIONS = f"""
inputs INPUT...  recording or its results, or sensor:NAME for a datasheet
-o --output DIR  folder for comparison.json and plots (default: none)
--label TEXT...  name of an input, such as a temperature or a serial number; give one per input, in
    the same order (default: name of folder or file)
--sensor NAME...  also compare with this datasheet, like sensor:NAME; `allan sensors` lists the
    names
--within PERCENT  also test whether the coefficients are the same up to this, such as 5%%
--common  separate the noise that IMUs on one body have in common (vibration) from the noise of
    each; the inputs are recordings made at the same time, or a bag with several Imu topics
--topic TOPIC []  with --common: Imu topic, if a bag has several (default: all of them are IMUs)
--accel-topic TOPIC []  with --common: topic of the accelerometer, if the gyro has another topic
--fail-on-difference  exit with {EXIT_DIFFERENT} if a difference is significant, or a limit of a
    datasheet is exceeded; with --within, if N is not shown to be the same, or another term differs
"""

INFLATE_OPTIONS = """
rest REST  the robot at rest, motors off
running RUNNING  the robot at rest, motors on
--horizon SECONDS [30]  longest time that the filter integrates without correction
-o --output DIR  folder for inflation.json, comparison.json and plots
"""

UNITS = Settings('result', ResultSettings, ['method', 'sensor', 'baseline', 'margin', 'export'])

RESULT = Settings('result', ResultSettings, ['sensor', 'baseline', 'export'])

COMMANDS = {
    'compare': Command(__doc__ or '', [COMPARE_OPTIONS, RESULT], run, EXITS),
    'inflate': Command(INFLATE, [INFLATE_OPTIONS, UNITS], inflate),
}
