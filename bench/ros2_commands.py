# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run every ROS 2 command of the documentation in a workspace, against running nodes.

    source install/setup.bash && python bench/ros2_commands.py

Needs ros2cli, ros2launch and the installed package. The commands, their exit codes and a line of
their output go to bench/results.md.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from doc_table import DocTable

TRIGGER = 'std_srvs/srv/Trigger'
LONGEST_S = 90.0
SHOWN = 220
"""Number of characters of the output in the table."""

COMMANDS = (
    ('ros2 launch allan_ros allan_ros.launch.py --show-args', "'config'"),
    ('ros2 node list', '/allan_monitor'),
    ('ros2 topic list -t', '/allan_monitor/noise_model'),
    ('ros2 topic info -v /imu/data', 'Subscription count'),
    ('ros2 param describe /allan_monitor estimator.margin', 'Description'),
    ('ros2 param set /allan_monitor estimator.margin 0.2', 'successful'),
    ('ros2 param set /allan_monitor estimator.method best', 'fail'),
    ('ros2 param set /allan_monitor input.topics "[imu]"', 'fail'),
    (f'ros2 service call /allan_monitor/save {TRIGGER}', 'message='),
    (f'ros2 service call /allan_monitor/fit {TRIGGER}', 'message='),
    (f'ros2 service call /allan_monitor/restore {TRIGGER}', 'message='),
    ('ros2 allan save', 'save'),
    ('ros2 allan fit --node /allan_monitor', 'fit'),
    ('ros2 allan check', 'gyro z'),
    ('ros2 allan watch --once', 'gyro z'),
    ('ros2 run allan_ros allan_watch --once', 'input'),
    ('ros2 run allan_ros allan_watch --json', '"message"'),
    (
        'ros2 topic echo --once --field angular_velocity_covariance /imu/data_with_covariance',
        'e-',
    ),
    (f'ros2 service call /allan_monitor/reset {TRIGGER}', 'message='),
    ('ros2 run allan_ros allan_monitor --help', 'usage'),
    ('ros2 run allan_ros allan_monitor --typo', 'unrecognized'),
    (
        'ros2 run allan_ros allan_imu_relay --ros-args -r imu/data:=/a '
        '-r imu/data_with_covariance:=/a',
        'relayed to itself',
    ),
    ('ros2 allan simulate --preset paper --hours 0.2 --rate 100 run.csv', ''),
    ('ros2 allan analyze run.csv -o results', ''),
    ('ros2 allan check run.csv', ''),
    ('ros2 run allan_ros allan sensors', 'adis16475-3'),
)
"""Command, and a text in the line of its output that is shown; '' for the last line."""


def background(command: str, folder: str) -> subprocess.Popen[bytes]:
    """Start a command in its own process group and discard its output."""
    return subprocess.Popen(
        command.split(),
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def run(command: str, folder: str) -> tuple[str, str]:
    """Return the exit code and the output of a command; the code is 'none' if it does not end."""
    try:
        ended = subprocess.run(
            command,
            cwd=folder,
            shell=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        return 'none', (error.stdout or b'').decode(errors='replace')
    return str(ended.returncode), ended.stdout


def line_of(output: str, words: str) -> str:
    """Return the first line that contains ``words``, else the last line."""
    lines = [' '.join(x.split()) for x in output.splitlines() if x.strip()]
    found = [line for line in lines if words and words in line] or lines[-1:]
    return found[0][:SHOWN] if found else ''


def main() -> None:
    """Run all commands and write the table."""
    table = DocTable('commands', ('command', 'exit', 'output'))
    launch = (
        'ros2 launch allan_ros allan_ros.launch.py sensor:=adis16475-3 relay:=true '
        'checkpoint:=imu.json'
    )
    script = Path(__file__).resolve().parents[1] / 'scripts' / 'play.py'
    player = f'{sys.executable} {script} --simulate 1800 --frequency 100 --wait 2'
    with tempfile.TemporaryDirectory() as folder:
        running = [background(launch, folder), background(player, folder)]
        try:
            for _ in range(20):  # until there are coefficients
                if 'N ' in run('ros2 allan watch --once --plain', folder)[1]:
                    break
                time.sleep(3.0)
            for command, words in COMMANDS:
                code, output = run(command, folder)
                row = f'`{command}`', code, line_of(output, words).replace(f'{folder}/', '')
                print(' | '.join(row), flush=True)
                table.put(row)
        finally:
            for process in running:
                os.killpg(process.pid, signal.SIGINT)
            codes = [process.wait(60) for process in running]
    table.put((f'`{launch}`', str(codes[0]), 'ran in the background, ended by SIGINT'))


if __name__ == '__main__':
    main()
