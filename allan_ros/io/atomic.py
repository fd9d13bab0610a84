# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or not there: written beside their place, then renamed into it."""

from __future__ import annotations

import os
from pathlib import Path
from uuid import uuid4

from ..core.errors import AllanError


def write_atomic(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Put the content at the path so that a reader, or a crash, never sees half of it.

    It is written to a file of its own in the same folder, synced to the disk and renamed.

    Raises
    ------
    AllanError
        When the folder is missing or not writable, or the disk is full.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    draft = path.with_name(f'.{path.name}.{uuid4().hex}.part')
    try:
        try:
            with draft.open('xb') as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)
        _sync_folder(path.parent)
    except OSError as error:
        raise AllanError(
            f'{path}: cannot be written ({error.strerror}): check the folder, its permissions '
            'and the space left'
        ) from error


def _sync_folder(folder: Path) -> None:
    """Make the rename itself last over a power cut, where the system can (not on Windows)."""
    if os.name != 'posix':
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
