# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text formats of exported files: JSON, YAML, lines of parameters or program code, XML."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from . import Form, Row, Value

INDENT = 2

HEADER_KEY = 'allan_ros'
"""Key of the header lines in JSON, which has no comments."""

INNERMOST_LIST = re.compile(r'\[\s+([^][{}"]*?)\s+\]')
"""A list of numbers on several lines."""


def nested(rows: Sequence[Row]) -> dict[str, Value]:
    """Return the values of rows as nested mappings."""
    tree: dict[str, Value] = {}
    for row in rows:
        here: Any = tree
        for key in row.path[:-1]:
            here = here.setdefault(key, {})
        here[row.key] = row.value
    return tree


class JsonForm(Form):
    """A JSON file; the header is the value of a key at the end."""

    def render(self, rows: Sequence[Row], header: Sequence[str]) -> str:
        # last, because a reader may expect one of its keys first
        document = {**nested(rows), HEADER_KEY: list(header)}
        text = json.dumps(document, indent=INDENT, ensure_ascii=False, allow_nan=False)
        return INNERMOST_LIST.sub(lambda found: f'[{" ".join(found[1].split())}]', text) + '\n'


@dataclass(frozen=True)
class LineForm(Form):
    """A file with one line per entry."""

    line: str  # `str.format` template of key and value
    comment: str = '#'  # start of a comment line
    before: str = ''  # text between header comment and lines
    after: str = ''  # text after the lines
    literal: Callable[[Value], str] = repr  # converts a value to the text of the language

    def render(self, rows: Sequence[Row], header: Sequence[str]) -> str:
        comments = ''.join(f'{self.comment} {line}\n' for line in header)
        lines = ''.join(
            self.line.format(key=row.key, value=self.literal(row.value)) + '\n' for row in rows
        )
        return f'{comments}{self.before}{lines}{self.after}'


def matlab_literal(value: Value) -> str:
    """Return a number or a list of numbers as a MATLAB literal."""
    return f'[{" ".join(map(repr, value))}]' if isinstance(value, list) else repr(value)


class XmlForm(Form):
    """A fragment of XML; a key that starts with '@' is an attribute of its element."""

    def render(self, rows: Sequence[Row], header: Sequence[str]) -> str:
        # a comment must not contain two hyphens in a row
        lines = [line.replace('--', '- -') for line in header]
        comment = '<!--\n' + ''.join(f'  {line}\n' for line in lines) + '-->\n'
        return comment + '\n'.join(_elements(nested(rows))) + '\n'


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


class _NumbersOnALine(list[float]):
    """Numbers that are written on one line."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes lists of numbers on one line, and indents sequences as OpenCV requires."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)


_Dumper.add_representer(
    _NumbersOnALine,
    lambda dumper, row: dumper.represent_sequence('tag:yaml.org,2002:seq', row, True),
)


@dataclass(frozen=True)
class YamlForm(Form):
    """A YAML file; with ``opencv`` for cv::FileStorage, which needs the first line %YAML:1.0."""

    opencv: bool = False

    def render(self, rows: Sequence[Row], header: Sequence[str]) -> str:
        first = '%YAML:1.0\n' if self.opencv else ''
        tree: str = yaml.dump(
            _on_lines(nested(rows)),
            Dumper=_Dumper,
            width=10**6,
            allow_unicode=True,
            sort_keys=False,
            indent=INDENT,
        )
        return first + ''.join(f'# {line}\n' for line in header) + tree


def _on_lines(value: Value) -> Any:
    """Return the value with each list of numbers as `_NumbersOnALine`."""
    if isinstance(value, dict):
        return {key: _on_lines(item) for key, item in value.items()}
    if isinstance(value, list):
        lists = any(isinstance(item, list) for item in value)
        return [_on_lines(item) for item in value] if lists else _NumbersOnALine(value)
    return value
