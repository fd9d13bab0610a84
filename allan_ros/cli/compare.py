# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""List significant differences between recordings, or between recordings and datasheets.

An input is a results.json, a sums.json, the folder of an analysis, a recording, the truth file of a
simulation, or sensor:NAME for a datasheet. Each recording is compared with each datasheet, and with
the truth or, without a truth file, with the first recording. --method applies to recordings and
Allan sums; a results.json is not fitted again.

  allan compare monday tuesday
  allan compare results sensor:adis16475-3 --fail-on-difference
  allan compare reference today --within 5% --fail-on-difference
  allan compare results simulated.mcap.truth.json --fail-on-difference
  allan compare left.mcap right.mcap top.mcap --common
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from ..api import comparison as api
from ..api.analysis import ResultSettings, is_document
from ..core.errors import AllanError
from ..results.comparison import comparison_document, inflation_document
from ..view.comparison import common_lines, inflation_lines
from .console import Console, width
from .options import Command, Option, Settings, percent, seconds
from .result_lines import comparison_lines

SENSOR_PREFIX = 'sensor:'

EXIT_DIFFERENT = 3

EXITS = {
    EXIT_DIFFERENT: 'with --fail-on-difference: a significant difference, or an exceeded limit'
}


def run(args: argparse.Namespace) -> int:
    """Compare the inputs, and print the comparison; return the exit code."""
    console = Console.of(args)
    if args.common:
        return _common(args, console)
    if args.topic or args.accel_topic:
        raise AllanError(
            '--topic and --accel-topic need --common: analyze each topic, then compare the results'
        )
    sheets = [text for text in args.inputs if text.startswith(SENSOR_PREFIX)]
    comparison = api.compare(
        *(text for text in args.inputs if text not in sheets),
        sensor=[text[len(SENSOR_PREFIX) :] for text in sheets],
        margin=args.margin,
        within=args.within or 0.0,
        method=args.method,
        observer=console,
    )
    text = '\n'.join(comparison_lines(comparison, args.units, width()))
    _show(console, text, comparison_document(comparison))
    return EXIT_DIFFERENT if args.fail_on_difference and comparison.differs else 0


def _show(console: Console, text: str, document: Mapping[str, Any]) -> None:
    """Print the JSON document if ``--json`` is given, else the text."""
    if console.json:
        console.document(document)
    else:
        print(text)


def _common(args: argparse.Namespace, console: Console) -> int:
    """Print how much noise several IMUs have in common; return the exit code."""
    default = ResultSettings()
    has_test = args.within or args.fail_on_difference or args.margin != default.margin
    if has_test or args.method != default.method:
        raise AllanError(
            '--common judges and fits nothing: omit --within, --fail-on-difference, --margin and '
            '--method'
        )
    for text in args.inputs:
        if text.startswith(SENSOR_PREFIX) or is_document(text):
            raise AllanError(
                f'{text}: --common needs the samples: give recordings, not results or datasheets'
            )
    common = api.common(*args.inputs, topic=args.topic, accel_topic=args.accel_topic)
    text = '\n'.join(common_lines(common, args.units, width()))
    _show(console, text, common.document())
    return 0


def inflate(args: argparse.Namespace) -> int:
    """Print the factor by which running motors increase the noise; return the exit code."""
    console = Console.of(args)
    inflation = api.inflate(args.rest, args.running, horizon=args.horizon, observer=console)
    _show(console, '\n'.join(inflation_lines(inflation, width())), inflation_document(inflation))
    return 0


INFLATE_TEXT = """
Measure how much running motors increase the noise of a robot at rest.

REST is the robot at rest with its motors off, and RUNNING is the robot at rest with its motors on.
Each is a results.json, the folder of an analysis, or a recording. The output contains N and K for a
state estimator with motors on, the factors by which the motors increase N and K, the ratios of the
Allan deviations, and the option for `allan export`.

  allan inflate rest/results.json motors_on/results.json
  allan inflate rest_bag motors_on_bag --json > inflation.json
"""

COMPARE_OPTIONS = (
    Option(
        ('inputs',), 'recording or its results, or sensor:NAME for a datasheet', 'INPUT', nargs='+'
    ),
    Option(
        ('--within',),
        'also test whether the coefficients are the same up to this percentage, such as 5%%',
        'PERCENT',
        parse=percent,
    ),
    Option(
        ('--common',),
        'separate the noise that IMUs on one body have in common (such as vibration) from the '
        'noise of each individual IMU; the inputs are recordings made at the same time, or a bag '
        'with several Imu topics',
    ),
    Option(
        ('--topic',),
        'with --common: Imu topic, if a bag has several (default: each topic is one IMU)',
        'TOPIC',
        default='',
    ),
    Option(
        ('--accel-topic',),
        'with --common: topic of the accelerometer, if the gyro has another topic',
        'TOPIC',
        default='',
    ),
    Option(
        ('--fail-on-difference',),
        f'exit with {EXIT_DIFFERENT} if a difference is significant, or a limit of a datasheet is '
        'exceeded; with --within: if N is not shown to be the same, or if another term differs',
    ),
)

INFLATE_OPTIONS = (
    Option(('rest',), 'the robot at rest, motors off', 'REST'),
    Option(('running',), 'the robot at rest, motors on', 'RUNNING'),
    Option(
        ('--horizon',),
        'longest time for which the state estimator integrates the IMU without a correction',
        'SECONDS',
        parse=seconds,
        default=30.0,
    ),
)

RESULT = Settings('result', ResultSettings, ['sensor', 'baseline', 'noise', 'export', 'plots'])

COMPARE = Command(__doc__ or '', [*COMPARE_OPTIONS, RESULT], run, EXITS)

INFLATE = Command(INFLATE_TEXT, INFLATE_OPTIONS, inflate)
