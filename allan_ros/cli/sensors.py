# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""List the IMU datasheets that are known, or show one of them.

A name refers to a file of the package or to your own file in ~/.config/allan_ros/sensors; anything
that ends in .yaml is a path.

  allan sensors
  allan sensors icm-42688-p
  allan analyze my_bag --sensor icm-42688-p
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from .console import Console, width, wrapped
from .options import Command

if TYPE_CHECKING:
    from ..io.datasheets import Datasheet, Limit, Source

GAP = 2
"""Characters between two columns."""

DIGITS = 3
"""Significant digits of a limit."""

HEADERS = ('name', 'gyro N deg/sqrt(h)', 'gyro B deg/h', 'accel N ug/sqrt(Hz)', 'accel B ug')
"""The columns of the list: accelerometers are listed as their datasheets state them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument(
        'name', nargs='?', metavar='NAME', help='one to show with its sources (default: list all)'
    )


def run(args: argparse.Namespace) -> int:
    """Show one datasheet, or list all."""
    from ..io.datasheets import load_sensor, sensor_names

    console = Console.of(args)
    if args.name:
        sheet = load_sensor(args.name)
        if console.json:
            console.document(sensor_document(args.name, sheet))
        else:
            print('\n'.join(sensor_lines(sheet, width())))
        return 0
    sheets = {name: load_sensor(name) for name in sensor_names()}
    if console.json:
        console.document({'sensors': [sensor_document(n, s) for n, s in sheets.items()]})
    else:
        print('\n'.join(list_lines(sheets, width())))
    return 0


def list_lines(sheets: Mapping[str, Datasheet], columns: int) -> Iterator[str]:
    """Yield one line per sensor: upper limits of N and B, of its worst axis.

    Columns that do not fit the width are omitted, from the right.
    """
    rows = [HEADERS, *(_row(name, sheet) for name, sheet in sheets.items())]
    widths = [max(map(len, column)) + GAP for column in zip(*rows)]
    shown = sum(sum(widths[: n + 1]) - GAP <= columns for n in range(len(widths)))
    for row in rows:
        cells = (f'{cell:{w}}' for cell, w in zip(row[:shown], widths))
        yield ''.join(cells).rstrip()
    yield ''
    for name, sheet in sheets.items():
        if sheet.carries:
            yield from wrapped(f'{name} carries {sheet.carries}.', columns)
    yield from wrapped(
        'Upper limits from the datasheets; "-": not stated. `allan sensors NAME` shows one with '
        'its conditions and sources.',
        columns,
    )


def sensor_lines(sheet: Datasheet, columns: int) -> Iterator[str]:
    """Yield the figures of one datasheet, the limits of N and B that follow, and the sources."""
    yield f'{sheet.name}{f" ({sheet.maker})" if sheet.maker else ""}'
    if sheet.carries:
        yield f'carries {sheet.carries}; the figures are those of that sensor'
    if sheet.remark:
        yield from wrapped(sheet.remark, columns)
    for axes, term, limit in _grouped(sheet):
        yield ''
        where = ', '.join(axes)
        yield from wrapped(f'{where} {term}: stated {limit.stated}', columns, '  ')
        yield from wrapped(f'  limit {_limit_text(axes[0], term, limit)}', columns, '    ')
        for text in (limit.note, limit.condition):
            if text:
                yield from wrapped(f'  {text}', columns, '    ')
        yield from wrapped(f'  source: {limit.source}', columns, '    ')
    yield ''
    for key, source in sheet.sources.items():
        yield from wrapped(f'{key}: {_source_text(source)}', columns, '  ')


def sensor_document(name: str, sheet: Datasheet) -> dict[str, Any]:
    """Return a datasheet as plain values, limits in SI."""
    from ..core.imu import SI_UNITS, sensor_of

    return {
        'id': name,
        'name': sheet.name,
        'maker': sheet.maker,
        'carries': sheet.carries,
        'remark': sheet.remark,
        'sources': {key: asdict(source) for key, source in sheet.sources.items()},
        'limits': {
            axis: {
                term: {**asdict(limit), 'unit': SI_UNITS[sensor_of(axis)][term]}
                for term, limit in terms.items()
            }
            for axis, terms in sheet.limits.items()
        },
        'range': dict(sheet.range),
    }


def _row(name: str, sheet: Datasheet) -> tuple[str, ...]:
    cells = [name]
    for header in HEADERS[1:]:
        sensor, term, unit = header.split()
        cells.append(_worst(sheet, sensor, term, unit))
    return tuple(cells)


def _worst(sheet: Datasheet, sensor: str, term: str, unit: str) -> str:
    """Return the largest limit of a term among the axes of a sensor; '-' where there is none."""
    from ..core.imu import UNITS
    from ..io.format import significant

    limits = [
        terms[term].value
        for axis, terms in sheet.limits.items()
        if axis.startswith(sensor) and term in terms
    ]
    return significant(max(limits) / UNITS[unit].factor, DIGITS) if limits else '-'


def _grouped(sheet: Datasheet) -> list[tuple[list[str], str, Limit]]:
    """Return the limits, axes that share one together."""
    groups: dict[tuple[str, str, Limit], list[str]] = {}
    for axis, terms in sheet.limits.items():
        for term, limit in terms.items():
            groups.setdefault((axis.split('_')[0], term, limit), []).append(axis)
    return [(axes, term, limit) for (_, term, limit), axes in groups.items()]


def _limit_text(axis: str, term: str, limit: Limit) -> str:
    from ..io.format import shown_unit, significant

    units = (shown_unit(axis, term, system) for system in ('datasheet', 'si'))
    return ' = '.join(f'{significant(limit.value * u.factor, DIGITS)} {u.name}' for u in units)


def _source_text(source: Source) -> str:
    seen = {
        'datasheet': 'the document itself was read',
        'secondary': 'read where it is quoted',
        '': '',
    }[source.seen]
    parts = (str(source), source.url, f'{seen}{f": {source.via}" if source.via else ""}')
    return '; '.join(part for part in parts if part)


COMMANDS = {'sensors': Command(__doc__ or '', add_arguments, run)}
