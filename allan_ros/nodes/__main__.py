# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of the executables of the ROS nodes.

Without installation: ``python -m allan_ros.nodes monitor --ros-args ...``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module

EXECUTABLES = ('accumulator', 'estimator', 'monitor', 'relay', 'watch')


def ros_is_missing(program: str) -> bool:
    """Return whether rclpy cannot be imported. If it cannot, print the reason in one line."""
    try:
        import_module('rclpy')
    except ImportError as error:
        print(
            f'{program}: rclpy cannot be imported by {sys.executable} ({error}): source the setup '
            'file of a ROS 2 distribution, such as /opt/ros/jazzy/setup.bash',
            file=sys.stderr,
        )
        return True
    return False


def start(name: str, args: Sequence[str] | None = None) -> int:
    """Run a node and return its exit code; without ROS, print one line and return 1."""
    if ros_is_missing(f'allan_{name}'):
        return 1
    if name == 'watch':
        from . import watch

        return watch.main(args)
    from . import monitor

    return monitor.main(name, args)


accumulator = partial(start, 'accumulator')
estimator = partial(start, 'estimator')
relay = partial(start, 'relay')
monitor = partial(start, 'monitor')
watch = partial(start, 'watch')


def main() -> int:
    """Run the node that the first argument names; return 2 if it names none of `EXECUTABLES`."""
    if sys.argv[1:2] == [] or sys.argv[1] not in EXECUTABLES:
        print(f'usage: python -m allan_ros.nodes {{{",".join(EXECUTABLES)}}} ...', file=sys.stderr)
        return 2
    return start(sys.argv[1], sys.argv[2:])


if __name__ == '__main__':
    sys.exit(main())
