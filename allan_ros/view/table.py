# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One `Table` of cells for all outputs: terminal text, HTML, CSV, and records for JSON.

A cell has a text for readers and a value for programs. Each function renders a table for one of the
outputs.
"""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, Literal, NamedTuple

from ..core.estimate import NOTHING_KNOWN
from ..core.settings import UNIT_SYSTEMS
from .format import pretty_unit

if TYPE_CHECKING:
    from rich.table import Table as Grid

DASH = '–'
"""Text of an unknown number in HTML, instead of `NOTHING_KNOWN`."""

MARKS = {'within': '✓', 'undecided': '≈', 'exceeds': '✕'}
"""Result of the comparison with a limit -> symbol beside this result in HTML."""

GAP, HEADINGS = 2, 14
"""Space between the columns of a table in the terminal, and smallest width of the row headings, in
characters. The smallest width aligns the tables of several sensors."""

WIDE = 1000
"""Width in characters of text that is not shown in a terminal, practically unlimited."""


class Heading(NamedTuple):
    """Heading of a column or of a row: name, unit of its cells, and an explanation.

    The explanation ``note`` is shown only in HTML; ``align``, ``wraps`` and ``repeats`` are used
    only in the terminal. ``align`` is the alignment of a column. If ``wraps`` is set, the texts of
    the column are broken into lines that fit the terminal; other columns are as wide as their
    content, unless a single column does not fit. If a table is too wide and therefore split, each
    part contains the columns for which ``repeats`` is set.
    """

    name: str
    unit: str = ''
    note: str = ''
    align: Literal['left', 'right'] = 'left'
    wraps: bool = False
    repeats: bool = False


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes
    ----------
    text : str
        The content for readers, which may have line breaks; '' for an empty cell.
    detail : str
        Further content, such as an interval, which is shown beside the text or below it.
    value : float, int, str or None
        The content for programs; None if it is unknown.
    status : str
        Status of a coefficient, such as 'not_observable', or the result of a comparison, such as
        'exceeds'. In HTML, a status in `MARKS` is shown with its symbol; another status is the
        class of the cell.
    link : str
        Address to which the text is linked in HTML.
    """

    text: str = ''
    detail: str = ''
    value: float | int | str | None = None
    status: str = ''
    link: str = ''


@dataclass(frozen=True)
class Table:
    """Rows of cells below the headings of their columns.

    Attributes
    ----------
    corner : Heading
        Heading of the column that contains the headings of the rows.
    columns : sequence of Heading
        Headings of the other columns.
    rows : sequence of (Heading, sequence of Cell)
        Each row has one cell for each column.
    note : str
        Explanation below the table; '' for no explanation.

    Raises
    ------
    ValueError
        When a row does not have one cell for each column.
    """

    corner: Heading
    columns: Sequence[Heading]
    rows: Sequence[tuple[Heading, Sequence[Cell]]]
    note: str = ''

    def __post_init__(self) -> None:
        if any(len(cells) != len(self.columns) for _, cells in self.rows):
            raise ValueError('each row needs one cell for each column')

    @property
    def has_headings(self) -> bool:
        """Whether any column has a heading."""
        return any(heading.name for heading in (self.corner, *self.columns))

    def with_rows(self, *rows: tuple[Heading, Sequence[Cell]]) -> Table:
        """Return the table with the given rows appended."""
        return replace(self, rows=(*self.rows, *rows))


# --- terminal text --------------------------------------------------------------------------------


