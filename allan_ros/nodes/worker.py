# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long computations off the callback thread, one at a time, so that nothing else is ever late."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

T = TypeVar('T')


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
