# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of one parameter a line, as autopilots and their ground stations load them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.errors import AllanError
from .target import Entry


@dataclass(frozen=True)
class LineForm:
    """A file of lines; ``line`` is a `str.format` template of key and value."""

    line: str

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file of these entries, its header in comments."""
        comments = ''.join(f'# {line}\n' for line in header)
        return comments + ''.join(
            self.line.format(key=entry.key, value=entry.value) + '\n' for entry in entries
        )

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Refuse: a ground station loads a file of some parameters beside those that are set."""
        raise AllanError(
            'a parameter file needs no merging: load this one beside the others, or leave out '
            '--merge-into'
        )
