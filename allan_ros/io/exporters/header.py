# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Header comment of every file: source, date, convention, units, rate, axes, intervals."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta, timezone

from ... import __version__
from ..format import duration_text, significant
from ..results import Results
from .convention import Entry
from .model import FilterNoise
from .target import Target

NAMED_SOURCES = 3
"""Number of recordings that are named; the rest are counted."""

EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
FIRST_DATE = datetime(2000, 1, 1, tzinfo=timezone.utc)
"""Earlier stamps count from the start of a machine or a simulation and are no dates."""

RULE_WORDS = {
    'worst': 'worst (the largest of x, y, z)',
    'mean': 'mean (root mean square of x, y, z)',
    'each': 'each (x, y, z)',
}


def header_lines(
    name: str, target: Target, noise: FilterNoise, entries: Sequence[Entry]
) -> list[str]:
    """Return the lines without comment marks; they contain printable characters only."""
    results, inflate = noise.results, noise.options.inflate
    limits = [entry.key for entry in entries if entry.is_limit]
    lines = [
        f'IMU noise for {name}, measured by allan_ros {__version__} (method {results.method})',
        f'source: {_sources(results)}; {duration_text(results.duration_s)} at rest, '
        f'{significant(results.rate_hz, 5)} Hz',
        f'date: {noise.options.date or _recorded(results)}',
        f'convention: {target.convention.text}',
        f'rate: f = {noise.rate:g} Hz, {noise.rate_words}',
        f'axis rule: {RULE_WORDS[noise.rule]}; inflation: {_inflation(inflate)}',
        *noise.reduction_lines(),
        *(f'{entry.key} {entry.words}' for entry in entries if entry.words),
        f'upper limits instead of measurements: {", ".join(limits) or "none"}',
        *(f'note: {note}' for note in target.notes),
        *dict.fromkeys(f'note: {said}' for entry in entries for said in entry.findings),
        *(f'warning: {said}' for said in noise.reduction_findings()),
    ]
    return [''.join(c if c.isprintable() else '?' for c in line) for line in lines]


def _inflation(factor: float) -> str:
    if factor == 1.0:
        return 'none'
    return f'x{factor:g} on every N, K and bias; the levels below are without it'


def _sources(results: Results) -> str:
    sources = [f'{s.path} {s.topic}'.strip() for s in results.provenance.sources]
    more = len(sources) - NAMED_SOURCES
    named = ', '.join(sources[:NAMED_SOURCES]) + (f' and {more} more' if more > 0 else '')
    return named or 'sums without a recording'


def _recorded(results: Results) -> str:
    starts = [span.start_ns for span in results.provenance.spans]
    if not starts:
        return 'not known'
    try:
        start = EPOCH + timedelta(microseconds=min(starts) // 1000)
    except OverflowError:
        return 'not known: the stamps are no dates'
    if start < FIRST_DATE:
        return 'not known: the stamps do not count from 1970'
    return f'recorded from {start:%Y-%m-%d %H:%M:%S} UTC on'
