# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are written as a whole, and JSON: parameter lines, programs, XML."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...core.errors import AllanError
from .target import Entry, Value, nested

INDENT = 2

HEADER_KEY = 'allan_ros'


class JsonForm:
    """A JSON file. It has no comments, so the header is the value of a key at the end."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file of these entries and the header."""
        return _written({}, entries, header)

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return the user's document with these entries and the header in it.

        Raises
        ------
        AllanError
            When the text is not a JSON object, or a key holds a value where a mapping is needed.
        """
        try:
            document = json.loads(existing, parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise AllanError(f'the file to merge into is not JSON ({error})') from None
        if not isinstance(document, dict):
            raise AllanError('the file to merge into is not a JSON object: give a calibration file')
        return _written(document, entries, header)


def _refuse(constant: str) -> None:
    raise ValueError(f'{constant} is not a JSON number')


def _written(document: dict[str, Any], entries: Sequence[Entry], header: Sequence[str]) -> str:
    for entry in entries:
        here: Any = document
        for key in entry.path[:-1]:
            here = here.setdefault(key, {})
            if not isinstance(here, dict):
                raise AllanError(f'{key} of the file to merge into is not a JSON object')
        if not (entry.keep and entry.key in here):
            here[entry.key] = entry.value
    # last, because a reader may expect its own key first
    document.pop(HEADER_KEY, None)
    document[HEADER_KEY] = list(header)
    return json.dumps(document, indent=4, ensure_ascii=False, allow_nan=False) + '\n'


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
    literal : callable
        From a value to the text of the language.
    """

    line: str
    comment: str = '#'
    before: str = ''
    after: str = ''
    literal: Callable[[Value], str] = repr

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file with these entries and the header in comments."""
        comments = ''.join(f'{self.comment} {line}\n' for line in header)
        lines = ''.join(
            self.line.format(key=entry.key, value=self.literal(entry.value)) + '\n'
            for entry in entries
        )
        return f'{comments}{self.before}{lines}{self.after}'

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Raise `AllanError`: the file is loaded in addition to those of the user."""
        raise AllanError(
            'this file is loaded in addition to yours and needs no merging: leave out --merge-into'
        )


def matlab_literal(value: Value) -> str:
    """Return a number or a list of numbers as MATLAB writes it."""
    return f'[{" ".join(map(repr, value))}]' if isinstance(value, list) else repr(value)


@dataclass(frozen=True)
class XmlForm:
    """A fragment of XML; a key that starts with '@' is an attribute of its element."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a fragment with these entries and the header in a comment."""
        # a comment must not contain two hyphens in a row
        lines = [line.replace('--', '- -') for line in header]
        comment = '<!--\n' + ''.join(f'  {line}\n' for line in lines) + '-->\n'
        return comment + '\n'.join(_elements(nested(entries))) + '\n'

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Raise `AllanError`: it is not known which sensor in a world the numbers are for."""
        raise AllanError('copy the fragment into your SDF or model file: leave out --merge-into')


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
