# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write a recording of an IMU with known noise, and a file of the true values next to it.

The five noises are exact in level. Set them by a preset, a datasheet or a file, and change single
ones with --gyro, --accel, --gyro-x ..., in datasheet units:

  gyro   Q urad   N deg/sqrt(h)   B deg/h   K deg/h^1.5   R deg/h^2
  accel  Q um/s   N m/s/sqrt(h)   B ug      K ug/sqrt(h)  R ug/h

  allan simulate bag --preset paper
  allan simulate imu.csv --gyro N=0.3,B=7 --gyro-z K=30 --accel N=0.02

OUT is a bag (a folder), or a file by its suffix: .mcap, .db3, .bag (ROS 1), .csv, .tsv, .npz.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..core.errors import AllanError
from ..core.imu import HOUR, NANOSECONDS
from ..core.simulate import PRESETS, Faults, simulate_imu
from .console import Console
from .options import Command, add_settings, settings_of

if TYPE_CHECKING:
    from ..core.imu import ImuBatch

START = 1_577_836_800.0
"""First stamp, s: 2020-01-01 00:00 UTC, so that the same command gives the same file."""

NOISE_OPTIONS = ('gyro', 'gyro_x', 'gyro_y', 'gyro_z', 'accel', 'accel_x', 'accel_y', 'accel_z')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb; defaults of the faults are those of `Faults`."""
    parser.add_argument('output', metavar='OUT', help='recording to write')
    noise = parser.add_argument_group('noise')
    base = noise.add_mutually_exclusive_group()
    base.add_argument(
        '--preset', choices=list(PRESETS), help='noise of a known IMU; paper: ADIS16475-3'
    )
    base.add_argument(
        '--sensor', metavar='NAME', help='N and B at the limits of this datasheet (name or file)'
    )
    base.add_argument('--spec', metavar='FILE', help='YAML file of axes and terms, or truth file')
    for name in NOISE_OPTIONS:
        noise.add_argument(
            f'--{name.replace("_", "-")}',
            dest=name,
            type=_terms,
            metavar='N=..,B=..',
            help=f'noise terms of {name}' if '_' in name else f'noise terms of all {name} axes',
        )
    length = parser.add_argument_group('recording')
    length.add_argument('--hours', type=float, default=2.0, help='length in hours (default 2)')
    length.add_argument(
        '--rate', type=float, default=100.0, help='samples per second (default 100)'
    )
    length.add_argument(
        '--seed', type=int, default=0, help='seed of the random numbers (default 0)'
    )
    length.add_argument(
        '--start',
        type=float,
        default=START,
        metavar='S',
        help='first stamp in s (default 2020-01-01)',
    )
    length.add_argument(
        '--frame-id', default='imu_link', metavar='TEXT', help='frame_id (default imu_link)'
    )
    length.add_argument(
        '--topic', default='/imu/data', metavar='TEXT', help='topic of a bag (default /imu/data)'
    )
    length.add_argument(
        '--storage', metavar='NAME', help='mcap, sqlite3, ros1, csv or npz (default: by suffix)'
    )
    length.add_argument(
        '--compression',
        default='none',
        metavar='NAME',
        help='none (default), chunk, message or file; bz2 or lz4 of ros1, deflate of npz',
    )
    length.add_argument('--overwrite', action='store_true', help='replace an existing recording')
    add_settings(parser, 'faults', Faults, without=['motion', 'gaps'])
    periods = parser.add_argument_group('faults in periods of time')
    for name, what in (('motion', 'the IMU moves'), ('gaps', 'samples are missing')):
        periods.add_argument(
            f'--{name}',
            type=_span,
            action='append',
            default=[],
            metavar='START:LENGTH',
            help=f'{what} for LENGTH seconds from START on; can be repeated',
        )


def run(args: argparse.Namespace) -> int:
    """Simulate, write the recording and then its truth."""

    from ..io.user_files import stated_noise, write_truth
    from ..io.writing import write_recording

    changes = {name: getattr(args, name) for name in NOISE_OPTIONS if getattr(args, name)}
    noise = stated_noise(args.preset or '', args.sensor or '', args.spec or '', changes)
    faults = settings_of(Faults, args, motion=tuple(args.motion), gaps=tuple(args.gaps))
    if args.seed < 0:
        raise AllanError(f'--seed is {args.seed}: give 0 or more')
    console = Console.of(args)
    seconds = args.hours * HOUR
    terms = list(noise.values())
    batches = simulate_imu(
        seconds,
        args.rate,
        terms[:3],
        terms[3:],
        seed=args.seed,
        faults=faults,
        start_ns=round(args.start * NANOSECONDS),
        frame_id=args.frame_id,
    )
    written = write_recording(
        args.output,
        _watched(batches, round(seconds * args.rate), console),
        storage=args.storage,
        compression=args.compression,
        topic=args.topic,
        overwrite=args.overwrite,
    )
    truth = write_truth(
        args.output, noise, seconds=seconds, rate=args.rate, seed=args.seed, faults=faults
    )
    if console.json:
        console.document(
            {
                'path': args.output,
                'samples': written,
                'duration_s': seconds,
                'rate_hz': args.rate,
                'truth': str(truth),
            }
        )
    elif not console.quiet:
        length = f'{written} samples, {seconds:g} s at {args.rate:g} Hz'
        print(f'{args.output}: {length}; truth in {truth}')
    return 0


def _watched(batches: Iterator[ImuBatch], samples: int, console: Console) -> Iterator[ImuBatch]:
    """Yield the batches under a progress bar."""
    with console.progress('writing', samples) as progress:
        for batch in batches:
            yield batch
            progress.advance(len(batch))


def _terms(text: str) -> dict[str, float]:
    """Return term -> number of ``N=0.3,B=7``."""
    try:
        pairs = [part.split('=') for part in text.split(',')]
        return {term.strip(): float(value) for term, value in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r}: write terms as N=0.3,B=7') from None


def _span(text: str) -> tuple[float, float]:
    """Return (start, length) in s of ``60:2.5``."""
    try:
        start, length = text.split(':')
        return float(start), float(length)
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r}: write a period as START:LENGTH') from None


COMMANDS = {'simulate': Command(__doc__ or '', add_arguments, run)}
