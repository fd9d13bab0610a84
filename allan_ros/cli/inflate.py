# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure what running motors add to the noise of a robot at rest.

REST is the robot at rest with its motors off, RUNNING the robot at rest with its motors on, each as
a results.json, the folder of an analysis, or a recording. Shown are N and K for a filter with the
factor on each, and the ratio of the Allan deviations.

  allan inflate rest/results.json motors_on/results.json
  allan inflate rest_bag motors_on_bag -o inflation
"""

from __future__ import annotations

import argparse

from ..core.errors import AllanError
from ..io.plot_style import PictureSettings
from .console import Console
from .options import add_settings, settings_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument('rest', metavar='REST', help='the robot at rest, motors off')
    parser.add_argument('running', metavar='RUNNING', help='the robot at rest, motors on')
    parser.add_argument(
        '--horizon',
        type=float,
        default=30.0,
        metavar='SECONDS',
        help='longest time that the filter integrates without correction (default 30)',
    )
    parser.add_argument(
        '-o',
        '--output',
        metavar='DIR',
        help='folder for inflation.json, report.html with both curves, and a table and pictures',
    )
    parser.add_argument(
        '--units',
        choices=('datasheet', 'si'),
        default='datasheet',
        help='units of the pictures (default datasheet)',
    )
    add_settings(parser, 'pictures', PictureSettings)


def run(args: argparse.Namespace) -> int:
    """Read both, show the factors, and write the files."""
    from ..api import inflate
    from ..io.comparison import inflation_document, inflation_facts

    console = Console.of(args)
    if not 0.0 < args.horizon < float('inf'):
        raise AllanError(f'--horizon {args.horizon:g}: give a time above 0 s')
    inflation = inflate(args.rest, args.running, horizon=args.horizon, observer=console)
    if console.json:
        console.document(inflation_document(inflation))
    elif not (console.quiet and args.output):
        print(inflation)
    if args.output:
        from ..io.comparison_files import write_comparison, write_overlay
        from ..io.files import to_json, write_atomic

        pictures = settings_of(PictureSettings, args)
        comparison = inflation.comparison
        written = write_comparison(args.output, comparison, args.units, pictures)
        facts = dict(inflation_facts(inflation))
        written.append(write_overlay(args.output, comparison.runs, units=args.units, facts=facts))
        path = written[0].parent / 'inflation.json'
        write_atomic(path, to_json(inflation_document(inflation)))
        names = ', '.join(one.name for one in (path, *written))
        console.say(f'written to {args.output}: {names}')
    return 0
