# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the table of sensors in docs/sensors.md, from the files in config/sensors.

usage: sensor_table.py

A test fails if the table is stale.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from allan_ros.results.datasheets import Datasheet, load_sensor

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / 'docs' / 'sensors.md'
SENSORS = ROOT / 'config' / 'sensors'

BEGIN = '<!-- Written by scripts/sensor_table.py (`make docs`): change config/sensors. -->'
END = '<!-- end -->'

COLUMNS = (('gyro', 'N'), ('gyro', 'B'), ('accel', 'N'), ('accel', 'B'))


def table() -> str:
    """Return the table as Markdown: N and B of each datasheet, and the sources."""
    return '\n'.join(_lines()) + '\n'


def _lines() -> Iterator[str]:
    yield '| name | gyro N | gyro B | accel N | accel B | source | read |'
    yield '|---|---|---|---|---|---|---|'
    for path in sorted(SENSORS.glob('*.yaml')):
        sheet = load_sensor(str(path))
        cells = [_stated(sheet, sensor, term) for sensor, term in COLUMNS]
        titles = '; '.join(dict.fromkeys(map(str, sheet.sources.values())))
        how = ', '.join(dict.fromkeys(source.seen for source in sheet.sources.values()))
        name = f'`{path.stem}`' + (f' (carries {sheet.carries})' if sheet.carries else '')
        yield f'| {name} | {" | ".join(cells)} | {titles} | {how} |'


def _stated(sheet: Datasheet, sensor: str, term: str) -> str:
    """Return a term of a datasheet as text; axes with equal values are named together."""
    axes: dict[str, list[str]] = {}
    for axis, limits in sheet.limits.items():
        if axis.startswith(sensor) and term in limits:
            axes.setdefault(limits[term].stated, []).append(axis[-1])
    return ', '.join(
        stated if len(of) == 3 else f'{"".join(of)}: {stated}' for stated, of in axes.items()
    )


def page(text: str) -> str:
    """Return the text of docs/sensors.md with the current table."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f'{before}{BEGIN}\n\n{table()}\n{END}{after}'


def main() -> None:
    """Write docs/sensors.md."""
    PAGE.write_text(page(PAGE.read_text()))


if __name__ == '__main__':
    main()
