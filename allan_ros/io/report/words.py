# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of terms and verdicts, and text that both systems of units are shown in."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from .chart_data import SYSTEMS

TERM_NAMES = {
    'gyro': {
        'Q': 'quantization',
        'N': 'angle random walk',
        'B': 'bias instability',
        'K': 'rate random walk',
        'R': 'rate ramp',
    },
    'accel': {
        'Q': 'quantization',
        'N': 'velocity random walk',
        'B': 'bias instability',
        'K': 'acceleration random walk',
        'R': 'acceleration ramp',
    },
}
"""sensor -> term -> its name in IEEE Std 952 and 1293."""

VERDICT_WORDS = {'within': 'within', 'open': 'not settled', 'beyond': 'beyond'}
"""Verdict of a comparison -> how the page says it."""


def in_units(html_of: Callable[[str], str]) -> str:
    """Return the HTML of both systems of units, of which the page shows the chosen one."""
    return ''.join(f'<span data-units="{units}">{html_of(units)}</span>' for units in SYSTEMS)


def cell(text: str, what: str = '') -> str:
    """Return a table cell of escaped text."""
    return f'<td{f" class={what!r}" if what else ""}>{escape(text)}</td>'
