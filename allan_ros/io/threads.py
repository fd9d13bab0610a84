# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Limit linear algebra to one thread during a fit.

The matrices of a fit have about a hundred rows. More threads do not make it faster, and their
busy-waiting multiplies the CPU time. OpenBLAS is set on Linux, which the wheels of numpy and scipy
contain.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

PREFIXES = ('scipy_openblas', 'openblas')
SUFFIXES = ('64_', '')
"""Parts of the function names in the builds of OpenBLAS."""

_lock = threading.Lock()
_users = 0
_restore = ExitStack()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread within the context; several threads may be in it at once."""
    global _users
    with _lock:
        if not _users:
            _limit()
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                _restore.close()


def _limit() -> None:
    """Set one thread, and register in `_restore` how to undo it."""
    import scipy.linalg  # noqa: F401  # loads its own BLAS library

    for get, set_number in _openblas():
        _restore.callback(set_number, get())
        set_number(1)


def _openblas() -> Iterator[tuple[Callable[[], int], Callable[[int], Any]]]:
    """Yield the functions that get and set the number of threads of each loaded OpenBLAS."""
    paths: set[str] = set()
    with suppress(OSError):  # not Linux
        for line in Path('/proc/self/maps').read_text(errors='surrogateescape').splitlines():
            path = line.split(maxsplit=5)[-1]
            if 'openblas' in path.rpartition('/')[2]:
                paths.add(path)
    for path in sorted(paths):
        with suppress(OSError):
            library = ctypes.CDLL(path)
            for name in (f'{p}_{{}}_num_threads{s}' for p in PREFIXES for s in SUFFIXES):
                if hasattr(library, name.format('set')):
                    yield getattr(library, name.format('get')), getattr(library, name.format('set'))
                    break
