# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text formats of exported files: JSON, YAML, lines of parameters or program code, XML.

Entries can also be merged into the user's JSON or YAML file. YAML text is changed only where the
parser locates the keys: comments, order, quotes and tags such as ``!!opencv-matrix`` stay. The
result is parsed again. If another value changed, nothing is written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from ...core.errors import AllanError
from . import Entry, Form, Value

INDENT = 2

HEADER_KEY = 'allan_ros'
"""Key of the header lines in JSON, which has no comments."""


def put_entries(tree: dict[str, Value], entries: Sequence[Entry]) -> dict[str, Value]:
    """Insert the values of entries into the nested mappings ``tree``, and return it.

    Raises AllanError when a key on the path of an entry has a value instead of a mapping.
    """
    for entry in entries:
        here: Any = tree
        for key in entry.path[:-1]:
            here = here.setdefault(key, {})
            if not isinstance(here, dict):
                raise AllanError(f'{key} of the file to merge into is not a JSON object')
        if not (entry.keep and entry.key in here):
            here[entry.key] = entry.value
    return tree


class JsonForm(Form):
    """A JSON file; the header is the value of a key at the end."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        return self.merge('{}', entries, header)

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        try:
            document = json.loads(existing, parse_constant=_reject_constant)
        except (ValueError, RecursionError) as error:
            raise AllanError(f'the file to merge into is not JSON ({error})') from None
        if not isinstance(document, dict):
            raise AllanError('the file to merge into is not a JSON object: give a calibration file')
        put_entries(document, entries)
        document.pop(HEADER_KEY, None)  # last, because a reader may expect one of its keys first
        document[HEADER_KEY] = list(header)
        return json.dumps(document, indent=4, ensure_ascii=False, allow_nan=False) + '\n'


def _reject_constant(constant: str) -> None:
    raise ValueError(f'{constant} is not a JSON number')


@dataclass(frozen=True)
class LineForm(Form):
    """A file with one line per entry."""

    line: str  # `str.format` template of key and value
    comment: str = '#'  # start of a comment line
    before: str = ''  # text between header comment and lines
    after: str = ''  # text after the lines
    literal: Callable[[Value], str] = repr  # converts a value to the text of the language

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        comments = ''.join(f'{self.comment} {line}\n' for line in header)
        lines = ''.join(
            self.line.format(key=entry.key, value=self.literal(entry.value)) + '\n'
            for entry in entries
        )
        return f'{comments}{self.before}{lines}{self.after}'


def matlab_literal(value: Value) -> str:
    """Return a number or a list of numbers as a MATLAB literal."""
    return f'[{" ".join(map(repr, value))}]' if isinstance(value, list) else repr(value)


class XmlForm(Form):
    """A fragment of XML; a key that starts with '@' is an attribute of its element."""

    no_merge = 'copy the fragment into your SDF or model file: omit --merge-into'

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        # a comment must not contain two hyphens in a row
        lines = [line.replace('--', '- -') for line in header]
        comment = '<!--\n' + ''.join(f'  {line}\n' for line in lines) + '-->\n'
        return comment + '\n'.join(_elements(put_entries({}, entries))) + '\n'


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


# --- YAML -----------------------------------------------------------------------------------------

BLOCK_BEGIN = '>>> allan_ros: this block is replaced by the next merge'
BLOCK_END = '<<< allan_ros'

_OPENCV_MARK = '%YAML:1.0'
_START = re.compile(r'\A\ufeff?(?:%YAML[^\n]*\n)?(?:---[^\n]*\n)?')
_OLD_BLOCK = re.compile(
    rf'^# {re.escape(BLOCK_BEGIN)}\n(?:#.*\n)*?# {re.escape(BLOCK_END)}\n', re.MULTILINE
)

_BY_HAND = 'copy the numbers by hand from the file that is written without --merge-into'

Path = tuple[str, ...]


class _NotYamlError(AllanError):
    """The text is not YAML, is nested too deeply, or has no keys at its top level."""


class _Row(list[float]):
    """Numbers that are written on one line."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes lists of numbers on one line, and indents sequences as OpenCV requires."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)


_Dumper.add_representer(
    _Row, lambda dumper, row: dumper.represent_sequence('tag:yaml.org,2002:seq', row, True)
)


