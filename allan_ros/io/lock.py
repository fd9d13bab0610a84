# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A path that one process keeps for as long as it lives."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path

from .atomic import unwritable


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
