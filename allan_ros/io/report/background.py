# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What stands behind the numbers: the recordings, what became of their samples, how it was done."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path

import numpy
import scipy

from ... import __version__
from ..results import Results
from ..shown import duration_text, significant

EARLIEST_S = 978_307_200
"""2001-01-01: a first stamp before it is no date, but the time since a machine was started."""

NS = 10**9


def recorded_on(results: Results) -> str:
    """Return when the evidence begins, in UTC, or '' where the stamps are no dates."""
    spans = results.provenance.spans
    start = min((span.start_ns for span in spans), default=0) // NS
    if start < EARLIEST_S:
        return ''
    when = datetime.datetime.fromtimestamp(start, datetime.timezone.utc)
    return f'{when:%Y-%m-%d %H:%M} UTC'


def background(results: Results, method: Mapping[str, str]) -> Iterator[str]:
    """Yield the section.

    Parameters
    ----------
    results : Results
    method : mapping of str to str
        What else one needs to do it again: the command, the fingerprint of the sums.
    """
    yield '<h3>Inputs</h3>' + _table(dict(_inputs(results)))
    yield '<h3>What became of the samples</h3>' + _table(dict(_fates(results)))
    yield '<h3>To repeat it</h3>' + _table({**method, **_versions()})
    settings = results.provenance.settings
    if settings:
        rows = {key: _value(value) for key, value in settings.items()}
        yield (f'<details><summary>Every setting ({len(rows)})</summary>{_table(rows)}</details>')


def _inputs(results: Results) -> Iterator[tuple[str, str]]:
    for source in results.provenance.sources:
        what = [part for part in (source.topic, source.type, source.storage) if part]
        yield source.path, ', '.join([*what, *_size(Path(source.path))])


def _size(path: Path) -> Iterator[str]:
    """Yield the size of an input, if it is still there."""
    try:
        files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
        stats = [file.stat() for file in files]
    except OSError:
        return
    if stats:
        yield f'{sum(stat.st_size for stat in stats):,} bytes'


def _fates(results: Results) -> Iterator[tuple[str, str]]:
    counts = results.provenance.counts
    yield (
        'evidence',
        f'{results.samples:,} samples at {significant(results.rate_hz, 5)} Hz, '
        f'{duration_text(results.duration_s)} in {results.segments} '
        f'segment{"" if results.segments == 1 else "s"}',
    )
    for name, number in vars(counts).items():
        if isinstance(number, int) and number:
            yield name.replace('_', ' '), f'{number:,}'
    yield 'cuts', ', '.join(f'{n} × {reason}' for reason, n in counts.cuts.items()) or 'none'


def _versions() -> dict[str, str]:
    return {
        'versions': f'allan_ros {__version__}, Python {platform.python_version()}, '
        f'numpy {numpy.__version__}, scipy {scipy.__version__}',
        'machine': f'{platform.system()} {platform.machine()}',
    }


def _value(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return ', '.join(str(v) for v in value) or '–'
    return f'{value:g}' if isinstance(value, float) else str(value) if value != '' else '–'


def _table(rows: Mapping[str, str]) -> str:
    cells = ''.join(
        f'<tr><th scope="row">{escape(key)}</th><td>{escape(value)}</td></tr>'
        for key, value in rows.items()
    )
    return f'<table class="facts"><tbody>{cells}</tbody></table>'
