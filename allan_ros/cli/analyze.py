# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise of an IMU from its recordings.

An input is a rosbag2 folder, .mcap, .db3, ROS 1 .bag, .csv, .tsv, .npz or .npy. Several inputs are
runs of the same IMU: their evidence adds up.

  allan analyze my_bag -o results
  allan analyze monday.mcap tuesday.mcap -o results --export openvins,px4
  allan analyze table.csv --columns t,gx,gy,gz,ax,ay,az --gyro-unit deg/s
  allan analyze my_bag --json | jq .axes.gyro_x.noise.N.value
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..core.errors import AllanError
from ..core.settings import SegmenterSettings
from ..io.plot_style import PictureSettings
from .console import Console
from .options import add_settings, settings_of
from .outcome import OutcomeSettings, add_runs, check_outcome, finish

if TYPE_CHECKING:
    from ..core.findings import Finding
    from .parts import Job, Part


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb; defaults are those of the settings classes."""
    from ..io.readers.recording import ReadOptions

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
    add_settings(parser, 'pictures', PictureSettings)
    add_settings(parser, 'evidence', SegmenterSettings, without=['declared_rate'])
    add_settings(parser, 'reading', ReadOptions, without=['rate_hz'])


def run(args: argparse.Namespace) -> int:
    """Read, accumulate, fit, show and write."""
    from ..core.findings import Finding
    from ..io.readers.recording import ReadOptions
    from .parts import Job, add_findings, add_spectra

    check_outcome(args)
    reading = settings_of(ReadOptions, args, rate_hz=args.rate)
    evidence = settings_of(SegmenterSettings, args, declared_rate=args.rate)
    console = Console.of(args)
    console.detail(f'settings: {_settings_text(reading, evidence)}')
    drawn = bool(args.output)
    jobs = [Job(path, reading, evidence, args.hardware_id, drawn) for path in args.inputs]
    outcomes = list(_spread(jobs, args, console))
    lost = [outcome for outcome in outcomes if isinstance(outcome, Finding)]
    parts = [outcome for outcome in outcomes if not isinstance(outcome, Finding)]
    if not parts:
        raise AllanError('; '.join(str(finding) for finding in lost))
    for part in parts:
        console.detail(_read_text(part))
    parts[0] = add_findings(parts[0], lost)
    run = add_runs(part.run for part in parts)
    signals, temperatures = zip(*((part.signal, part.temperature) for part in parts))
    return finish(run, args, signals, add_spectra(parts), temperatures)


def _spread(
    jobs: Sequence[Job], args: argparse.Namespace, console: Console
) -> Iterator[Part | Finding]:
    """Do the jobs where the arguments say."""
    if args.jobs < 1:
        raise AllanError(f'--jobs {args.jobs}: give the number of processes, at least 1')
    if args.scheduler:
        from .cluster import on_cluster

        return on_cluster(jobs, args.scheduler, console)
    from .parts import in_processes, in_turn

    if min(args.jobs, len(jobs)) > 1:
        return in_processes(jobs, args.jobs, console)
    return in_turn(jobs, console)


def _settings_text(*settings: Any) -> str:
    """Return every setting with its value."""
    values = {name: value for s in settings for name, value in asdict(s).items()}
    return ', '.join(f'{name}={value!r}' for name, value in values.items())


def _read_text(part: Part) -> str:
    """Return what was read of one recording, and how."""
    (source,), counts = part.run.provenance.sources, part.run.provenance.counts
    what = ' '.join(word for word in (source.topic, source.type) if word)
    return (
        f'{source.path}: {counts.received:,} samples from {source.storage}'
        f'{f", {what}" if what else ""}; {counts.used:,} used'
    )
