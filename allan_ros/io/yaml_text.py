# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""YAML as text, which may come from a stranger: plain values only, in bounded time and memory."""

from __future__ import annotations

import re
from typing import Any

import yaml

MOST_BRACKETS = 50
"""No file we read nests deeper; what a scanner takes grows with the square of the depth."""

MERGE = 'tag:yaml.org,2002:merge'
"""Tag of the key ``<<``: merges of merges copy, so that a page of them fills the memory."""


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
    """Return what a YAML (or JSON) text holds.

    Raises
    ------
    yaml.YAMLError
        When it is none, nests too deep, or has merge keys.
    """
    loader = _Loader(text)
    try:
        return loader.get_single_data()
    except RecursionError:
        raise yaml.YAMLError('it nests too deep') from None
    finally:
        loader.dispose()
