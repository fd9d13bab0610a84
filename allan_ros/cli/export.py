# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the measured noise to a file for a state estimator or simulator.

The input is a results.json of `allan analyze`, its folder, or a datasheet (--sensor). Without -o
the file goes to the standard output. Warnings about the exported numbers are in the header of the
file and on stderr.

  allan export --list
  allan export results --to openvins -o kalibr_imu_chain.yaml
  allan export results --to openvins --against my_imu_chain.yaml
  allan export --sensor bmi088 --to openvins --filter-rate 200
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping

from ..core.errors import AllanError
from ..core.estimate import LIMIT_DIGITS, significant
from ..core.fields import plain
from ..core.imu import UNITS, sensor_of, shown_unit
from ..export import TARGETS, ExportOptions
from ..readers.files import MAX_BYTES, read_text
from ..results.datasheets import Datasheet, Limit, load_sensor, sensor_names
from ..results.from_datasheet import DEFAULT_RATE_HZ, results_of_datasheet
from ..results.measured import measured_entry, measured_lines
from ..results.plan import plan_text
from ..view.finding_text import finding_document, finding_line
from ..view.table import GAP
from .console import Console, width, wrapped
from .options import Command, Option, Settings, settings_of


def run(args: argparse.Namespace) -> int:
    """Write or print a file for a state estimator or simulator, or list the export targets.

    With ``--against``, the drift that the user's file predicts and the measured drift are printed
    instead. Returns the exit code.
    """
    console = Console.of(args)
    if args.list and console.json:
        console.document({'targets': {name: target.title for name, target in TARGETS.items()}})
        return 0
    if args.list:
        name_width = max(map(len, TARGETS))
        for name, target in TARGETS.items():
            print(f'{name:{name_width}}  {target.title}')
        return 0
    if bool(args.results) == bool(args.sensor) or not args.to:
        raise AllanError(
            'give a results.json or its folder, or --sensor NAME, and --to TARGET; --list shows '
            'the targets'
        )
    from ..export import make_export, target_of, write_export
    from ..export.own_file import compare_drifts, verdicts
    from ..results.documents import load

    target_of(args.to)  # an unknown target is an error before the results are read
    options = settings_of(ExportOptions, args)
    if args.sensor:
        results = results_of_datasheet(
            load_sensor(args.sensor), options.filter_rate or DEFAULT_RATE_HZ
        )
    else:
        results = load(args.results)
    if args.against:
        drifts = compare_drifts(
            results, target_of(args.to), read_text(args.against, MAX_BYTES), options
        )
        if console.json:
            drift_documents = [{**drift._asdict(), 'ratio': drift.ratio} for drift in drifts]
            console.document({'target': args.to, 'against': args.against, 'drift': drift_documents})
        else:
            print('\n'.join([*map(str, drifts), *verdicts(drifts)]))
        return 0
    exported = make_export(results, args.to, options, finding_line)
    path = None
    if args.output:
        path = write_export(args.output, args.to, exported.text, args.overwrite)
    if console.json:
        findings = [finding_document(finding) for finding in exported.findings]
        destination = {'path': str(path)} if path else {'text': exported.text}
        console.document({'target': args.to, **destination, 'findings': findings})
    elif path is None:
        sys.stdout.write(exported.text)
    input_findings = results.findings if args.sensor else ()
    for finding in (*input_findings, *exported.findings):
        console.say(finding_line(finding))
    return 0


SEEN = {
    'datasheet': 'read in the document itself:',
    'secondary': 'not read, but quoted by',
    '': '',
}
"""`Source.seen` -> text that precedes the name of the document from which figures were read."""

HEADERS = ('name', 'gyro N deg/sqrt(h)', 'gyro B deg/h', 'accel N ug/sqrt(Hz)', 'accel B ug')
"""Column headers of the list of datasheets: 'name', then sensor, term and unit of each limit."""


def sensors(args: argparse.Namespace) -> int:
    """Print a datasheet, a list of datasheets, a test plan, or an entry for a datasheet file."""
    console = Console.of(args)
    if source := vars(args)['from']:
        from ..results.documents import load

        if args.name:
            raise AllanError(f'--from prints an entry for any sensor: omit {args.name}')
        print(measured_entry(load(source)))
        return 0
    if args.as_plan:
        if not args.name:
            raise AllanError('--as-plan needs the name of a sensor: `allan sensors` lists them')
        print(plan_text(load_sensor(args.name)), end='')
        return 0
    if args.name:
        sheet = load_sensor(args.name)
        if console.json:
            console.document({'id': args.name, **plain(sheet)})
            return 0
        print('\n'.join([*sensor_lines(sheet, width()), *measured_lines(sheet)]))
        return 0
    sheets = {name: load_sensor(name) for name in sensor_names()}
    if console.json:
        console.document({'sensors': [{'id': n, **plain(s)} for n, s in sheets.items()]})
    else:
        print('\n'.join(list_lines(sheets, width())))
    return 0


