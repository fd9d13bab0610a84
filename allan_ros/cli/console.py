# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output of all verbs: results to stdout, everything else to stderr, as much as requested."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TextIO

from ..core.errors import one_line

WIDTH = 100
"""Width in columns if there is no terminal and ``COLUMNS`` is not set."""

LABEL = 30
"""Largest number of characters of the label of a progress bar; a longer label loses its
beginning."""


class Progress:
    """A progress bar on stderr with the remaining time; silent if stderr is not a terminal.

    ``total`` is the number of units of work, or None if unknown.
    """

    def __init__(self, label: str, total: int | None, shown: bool = True) -> None:
        self._bar = _bar(total) if shown and sys.stderr.isatty() else None
        if self._bar is not None:
            short = label if len(label) <= LABEL else f'...{label[3 - LABEL :]}'
            self._task = self._bar.add_task(short, total=total or 0)

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, units: int) -> None:
        """Count further completed units."""
        if self._bar is not None:
            self._bar.advance(self._task, units)


def _bar(total: int | None) -> Any:
    """Return a progress bar of rich that is erased at its end; None if rich is not installed."""
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
"""Width in columns below which text is not wrapped here, but by the terminal."""

SEVERITY_COLOURS = {'info': '36', 'warning': '33', 'error': '31'}
"""ANSI colours (ECMA-48): cyan, yellow, red. They only emphasize the word of the severity."""


OPTIONS = """
terminal:
  --json  print one JSON document to stdout; messages go to stderr
  | -q --quiet  print errors only; print the result only if it is not written to files
  | -v --verbose  print every finding with its remedy; print settings, inputs and times to
    stderr
"""
"""Options of every verb."""


@dataclass(frozen=True)
class Console:
    """Output of a verb, controlled by `OPTIONS`."""

    verb: str = ''
    json: bool = False
    quiet: bool = False
    verbose: bool = False

    @classmethod
    def of(cls, args: argparse.Namespace) -> Console:
        """Return the console that the arguments select."""
        return cls(args.verb, args.json, args.quiet, args.verbose)

    def document(self, document: Mapping[str, Any]) -> None:
        """Print the document of ``--json``, in ASCII for any terminal or pipe."""
        print(json.dumps(document, indent=1, allow_nan=False))

    def say(self, text: str) -> None:
        """Print a message to stderr."""
        if not self.quiet:
            print(one_line(f'allan {self.verb}: {text}'), file=sys.stderr)

    def detail(self, text: str) -> None:
        """Print a detail to stderr if ``--verbose`` is given."""
        if self.verbose:
            self.say(text)

    def progress(self, label: str, total: int | None) -> Progress:
        """Return a progress bar; ``--quiet`` suppresses it."""
        return Progress(label, total, shown=not self.quiet)

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Report the duration of a step after its end."""
        began = time.monotonic()
        yield
        self.detail(f'{what}: {time.monotonic() - began:.2f} s')


def width() -> int:
    """Return the width of the output: of the terminal, else ``COLUMNS``, else the default."""
    return max(shutil.get_terminal_size((WIDTH, 24)).columns, NARROWEST)


def coloured(stream: TextIO) -> bool:
    """Return whether to write colours: on a terminal, unless the environment overrides it.

    A non-empty ``NO_COLOR`` turns colours off, a non-empty ``FORCE_COLOR`` turns them on
    (no-color.org, force-color.org).
    """
    if os.environ.get('NO_COLOR'):
        return False
    if os.environ.get('FORCE_COLOR'):
        return True
    return stream.isatty() and os.environ.get('TERM') != 'dumb'


def painted(line: str, word: str, colour: str, colours: bool) -> str:
    """Return the line with the first occurrence of the word in an ANSI colour, if colours are
    on."""
    return line.replace(word, f'\x1b[{colour}m{word}\x1b[0m', 1) if colours else line


def wrapped(text: str, columns: int, indent: str = '') -> list[str]:
    """Return the text in lines that leave the last column free; all but the first are indented."""
    room = max(columns, NARROWEST) - 1
    return textwrap.wrap(text, room, subsequent_indent=indent, break_on_hyphens=False)
