# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings: messages to the user about a recording or a running node.

All texts are in the catalog ``findings.txt``. The message of a finding states the cause with its
numbers, the remedy states the next step.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pkgutil import get_data
from typing import Literal

from .errors import one_line

Severity = Literal['info', 'warning', 'error']

SEVERITIES: tuple[Severity, ...] = ('error', 'warning', 'info')
"""Severities, the most severe first."""


@dataclass(frozen=True)
class Finding:
    """A message to the user: the cause with its numbers, and the remedy.

    ``axes`` are the affected axes; an empty tuple means all of them.
    """

    id: str
    severity: Severity
    message: str
    remedy: str
    axes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f'{", ".join(self.axes)}: ' if self.axes else ''
        return f'{where}{self.message} {self.remedy}'


def _catalog(text: str) -> Iterator[Finding]:
    """Yield each kind of finding, with its texts as templates of `str.format`."""
    for entry in re.split(r'\n(?=\w)', re.sub(r'(?m)^(#.*)?\n', '', text)):
        head, _, words = entry.partition('\n')
        id, _, severity = head.partition(': ')
        message, _, remedy = (' '.join(part.split()) for part in words.partition('  > '))
        yield Finding(id, severity, message, remedy)  # type: ignore[arg-type]


_TEXT = (get_data(__package__, 'findings.txt') or b'').decode()

CATALOG = {one.id: one for one in _catalog(_TEXT)}
"""Finding by id; its texts are templates whose fields `finding` fills in."""

PLURAL = re.compile(r'\{(\w+):([^{}|]*)\|([^{}|]*)\}')
"""A template field ``{name:singular|plural}``: the first text is used if the value is 1."""


def _filled(template: str, values: Mapping[str, object]) -> str:
    """Return a template as one line, with the values inserted and singular or plural selected."""
    text = PLURAL.sub(lambda field: field[2 if values[field[1]] == 1 else 3], template)
    return one_line(text.format(**values))


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding ``id`` of the catalog, with ``values`` inserted into its texts.

    ``axes`` are the affected axes; empty for all. ``values`` must contain every field of the
    templates. Only ``when``, a text such as ' in the last minute', is '' by default.
    """
    known, values = CATALOG[id], {'when': '', **values}
    message, remedy = (_filled(text, values) for text in (known.message, known.remedy))
    return replace(known, message=message, remedy=remedy, axes=axes)


def duration_text(seconds: float, digits: int = 2) -> str:
    """Return a duration given in seconds as text, in s, min, h or days.

    >>> duration_text(90.0), duration_text(1234.0, digits=3), duration_text(86400.0 * 3.456)
    ('90 s', '20.6 min', '3.5 days')
    """
    for unit, size in (('days', 86400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2.0 * size:
            return f'{float(f"{seconds / size:.{digits}g}"):g} {unit}'
    return f'{float(f"{seconds:.{digits}g}"):g} s'
