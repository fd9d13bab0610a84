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
from typing import Any, Protocol, TypeVar

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
"""Returns freed heap memory to the system (glibc only). A fit leaves about 20 MB of free blocks
below memory that is still in use."""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""QoS of sums and noise model: reliable, and late subscribers receive the last message."""

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of all timers, which neither a paused ``/clock`` nor a wall-clock step stops."""


class Worker:
    """A daemon thread with a task queue; an unfinished task does not delay the end of the node."""

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True).start()

    def submit(self, task: Callable[[], T]) -> Future[T]:
        """Queue a task; the future receives its result or exception."""
        future: Future[T] = Future()
        self._tasks.put((future, task))
        return future

    def _work(self) -> None:
        while True:
            future, task = self._tasks.get()
            try:
                future.set_result(task())
            except BaseException as error:  # raised again by future.result()
                future.set_exception(error)
            del task, future  # release the objects of the task before the next one
            if _TRIM is not None:
                _TRIM(0)


class Runnable(Protocol):
    """Methods that `run` requires of a node."""

    def close(self) -> None:
        """Finish the work before the node is destroyed; called once, not interrupted by signals."""

    def destroy_node(self) -> None:
        """Destroy the node, as `rclpy.node.Node` does."""


def ros_parser(name: str, description: str) -> argparse.ArgumentParser:
    """Return the command line parser of an executable that is configured only by ROS arguments."""
    return argparse.ArgumentParser(
        prog=name,
        description=description,
        epilog='Parameters are set by ROS arguments: --ros-args -p NAME:=VALUE, '
        '--params-file FILE, -r TOPIC:=OTHER. All parameters: config/allan_ros.yaml, or '
        'ros2 param describe.',
    )


def run(
    name: str,
    make_node: Callable[[Event, argparse.Namespace], Runnable],
    parser: argparse.ArgumentParser,
    args: Sequence[str] | None = None,
) -> int:
    """Run a node until SIGINT, SIGTERM or its own end, and return the exit code.

    If the node cannot start (invalid parameters, a missing file), the reason is logged in one line,
    and the exit code is 1. After any number of signals the node is closed, and the exit code is 0.
    An exception in a callback of the node is passed to ``node.fault``, if it has one, and the node
    continues.

    ``make_node`` gets an event that ends the node when it is set, and the parsed options of the
    command line without ROS arguments. The node must have a timer, because signals are handled when
    the executor wakes.
    """
    argv = sys.argv if args is None else [name, *args]
    try:
        options = parser.parse_args(remove_ros_args(list(argv))[1:])
    except RuntimeError as error:  # from rcl: a missing or damaged parameter file
        get_logger(name).fatal(f'{name} stops: {one_line(str(error))}')
        return 1
    stop = Event()
    # Python's default handler would raise KeyboardInterrupt in the middle of an update or while a
    # checkpoint is written, and rclpy's would shut the graph down before the node has finished.
    for number in STOP_SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    try:
        rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # from rcl: a missing keystore, an unknown ROS argument
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


def _spin(executor: SingleThreadedExecutor, node: Runnable, stop: Event) -> None:
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