def terminal_lines(table: Table, width: int) -> Iterator[str]:
    """Yield the lines of a table and of its note with at most ``width`` characters.

    If the table is too wide, details are printed below the texts. If it is still too wide, it is
    split into several tables with fewer columns, which are separated by empty lines. The texts in a
    single column that is too wide are broken into several lines. A table with a column that
    ``wraps`` is not split: the texts in this column are broken into several lines instead.

    Examples
    --------
    >>> angle = Table(Heading('gyro'), [Heading('x')], [(Heading('N', 'deg'), [Cell('1', '0..2')])])
    >>> print(*terminal_lines(angle, 80), sep='\\n')
    gyro            x
    N deg           1 0..2
    >>> print(*terminal_lines(angle, 20), sep='\\n')
    gyro            x
    N deg           1
                    0..2
    """
    from rich.console import Console

    output = io.StringIO()
    console = Console(
        file=output, width=width, color_system=None, markup=False, emoji=False, highlight=False
    )

    def fits(grid: Grid) -> bool:
        wraps = any(column.wraps for column in table.columns)
        double_width = console.options.update(width=2 * width)
        return wraps or console.measure(grid, options=double_width).maximum <= width

    all_columns = range(len(table.columns))
    repeated = [i for i in all_columns if table.columns[i].repeats]
    other_columns = [i for i in all_columns if i not in repeated]
    grids = [_grid(table, all_columns, details_beside=True)]
    if not fits(grids[0]):
        counts = range(len(other_columns), 0, -1)
        n_columns = next(
            (n for n in counts if fits(_grid(table, [*repeated, *other_columns[:n]]))), 1
        )
        parts = [
            [*repeated, *other_columns[i : i + n_columns]]
            for i in range(0, len(other_columns), n_columns)
        ]
        grids = [
            grid if fits(grid := _grid(table, part)) else _grid(table, part, folds=True)
            for part in parts
        ]
    for i, each in enumerate(grids):
        console.print(*([''] * bool(i)), each, sep='\n')
    yield from (line.rstrip() for line in output.getvalue().splitlines())
    yield from textwrap.wrap(table.note, width - 1, break_on_hyphens=False)


def _grid(
    table: Table, columns: Sequence[int], details_beside: bool = False, folds: bool = False
) -> Grid:
    """Return the given columns of a table as a table of the package `rich`.

    The details of cells are beside the texts if ``details_beside`` is set, else below the texts.
    ``folds`` permits line breaks in all columns.
    """
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid.grid(padding=(0, GAP, 0, 0), pad_edge=False)
    grid.add_column(no_wrap=not folds, overflow='fold', min_width=HEADINGS)
    for i in columns:
        heading = table.columns[i]
        wraps = folds or heading.wraps
        grid.add_column(no_wrap=not wraps, overflow='fold', justify=heading.align)
    widths = {i: max((len(cells[i].text) for _, cells in table.rows), default=0) for i in columns}

    def text_of(cell: Cell, i: int) -> Text:
        if not details_beside or not cell.detail:
            return Text('\n'.join(filter(None, (cell.text, cell.detail))))
        return Text(f'{cell.text:{widths[i]}} {cell.detail}')

    if table.has_headings:
        grid.add_row(Text(_plain(table.corner)), *(Text(_plain(table.columns[i])) for i in columns))
    for heading, cells in table.rows:
        grid.add_row(Text(_plain(heading)), *(text_of(cells[i], i) for i in columns))
    return grid


def _plain(heading: Heading) -> str:
    return f'{heading.name} {heading.unit}'.rstrip()


# --- HTML -----------------------------------------------------------------------------------------


def in_units(html_of: Callable[[str], str]) -> str:
    """Return HTML that contains a text in datasheet units and in SI; the page shows one of them.

    ``html_of`` returns the HTML of the text for 'deg/h' or 'SI'. If both texts are equal, the HTML
    contains the text once.
    """
    texts = {units: html_of(units) for units in UNIT_SYSTEMS}
    if len({*texts.values()}) == 1:
        return texts[UNIT_SYSTEMS[0]]
    return ''.join(f'<span data-units="{units}">{text}</span>' for units, text in texts.items())


