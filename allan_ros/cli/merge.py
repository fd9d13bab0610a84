# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Add the sums of several runs of one IMU, and fit them together.

An input is a sums.json of `allan analyze`, or a checkpoint of a node. The result is what one
analysis of all recordings would give, to rounding.

  allan merge monday/sums.json tuesday/sums.json -o both
"""

from __future__ import annotations

import argparse

from ..io.plot_style import PictureSettings
from .options import add_settings
from .outcome import OutcomeSettings, Run, add_runs, check_outcome, finish


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument('inputs', nargs='+', metavar='SUMS.JSON', help='sums of one run')
    parser.add_argument(
        '-o', '--output', metavar='DIR', help='folder for results, plots and report (default: none)'
    )
    add_settings(parser, 'result', OutcomeSettings)
    add_settings(parser, 'pictures', PictureSettings)


def run(args: argparse.Namespace) -> int:
    """Read, add, fit, show and write."""
    from ..io.documents import read_json, sums_file_from_document

    check_outcome(args)
    runs = [Run(path, *sums_file_from_document(read_json(path), path)) for path in args.inputs]
    return finish(add_runs(runs), args)
