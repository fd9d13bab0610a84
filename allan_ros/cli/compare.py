# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""List significant differences between recordings, or from a datasheet.

An input is a results.json, a sums.json, the folder of an analysis, a recording, or sensor:NAME for
a datasheet. Recordings are compared with the first one, and with each datasheet. --method applies
to recordings and sums; a results.json is not fitted again.

  allan compare monday tuesday
  allan compare run1 run2 --label cold --label warm -o compared
  allan compare results sensor:adis16475-3 --fail-on-difference
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from .. import api
from ..api import ResultSettings
from ..core.errors import AllanError
from ..core.findings import Quantity
from ..core.fit import AxisFit
from ..core.fit.simple_methods import fit_curve
from ..core.imu import SENSORS, sensor_of
from ..io.comparison import (
    comparison_document,
    inflation_document,
    inflation_facts,
    write_comparison,
    write_overlay,
)
from ..io.files import to_json, write_atomic
from ..io.format import deviation_text
from ..io.plot_style import PictureSettings, check_pictures
from .console import Console, width
from .options import Command, Settings, settings_of
from .tables import axis_cells, comparison_lines, table_lines, term_labels

SENSOR_PREFIX = 'sensor:'

EXIT_DIFFERENT = 3

EXITS = {EXIT_DIFFERENT: 'with --fail-on-difference: a significant difference, or a limit exceeded'}


def run(args: argparse.Namespace) -> int:
    """Compare the inputs, print the comparison, and write the files; return the exit code."""
    console = Console.of(args)
    pictures = settings_of(PictureSettings, args)
    check_pictures(pictures)
    if args.report and not args.output:
        raise AllanError('--report needs a folder: give one with -o')
    given = [text for text in args.inputs if text.startswith(SENSOR_PREFIX)]
    comparison = api.compare(
        *(text for text in args.inputs if text not in given),
        labels=args.label,
        sensor=[text[len(SENSOR_PREFIX) :] for text in given] + args.sensor,
        margin=args.margin,
        method=args.method,
        observer=console,
    )
    if console.json:
        console.document(comparison_document(comparison))
    elif not (console.quiet and args.output):
        print('\n'.join(comparison_lines(comparison, args.units, width())))
    if args.output:
        written = write_comparison(args.output, comparison, args.units, pictures)
        if args.report:
            written.append(write_overlay(args.output, comparison.runs, args.margin, args.units))
        console.say(f'written to {args.output}: {", ".join(path.name for path in written)}')
    return EXIT_DIFFERENT if args.fail_on_difference and comparison.differs else 0


def inflate(args: argparse.Namespace) -> int:
    """Print and write how much running motors increase the noise; return the exit code."""
    console = Console.of(args)
    if not 0.0 < args.horizon < float('inf'):
        raise AllanError(f'--horizon {args.horizon:g}: give a time above 0 s')
    pictures = settings_of(PictureSettings, args)
    check_pictures(pictures)
    inflation = api.inflate(args.rest, args.running, horizon=args.horizon, observer=console)
    if console.json:
        console.document(inflation_document(inflation))
    elif not (console.quiet and args.output):
        print(inflation)
    if args.output:
        comparison = inflation.comparison
        written = write_comparison(args.output, comparison, args.units, pictures)
        facts = dict(inflation_facts(inflation))
        written.append(write_overlay(args.output, comparison.runs, units=args.units, facts=facts))
        path = written[0].parent / 'inflation.json'
        write_atomic(path, to_json(inflation_document(inflation)))
        names = ', '.join(one.name for one in (path, *written))
        console.say(f'written to {args.output}: {names}')
    return 0


def fit(args: argparse.Namespace) -> int:
    """Fit the Allan curves of a file, and print coefficients, noise processes and warnings."""
    from ..io.user_files import contradictions, read_curves, read_published

    console = Console.of(args)
    if args.hours is not None and not 0.0 < args.hours < float('inf'):
        raise AllanError(f'--hours {args.hours:g}: give a time above 0')
    curves = read_curves(args.curve, args.gyro_unit or '')
    published = read_published(args.published) if args.published else {}
    record = None if args.hours is None else 3600.0 * args.hours
    fits = {axis: fit_curve(curves.tau, adev, record) for axis, adev in curves.adev.items()}
    warnings = contradictions(curves, fits, published)
    if console.json:
        console.document(_document(args.curve, fits, warnings))
        return 0
    lines: list[str] = []
    for sensor in SENSORS:
        axes = [axis for axis in fits if axis.startswith(sensor)]
        columns = [axis_cells(axis, fits[axis].noise, args.units) for axis in axes]
        lines += table_lines(term_labels(sensor, args.units), columns, width())
    lines.append('')
    for axis, fit in fits.items():
        lines += _process_lines(axis, fit, args.units)
    print('\n'.join([*lines, *(f'warning: {text}' for text in warnings)]))
    return 0


