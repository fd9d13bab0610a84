# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON files. They have no comments, so the header is the value of a key at the end."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from ...core.errors import AllanError
from .convention import Entry

HEADER_KEY = 'allan_ros'


class JsonForm:
    """A JSON file."""

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
