# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start, spin and stop a node: the only place that knows of signals and exit codes."""

from __future__ import annotations

import ctypes
import queue
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from threading import Event
from typing import Any, Protocol, TypeVar

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions

from ..core.errors import AllanError, one_line


class Periodic:
    """Comes due once a period; the period may change while it runs.

    One timer that asks several of these costs a third of as many timers in the executor.
    """

    def __init__(self, period: Callable[[], float], now: float) -> None:
        self._period = period
        self._last = now

    def due(self, now: float) -> bool:
        """Return whether a period has passed since it last was due (steady clock, s)."""
        if now - self._last < self._period():
            return False
        # late by less than a period: keep the beat; by more: start it anew
        self._last = max(self._last + self._period(), now - self._period())
        return True


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


STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""All timers run on it, so neither a paused ``/clock`` nor a wall-clock step stops them."""


class Closable(Protocol):
    """A node that has something to finish before it goes."""

    def close(self) -> None:
        """Finish: called once, while the graph is still there, and not interrupted by signals."""

    def destroy_node(self) -> None:
        """Destroy the node, as `rclpy.node.Node` does."""


def run(
    name: str, make_node: Callable[[Event], Closable], args: Sequence[str] | None = None
) -> int:
    """Run a node until SIGINT, SIGTERM or its own end, and return the exit code.

    A reason not to start (bad parameters, a missing file) is logged in one line: exit 1. After
    any number of signals the node is closed in peace: exit 0.

    Parameters
    ----------
    name : str
        Of the executable.
    make_node : callable
        Makes the node; it gets an event that ends the node when set. The node must have a timer:
        a signal is heeded when the executor next wakes.
    args : sequence of str, optional
        Command line, by default that of the process.
    """
    stop = Event()
    # Python's default handler would raise KeyboardInterrupt in the middle of an update or of the
    # writing of a checkpoint, and rclpy's would shut the graph down before the node has finished.
    for number in STOP_SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    given = None if args is None else list(args)
    try:
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # of rcl: a missing keystore, an argument it does not know
        get_logger(name).fatal(f'{name} stops: {one_line(str(error))}')
        return 1
    executor = SingleThreadedExecutor()
    try:
        node = make_node(stop)
        executor.add_node(node)
        try:
            while not stop.is_set():
                executor.spin_once()
        except ExternalShutdownException:
            pass
        finally:
            node.close()
            node.destroy_node()
        return 0
    except (AllanError, ParameterException) as error:
        get_logger(name).fatal(f'{name} stops: {error}')
        return 1
    finally:
        executor.shutdown()
        if rclpy.ok():
            rclpy.shutdown()
        # Python puts back the deadly default when it ends, but leaves ignored signals ignored.
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