def list_lines(sheets: Mapping[str, Datasheet], columns: int) -> Iterator[str]:
    """Yield the lines of a table of datasheets, and of the explanations below the table.

    The table contains the limits of N and B of the gyro and the accelerometer; if the axes differ,
    the largest limit is shown. ``sheets`` maps names to datasheets. ``columns`` is the width of the
    text in characters; columns of the table that do not fit are omitted.
    """
    rows = [list(HEADERS)]
    for name, sheet in sheets.items():
        row = [name]
        for header in HEADERS[1:]:
            sensor, term, unit = header.split()
            axis_terms = (terms for axis, terms in sheet.limits.items() if axis.startswith(sensor))
            limits = [terms[term].value for terms in axis_terms if term in terms]
            row.append(
                significant(max(limits) / UNITS[unit].factor, LIMIT_DIGITS) if limits else '-'
            )
        rows.append(row)
    widths = [max(map(len, column)) + GAP for column in zip(*rows)]
    n_shown = sum(sum(widths[: n + 1]) - GAP <= columns for n in range(len(widths)))
    for row in rows:
        yield ''.join(f'{cell:{w}}' for cell, w in zip(row[:n_shown], widths)).rstrip()
    yield ''
    for name, sheet in sheets.items():
        if sheet.carries:
            yield from wrapped(f'{name} carries {sheet.carries}.', columns)
    yield from wrapped(
        'Upper limits from the datasheets; "-": not stated. `allan sensors NAME` shows one '
        'datasheet with its conditions and sources.',
        columns,
    )


def sensor_lines(sheet: Datasheet, columns: int) -> Iterator[str]:
    """Yield the lines of one datasheet: figures, limits in datasheet units and SI, and sources.

    ``columns`` is the width of the text in characters.
    """
    yield from wrapped(f'{sheet.name}{f" ({sheet.maker})" if sheet.maker else ""}', columns)
    if sheet.carries:
        yield from wrapped(f'contains {sheet.carries}; the figures are from this sensor', columns)
    if sheet.remark:
        yield from wrapped(sheet.remark, columns)
    groups: dict[tuple[str, str, Limit], list[str]] = {}  # (sensor, term, limit) -> axes
    for axis, terms in sheet.limits.items():
        for term, limit in terms.items():
            groups.setdefault((sensor_of(axis), term, limit), []).append(axis)
    for (sensor, term, limit), axes in groups.items():
        units = (shown_unit(sensor, term, system) for system in ('deg/h', 'SI'))
        values = (f'{significant(limit.value * u.factor, LIMIT_DIGITS)} {u.name}' for u in units)
        yield ''
        yield from wrapped(f'{", ".join(axes)} {term}: stated {limit.stated}', columns, '  ')
        limit_texts = (f'limit {" = ".join(values)}', limit.note, limit.condition)
        for text in (*filter(None, limit_texts), f'source: {limit.source}'):
            yield from wrapped(f'  {text}', columns, '    ')
    yield ''
    for key, source in sheet.sources.items():
        parts = (str(source), source.url, f'{SEEN[source.seen]} {source.via}'.strip())
        yield from wrapped(f'{key}: {"; ".join(filter(None, parts))}', columns, '  ')


SENSORS_TEXT = """
List the known IMU datasheets, or show one of them.

A name refers to a file of the package or to your own file in ~/.config/allan_ros/sensors. A NAME
that ends in .yaml is a path.

  allan sensors
  allan sensors icm-42688-p
  allan sensors --from results > entry.yaml
  allan sensors icm-42688-p --as-plan > plan.yaml
  allan analyze my_bag --sensor icm-42688-p
"""

EXPORT_OPTIONS = (
    Option(('results',), 'results.json, or its folder', 'RESULTS', nargs='?'),
    Option(
        ('--sensor',),
        'export the noise that this datasheet states, instead of measured results; `allan sensors` '
        'lists the names',
        'NAME',
    ),
    Option(
        ('--to',),
        'state estimator or simulator that reads the file; --list lists them',
        'TARGET',
        default='',
    ),
    Option(('--list',), 'list the export targets, one per line'),
    Option(
        ('-o', '--output'),
        'file to write (default: standard output)',
        'FILE',
    ),
    Option(('--overwrite',), 'replace a file that was not written by allan_ros'),
    Option(
        ('--against',),
        'your own file for TARGET: print the drift after 1, 10 and 60 s that a state estimator '
        'with this file expects, and the measured drift; no file is written',
        'EXISTING',
    ),
)

SENSOR_OPTIONS = (
    Option(
        ('name',),
        'sensor whose figures, sources and measured values are shown (default: list all)',
        'NAME',
        nargs='?',
    ),
    Option(
        ('--from',),
        'print these results (results.json, or its folder) as an entry for a datasheet file',
        'RESULTS',
    ),
    Option(
        ('--as-plan',),
        'print a test plan with the limits of the datasheet, for `allan check --plan`',
    ),
)

EXPORT = Command(__doc__ or '', [*EXPORT_OPTIONS, Settings('numbers', ExportOptions)], run)

SENSORS_COMMAND = Command(SENSORS_TEXT, SENSOR_OPTIONS, sensors)
