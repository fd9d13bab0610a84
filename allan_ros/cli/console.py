# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output of all verbs: results to stdout, everything else to stderr, as much as asked for."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Any, TextIO

from ..core.errors import one_line
from ..core.findings import Finding, duration_text

WIDTH = 100
"""Columns where there is no terminal and ``COLUMNS`` does not say."""


REDRAW_S = 0.1
"""Seconds between two updates of the bar."""


BAR = 24
"""Characters of the bar."""


class Progress:
    """A progress bar with the time left, drawn on a terminal only; elsewhere it is silent.

    Parameters
    ----------
    label : str
        What is being done.
    total : int or None
        How many units the work has; None when it is not known in advance.
    stream : file, optional
        Where to draw (default: stderr).
    shown : bool
        Whether to draw at all.
    """

    def __init__(
        self, label: str, total: int | None, stream: TextIO | None = None, shown: bool = True
    ) -> None:
        self._label = label
        self._total = total
        self._stream = sys.stderr if stream is None else stream
        self._draws = shown and self._stream.isatty()
        self._start = self._drawn = time.monotonic()
        self._done = 0

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._draws:
            self._stream.write('\r\x1b[K')  # erase the bar before the result is printed
            self._stream.flush()

    def advance(self, units: int) -> None:
        """Count further completed units."""
        self._done += units
        now = time.monotonic()
        if self._draws and now - self._drawn >= REDRAW_S:
            self._drawn = now
            width = shutil.get_terminal_size().columns
            line = progress_line(self._label, self._done, self._total, now - self._start, width - 1)
            self._stream.write(f'\r\x1b[K{line}')
            self._stream.flush()


def progress_line(
    label: str, done: int, total: int | None, elapsed_s: float, columns: int = WIDTH
) -> str:
    """Return the line of the progress bar, at most ``columns`` wide.

    In a narrow terminal the speed is omitted first, then the beginning of the label.
    """
    speed = done / elapsed_s if elapsed_s > 0 else 0.0
    counted = f'{done:,} samples, {speed:,.0f}/s'
    if not total:
        return _fitted(label, f'  {counted}', columns)
    share = min(done / total, 1.0)
    filled = round(share * BAR)
    left = f', {duration_text((total - done) / speed)} left' if speed > 0 and done < total else ''
    bar = f'  [{"#" * filled}{"." * (BAR - filled)}] {share:4.0%}'
    rest = f'{bar}  {counted}{left}'
    return _fitted(label, rest if len(label) + len(rest) <= columns else f'{bar}{left}', columns)


def _fitted(label: str, rest: str, columns: int) -> str:
    """Return both in one line; a label that is too long loses its beginning."""
    room = max(columns - len(rest), 8)
    return (label if len(label) <= room else f'...{label[3 - room :]}') + rest


NARROWEST = 40
"""Columns below which text is not squeezed: the terminal breaks the lines then."""


SEVERITY_COLOURS = {'info': '36', 'warning': '33', 'error': '31'}
"""ANSI colours (ECMA-48): cyan, yellow, red. They only repeat what the word says."""


def add_console_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that every verb has."""
    group = parser.add_argument_group('terminal')
    group.add_argument(
        '--json',
        action='store_true',
        help='one JSON document on stdout and nothing else; messages go to stderr',
    )
    loudness = group.add_mutually_exclusive_group()
    loudness.add_argument(
        '-q',
        '--quiet',
        action='store_true',
        help='print errors only; the result is printed only if it is not written to files',
    )
    loudness.add_argument(
        '-v',
        '--verbose',
        action='store_true',
        help='print every finding with its remedy, and on stderr settings, inputs and times',
    )


@dataclass(frozen=True)
class Console:
    """Output of a verb, controlled by the options of `add_console_options`."""

    verb: str = ''
    json: bool = False
    quiet: bool = False
    verbose: bool = False

    @classmethod
    def of(cls, args: argparse.Namespace) -> Console:
        """Return the console that the arguments ask for."""
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

    def findings(self, findings: Iterable[Finding]) -> None:
        """Print findings to stderr, for a result that does not show them itself."""
        from ..io.format import grouped

        for finding in () if self.quiet else grouped(findings):
            print(*finding_lines(finding, width(), coloured(sys.stderr)), sep='\n', file=sys.stderr)

    def progress(self, label: str, total: int | None) -> Progress:
        """Return a progress bar, which ``--quiet`` leaves out."""
        return Progress(label, total, shown=not self.quiet)

    @contextmanager
    def timed(self, what: str) -> Iterator[None]:
        """Report the duration of a step when it has ended."""
        began = time.monotonic()
        yield
        self.detail(f'{what}: {time.monotonic() - began:.2f} s')


def width() -> int:
    """Return the width of the output: of the terminal, else ``COLUMNS``, else the default."""
    return max(shutil.get_terminal_size((WIDTH, 24)).columns, NARROWEST)


def coloured(stream: TextIO) -> bool:
    """Return whether to write colours: on a terminal, unless the environment says otherwise.

    ``NO_COLOR`` forbids and ``FORCE_COLOR`` demands them where they are not empty, as
    no-color.org and force-color.org have it.
    """
    if os.environ.get('NO_COLOR'):
        return False
    if os.environ.get('FORCE_COLOR'):
        return True
    return stream.isatty() and os.environ.get('TERM') != 'dumb'


def finding_lines(finding: Finding, columns: int, colours: bool = False) -> Sequence[str]:
    """Return a finding with its remedy wrapped to the width, its severity first."""
    lines = wrapped(f'{finding.severity}: {finding}', columns, '  ')
    colour = SEVERITY_COLOURS[finding.severity]
    return [painted(lines[0], finding.severity, colour, colours), *lines[1:]]


def painted(line: str, word: str, colour: str, colours: bool) -> str:
    """Return the line with its first such word in an ANSI colour, if colours are wanted."""
    return line.replace(word, f'\x1b[{colour}m{word}\x1b[0m', 1) if colours else line


def wrapped(text: str, columns: int, indent: str = '') -> list[str]:
    """Return the text in lines that leave the last column free; later ones are indented."""
    room = max(columns, NARROWEST) - 1
    return textwrap.wrap(text, room, subsequent_indent=indent, break_on_hyphens=False)
