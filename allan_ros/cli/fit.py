# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit an Allan curve computed by another tool, and check the values published with it.

CURVE is a text file with averaging times in s and Allan deviations, one column per axis: with a
header of names (tau, gyro_x, ...), or as allan_variance_ros writes it.

  allan fit allan_variance.csv --published imu.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..core.errors import AllanError
from .console import Console
from .options import Command

if TYPE_CHECKING:
    from ..core.fit import AxisFit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument('curve', metavar='CURVE', help='text file of an Allan curve')
    parser.add_argument(
        '--published',
        metavar='FILE',
        help='imu.yaml of Kalibr whose values are checked against the curve',
    )
    parser.add_argument(
        '--hours',
        type=float,
        metavar='HOURS',
        help='length of the recording (default: nine times the longest averaging time)',
    )
    parser.add_argument(
        '--gyro-unit',
        choices=('rad/s', 'deg/s'),
        help='unit of gyro deviations (default rad/s with a header, else deg/s)',
    )
    parser.add_argument(
        '--units',
        choices=('datasheet', 'si'),
        default='datasheet',
        help='units shown (default datasheet)',
    )


def run(args: argparse.Namespace) -> int:
    """Fit all curves of the file, and show coefficients, processes and inconsistencies."""
    from ..core.fit.curve_fit import fit_curve
    from ..io.user_files import doubts, read_curves, read_published

    console = Console.of(args)
    if args.hours is not None and not 0.0 < args.hours < float('inf'):
        raise AllanError(f'--hours {args.hours:g}: give a time above 0')
    curves = read_curves(args.curve, args.gyro_unit or '')
    published = read_published(args.published) if args.published else {}
    record = None if args.hours is None else 3600.0 * args.hours
    fits = {axis: fit_curve(curves.tau, adev, record) for axis, adev in curves.adev.items()}
    doubtful = doubts(curves, fits, published)
    if console.json:
        console.document(_document(args.curve, fits, doubtful))
        return 0
    from ..core.fit import TERMS
    from ..io.format import interval_text, shown_unit, value_text
    from .tables import table_lines

    for sensor in ('gyro', 'accel'):
        axes = [axis for axis in fits if axis.startswith(sensor)]
        if not axes:
            continue
        units = [shown_unit(axes[0], term, args.units) for term in TERMS]
        labels = ['', *(f'{term} [{unit.name}]' for term, unit in zip(TERMS, units))]
        columns = [
            [
                axis,
                *(
                    f'{value_text(fits[axis].noise[term], unit):9} '
                    f'{interval_text(fits[axis].noise[term], unit)}'
                    for term, unit in zip(TERMS, units)
                ),
            ]
            for axis in axes
        ]
        for line in table_lines(labels, columns, 100):
            print(line)
    print()
    for axis, fit in fits.items():
        for text in _process_lines(axis, fit):
            print(text)
    for text in doubtful:
        print(f'warning: {text}')
    return 0


def _process_lines(axis: str, fit: AxisFit) -> list[str]:
    """Return the processes of an axis and its largest deviation, one line each."""
    from ..core.imu import SI_UNITS, sensor_of

    unit = SI_UNITS[sensor_of(axis)]['B']
    lines = [
        f'{axis}: Gauss-Markov, {p.sigma:.3g} {unit}, {p.correlation_time:.3g} s'
        for p in fit.processes.gauss_markov
    ]
    lines += [
        f'{axis}: sinusoid, {p.amplitude:.3g} {unit}, {p.frequency:.3g} Hz'
        for p in fit.processes.sinusoid
    ]
    if fit.deviation is not None:
        relative, tau = fit.deviation
        lines.append(f'{axis}: largest deviation {abs(relative):.0%} at {tau:.3g} s')
    return lines


def _document(source: str, fits: Mapping[str, AxisFit], doubtful: list[str]) -> dict[str, Any]:
    """Return the fits as JSON values in SI."""
    from dataclasses import asdict

    axes = {}
    for axis, fit in fits.items():
        axes[axis] = {
            'noise': {term: asdict(c) for term, c in fit.noise.items()},
            'processes': asdict(fit.processes),
            'deviation': fit.deviation._asdict() if fit.deviation else None,
            'gof_z': fit.gof_z,
        }
    return {'schema': 'allan_ros/curve_fit/1', 'source': source, 'axes': axes, 'doubts': doubtful}


COMMANDS = {'fit': Command(__doc__ or '', add_arguments, run)}
