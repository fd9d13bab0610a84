# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`PathLock`: a file or folder that one process owns for as long as it runs."""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path

from ..core.errors import AllanError
from .files import unwritable

OWNER_BYTES = 20
"""Longest process number that is read from a lock file."""

LOCKED_BYTE = 2**30
"""Offset of the byte that is locked on Windows: beyond the text, which stays readable."""


class PathLock:
    """Marks a path as owned by one process, with a lock on a hidden file next to it.

    The path itself cannot be locked, because it is replaced whenever it is written.

    Parameters
    ----------
    path : Path
        What one process owns; it need not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle: int | None = None

    @property
    def _mark(self) -> Path:
        return self._path.with_name(f'.{self._path.name}.lock')

    def acquire(self) -> str:
        """Acquire the lock. Return '' on success, else the owner.

        Raises
        ------
        AllanError
            When the folder is missing or not writable, or the lock file is no regular file.
        """
        while self._handle is None:
            handle = self._open_mark()
            if not _try_to_lock(handle):
                os.lseek(handle, 0, os.SEEK_SET)
                owner = os.read(handle, OWNER_BYTES).decode(errors='replace').strip()
                os.close(handle)
                return f'process {owner}' if owner.isdigit() else 'another process'
            if not _is_at(handle, self._mark):
                os.close(handle)  # released, and removed, before it was locked
                continue
            self._handle = handle
            with contextlib.suppress(OSError):  # a full disk: then the owner has no name
                self._mark.write_text(f'{os.getpid()}\n')
        return ''

    def release(self) -> None:
        """Release the lock and remove the lock file."""
        handle, self._handle = self._handle, None
        if handle is not None:
            with contextlib.suppress(OSError):
                self._mark.unlink()
            os.close(handle)

    def _open_mark(self) -> int:
        # not for writing: that would keep a file system from being remounted read-only
        flags = os.O_CREAT | os.O_RDONLY
        for name in ('O_NOFOLLOW', 'O_NONBLOCK', 'O_CLOEXEC'):  # a FIFO must not block the call
            flags |= getattr(os, name, 0)
        try:
            handle = os.open(self._mark, flags, 0o644)
        except OSError as error:
            raise unwritable(self._path, error) from error
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise AllanError(f'{self._mark}: is not a regular file, as a lock must be: remove it')
        return handle


def _try_to_lock(handle: int) -> bool:
    """Lock an open file for this process; return False if another process has locked it."""
    try:
        import fcntl
    except ImportError:
        return _try_to_lock_on_windows(handle)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass  # a file system without locks: other owners cannot be detected
    return True


def _try_to_lock_on_windows(handle: int) -> bool:
    try:
        import msvcrt
    except ImportError:
        return True  # no locks on this system: other owners cannot be detected
    os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError:
        return False
    return True


def _is_at(handle: int, path: Path) -> bool:
    """Return whether the open file is the one that is at the path now."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False
