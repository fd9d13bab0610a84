# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files: written as a whole, or merged into the user's own file.

Merging changes the text at the positions that the parser reports, so comments, order, quotes and
foreign tags (``!!opencv-matrix``) stay. The result is parsed again and must hold the new values and
all others unchanged, or nothing is written.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from ...core.errors import AllanError
from .target import Entry, Value, nested

BLOCK_BEGIN = '>>> allan_ros: this block is replaced by the next merge'
BLOCK_END = '<<< allan_ros'

_OPENCV_MARK = '%YAML:1.0'
_START = re.compile(r'\A\ufeff?(?:%YAML[^\n]*\n)?(?:---[^\n]*\n)?')
_OLD_BLOCK = re.compile(
    rf'^# {re.escape(BLOCK_BEGIN)}\n(?:#.*\n)*?# {re.escape(BLOCK_END)}\n', re.MULTILINE
)

INDENT = 2

_BY_HAND = 'copy the numbers by hand from the file that is written without --merge-into'


class _NotYamlError(AllanError):
    """The text is not a YAML file of keys."""


class _Row(list[float]):
    """Numbers that are written in one line."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes lists of numbers in one line, and indents sequences as OpenCV needs it."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)


_Dumper.add_representer(
    _Row, lambda dumper, row: dumper.represent_sequence('tag:yaml.org,2002:seq', row, True)
)


@dataclass(frozen=True)
class YamlForm:
    """A YAML file; ``opencv`` for cv::FileStorage, which needs the first line %YAML:1.0."""

    opencv: bool = False

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file with these entries and the header in comments."""
        first = f'{_OPENCV_MARK}\n' if self.opencv else ''
        return first + ''.join(f'# {line}\n' for line in header) + _dumped(_rows(nested(entries)))

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return the user's text with these entries in it and all else unchanged.

        A key is searched at its path, else anywhere if it occurs once. Missing keys are added to
        the mapping of their siblings.

        Raises
        ------
        AllanError
            When the text is not YAML, a key occurs in several places, or the merge would change
            other values.
        """
        text = _OLD_BLOCK.sub('', existing.replace('\r\n', '\n'))
        start = _START.match(text)
        head = start.group() if start else ''
        body = text[len(head) :]
        before = _flat(_composed(body))
        wanted: dict[tuple[str, ...], Value] = {}
        try:
            for entry in entries:
                body, place = _with_entry(body, entry, entries)
                if place is not None:
                    wanted[place] = entry.value
            after = _flat(_composed(body))
        except _NotYamlError:
            raise AllanError(
                f'the file is written in a way that takes no new keys: {_BY_HAND}'
            ) from None
        _prove(before, after, wanted)
        block = [f'# {line}\n' for line in (BLOCK_BEGIN, *header, BLOCK_END)]
        if self.opencv and not head.startswith('%YAML'):
            head = f'{_OPENCV_MARK}\n{head}'
        merged = head + ''.join(block) + body
        return merged.replace('\n', '\r\n') if '\r\n' in existing else merged


def _rows(value: Value) -> Any:
    """Return the value with its lists of numbers marked to be written in one line."""
    if isinstance(value, dict):
        return {key: _rows(item) for key, item in value.items()}
    if isinstance(value, list):
        nested_lists = any(isinstance(item, list) for item in value)
        return [_rows(item) for item in value] if nested_lists else _Row(value)
    return value


def _dumped(tree: object) -> str:
    text: str = yaml.dump(
        tree, Dumper=_Dumper, sort_keys=False, indent=INDENT, width=10**6, allow_unicode=True
    )
    return text


def _inline(value: Value) -> str:
    """Return the value as text after a key, in one line."""
    dumped: str = yaml.dump(
        value, Dumper=_Dumper, default_flow_style=True, width=10**6, allow_unicode=True
    )
    return dumped.removesuffix('\n').removesuffix('\n...')


def _composed(body: str) -> yaml.Node | None:
    try:
        node: yaml.Node | None = yaml.compose(body, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise _NotYamlError(
            f'the file to merge into is not YAML ({" ".join(str(error).split())}): {_BY_HAND}'
        ) from None
    except RecursionError:
        raise _NotYamlError(f'the file to merge into is nested too deep: {_BY_HAND}') from None
    if node is not None and not isinstance(node, yaml.MappingNode):
        raise _NotYamlError(f'the file to merge into has no keys at its top: {_BY_HAND}')
    return node


def _with_entry(
    body: str, entry: Entry, siblings: Sequence[Entry]
) -> tuple[str, tuple[str, ...] | None]:
    """Return the text with one entry in it, and its path; None for an entry that was kept."""
    root = _composed(body)
    home, path = _home(root, entry, siblings)
    if home is None:
        return _added(body, root, entry), entry.path
    place = (*path, entry.key)
    found = _item(home, entry.key)
    if found is None:
        return _inserted(body, home, f'{entry.key}: {_inline(entry.value)}'), place
    if entry.keep:
        return body, None
    key, value = found
    if isinstance(value, yaml.MappingNode):
        raise AllanError(f'{entry.key} of the file holds keys where a number belongs: {_BY_HAND}')
    start, end = value.start_mark.index, _end(value)
    if start == end or (isinstance(value, yaml.CollectionNode) and not value.flow_style):
        # no value, or a block: the new value goes directly behind the colon
        start = body.index(':', key.end_mark.index) + 1
        return f'{body[:start]} {_inline(entry.value)}{body[max(start, end) :]}', place
    return body[:start] + _inline(entry.value) + body[end:], place


def _home(
    root: yaml.Node | None, entry: Entry, siblings: Sequence[Entry]
) -> tuple[yaml.MappingNode | None, tuple[str, ...]]:
    """Return the mapping that an entry belongs to, with its path; None if it does not exist."""
    places = dict(_mappings(root))
    parent = entry.path[:-1]
    if parent in places and (parent or _item(places[parent], entry.key)):
        return places[parent], parent
    keys = {other.key for other in siblings if other.path[:-1] == parent and not other.keep}
    found = [path for path, node in places.items() if any(_holds(node, key) for key in keys)]
    if len(found) > 1:
        where = ', '.join('/'.join(path) or 'the top' for path in found)
        raise AllanError(f'{entry.key} could belong to {where} of the file: {_BY_HAND}')
    if found:
        return places[found[0]], found[0]
    return (places[()], ()) if parent == () and () in places else (None, parent)


def _mappings(
    node: yaml.Node | None, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], yaml.MappingNode]]:
    if isinstance(node, yaml.MappingNode):
        yield path, node
        for key, value in node.value:
            yield from _mappings(value, (*path, str(key.value)))


def _item(node: yaml.MappingNode, key: str) -> tuple[yaml.Node, yaml.Node] | None:
    """Return the key and the value of that name."""
    return next(((name, value) for name, value in node.value if name.value == key), None)


def _holds(node: yaml.MappingNode, key: str) -> bool:
    """Return whether a mapping has a value, not a mapping, under that key."""
    found = _item(node, key)
    return found is not None and not isinstance(found[1], yaml.MappingNode)


def _end(node: yaml.Node) -> int:
    """Return the index where the text of a node ends; for a block, of its last item."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(node, yaml.MappingNode) else last)
    index: int = node.end_mark.index
    return index


