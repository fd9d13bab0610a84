# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start, spin and stop a node: the only place that knows of signals and exit codes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger

from ..core.errors import AllanError

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""All timers run on it, so neither a paused ``/clock`` nor a wall-clock step stops them."""


class Closable(Protocol):
    """A node that has something to finish before it goes."""

    def close(self) -> None:
        """Finish: called once, before the node is destroyed, and not interrupted by signals."""

    def destroy_node(self) -> None:
        """Destroy the node, as `rclpy.node.Node` does."""


def run(name: str, make_node: Callable[[], Closable], args: Sequence[str] | None = None) -> int:
    """Run a node until SIGINT, SIGTERM or shutdown and return the exit code.

    A reason not to start (bad parameters, a missing file) is logged in one line: exit 1. After
    any number of signals the node is closed in peace: exit 0.
    """
    # rclpy's own handlers wake the executor and chain to these. Python's default handler would
    # raise KeyboardInterrupt in the middle of an update or of the writing of a checkpoint.
    for number in STOP_SIGNALS:
        signal.signal(number, _heard)
    rclpy.init(args=None if args is None else list(args))
    try:
        try:
            node = make_node()
        except (AllanError, ParameterException) as error:
            get_logger(name).fatal(f'{name} does not start: {error}')
            return 1
        try:
            rclpy.spin(node)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        finally:
            node.close()
            node.destroy_node()
        return 0
    finally:
        if rclpy.ok():
            rclpy.shutdown()
        # Python puts back the deadly default when it ends, but leaves ignored signals ignored.
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def _heard(_number: int, _frame: object) -> None:
    """Take note of a signal by doing nothing: rclpy's handler has shut the context down."""
