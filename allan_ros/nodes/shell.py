# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start, spin and stop a node: command line, signals, exit codes and the worker thread."""

from __future__ import annotations

import argparse
import ctypes
import queue
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from threading import Event
from typing import Any, TypeVar

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ..core.errors import AllanError, one_line

T = TypeVar('T')

_TRIM = getattr(ctypes.CDLL(None), 'malloc_trim', None) if sys.platform == 'linux' else None
"""Function of glibc that returns free heap memory to the system; None without glibc. If it is not
called, the process keeps about 20 MB of heap memory that a fit has freed."""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of sums, noise model and bias: reliable, and a late subscriber gets the last message."""

STEADY_CLOCK = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of all timers. It continues while ``/clock`` is paused or the system time is changed."""


class Worker:
    """A daemon thread with a task queue. The process can exit while a task is still running."""

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True).start()

    def submit(self, task: Callable[[], T]) -> Future[T]:
        """Queue a task, and return a future that receives the result or exception of the task."""
        future: Future[T] = Future()
        self._tasks.put((future, task))
        return future

    def _work(self) -> None:
        while True:
            future, task = self._tasks.get()
            try:
                future.set_result(task())
            except BaseException as error:  # future.result() raises it again
                future.set_exception(error)
            del task, future  # frees the memory of the task before the next task arrives
            if _TRIM is not None:
                _TRIM(0)


def run(
    name: str,
    make_node: Callable[[Event, argparse.Namespace], Any],
    parser: argparse.ArgumentParser,
    args: Sequence[str] | None = None,
) -> int:
    """Run a node until it receives SIGINT or SIGTERM or stops itself, and return the exit code.

    The exit code is 0, or 1 if the node cannot start (invalid parameters, a missing file); the
    reason is then logged in one line. If the options are invalid, ``parser`` raises SystemExit.

    ``make_node`` returns the node. Its arguments are an event and the options of the command line.
    Setting the event stops the node. ``parser`` parses the options from ``args`` (by default,
    ``sys.argv``) without the ROS arguments. The node needs a timer, because signals are handled
    when the executor wakes. The method ``close()`` of the node is called once before the node is
    destroyed. If the node has a method ``fault(where, error)``, exceptions of callbacks are passed
    to this method, and the node continues.
    """
    argv = sys.argv if args is None else [name, *args]
    stop = Event()
    try:
        options = parser.parse_args(remove_ros_args(list(argv))[1:])
        # Python's default handler would raise KeyboardInterrupt, even during an update or while a
        # checkpoint is written. The handler of rclpy would shut down the context before the node is
        # closed.
        for number in STOP_SIGNALS:
            signal.signal(number, lambda *_: stop.set())
        rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rcl cannot read a parameter file or a keystore
        get_logger(name).fatal(f'{name} stops: {one_line(str(error))}')
        return 1
    executor = SingleThreadedExecutor()
    try:
        node = make_node(stop, options)
        executor.add_node(node)
        try:
            _spin(executor, node, stop)
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
        # Python restores the default handlers at exit, but ignored signals stay ignored.
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def _spin(executor: SingleThreadedExecutor, node: Any, stop: Event) -> None:
    """Execute callbacks until the event is set or the context is shut down."""
    fault: Callable[[str, Exception], None] | None = getattr(node, 'fault', None)
    while not stop.is_set():
        try:
            executor.spin_once()
        except ExternalShutdownException:
            return
        except Exception as error:
            if fault is None:
                raise
            fault('callback', error)
