# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Add the sums of several runs of one IMU, and fit them together.

An input is the folder of an analysis, its sums.json, or a checkpoint of a node. The result is what
one analysis of all recordings would give, to rounding.

  allan merge monday tuesday -o both
  allan merge monday/sums.json ~/.ros/imu.json
"""

from __future__ import annotations

import argparse

from ..api import ResultSettings
from ..io.documents import load_sums
from ..io.plot_style import PictureSettings
from ..io.recorded import add_recordings
from .analyze import EXITS, add_fail_on, check_result_arguments, show_results
from .options import add_settings

__all__ = ['EXITS', 'add_arguments', 'run']


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument(
        'inputs', nargs='+', metavar='RUN', help='sums of one run, or the folder they are in'
    )
    parser.add_argument(
        '-o', '--output', metavar='DIR', help='folder for results, plots and report (default: none)'
    )
    add_settings(parser, 'result', ResultSettings)
    add_fail_on(parser)
    add_settings(parser, 'pictures', PictureSettings)


def run(args: argparse.Namespace) -> int:
    """Read, add, fit, show and write."""
    check_result_arguments(args)
    return show_results(add_recordings(map(load_sums, args.inputs)), args)
