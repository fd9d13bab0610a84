# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of an analysis, given where one of its files is meant."""

from __future__ import annotations

from pathlib import Path

from ..core.errors import AllanError

RESULTS, SUMS = 'results.json', 'sums.json'
"""Files of the folder of an analysis: what was found, and the sums it was found from."""


def file_of(path: str, name: str) -> str:
    """Return the path itself, or where it is a folder the file of that name in it.

    Raises
    ------
    AllanError
        When the folder has none.
    """
    if not Path(path).is_dir():
        return path
    inside = Path(path) / name
    if not inside.is_file():
        raise AllanError(
            f'{path}: no {name} in this folder: give the folder of an analysis, or the file'
        )
    return str(inside)