@dataclass(frozen=True)
class YamlForm(Form):
    """A YAML file; with ``opencv`` for cv::FileStorage, which needs the first line %YAML:1.0."""

    opencv: bool = False

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        first = f'{_OPENCV_MARK}\n' if self.opencv else ''
        return first + ''.join(f'# {line}\n' for line in header) + _block(put_entries({}, entries))

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return the user's text with these entries inserted and everything else unchanged.

        A key is expected at its path, else in the only mapping that has one of the new keys.
        Missing keys are added to the same mapping. Raises AllanError when the text is not YAML,
        several mappings have the keys, or the merge would change other values.
        """
        text = _OLD_BLOCK.sub('', existing.replace('\r\n', '\n'))
        start = _START.match(text)
        head = start.group() if start else ''
        body = text[len(head) :]
        before = _flat(_parse_mapping(body))
        wanted: dict[Path, Value] = {}
        try:
            for entry in entries:
                body, place = _write_entry(body, entry, entries)
                if place is not None:
                    wanted[place] = entry.value
            after = _flat(_parse_mapping(body))
        except _NotYamlError:
            raise AllanError(
                f'no keys can be added to a file in this YAML style: {_BY_HAND}'
            ) from None
        _check_merge(before, after, wanted)
        block = [f'# {line}\n' for line in (BLOCK_BEGIN, *header, BLOCK_END)]
        if self.opencv and not head.startswith('%YAML'):
            head = f'{_OPENCV_MARK}\n{head}'
        merged = head + ''.join(block) + body
        return merged.replace('\n', '\r\n') if '\r\n' in existing else merged


def _rows(value: Value) -> Any:
    """Return the value with each list of numbers as a `_Row`."""
    if isinstance(value, dict):
        return {key: _rows(item) for key, item in value.items()}
    if isinstance(value, list):
        lists = any(isinstance(item, list) for item in value)
        return [_rows(item) for item in value] if lists else _Row(value)
    return value


def _dump(value: Any, **style: Any) -> str:
    text: str = yaml.dump(value, Dumper=_Dumper, width=10**6, allow_unicode=True, **style)
    return text


def _block(tree: dict[str, Value]) -> str:
    """Return nested mappings as indented lines of YAML."""
    return _dump(_rows(tree), sort_keys=False, indent=INDENT)


def _inline(value: Value) -> str:
    """Return the value as YAML on one line."""
    return _dump(value, default_flow_style=True).removesuffix('\n').removesuffix('\n...')


def _parse_mapping(body: str) -> yaml.Node | None:
    """Return the mapping of a YAML text, None if it is empty; raise `_NotYamlError` otherwise."""
    try:
        node: yaml.Node | None = yaml.compose(body, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise _NotYamlError(
            f'the file to merge into is not YAML ({" ".join(str(error).split())}): {_BY_HAND}'
        ) from None
    except RecursionError:
        raise _NotYamlError(f'the file to merge into is nested too deeply: {_BY_HAND}') from None
    if node is not None and not isinstance(node, yaml.MappingNode):
        raise _NotYamlError(f'the file to merge into has no keys at its top level: {_BY_HAND}')
    return node


def _write_entry(body: str, entry: Entry, siblings: Sequence[Entry]) -> tuple[str, Path | None]:
    """Return the text with the entry, and its path (None if the value of the file is kept)."""
    places = dict(_mappings(_parse_mapping(body)))
    path = _parent(places, entry, siblings)
    if path not in places:
        return _add_entry(body, places, entry), entry.path
    mapping, place = places[path], (*path, entry.key)
    found = _item(mapping, entry.key)
    if found is None:
        return _insert_line(body, mapping, f'{entry.key}: {_inline(entry.value)}'), place
    if entry.keep:
        return body, None
    key, value = found
    if isinstance(value, yaml.MappingNode):
        raise AllanError(f'{entry.key} of the file is a mapping, not a number: {_BY_HAND}')
    start, end = value.start_mark.index, _end(value)
    if start == end or (isinstance(value, yaml.CollectionNode) and not value.flow_style):
        # no value, or a block: the new value follows directly after the colon
        start = body.index(':', key.end_mark.index) + 1
        return f'{body[:start]} {_inline(entry.value)}{body[max(start, end) :]}', place
    return body[:start] + _inline(entry.value) + body[end:], place


def _parent(places: dict[Path, yaml.MappingNode], entry: Entry, siblings: Sequence[Entry]) -> Path:
    """Return the path of the mapping for an entry, which may not exist yet."""
    parent = entry.path[:-1]
    if parent in places and (parent or _item(places[parent], entry.key)):
        return parent
    keys = {other.key for other in siblings if other.path[:-1] == parent and not other.keep}
    found = [path for path, node in places.items() if any(_has_value(node, key) for key in keys)]
    if len(found) > 1:
        where = ', '.join('/'.join(path) or 'the top level' for path in found)
        raise AllanError(f'{entry.key} could belong to {where} of the file: {_BY_HAND}')
    return found[0] if found else parent


def _mappings(node: yaml.Node | None, path: Path = ()) -> Iterator[tuple[Path, yaml.MappingNode]]:
    if isinstance(node, yaml.MappingNode):
        yield path, node
        for key, value in node.value:
            yield from _mappings(value, (*path, str(key.value)))


def _item(node: yaml.MappingNode, key: str) -> tuple[yaml.Node, yaml.Node] | None:
    """Return the nodes of a key and of its value; None if the mapping does not contain it."""
    return next(((name, value) for name, value in node.value if name.value == key), None)


def _has_value(node: yaml.MappingNode, key: str) -> bool:
    """Return whether a mapping has the key with a value that is not a mapping."""
    found = _item(node, key)
    return found is not None and not isinstance(found[1], yaml.MappingNode)


def _end(node: yaml.Node) -> int:
    """Return the index in the text at which a node, or the last item of a block, ends."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(node, yaml.MappingNode) else last)
    index: int = node.end_mark.index
    return index


