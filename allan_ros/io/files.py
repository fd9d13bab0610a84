# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A path that one process keeps for as long as it lives."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import stat
import time
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from ..core.errors import AllanError

ABANDONED_S = 3600.0
"""A draft that nobody has written to for an hour was left by a process that was killed."""


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading.

    Links are followed. The call never waits, which opening a FIFO does otherwise.

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
    """Put the content at the path so that a reader, or a crash, never sees half of it.

    It is written to a draft in the same folder, synced to the disk and renamed.

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
        raise unwritable(path, error) from error
    remove_drafts(path)


def remove_drafts(path: Path, older_s: float = ABANDONED_S) -> None:
    """Remove the drafts of this path that killed processes left.

    Parameters
    ----------
    path : Path
    older_s : float
        How old a draft must be in s; 0 is for who knows that nobody else writes this path.
    """
    of_this_path = re.compile(rf'\.{re.escape(path.name)}\.[0-9a-f]{{32}}\.part')
    with contextlib.suppress(OSError):
        for name in filter(of_this_path.fullmatch, os.listdir(path.parent)):
            draft = path.with_name(name)
            with contextlib.suppress(OSError):  # gone meanwhile, or somebody else's
                if time.time() - draft.lstat().st_mtime >= older_s:
                    draft.unlink()


def unwritable(path: Path, error: OSError) -> AllanError:
    """Return what to tell of a path that cannot be written."""
    return AllanError(
        f'{path}: cannot be written ({error.strerror}): check the folder, its permissions '
        'and the space left'
    )


def _sync_folder(folder: Path) -> None:
    """Make the rename itself last over a power cut, where the system can (not on Windows)."""
    if os.name != 'posix':
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class PathLock:
    """Marks a path as that of one process, in a hidden file beside it.

    The file itself cannot be locked: it is replaced whenever it is written.

    Parameters
    ----------
    path : Path
        What is to be kept by one process only; it need not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle: int | None = None

    @property
    def _mark(self) -> Path:
        return self._path.with_name(f'.{self._path.name}.lock')

    def acquire(self) -> str:
        """Hold the path and return '', or else who holds it.

        Raises
        ------
        AllanError
            When the folder is missing or not writable.
        """
        while self._handle is None:
            try:
                # not for writing: that would keep a file system from being remounted read-only
                handle = os.open(self._mark, os.O_CREAT | os.O_RDONLY | os.O_NOFOLLOW, 0o644)
            except OSError as error:
                raise unwritable(self._path, error) from error
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                owner = os.pread(handle, 20, 0).decode(errors='replace').strip()
                os.close(handle)
                return f'process {owner}' if owner.isdigit() else 'another process'
            except OSError:
                pass  # a file system without locks: then nobody can be found out
            if not _is_at(handle, self._mark):
                os.close(handle)  # released, and removed, before it was locked
                continue
            self._handle = handle
            with contextlib.suppress(OSError):  # a full disk: then nobody can be named
                self._mark.write_text(f'{os.getpid()}\n')
        return ''

    def release(self) -> None:
        """Let it go, and take the mark away."""
        handle, self._handle = self._handle, None
        if handle is not None:
            with contextlib.suppress(OSError):
                self._mark.unlink()
            os.close(handle)


def _is_at(handle: int, path: Path) -> bool:
    """Return whether the open file is the one that is at the path now."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False
