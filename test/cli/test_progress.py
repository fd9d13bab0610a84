# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The progress line: correct on a terminal, absent elsewhere."""

from __future__ import annotations

import io

import pytest

from allan_ros.cli import console as progress
from allan_ros.cli.console import Progress, progress_line


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_line_says_share_speed_and_time_left() -> None:
    line = progress_line('bag', 250_000, 1_000_000, 10.0)
    assert '[######..................]  25%' in line
    assert '250,000 samples, 25,000/s, 30 s left' in line


def test_an_unknown_total_shows_the_count() -> None:
    assert progress_line('bag', 500, None, 2.0) == 'bag  500 samples, 250/s'


def test_more_than_was_promised_is_all() -> None:
    line = progress_line('bag', 12, 10, 1.0)
    assert '100%' in line
    assert 'left' not in line


def test_it_is_silent_without_a_terminal() -> None:
    stream = io.StringIO()
    with Progress('bag', 10, stream) as bar:
        bar.advance(10)
    assert stream.getvalue() == ''


def test_a_terminal_is_left_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, 'REDRAW_S', 0.0)
    stream = Terminal()
    with Progress('bag', 10, stream) as bar:
        bar.advance(5)
    assert '50%' in stream.getvalue()
    assert stream.getvalue().endswith('\r\x1b[K')


@pytest.mark.parametrize('columns', [40, 60, 79])
def test_a_long_name_leaves_room_for_the_share_and_the_time(columns: int) -> None:
    label = '/a/very/long/path/' * 8 + 'recording_of_monday.mcap'
    line = progress_line(label, 250_000, 1_000_000, 10.0, columns)
    assert len(line) <= max(columns, 58)
    assert line.endswith(' 25%, 30 s left')
