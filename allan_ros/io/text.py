# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON and YAML text: strict in both directions, and bounded when read."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ..core.errors import AllanError
from .files import read_bounded

MAX_BYTES = 16 * 2**20
"""Longest document that is read; real ones are far smaller."""


MAX_DIGITS = 20
"""Most digits of an integer: one of a million digits takes minutes to read."""


def to_json(document: Mapping[str, Any]) -> str:
    """Return the document as text; a NaN in it is a bug and raises ValueError."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + '\n'


def parse_json(text: str, where: str) -> object:
    """Return the value of a JSON text.

    Raises
    ------
    AllanError
        When it is too long, too deep or not JSON; NaN and infinity, half surrogates and numbers
        beyond the bounds are rejected.
    """
    if len(text) > MAX_BYTES:
        raise AllanError(
            f'{where}: has more than {MAX_BYTES} bytes: it is not a document of allan_ros'
        )
    try:
        document: object = json.loads(text, parse_constant=_refuse, parse_int=_integer)
        if '\\ud' in text.lower():  # half a surrogate pair, which no file can contain
            json.dumps(document, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise AllanError(f'{where}: is not JSON ({error}): write it again') from None
    return document


def read_json(path: str | os.PathLike[str]) -> object:
    """Return the value of a JSON file.

    Raises
    ------
    AllanError
        When it is missing, or `parse_json` rejects it.
    """
    path = Path(path)
    try:
        text = read_bounded(path, MAX_BYTES).decode('utf-8')
    except FileNotFoundError:
        raise AllanError(f'{path}: no such file: check the path') from None
    except OSError as error:
        raise AllanError(f'{path}: cannot be read ({error.strerror})') from error
    except ValueError as error:
        raise AllanError(f'{path}: is not JSON ({error}): write it again') from None
    return parse_json(text, str(path))


def _refuse(name: str) -> object:
    raise ValueError(f'{name} is not a number')


def _integer(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError(f'an integer of {len(digits)} digits')
    return int(digits)


MOST_BRACKETS = 50
"""Deepest nesting that is read: the time of the scanner grows with the square of the depth."""


MERGE = 'tag:yaml.org,2002:merge'
"""Tag of the key ``<<``: nested merges are copied, so a short file of them can fill the memory."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    def fetch_flow_collection_start(self, token: Any) -> None:
        if self.flow_level >= MOST_BRACKETS:
            raise yaml.YAMLError(f'more than {MOST_BRACKETS} brackets one in another')
        super().fetch_flow_collection_start(token)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        if any(key.tag == MERGE for key, _ in node.value):
            raise yaml.YAMLError('it has a key "<<", which is not followed')


# YAML 1.1 takes 1e-4 for a word because it has no point; people, and JSON, mean a number.
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?[0-9]+[eE][-+]?[0-9]+$'), list('-+0123456789')
)


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML (or JSON) text.

    Raises
    ------
    yaml.YAMLError
        When it is invalid, nests too deep, or has merge keys.
    """
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    except RecursionError:
        raise yaml.YAMLError('it nests too deep') from None
    finally:
        loader.dispose()
