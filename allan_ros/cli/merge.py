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

from ..io.plot_style import PictureSettings
from .options import SUMS, add_settings, file_of
from .outcome import OutcomeSettings, RecordingSums, add_runs, check_outcome, finish


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument(
        'inputs', nargs='+', metavar='RUN', help='sums of one run, or the folder they are in'
    )
    parser.add_argument(
        '-o', '--output', metavar='DIR', help='folder for results, plots and report (default: none)'
    )
    add_settings(parser, 'result', OutcomeSettings)
    add_settings(parser, 'pictures', PictureSettings)


def run(args: argparse.Namespace) -> int:
    """Read, add, fit, show and write."""
    from ..io.documents import sums_file_from_document
    from ..io.text import read_json

    check_outcome(args)
    paths = [file_of(path, SUMS) for path in args.inputs]
    runs = [RecordingSums(path, *sums_file_from_document(read_json(path), path)) for path in paths]
    return finish(add_runs(runs), args)
