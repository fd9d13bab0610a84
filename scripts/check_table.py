# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run `allan check` on recordings of IMUs in a known state, and print a table of the verdicts.

usage: check_table.py DATA

DATA is the folder of the real recordings. Simulated recordings are written to a temporary folder.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from allan_ros.cli.main import main as allan

HEAD = """| recording | state | checked against | exit code | line |
|---|---|---|---|---|
"""


class Case(NamedTuple):
    """A recording, the known state of its IMU, and the expected exit code of `allan check`.

    Attributes
    ----------
    path : str
        Path in the folder of the real recordings, or file name of a simulated recording.
    state : str
        Description of the recording in the table.
    options : str
        Options of `allan check`.
    exit_code : int
        The expected exit code.
    simulated : str
        Arguments of `allan simulate`; '' for a real or an existing recording.
    """

    path: str
    state: str
    options: str
    exit_code: int
    simulated: str = ''


QUIET = '--hours 0.5 --gyro N=0.25,B=3,K=1 --accel N=0.01,B=3'

CASES = (
    Case('healthy.npz', 'simulated within its limits', '--sensor adis16475-3', 0, QUIET),
    Case('healthy.npz', 'the same', '', 4),
    Case(
        *('noisy.npz', 'simulated, N of the gyro 3 times the limit', '--sensor adis16475-3', 3),
        '--hours 0.1 --gyro N=0.9,B=3 --accel N=0.01,B=3',
    ),
    Case(
        'short.npz',
        'the same noise, 10 s',
        '--sensor adis16475-3',
        4,
        '--hours 0.0028 --gyro N=0.9 --accel N=0.01',
    ),
    Case('mpu6050.npz', 'real MPU-6050, noisier than its datasheet', '--sensor mpu-6050', 3),
    Case('vn310.npz', 'real VN-310 of 34 s, no datasheet known', '', 4),
    Case('bags/turtlebot3.bag', 'real, never at rest', '--sensor mpu-9250', 1),
    Case('bags/phidgets_imu_upside_down.bag', 'real, 1 s at rest', '--sensor mpu-6050', 4),
    Case('bags/plotjuggler_rosbag2_test', 'real, constant values', '--sensor mpu-6050', 3),
    Case('ulog/sample_log_small.ulg', 'real flight, 6 s at rest', '', 4),
    Case('odd/empty_bag_rosbag2', 'bag without an IMU', '', 1),
    Case('odd/tiryoh_truncated.mcap', 'damaged bag', '', 1),
)


def run_cases(data: Path, folder: Path) -> Iterator[tuple[Case, int, str]]:
    """Yield each case with the exit code of `allan check` and the line that it prints.

    ``data`` is the folder of the real recordings, and ``folder`` receives the simulated recordings.
    """
    for case in CASES:
        path = folder / case.path
        if case.simulated:
            allan(['simulate', str(path), *case.simulated.split(), '--quiet'])
        path = path if path.exists() else data / case.path
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = allan(['check', str(path), *case.options.split()])
        line = (out.getvalue() or err.getvalue()).strip()
        yield case, code, line.replace(f'{path.parent}/', '')


def main() -> int:
    """Print the table; return 1 if an exit code differs from the expected one, 2 without DATA."""
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    rows, wrong = [], []
    with tempfile.TemporaryDirectory() as folder:
        for case, code, line in run_cases(Path(sys.argv[1]), Path(folder)):
            against = f'`{case.options}`' if case.options else 'nothing'
            rows.append(f'| `{case.path}` | {case.state} | {against} | {code} | {line} |')
            wrong += [case.path] * (code != case.exit_code)
    print(HEAD + '\n'.join(rows))
    for path in wrong:
        print(f'{path}: another exit code than expected', file=sys.stderr)
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