def _insert_line(body: str, mapping: yaml.MappingNode, line: str) -> str:
    """Return the text with a line added at the end of a mapping."""
    if mapping.flow_style or not mapping.value:
        at = mapping.end_mark.index - 1
        return f'{body[:at]}{", " if mapping.value else ""}{line}{body[at:]}'
    at = _end(mapping)
    if body[at - 1] != '\n':  # after the comment that follows the last value
        rest = body.find('\n', at)
        at = len(body) if rest < 0 else rest + 1
    gap = '' if body[at - 1] == '\n' else '\n'
    indent = ' ' * mapping.value[0][0].start_mark.column
    lines = ''.join(f'{indent}{one}\n' for one in line.splitlines())
    return f'{body[:at]}{gap}{lines}{body[at:]}'


def _add_entry(body: str, places: dict[Path, yaml.MappingNode], entry: Entry) -> str:
    """Return the text with the entry added, and with any missing mapping on its path."""
    path = entry.path
    depth = next((n for n in range(len(path) - 1, -1, -1) if path[:n] in places), None)
    below = put_entries({}, [Entry(path[depth or 0 :], entry.value)])
    if depth is None:
        return body + _block(below)
    mapping = places[path[:depth]]
    if _item(mapping, path[depth]):
        raise AllanError(f'{path[depth]} of the file is a value, not a mapping: {_BY_HAND}')
    if mapping.flow_style or not mapping.value:
        return _insert_line(body, mapping, _inline(_rows(below)).strip()[1:-1])
    return _insert_line(body, mapping, _block(below))


def _flat(node: yaml.Node | None, path: Path = ()) -> dict[Path, str]:
    """Return a mapping from the path of each scalar below a node to its tag and text."""
    if isinstance(node, yaml.CollectionNode):
        pairs = (
            [(str(key.value), value) for key, value in node.value]
            if isinstance(node, yaml.MappingNode)
            else [(str(i), value) for i, value in enumerate(node.value)]
        )
        return {
            place: text
            for key, value in pairs
            for place, text in _flat(value, (*path, key)).items()
        }
    return {} if node is None else {path: f'{node.tag} {node.value}'}


def _check_merge(before: dict[Path, str], after: dict[Path, str], new: dict[Path, Value]) -> None:
    """Raise AllanError if ``before`` and ``after`` differ in anything but the new values."""
    expected = {
        place: text
        for place, text in before.items()
        if not any(place[: len(path)] == path for path in new)
    }
    for path, value in new.items():
        expected.update(_flat(yaml.compose(_inline(value), Loader=yaml.SafeLoader), path))
    if after != expected:
        places = sorted({*expected, *after})
        changed = next(place for place in places if expected.get(place) != after.get(place))
        raise AllanError(
            f'the file cannot be merged into without changing {"/".join(changed)}: {_BY_HAND}'
        )
