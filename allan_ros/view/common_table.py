# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of the noise that several IMUs have in common."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..core.allan.common_noise import CommonNoise
from ..core.estimate import interval_text, value_text
from ..core.imu import shown_unit
from ..results.common_noise import CommonResult
from .finding_text import finding_line

SHOWN_TAU_S = (0.1, 1.0, 10.0, 100.0)
"""Averaging times in s at which the table shows the coherence."""

NEAR = 1.5
"""Largest ratio of an averaging time to the one that is shown for it."""


def common_lines(common: CommonResult, units: str = 'deg/h') -> Iterator[str]:
    """Yield the lines of a table: N as measured, N without common noise, and the coherence."""
    shown = [tau for tau in SHOWN_TAU_S if any(_text(row, tau) for row in common.rows)]
    has_noise = any(row.measured or row.own for row in common.rows)
    own = 'own N' if len({row.label for row in common.rows}) > 2 else 'own N, mean of both'
    noise = ['N', own, ''] if has_noise else []
    table = [['axis', 'IMU', *noise, *(f'coherence at {tau:g} s' for tau in shown)]]
    for row in common.rows:
        unit = shown_unit(row.axis, 'N', units)
        cells = [row.axis, row.label, *([''] * len(noise))]
        if row.measured is not None:
            cells[2] = f'{value_text(row.measured, unit)} {unit.name}'
        if row.own is not None:
            cells[3:] = value_text(row.own, unit), interval_text(row.own, unit)
        table.append(cells + [_text(row, tau) for tau in shown])
    widths = [max(map(len, column)) for column in zip(*table)]
    for cells in table:
        yield '  '.join(f'{cell:{width}}' for cell, width in zip(cells, widths)).rstrip()
    yield ''
    yield '95 % intervals; coherence 0: independent noise, 1: common noise, such as vibration'
    for label, found in common.findings.items():
        yield from (
            f'{each.severity}: {label}: {finding_line(each)}'
            for each in found
            if each.severity != 'info'
        )


def _text(row: CommonNoise, tau: float) -> str:
    times, *numbers = row.coherence
    distance = np.abs(np.log(times / tau))
    at = int(np.argmin(distance))
    if distance[at] > np.log(NEAR):
        return ''
    # 0.0 is added to write -0.00 as 0.00
    return '{:.2f} ({:.2f} to {:.2f})'.format(*(round(number[at], 2) + 0.0 for number in numbers))