def html_table(kind: str, table_of: Callable[[str], Table]) -> str:
    """Return a table as HTML, with its texts in datasheet units and in SI.

    ``table_of`` returns the table for 'deg/h' or 'SI'. Both tables must have the same numbers of
    rows and columns. ``kind`` is the class of the table in the style sheet.
    """
    tables = {units: table_of(units) for units in UNIT_SYSTEMS}
    first_table = tables[UNIT_SYSTEMS[0]]

    def heading(heading_of: Callable[[Table], Heading]) -> str:
        return in_units(lambda units: heading_html(heading_of(tables[units])))

    corner = heading(lambda table: table.corner)
    header_cells = f'<th scope="col">{corner}</th>' if corner else '<td></td>'
    for i, column in enumerate(first_table.columns):
        class_attribute = f' class="{escape(column.name)}"' if column.name.isalpha() else ''
        header_cells += (
            f'<th scope="col"{class_attribute}>{heading(lambda t, i=i: t.columns[i])}</th>'  # type: ignore[misc]
        )
    body = ''
    for r, (_, cells) in enumerate(first_table.rows):
        body += f'<tr><th scope="row">{heading(lambda t, r=r: t.rows[r][0])}</th>'  # type: ignore[misc]
        for i, cell in enumerate(cells):
            content_html = in_units(lambda units, r=r, i=i: _cell_html(tables[units].rows[r][1][i]))  # type: ignore[misc]
            class_attribute = (
                f' class="{cell.status}"' if cell.status and cell.status not in MARKS else ''
            )
            body += f'<td{class_attribute}>{content_html}{_mark_html(cell.status)}</td>'
        body += '</tr>'
    header = f'<thead><tr>{header_cells}</tr></thead>' if first_table.has_headings else ''
    note = note_html(first_table.note) if first_table.note else ''
    return f'<table class="{kind}">{header}<tbody>{body}</tbody></table>{note}'


def note_html(text: str) -> str:
    """Return an explanation below a table or chart as HTML."""
    return f'<p class="note">{escape(text, quote=False).replace(" %", "&nbsp;%")}</p>'


def heading_html(heading: Heading) -> str:
    """Return a heading as HTML: name and unit, with the explanation below."""
    unit = f' <em>{escape(pretty_unit(heading.unit))}</em>' if heading.unit else ''
    note = f'<small>{escape(heading.note)}</small>' if heading.note else ''
    return f'{escape(heading.name)}{unit}{note}'


def _cell_html(cell: Cell) -> str:
    text = DASH if cell.text == NOTHING_KNOWN else escape(cell.text).replace('\n', '<br>')
    if cell.link:
        text = f'<a href="{escape(cell.link)}">{text}</a>'
    # in an interval, a line break is permitted only before the two dots
    detail = escape(cell.detail).replace('..', '<wbr>..')
    return f'{text}<small>{detail}</small>' if detail else text


def _mark_html(status: str) -> str:
    if status not in MARKS:
        return ''
    return f'<b class="mark {status}"><i aria-hidden="true">{MARKS[status]}</i> {status}</b>'


# --- programs -------------------------------------------------------------------------------------

Record = Mapping[str, 'float | int | str | None']
"""Values of one row of a table: name of a column -> value."""


def records(table: Table) -> list[Record]:
    """Return each row of a table as a record: name of the column -> value of the cell.

    The heading of a row is the value of the first column.
    """
    names = [table.corner.name, *(column.name for column in table.columns)]
    return [
        dict(zip(names, (heading.name, *(cell.value for cell in cells))))
        for heading, cells in table.rows
    ]


def csv_text(rows: Iterable[Record], names: Sequence[str]) -> str:
    """Return records as the text of a CSV file, with the names of the columns in the first line.

    The cell of a value that is None or missing is empty. Floating-point numbers have six
    significant digits. Raises ValueError if a record has a name that ``names`` does not contain.
    """
    file = io.StringIO()
    writer = csv.DictWriter(file, names, restval='', lineterminator='\n')
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {
                name: f'{value:.6g}' if isinstance(value, float) else value
                for name, value in row.items()
            }
        )
    return file.getvalue()
