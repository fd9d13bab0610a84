# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output of all verbs: results go to stdout, messages and progress to stderr."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import textwrap
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from ..core.errors import one_line
from ..version import __version__
from .options import Option, OptionGroup

EXIT_ERROR, EXIT_FAULT = 1, 70
"""Exit codes for an error that the user can fix, and for a bug."""

UNLIMITED = 100_000
"""Width in columns if there is no terminal and ``COLUMNS`` is not set: practically unlimited."""

LABEL = 30
"""Largest number of characters in the label of a progress bar. Only the end of a longer label is
shown."""


class Progress:
    """A progress bar on stderr with the remaining time.

    Nothing is shown if stderr is not a terminal, if the package rich is not installed, or if
    ``shown`` is False. ``total`` is the number of samples or recordings to process; None if it is
    unknown, in which case the number of processed samples or recordings is shown without a bar.
    """

    def __init__(self, label: str, total: int | None, shown: bool = True) -> None:
        self._bar = _bar(total) if shown and sys.stderr.isatty() else None
        if self._bar is not None:
            shown_label = label if len(label) <= LABEL else f'...{label[3 - LABEL :]}'
            self._task = self._bar.add_task(shown_label, total=total or 0)

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, done: int) -> None:
        """Advance the bar by a number of processed samples or recordings."""
        if self._bar is not None:
            self._bar.advance(self._task, done)


def _bar(total: int | None) -> Any:
    """Return a progress bar of the package rich, or None if rich is not installed.

    The bar is erased from the terminal at the end.
    """
    try:
        from rich.console import Console as Terminal
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar
    except ImportError:
        return None
    columns: list[Any] = [TextColumn('{task.description}', markup=False)]
    if total:
        columns += [BarColumn(), TextColumn('{task.percentage:3.0f} %'), TimeRemainingColumn()]
    columns.append(TextColumn('{task.completed:,.0f}'))
    return Bar(*columns, console=Terminal(stderr=True), transient=True)


NARROWEST = 40
"""Smallest width in columns to which text is wrapped. Narrower terminals break the lines again."""

SEVERITY_COLORS = {'info': '36', 'warning': '33', 'error': '31'}
"""Severity of a finding -> ANSI color (ECMA-48): cyan, yellow, red."""

COMMON_OPTIONS: tuple[OptionGroup, ...] = (
    OptionGroup(
        'terminal',
        (
            Option(('--json',), 'print one JSON document to stdout; messages go to stderr'),
            Option(
                ('-q', '--quiet'),
                'print errors only; print the result only if it is not written to files',
                exclusive=True,
            ),
            Option(
                ('-v', '--verbose'),
                'print every finding with its remedy',
                exclusive=True,
            ),
        ),
    ),
)
"""Options of every verb."""


@dataclass(frozen=True)
class Console:
    """Output of one verb: as text or JSON, quiet or verbose."""

    verb: str = ''
    json: bool = False
    quiet: bool = False
    verbose: bool = False

    @classmethod
    def of(cls, args: argparse.Namespace) -> Console:
        """Return the console for the parsed arguments of a verb."""
        return cls(args.verb, args.json, args.quiet, args.verbose)

    def document(self, document: Mapping[str, Any]) -> None:
        """Print a JSON document to stdout, indented and in ASCII."""
        print(json.dumps(document, indent=1, allow_nan=False))

    def line(self, document: Mapping[str, Any]) -> None:
        """Print a JSON document to stdout as one line, and flush stdout."""
        print(json.dumps(document, allow_nan=False), flush=True)

    def say(self, text: str) -> None:
        """Print a message to stderr, unless ``--quiet`` is given."""
        if not self.quiet:
            print(one_line(f'allan {self.verb}: {text}'), file=sys.stderr)

    def progress(self, label: str, total: int | None) -> Progress:
        """Return a progress bar for ``total`` samples or recordings; ``--quiet`` suppresses it."""
        return Progress(label, total, shown=not self.quiet)


def width() -> int:
    """Return the width of the output in columns, at least `NARROWEST`.

    The width is the environment variable ``COLUMNS`` if it is a number above 0, else the width of
    the terminal. Without a terminal, the width is `UNLIMITED`.
    """
    return max(shutil.get_terminal_size((UNLIMITED, 24)).columns, NARROWEST)


def colored(stream: TextIO) -> bool:
    """Return whether colors are printed to a stream: by default, if the stream is a terminal.

    A non-empty ``NO_COLOR`` turns colors off; otherwise, a non-empty ``FORCE_COLOR`` turns them on
    (no-color.org, force-color.org). A terminal with ``TERM=dumb`` shows no colors by default.
    """
    if os.environ.get('NO_COLOR'):
        return False
    if os.environ.get('FORCE_COLOR'):
        return True
    return stream.isatty() and os.environ.get('TERM') != 'dumb'


def painted(line: str, word: str, color: str, colors: bool) -> str:
    """Return a line of text in which the first occurrence of a word is colored.

    Parameters
    ----------
    line, word : str
        The line, and the word to color.
    color : str
        ANSI color, such as '1;31'.
    colors : bool
        Whether colors are used; if False, the line is returned unchanged.
    """
    return line.replace(word, f'\x1b[{color}m{word}\x1b[0m', 1) if colors else line


def wrapped(text: str, columns: int, indent: str = '') -> list[str]:
    """Return a text as lines of fewer than ``columns`` characters.

    All lines but the first begin with ``indent``. If ``columns`` is less than `NARROWEST`, the
    lines have up to `NARROWEST` - 1 characters.
    """
    line_width = max(columns, NARROWEST) - 1
    return textwrap.wrap(text, line_width, subsequent_indent=indent, break_on_hyphens=False)


def fault_text(error: Exception) -> str:
    """Return a text about an unexpected error and the lines where it occurred, for a bug report."""
    package = Path(__file__).parents[1]
    frames = traceback.extract_tb(error.__traceback__)
    own_frames = [frame for frame in frames if package in Path(frame.filename).parents]
    locations = [f'{Path(f.filename).relative_to(package)}:{f.lineno}' for f in own_frames[-2:]]
    return (
        f'internal error of allan_ros {__version__}: {type(error).__name__}: {error} '
        f'at {" > ".join(locations)}; please report this line and the command'
    )
