# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the tool tells a user to know or do: worded once, shown alike everywhere.

A `Finding` is a cause and a remedy in the words of `CATALOGUE`; the log, `/diagnostics`,
`results.json` and the report show the same sentence.
"""

from __future__ import annotations

from dataclasses import dataclass

from .errors import one_line
from .finding_catalogue import CATALOGUE, Severity

__all__ = ['CATALOGUE', 'Finding', 'Severity', 'finding']


@dataclass(frozen=True)
class Finding:
    """One thing a user should know, and what to do about it."""

    id: str
    severity: Severity
    message: str
    remedy: str
    axes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f'{", ".join(self.axes)}: ' if self.axes else ''
        return f'{where}{self.message}; {self.remedy}'


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding of that id with its numbers filled in.

    Raises
    ------
    KeyError
        When the id is not in the catalogue, or a value its words need is missing.
    """
    words = CATALOGUE[id]
    message, remedy = (one_line(t.format(**values)) for t in (words.message, words.remedy))
    return Finding(id, words.severity, message, remedy, axes)
