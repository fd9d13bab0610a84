# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The progress bar: on a terminal only, and erased at the end."""

from __future__ import annotations

import io
import sys

import pytest

from allan_ros.cli.console import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_it_is_silent_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, 'stderr', stream)
    with Progress('bag', 10) as bar:
        bar.advance(10)
    assert stream.getvalue() == ''


@pytest.mark.parametrize('total', [10, None])
def test_a_terminal_is_left_clean(monkeypatch: pytest.MonkeyPatch, total: int | None) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, 'stderr', stream)
    monkeypatch.setenv('TERM', 'xterm')
    with Progress('/a/very/long/path/' * 8 + '[bold]monday.mcap', total) as bar:
        bar.advance(5)
    assert '[bold]monday.mcap' in stream.getvalue()
    assert ('50 %' in stream.getvalue()) == (total is not None)
    assert stream.getvalue().endswith('\x1b[2K')


def test_quiet_shows_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, 'stderr', stream)
    with Progress('bag', 10, shown=False) as bar:
        bar.advance(10)
    assert stream.getvalue() == ''
