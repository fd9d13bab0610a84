# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read and write files safely: regular files only, bounded, never half written."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from ..core.errors import AllanError

ABANDONED_S = 3600.0
"""A draft unchanged for an hour was left by a process that was killed."""


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading.

    Links are followed. The call does not block on a FIFO.

    Raises
    ------
    AllanError
        When the path is a folder, FIFO, device or socket.
    OSError
        When it is missing or unreadable.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):  # opening a device may already have an effect
        raise _not_regular(path)
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_BINARY', 0)
    file = os.fdopen(os.open(path, flags), 'rb')
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # replaced in between
        file.close()
        raise _not_regular(path)
    return file


def read_bounded(path: str | os.PathLike[str], limit: int) -> bytes:
    """Return the content of a regular file of at most ``limit`` bytes.

    Raises
    ------
    AllanError
        When the path is no regular file, or the file is larger.
    OSError
        When it is missing or unreadable.
    """
    with open_regular(path) as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise AllanError(
            f'{os.fspath(path)}: is larger than {limit} bytes, the limit for such a file: '
            'check the path'
        )
    return data


def _not_regular(path: str | os.PathLike[str]) -> AllanError:
    return AllanError(
        f'{os.fspath(path)}: is a folder, FIFO, device or socket: give a regular file'
    )


def write_atomic(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file atomically: neither a reader nor a crash leaves or sees a part of it.

    The content is written to a draft in the same folder, synced to the disk and renamed.

    Raises
    ------
    AllanError
        When the path is no regular file, the folder is missing or not writable, or the disk is
        full.
    """
    write_together(Path(path).parent, {Path(path).name: content})


def write_together(
    folder: Path, contents: Mapping[str, str | bytes], remove: Iterable[str] = ()
) -> None:
    """Write several files of one folder; none is replaced before all are on the disk.

    Parameters
    ----------
    folder : Path
    contents : mapping of file name to content
        Replaced in this order: the last file is replaced when all others are.
    remove : iterable of str
        Files to remove before the first is replaced.

    Raises
    ------
    AllanError
        When a path is no regular file, the folder is missing or not writable, or the disk is
        full. Then no file has changed, unless a rename failed.
    """
    drafts: dict[Path, Path] = {}
    path = folder
    try:
        try:
            for name, content in contents.items():
                path = folder / name
                check_replaceable(path)
                drafts[path] = path.with_name(f'.{name}.{uuid4().hex}.part')
                with drafts[path].open('xb') as file:
                    file.write(content.encode() if isinstance(content, str) else content)
                    file.flush()
                    os.fsync(file.fileno())
            for name in remove:
                path = folder / name
                check_replaceable(path)
                path.unlink(missing_ok=True)
            for path, draft in drafts.items():
                draft.replace(path)
        finally:
            for draft in drafts.values():
                draft.unlink(missing_ok=True)
        _sync_folder(folder)
    except OSError as error:
        raise unwritable(path, error) from error
    for path in drafts:
        remove_drafts(path)


def check_replaceable(path: Path) -> None:
    """Do nothing if a file may be written or renamed to the path.

    Raises
    ------
    AllanError
        When a folder, FIFO, device or socket, or a link to one, is there.
    """
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise _not_regular(path)


def remove_drafts(path: Path, older_s: float = ABANDONED_S) -> None:
    """Remove the drafts of this path that killed processes left behind.

    Parameters
    ----------
    path : Path
    older_s : float
        How old a draft must be in s; 0 only where no other process writes this path.
    """
    of_this_path = re.compile(rf'\.{re.escape(path.name)}\.[0-9a-f]{{32}}\.part')
    with contextlib.suppress(OSError):
        for name in filter(of_this_path.fullmatch, os.listdir(path.parent)):
            draft = path.with_name(name)
            with contextlib.suppress(OSError):  # gone meanwhile, or of another user
                found = draft.lstat()
                if stat.S_ISREG(found.st_mode) and time.time() - found.st_mtime >= older_s:
                    draft.unlink()


def unwritable(path: Path, error: OSError) -> AllanError:
    """Return the error for a path that cannot be written."""
    return AllanError(
        f'{path}: cannot be written ({error.strerror}): check the folder, its permissions '
        'and the space left'
    )


def _sync_folder(folder: Path) -> None:
    """Make renames survive a power cut, where the system can do this (not on Windows)."""
    if os.name != 'posix':
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