def _inserted(body: str, home: yaml.MappingNode, line: str) -> str:
    """Return the text with a line added at the end of a mapping."""
    if home.flow_style or not home.value:
        at = home.end_mark.index - 1
        return f'{body[:at]}{", " if home.value else ""}{line}{body[at:]}'
    at = _end(home)
    if body[at - 1] != '\n':  # past the comment behind the last value
        rest = body.find('\n', at)
        at = len(body) if rest < 0 else rest + 1
    gap = '' if body[at - 1] == '\n' else '\n'
    indent = ' ' * home.value[0][0].start_mark.column
    lines = ''.join(f'{indent}{one}\n' for one in line.splitlines())
    return f'{body[:at]}{gap}{lines}{body[at:]}'


def _added(body: str, root: yaml.Node | None, entry: Entry) -> str:
    """Return the text with the entry and the mappings it needs, after the existing ones."""
    places = dict(_mappings(root))
    depth = next((n for n in range(len(entry.path) - 1, -1, -1) if entry.path[:n] in places), None)
    if depth is None:
        return body + _dumped(_rows(nested([entry])))
    home = places[entry.path[:depth]]
    if _item(home, entry.path[depth]):
        raise AllanError(
            f'{entry.path[depth]} of the file holds a value where keys belong: {_BY_HAND}'
        )
    below = Entry(entry.path[depth:], entry.value)
    if home.flow_style or not home.value:
        tree = _inline(_rows(nested([below])))
        return _inserted(body, home, tree.strip()[1:-1])
    return _inserted(body, home, _dumped(_rows(nested([below]))))


def _flat(node: yaml.Node | None, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], str]:
    """Return path -> tag and text of every scalar."""
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


def _prove(
    before: dict[tuple[str, ...], str],
    after: dict[tuple[str, ...], str],
    wanted: dict[tuple[str, ...], Value],
) -> None:
    """Check that the text holds the new values and all others unchanged."""
    expected = {
        place: text
        for place, text in before.items()
        if not any(place[: len(path)] == path for path in wanted)
    }
    for path, value in wanted.items():
        expected.update(_flat(yaml.compose(_inline(value), Loader=yaml.SafeLoader), path))
    if after != expected:
        places = sorted({*expected, *after})
        changed = next(place for place in places if expected.get(place) != after.get(place))
        raise AllanError(
            f'the file cannot be merged into without changing {"/".join(changed)}: {_BY_HAND}'
        )
