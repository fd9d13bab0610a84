# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the numbers in documents, and sums with extreme numbers."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.imu import AXES, LARGEST

from .sums import sums_of

NO_NUMBER = re.compile(r'(?<![\w-])-?(nan|inf|infinity)(?!\w)', re.IGNORECASE)
"""Pattern of texts that must not appear in any output."""

SIGNED = {
    *('reference', 'total', 'gof_z', 'start_ns', 'begin_ns'),
    *('relative', 'matrix', 'mean', 'slope', 'slope_ci95', 'temperature', 'R'),
}
"""Fields whose numbers may be negative."""


def check_numbers(value: Any, key: str = '') -> None:
    """Raise unless all numbers of a document are finite, and none is negative where it cannot
    be.
    """
    if isinstance(value, dict):
        for name, inner in value.items():
            check_numbers(inner, key if name in ('value', 'ci95') else name)
    elif isinstance(value, (list, tuple)):
        for inner in value:
            check_numbers(inner, key)
    elif isinstance(value, (int, float)):
        assert type(value) in (bool, int, float), f'{key} is a {type(value).__name__}'
        assert math.isfinite(value), f'{key} is {value}'
        assert value >= 0 or key in SIGNED, f'{key} is {value}'


def noisy_sums(n: int = 1000) -> AllanSums:
    """Return sums of axes with tiny, common, huge, drifting, rounded and steep samples."""
    noise = np.random.default_rng(8).uniform(-1.0, 1.0, (n, 6))
    noise *= (1e-36, 1e-3, LARGEST, 1e-20, 1.0, 1e12)
    noise[:, 3] = noise[:, 3].cumsum()
    noise[:, 4] = np.diff(noise[:, 4], prepend=0.0)
    noise[:, 5] += 1e12 * np.arange(n)
    return sums_of(noise, cuts=(n // 3,), axes=AXES)


def noiseless_sums(n: int = 400) -> AllanSums:
    """Return sums of axes without noise: constant, subnormal, stepped, steep or alternating
    samples.
    """
    i = np.arange(n)
    columns = (
        np.full(n, 9.8),
        1e-310 * (i % 3),
        1.0 * (i == 7),
        1e-9 * (i > 9),
        1e15 * i,
        (-1.0) ** i,
    )
    return sums_of(np.column_stack(columns), cuts=(n // 3,), axes=AXES)