def _process_lines(axis: str, fit: AxisFit, units: str) -> list[str]:
    """Return a line for each noise process, and one for the largest misfit of the model."""
    sensor = sensor_of(axis)
    lines = [
        f'{axis}: Gauss-Markov, {Quantity(p.sigma, sensor, "B").text(units)}, '
        f'{p.correlation_time:.3g} s'
        for p in fit.processes.gauss_markov
    ]
    lines += [
        f'{axis}: sinusoid, {Quantity(p.amplitude, sensor, "signal").text(units)}, '
        f'{p.frequency:.3g} Hz'
        for p in fit.processes.sinusoid
    ]
    if fit.deviation is not None:
        lines.append(f'{axis}: largest deviation {deviation_text(fit.deviation)}')
    return lines


def _document(source: str, fits: Mapping[str, AxisFit], warnings: list[str]) -> dict[str, Any]:
    """Return the fits as JSON values in SI."""
    axes = {
        axis: {
            'noise': {term: asdict(c) for term, c in fit.noise.items()},
            'processes': asdict(fit.processes),
            'deviation': fit.deviation._asdict() if fit.deviation else None,
            'gof_z': fit.gof_z,
        }
        for axis, fit in fits.items()
    }
    return {
        'schema': 'allan_ros/curve_fit/1',
        'source': source,
        'axes': axes,
        'doubts': warnings,
    }


FIT = """
Fit an Allan curve computed by another tool, and check the values published with it.

CURVE is a text file with averaging times in s and Allan deviations, one column per axis: with a
header of names (tau, gyro_x, ...), or as allan_variance_ros writes it.

  allan fit allan_variance.csv --published imu.yaml
"""

INFLATE = """
Measure what running motors add to the noise of a robot at rest.

REST is the robot at rest with its motors off, RUNNING the robot at rest with its motors on, each as
a results.json, the folder of an analysis, or a recording. The output is N and K for a filter, their
increase as a factor, and the ratio of the Allan deviations.

  allan inflate rest/results.json motors_on/results.json
  allan inflate rest_bag motors_on_bag -o inflation
"""

COMPARE_OPTIONS = f"""
inputs INPUT...  recording or its results, or sensor:NAME for a datasheet
-o --output DIR  folder for tables and figures (default: none)
--report  also write report.html of the first input, with the curves of the others
--label TEXT...  name of an input, such as a temperature or a serial number; give one per input, in
    the same order (default: name of folder or file)
--sensor NAME...  also compare with this datasheet, like sensor:NAME; `allan sensors` lists the
    names
--fail-on-difference  exit with {EXIT_DIFFERENT} if a difference is significant, or a limit of a
    datasheet is exceeded
"""

INFLATE_OPTIONS = """
rest REST  the robot at rest, motors off
running RUNNING  the robot at rest, motors on
--horizon SECONDS [30]  longest time that the filter integrates without correction
-o --output DIR  folder for inflation.json, report.html with both curves, and a table
"""

FIT_OPTIONS = """
curve CURVE  text file of an Allan curve
--published FILE  imu.yaml of Kalibr whose values are checked against the curve
--hours HOURS  length of the recording (default: nine times the longest averaging time)
--gyro-unit {rad/s,deg/s}  unit of gyro deviations (default rad/s with a header, else deg/s)
"""

UNITS = Settings('result', ResultSettings, ['method', 'sensor', 'baseline', 'margin', 'export'])

RESULT = Settings('result', ResultSettings, ['sensor', 'baseline', 'export'])

PICTURES = Settings('pictures', PictureSettings)

COMMANDS = {
    'compare': Command(__doc__ or '', [COMPARE_OPTIONS, RESULT, PICTURES], run, EXITS),
    'inflate': Command(INFLATE, [INFLATE_OPTIONS, UNITS, PICTURES], inflate),
    'fit': Command(FIT, [FIT_OPTIONS, UNITS], fit),
}
