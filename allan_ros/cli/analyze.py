# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise of an IMU from its recordings.

An input is a rosbag2 folder, .mcap, .db3, ROS 1 .bag, .csv, .tsv, .npz or .npy. Several inputs are
runs of the same IMU: their evidence adds up.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ..core.errors import AllanError
from ..core.settings import SegmenterSettings
from .options import add_settings, settings_of
from .outcome import OutcomeSettings, add_runs, check_exports, finish

if TYPE_CHECKING:
    from ..core.findings import Finding
    from .parts import Job, Part


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb; defaults are those of the settings classes."""
    from ..io.recordings import ReadOptions

    parser.add_argument('inputs', nargs='+', metavar='INPUT', help='a recording')
    parser.add_argument(
        '-o', '--output', metavar='DIR', help='folder for results, plots and report (default: none)'
    )
    parser.add_argument(
        '--rate',
        type=float,
        default=0.0,
        metavar='HZ',
        help='sample rate: checked against the stamps, or believed where there are none',
    )
    parser.add_argument(
        '--hardware-id',
        default='',
        metavar='TEXT',
        help='which piece this is; only sums with the same one add up',
    )
    spread = parser.add_argument_group('several recordings')
    spread.add_argument(
        '--jobs', type=int, default=1, metavar='N', help='read so many at a time (default 1)'
    )
    spread.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='read them on the Dask cluster of this scheduler, as tcp://host:8786; '
        'its workers must see the same paths',
    )
    add_settings(parser, 'result', OutcomeSettings)
    add_settings(parser, 'evidence', SegmenterSettings, without=['declared_rate'])
    add_settings(parser, 'reading', ReadOptions, without=['rate_hz'])


def run(args: argparse.Namespace) -> int:
    """Read, accumulate, fit, show and write."""
    from ..core.findings import Finding
    from ..io.recordings import ReadOptions
    from .parts import Job, add_findings

    check_exports(args)
    reading = settings_of(ReadOptions, args, rate_hz=args.rate)
    evidence = settings_of(SegmenterSettings, args, declared_rate=args.rate)
    jobs = [Job(path, reading, evidence, args.hardware_id) for path in args.inputs]
    outcomes = list(_spread(jobs, args))
    lost = [outcome for outcome in outcomes if isinstance(outcome, Finding)]
    parts = [outcome for outcome in outcomes if not isinstance(outcome, Finding)]
    if not parts:
        raise AllanError('; '.join(str(finding) for finding in lost))
    parts[0] = add_findings(parts[0], lost)
    return finish(add_runs(part.run for part in parts), args, [part.signal for part in parts])


def _spread(jobs: Sequence[Job], args: argparse.Namespace) -> Iterator[Part | Finding]:
    """Do the jobs where the arguments say."""
    if args.jobs < 1:
        raise AllanError(f'--jobs {args.jobs}: give the number of processes, at least 1')
    if args.scheduler:
        from .cluster import on_cluster

        return on_cluster(jobs, args.scheduler)
    from .parts import in_processes, in_turn

    if min(args.jobs, len(jobs)) > 1:
        return in_processes(jobs, args.jobs)
    return in_turn(jobs)
