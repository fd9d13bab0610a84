# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Print the extras of the package that the Makefile installs.

usage: venv_extras.py DISTRO [EXTRA ...]

The extras are DISTRO, which installs the ROS wheels, and each EXTRA. No extra is printed if a ROS
installation provides rclpy, or if PyPI has no ROS wheels for this system.
"""

import importlib.util
import platform
import sys


def main() -> None:
    """Print the extras to stdout, and to stderr why no ROS wheels are installed."""
    distro, *more = sys.argv[1:]
    extras: list[str] = []
    found = importlib.util.find_spec('rclpy')
    if found and not str(found.origin).startswith(sys.prefix):  # not from a wheel
        print('rclpy of the sourced ROS installation is used', file=sys.stderr)
    elif (
        platform.python_implementation() == 'CPython'
        and (3, 10) <= sys.version_info[:2] <= (3, 13)
        and sys.platform == 'linux'
        and platform.machine() == 'x86_64'
    ):
        extras += [distro, *more]
    else:
        print(
            f'no rclpy wheels for {platform.python_implementation()} '
            f'{platform.python_version()} on {platform.machine()} {sys.platform}: everything but '
            'the nodes is run; use CPython 3.10 to 3.13 on x86-64 Linux, or source a ROS 2 '
            'installation, to run them too',
            file=sys.stderr,
        )
    print(','.join(extras))


if __name__ == '__main__':
    main()
