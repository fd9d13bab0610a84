# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are written as a whole: parameter lines, programs and XML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.errors import AllanError
from .convention import Entry, Value

INDENT = 2


@dataclass(frozen=True)
class LineForm:
    """One line per entry.

    Attributes
    ----------
    line : str
        `str.format` template of key and value.
    comment : str
        Start of a comment line.
    before, after : str
        Further text around the lines.
    """

    line: str
    comment: str = '#'
    before: str = ''
    after: str = ''

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file with these entries and the header in comments."""
        comments = ''.join(f'{self.comment} {line}\n' for line in header)
        lines = ''.join(
            self.line.format(key=entry.key, value=self.value_text(entry.value)) + '\n'
            for entry in entries
        )
        return f'{comments}{self.before}{lines}{self.after}'

    def value_text(self, value: Value) -> str:
        """Return the value as it is written."""
        return f'{value}'

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Raise `AllanError`: the file is loaded in addition to those of the user."""
        raise AllanError(
            'this file is loaded in addition to yours and needs no merging: leave out --merge-into'
        )


class PythonForm(LineForm):
    """Assignments of a Python module."""

    def value_text(self, value: Value) -> str:
        """Return the value as a Python literal."""
        return repr(value)


class MatlabForm(LineForm):
    """Assignments of a MATLAB or Octave script."""

    def value_text(self, value: Value) -> str:
        """Return the value as MATLAB writes it."""
        return f'[{" ".join(map(repr, value))}]' if isinstance(value, list) else repr(value)


@dataclass(frozen=True)
class XmlForm:
    """A fragment of XML; a key that starts with '@' is an attribute of its element."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a fragment with these entries and the header in a comment."""
        # a comment must not contain two hyphens in a row
        lines = [line.replace('--', '- -') for line in header]
        comment = '<!--\n' + ''.join(f'  {line}\n' for line in lines) + '-->\n'
        return comment + '\n'.join(_elements(_tree(entries))) + '\n'

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Raise `AllanError`: it is not known which sensor in a world the numbers are for."""
        raise AllanError('copy the fragment into your SDF or model file: leave out --merge-into')


def _tree(entries: Sequence[Entry]) -> dict[str, Value]:
    tree: dict[str, Value] = {}
    for entry in entries:
        here = tree
        for key in entry.path[:-1]:
            here = here.setdefault(key, {})
        here[entry.key] = entry.value
    return tree


def _elements(tree: dict[str, Value], depth: int = 0) -> list[str]:
    lines, margin = [], ' ' * INDENT * depth
    for key, value in tree.items():
        if key.startswith('@'):
            continue
        if not isinstance(value, dict):
            lines.append(f'{margin}<{key}>{value}</{key}>')
            continue
        attributes = ''.join(f' {k[1:]}="{v}"' for k, v in value.items() if k.startswith('@'))
        lines += [f'{margin}<{key}{attributes}>', *_elements(value, depth + 1), f'{margin}</{key}>']
    return lines
