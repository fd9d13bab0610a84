# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long computations off the callback thread, one at a time, so that nothing else is ever late."""

from __future__ import annotations

import ctypes
import queue
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar('T')

_TRIM = getattr(ctypes.CDLL(None), 'malloc_trim', None) if sys.platform == 'linux' else None


class Worker:
    """A daemon thread with a queue: a fit under way does not hold up the end of the node."""

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True).start()

    def submit(self, task: Callable[[], T]) -> Future[T]:
        """Queue a task; its result or exception is in the future."""
        future: Future[T] = Future()
        self._tasks.put((future, task))
        return future

    def _work(self) -> None:
        while True:
            future, task = self._tasks.get()
            try:
                future.set_result(task())
            except BaseException as error:  # it belongs to whoever asks for the result
                future.set_exception(error)
            del task, future  # or they would keep what they hold until the next task
            _give_memory_back()


def _give_memory_back() -> None:
    """Return freed memory to the system: glibc keeps what lies below anything still in use.

    A fit leaves some 20 MB of holes. Other C libraries have nothing of the kind.
    """
    if _TRIM is not None:
        _TRIM(0)
