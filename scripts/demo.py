# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Demonstration: simulate an IMU, analyze it, compare with the true noise, play to the nodes.

usage: demo.py FOLDER [--hours H]

The simulated IMU is the ADIS16475-3 of Cong, Wang & Yan (2019, table 1), 2 h at 100 Hz.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from demo_online import play

from allan_ros.cli.main import main as allan
from allan_ros.results.simulation import truth_path


def main() -> int:
    """Run the steps of the demo. Return the exit code of the first step that fails, or 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--hours', default='2', help='length of the recording (default 2)')
    args = parser.parse_args()
    bag = args.folder / 'adis16475'
    args.folder.mkdir(parents=True, exist_ok=True)
    steps = [
        ['simulate', f'{bag}', '--preset', 'paper', '--hours', args.hours, '--overwrite'],
        ['analyze', f'{bag}', '-o', f'{args.folder}'],
        ['compare', f'{args.folder}', f'{truth_path(bag)}'],
    ]
    for step in steps:
        print(f'$ allan {shlex.join(step)}', flush=True)
        began = time.monotonic()
        code = allan(step)
        if code:
            return code
        print(f'({time.monotonic() - began:.1f} s)\n', flush=True)
    if find_spec('rclpy') is None:
        print('\nno rclpy here: the nodes are omitted (ROS and `make venv` provide rclpy)')
        return 0
    return play(bag, args.folder, 'adis16475-3')


if __name__ == '__main__':
    sys.exit(main())
