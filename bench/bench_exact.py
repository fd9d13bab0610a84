# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rounding errors of the engine, against exact integer arithmetic, for
bench/results.md.

A float64 near 9.8 is a multiple of 2^-49. So the sums of such samples can be computed in integers
of any length, and the result of the engine differs only by its rounding.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from doc_table import DocTable
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.imu import ImuIdentity

UNIT = 2.0**-49
"""Spacing of float64 from 8 to 16."""

OFFSET = 9.8
"""Gravity in m/s^2, which an accelerometer at rest measures."""

HEADING = ('samples about 9.8 m/s^2', 'sums', 'largest error of one', 'mean error')


def main() -> None:
    """Print and write a row for each kind of noise and length."""
    rng, table = np.random.default_rng(4), DocTable('exact', HEADING)
    for n in (10**4, 10**5, 10**6):
        white = rng.normal(0.0, 0.01, n)
        kinds = {
            f'{n}, white noise of 0.01': white,
            f'{n}, with a walk of 1e-4 a step': white + rng.normal(0.0, 1e-4, n).cumsum(),
            f'{n}, with a ramp of 1 in all': white + np.arange(n) / n,
        }
        for name, y in kinds.items():
            errors = _errors(OFFSET + y)
            row = (name, str(len(errors)), f'{errors.max():.1e}', f'{errors.mean():.1e}')
            print(' | '.join(row), flush=True)
            table.put(row)


def _errors(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the relative error of each sum of d^2."""
    engine = RunningSums(ImuIdentity('imu'), ('accel_z',))
    engine.update(y[:, None], 0, len(y) - 1)
    sums = engine.sums
    whole = (y / UNIT).astype(np.int64)
    theta = np.concatenate([[0], np.cumsum((whole - whole[0]).astype(object))])
    errors = []
    for m, stride, found in zip(sums.m, sums.stride, sums.sum_sq[:, 0]):
        d = (theta[2 * m :] - 2 * theta[m:-m] + theta[: -2 * m])[::stride]
        exact = float((d * d).sum()) * UNIT * UNIT
        errors.append(abs(found - exact) / exact)
    return np.array(errors)


if __name__ == '__main__':
    main()
