# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare runs, or runs with a datasheet: which differences are significant.

An input is a results.json, a sums.json, the folder of an analysis, a recording, or sensor:NAME for
a datasheet. The first run is what the others are compared with.

  allan compare monday tuesday
  allan compare run1 run2 --label cold --label warm -o compared
  allan compare results sensor:adis16475-3 --fail-on-difference
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ..core.compare import MARGIN
from ..core.errors import AllanError
from ..core.fit import METHODS
from ..io.plot_style import PictureSettings
from .console import Console, width, wrapped
from .options import Command, add_settings, settings_of

if TYPE_CHECKING:
    from ..io.comparison import RunComparison

SENSOR_PREFIX = 'sensor:'

EXIT_DIFFERENT = 3

EXITS = {EXIT_DIFFERENT: 'with --fail-on-difference: a significant difference, or a limit exceeded'}

NOT_THERE = ''
"""Text of a cell where a run does not have the axis."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument(
        'inputs', nargs='+', metavar='INPUT', help='a run, or sensor:NAME for a datasheet'
    )
    parser.add_argument(
        '-o', '--output', metavar='DIR', help='folder for tables and pictures (default: none)'
    )
    parser.add_argument(
        '--report',
        action='store_true',
        help='also write report.html: the first run with the curves of the others drawn over it',
    )
    parser.add_argument(
        '--label',
        action='append',
        default=[],
        metavar='TEXT',
        help='name of a run, in the order of the runs: a temperature, a serial number; may be '
        'given again (default: its folder or file)',
    )
    parser.add_argument(
        '--sensor',
        action='append',
        default=[],
        metavar='NAME',
        help='also a datasheet, as sensor:NAME; `allan sensors` lists them',
    )
    parser.add_argument(
        '--margin',
        type=float,
        default=MARGIN,
        metavar='NUMBER',
        help='fraction by which a complete interval must exceed the limit of a datasheet '
        f'(default {MARGIN:g})',
    )
    parser.add_argument(
        '--fail-on-difference',
        action='store_true',
        help=f'exit with {EXIT_DIFFERENT} if any difference is significant, or a limit of a '
        'datasheet is exceeded',
    )
    result = parser.add_argument_group('result')
    result.add_argument(
        '--method',
        choices=tuple(METHODS),
        default='gls',
        help='how sums and recordings are fitted (default gls); results are not fitted again',
    )
    result.add_argument(
        '--units',
        choices=('datasheet', 'si'),
        default='datasheet',
        help='units shown (default datasheet)',
    )
    add_settings(parser, 'pictures', PictureSettings)


def run(args: argparse.Namespace) -> int:
    """Read, compare, show and write."""
    from ..api import results_of
    from ..io.comparison import Subject, compare_runs, comparison_document
    from ..io.datasheets import load_sensor
    from ..io.documents import labels_of
    from ..io.plot_style import load_style

    console = Console.of(args)
    pictures = settings_of(PictureSettings, args)
    load_style(pictures.plot_style)
    if args.report and not args.output:
        raise AllanError('--report writes into the folder of -o: give one')
    if not args.margin >= 0.0:
        raise AllanError(f'--margin {args.margin:g}: give 0 or more')
    given = [text for text in args.inputs if text.startswith(SENSOR_PREFIX)]
    names = [text[len(SENSOR_PREFIX) :] for text in given] + args.sensor
    datasheets = [load_sensor(name) for name in names]
    paths = [text for text in args.inputs if text not in given]
    if len(args.label) > len(paths):
        raise AllanError(
            f'{len(args.label)} --label for {len(paths)} runs: give at most one per run'
        )
    labels = [*args.label, *labels_of(paths)[len(args.label) :]]
    if len(set(labels)) < len(labels):
        raise AllanError(f'two runs are called {_twice(labels)!r}: name them with --label')
    if len(paths) + len(datasheets) < 2 or not paths:
        raise AllanError('give two runs, or a run and sensor:NAME: there is nothing to compare')
    runs = [
        Subject(label, results_of(path, args.method, console)) for label, path in zip(labels, paths)
    ]
    comparison = compare_runs(runs, datasheets, args.margin)
    if console.json:
        console.document(comparison_document(comparison))
    elif not (console.quiet and args.output):
        print('\n'.join(comparison_lines(comparison, args.units, width())))
    if args.output:
        from ..io.comparison_files import write_comparison, write_overlay

        written = write_comparison(args.output, comparison, args.units, pictures)
        if args.report:
            written.append(write_overlay(args.output, runs, args.margin, args.units))
        console.say(f'written to {args.output}: {", ".join(path.name for path in written)}')
    return EXIT_DIFFERENT if args.fail_on_difference and comparison.differs else 0


def comparison_lines(comparison: RunComparison, units: str, columns: int) -> Iterator[str]:
    """Yield the lines of the verdict, of a table per sensor, and of the datasheet comparisons."""
    from ..core.imu import AXES, SENSORS
    from ..io.comparison import comparison_headline
    from .tables import datasheet_lines, table_lines

    for sentence in comparison_headline(comparison):
        yield from wrapped(sentence, columns, '  ')
    for sensor, where in SENSORS.items():
        axes = [a for a in AXES[where] if any(a in r.results.axes for r in comparison.runs)]
        if axes:
            cells = [_column(comparison, axis, units) for axis in axes]
            yield from table_lines(_labels(comparison, sensor, units), cells, columns)
    yield ''
    if comparison.pairs:
        yield from wrapped(
            f'ratios are to {comparison.runs[0].label}, with 95 % intervals; "higher" and "lower" '
            f'are more than chance: in runs of equal noise any of all that is compared is called '
            f'so in at most {comparison.family_error:.0%} of comparisons',
            columns,
        )
    for label, checked in comparison.datasheets:
        yield ''
        yield f'{label}'
        yield from datasheet_lines(checked, units, columns)


def _labels(comparison: RunComparison, sensor: str, units: str) -> list[str]:
    from ..core.fit import TERMS
    from ..io.format import shown_unit

    labels = [sensor]
    for term in TERMS:
        unit = shown_unit(sensor, term, units).name
        for i, subject in enumerate(comparison.runs):
            labels.append(f'{f"{term} {unit}" if i == 0 else "":16}{subject.label}')
        labels += [f'{"":16}{pair.second} ratio' for pair in comparison.pairs]
    labels += [f'deviation {pair.second}' for pair in comparison.pairs]
    return labels


def _column(comparison: RunComparison, axis: str, units: str) -> list[str]:
    """Return the cells of one axis: each term of each run and its ratio, then the deviations."""
    from ..core.fit import TERMS
    from ..io.comparison import ratio_text, verdict_text
    from ..io.format import interval_text, shown_unit, value_text

    cells = [axis.rsplit('_', 1)[1]]
    for term in TERMS:
        unit = shown_unit(axis, term, units)
        for subject in comparison.runs:
            result = subject.results.axes.get(axis)
            if result is None:
                cells.append(NOT_THERE)
                continue
            c = result.fit.noise[term]
            cells.append(f'{value_text(c, unit):9} {interval_text(c, unit)}'.rstrip())
        for pair in comparison.pairs:
            d = pair.of(axis, term)
            said = NOT_THERE if d is None else f'{ratio_text(d)} {verdict_text(d)}'.strip()
            cells.append(said)
    for pair in comparison.pairs:
        tried = [d for d in pair.differences if d.axis == axis and d.tau is not None]
        off = [d for d in tried if d.significant]
        cells.append(f'{len(off)} of {len(tried)} differ' if tried else NOT_THERE)
    return cells


def _twice(labels: Sequence[str]) -> str:
    return next(label for label in labels if labels.count(label) > 1)


def add_inflate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `allan inflate`."""
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


def inflate(args: argparse.Namespace) -> int:
    """Read both, show the factors, and write the files."""
    from .. import api
    from ..io.comparison import inflation_document, inflation_facts

    console = Console.of(args)
    if not 0.0 < args.horizon < float('inf'):
        raise AllanError(f'--horizon {args.horizon:g}: give a time above 0 s')
    inflation = api.inflate(args.rest, args.running, horizon=args.horizon, observer=console)
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


INFLATE = """
Measure what running motors add to the noise of a robot at rest.

REST is the robot at rest with its motors off, RUNNING the robot at rest with its motors on, each as
a results.json, the folder of an analysis, or a recording. Shown are N and K for a filter with the
factor on each, and the ratio of the Allan deviations.

  allan inflate rest/results.json motors_on/results.json
  allan inflate rest_bag motors_on_bag -o inflation
"""

COMMANDS = {
    'compare': Command(__doc__ or '', add_arguments, run, EXITS),
    'inflate': Command(INFLATE, add_inflate_arguments, inflate),
}
