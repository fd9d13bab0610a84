# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write a recording of an IMU with known noise, and a file of the true values next to it.

State the true coefficients of the five noise terms by a preset or a datasheet. Change single terms
by a file or with --gyro, --accel, --gyro-x ..., in datasheet units:

  gyro   Q urad   N deg/sqrt(h)   B deg/h   K deg/h^1.5   R deg/h^2
  accel  Q um/s   N m/s/sqrt(h)   B ug      K ug/sqrt(h)  R ug/h

  allan simulate bag --preset paper
  allan simulate imu.csv --gyro N=0.3,B=7 --gyro-z K=30 --accel N=0.02
  allan simulate shaken.mcap --preset paper --spec faults.yaml

A specification has `noise`, `faults` or both, for example
  faults: {drop: 0.01, motion: [[60, 2.5]], vibration_gyro: 0.001, vibration_frequency: 25}

OUT is a file in the format of its suffix: .mcap, .db3, .csv, .tsv or .npz. Without a suffix, OUT is
the folder of an mcap bag.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..core.errors import one_line
from ..core.imu import AXES, HOUR, NANOSECONDS, SENSORS
from ..core.simulator import PRESETS, Faults, samples_in, simulate_imu
from .console import Console
from .options import Command, Option, OptionGroup, seconds, terms

if TYPE_CHECKING:
    from ..core.imu import ImuBatch

NOISES = {
    **{sensor: f'all {sensor} axes' for sensor in SENSORS},
    **{axis: axis for axis in AXES},
}
"""Name of an option for noise terms -> text about the axes to which the terms apply."""

SIMULATE_OPTIONS = (
    Option(('output',), 'recording to write', 'OUT'),
    OptionGroup(
        'noise',
        (
            Option(
                ('--preset',),
                'noise of a known IMU; `paper` is an ADIS16475-3',
                f'{{{",".join(PRESETS)}}}',
                choices=tuple(PRESETS),
                exclusive=True,
            ),
            Option(
                ('--sensor',),
                'datasheet whose N and B are simulated: a name from `allan sensors`, or a file',
                'NAME',
                exclusive=True,
            ),
            *(
                Option(
                    (f'--{name.replace("_", "-")}',),
                    f'noise terms of {axes_text}',
                    'N=..,B=..',
                    terms,
                )
                for name, axes_text in NOISES.items()
            ),
            Option(
                ('--spec',),
                'YAML file of noise terms and faults, or the truth file of an earlier simulation',
                'FILE',
            ),
        ),
    ),
    OptionGroup(
        'recording',
        (
            Option(
                ('--hours',), 'length of the recording in hours', 'HOURS', parse=float, default=2.0
            ),
            Option(('--rate',), 'samples per second', 'HZ', parse=float, default=100.0),
            Option(
                ('--seed',), 'seed of the random numbers (default 0)', 'N', parse=int, default=0
            ),
            Option(
                ('--start',),
                'first stamp in Unix time, such as 1577836800 for 2020-01-01; recordings that are '
                'analyzed together need different times',
                'SECONDS',
                parse=seconds,
                default=1577836800.0,
            ),
            Option(('--frame-id',), 'frame_id of the messages', 'TEXT', default='imu_link'),
            Option(('--topic',), 'topic of the messages in a bag', 'TEXT', default='/imu/data'),
            Option(('--overwrite',), 'replace an existing recording'),
        ),
    ),
)


def run(args: argparse.Namespace) -> int:
    """Simulate a recording, write the recording and its true noise, and return the exit code."""
    from ..readers.writing import write_recording
    from ..results.simulation import read_specification, stated_noise, write_truth

    changes = {name: getattr(args, name) for name in NOISES if getattr(args, name)}
    specified_noise, faults = read_specification(args.spec) if args.spec else (None, Faults())
    noise = stated_noise(args.preset or '', args.sensor or '', specified_noise, changes)
    samples = samples_in(args.hours * HOUR, args.rate)
    console = Console.of(args)
    duration_s = args.hours * HOUR
    noise_of_axes = list(noise.values())
    batches = simulate_imu(
        duration_s,
        args.rate,
        noise_of_axes[:3],
        noise_of_axes[3:],
        seed=args.seed,
        faults=faults,
        start_ns=round(args.start * NANOSECONDS),
        frame_id=args.frame_id,
    )
    n_written = write_recording(
        args.output,
        _tracked(batches, samples, console),
        topic=args.topic,
        overwrite=args.overwrite,
    )
    truth = write_truth(
        args.output, noise, seconds=duration_s, rate=args.rate, seed=args.seed, faults=faults
    )
    if console.json:
        console.document(
            {
                'path': args.output,
                'samples': n_written,
                'duration_s': duration_s,
                'rate_hz': args.rate,
                'truth': str(truth),
            }
        )
    elif not console.quiet:
        length = f'{n_written} samples, {duration_s:g} s at {args.rate:g} Hz'
        print(one_line(f'{args.output}: {length}; truth in {truth}'))
    return 0


def _tracked(batches: Iterator[ImuBatch], samples: int, console: Console) -> Iterator[ImuBatch]:
    """Yield the batches, and show a progress bar; ``samples`` is the total number of samples."""
    with console.progress('writing', samples) as progress:
        for batch in batches:
            yield batch
            progress.advance(len(batch))


SIMULATE = Command(__doc__ or '', SIMULATE_OPTIONS, run)
