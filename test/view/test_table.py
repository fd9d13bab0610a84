# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A table is complete and legible in each output."""

from __future__ import annotations

import csv
import io

import pytest

from allan_ros.view.table import (
    Cell,
    Heading,
    Record,
    Table,
    csv_text,
    html_table,
    records,
    terminal_lines,
)

COLUMNS = [Heading('run', repeats=True), *(Heading(axis) for axis in 'xyz')]
NUMBERS = [Cell(f'{i}.5', f'{i}.0..{i + 1}.0', i + 0.5) for i in range(3)]
TABLE = Table(
    Heading('gyro'),
    COLUMNS,
    [
        (Heading('N', 'deg'), [Cell('first'), *NUMBERS]),
        (Heading('B'), [Cell('second'), Cell('-'), Cell(), Cell('3', status='exceeds')]),
    ],
)


@pytest.mark.parametrize('width', [40, 45, 60, 80, 200])
def test_a_narrow_table_is_split_but_never_cut(width: int) -> None:
    lines = list(terminal_lines(TABLE, width))
    assert max(map(len, lines)) <= width
    words = ' '.join(lines).split()
    for cell in NUMBERS:
        assert words.count(cell.text) == words.count(cell.detail) == 1
    parts = '\n'.join(lines).split('\n\n')
    assert all('first' in part and part.startswith('gyro') for part in parts)
    assert len(parts) == {40: 3, 45: 2}.get(width, 1)


def test_a_column_that_is_too_wide_has_several_lines() -> None:
    name = 'a_recording_with_a_long_name' * 3
    table = Table(Heading(''), COLUMNS, [(Heading('N'), [Cell(name), *NUMBERS])])
    lines = list(terminal_lines(table, 60))
    assert max(map(len, lines)) <= 60
    text = ' '.join(lines)
    assert all(cell.detail in text for cell in NUMBERS)
    folded = ''.join(line[16:].split('  ')[0] for line in lines)
    assert name in folded


def test_columns_are_aligned_by_the_width_of_their_characters() -> None:
    wide = Table(
        Heading(''), [Heading('a'), Heading('b')], [(Heading('r'), [Cell('陀螺'), Cell('1')])]
    )
    head, row = terminal_lines(wide, 80)
    assert head.index('b') == row.index('1') + len('陀螺')  # two columns each


def test_a_long_text_wraps_in_its_column() -> None:
    text = 'word ' * 20
    table = Table(Heading(''), [Heading('', wraps=True)], [(Heading('key'), [Cell(text)])])
    lines = list(terminal_lines(table, 40))
    assert max(map(len, lines)) <= 40 and lines[0].startswith('key')
    assert ' '.join(lines).split() == ['key', *text.split()]


def test_html_shows_one_system_of_units_and_escapes_texts() -> None:
    def of(units: str) -> Table:
        value = {'deg/h': '1', 'SI': '2'}[units]
        cells = [Cell(f'<{value}>', '1..2', status='estimated'), Cell('a\nb', link='https://x?a&b')]
        return Table(Heading('<t>'), [Heading('x'), Heading('y')], [(Heading('N', units), cells)])

    html = html_table('kind', of)
    for value, units in (('1', 'deg/h'), ('2', 'SI')):
        shown = f'<span data-units="{units}">&lt;{value}&gt;<small>1<wbr>..2</small></span>'
        assert shown in html
    assert '<td class="estimated">' in html and '<th scope="col">&lt;t&gt;</th>' in html
    assert '<td><a href="https://x?a&amp;b">a<br>b</a></td>' in html  # equal texts are written once


def test_html_marks_the_result_of_a_comparison_and_shows_a_dash_for_the_unknown() -> None:
    html = html_table('kind', lambda _: TABLE)
    assert '<b class="mark exceeds"><i aria-hidden="true">✕</i> exceeds</b></td>' in html
    assert '<td>–</td><td></td>' in html


def test_records_and_csv_have_the_values() -> None:
    rows: list[Record] = records(TABLE)
    assert rows[0] == {'gyro': 'N', 'run': None, 'x': 0.5, 'y': 1.5, 'z': 2.5}
    assert rows[1]['x'] is None
    text = csv_text([{**rows[0], 'z': 1 / 3}, {'gyro': 'a,b'}], ['gyro', 'x', 'y', 'z', 'run'])
    read = list(csv.DictReader(io.StringIO(text)))
    assert read[0] == {'gyro': 'N', 'x': '0.5', 'y': '1.5', 'z': '0.333333', 'run': ''}
    assert read[1] == {'gyro': 'a,b', 'x': '', 'y': '', 'z': '', 'run': ''}


def test_a_row_with_a_missing_cell_is_rejected() -> None:
    with pytest.raises(ValueError, match='one cell for each column'):
        TABLE.with_rows((Heading('K'), [Cell()]))
