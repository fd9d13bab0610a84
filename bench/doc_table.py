# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the documentation that benchmarks write.

A table is enclosed by two comments that Markdown does not show: ``<!-- table: faults -->`` and
``<!-- end -->``. Rows are identified by their first cell, so that a single row can be measured
again. Tables that no page of the documentation contains go to bench/results.md, which is not part
of the repository.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from allan_ros.io.files import write_atomic

RESULTS = Path(__file__).resolve().parent / 'results.md'


class DocTable:
    """One table of a document.

    Parameters
    ----------
    name : str
        As in its opening comment.
    heading : sequence of str
        Cells of the heading; the first column names the rows.
    path : Path
        The document.
    """

    def __init__(self, name: str, heading: Sequence[str], path: Path = RESULTS) -> None:
        self._opening, self._heading, self._path = f'<!-- table: {name} -->', heading, path

    def put(self, *rows: Sequence[str]) -> None:
        """Write rows; each replaces the row with the same first cell, or is appended at the end."""
        text = self._path.read_text() if self._path.exists() else ''
        if self._opening not in text:
            text += f'\n{self._opening}\n<!-- end -->\n'
        before, opening, rest = text.partition(self._opening)
        old, _, after = rest.partition('<!-- end -->')
        lines = [line for line in old.splitlines() if line.startswith('| ')][1:]
        known = {line[2:].split(' | ')[0]: line for line in lines}
        known |= {row[0]: _line(row) for row in rows}
        table = [_line(self._heading), '|---' * len(self._heading) + '|']
        text = '\n'.join([*table, *known.values()])
        write_atomic(self._path, f'{before}{opening}\n{text}\n<!-- end -->{after}')


def _line(cells: Sequence[str]) -> str:
    return f'| {" | ".join(cell.replace("|", "/") for cell in cells)} |'
