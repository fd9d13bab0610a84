# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One line on a terminal that says how far the work is and how long it will still take."""

from __future__ import annotations

import shutil
import sys
import time
from types import TracebackType
from typing import TextIO

REDRAW_S = 0.1
"""Seconds between two drawings: smooth to the eye, nothing to the processor."""

BAR = 24
"""Characters of the bar."""


class Progress:
    """A progress bar with the time left, drawn on a terminal only; elsewhere it is silent.

    Parameters
    ----------
    label : str
        What is being done.
    total : int or None
        How many units the work has; None when only doing it can tell.
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
            self._stream.write('\r\x1b[K')  # leave no trace: the result is what counts
            self._stream.flush()

    def advance(self, units: int) -> None:
        """Say that so many more units are done."""
        self._done += units
        now = time.monotonic()
        if self._draws and now - self._drawn >= REDRAW_S:
            self._drawn = now
            width = shutil.get_terminal_size().columns
            line = progress_line(self._label, self._done, self._total, now - self._start)
            self._stream.write(f'\r\x1b[K{line[: width - 1]}')
            self._stream.flush()


def progress_line(label: str, done: int, total: int | None, elapsed_s: float) -> str:
    """Return the line for so many units done in so many seconds."""
    speed = done / elapsed_s if elapsed_s > 0 else 0.0
    counted = f'{done:,} samples, {speed:,.0f}/s'
    if not total:
        return f'{label}  {counted}'
    share = min(done / total, 1.0)
    filled = round(share * BAR)
    left = f', {time_left((total - done) / speed)} left' if speed > 0 and done < total else ''
    return f'{label}  [{"#" * filled}{"." * (BAR - filled)}] {share:4.0%}  {counted}{left}'


def time_left(seconds: float) -> str:
    """Return a time to wait in the words people use: 40 s, 3 min 05 s, 2 h 10 min."""
    seconds = round(seconds)
    if seconds < 60:
        return f'{seconds} s'
    if seconds < 3600:
        return f'{seconds // 60} min {seconds % 60:02d} s'
    return f'{seconds // 3600} h {seconds % 3600 // 60:02d} min'
