# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise that several IMUs, or the axes of one IMU, have in common: from recordings to a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.allan.common_noise import CommonNoise, Samples, common_noise, common_of_axes
from ..core.errors import AllanError
from ..core.estimate import interval_text, value_text
from ..core.fields import plain
from ..core.imu import AXES, SENSORS, sensor_of, shown_unit
from ..core.settings import SegmenterSettings
from ..core.stream.pipeline import ImuStream
from ..readers import Recording
from .analysis import one_thread

SHOWN_TAU_S = (0.1, 1.0, 10.0, 100.0)
"""Averaging times in s at which the table shows the coherence."""

NEAR = 1.5
"""Largest ratio of an averaging time to the one that is shown for it."""


@dataclass(frozen=True)
class CommonResult:
    """The common and the own noise of several IMUs on one body, or of the axes of one IMU.

    Printed, it is a table. ``rows`` has a `CommonNoise` for each axis and IMU, or for each two axes
    of a single IMU.
    """

    rows: tuple[CommonNoise, ...]

    def __repr__(self) -> str:
        return '\n'.join(common_lines(self))

    def document(self) -> dict[str, Any]:
        """Return the result as a JSON object of the schema ``allan_ros/common/1``, in SI."""
        return {'schema': 'allan_ros/common/1', 'rows': plain(self.rows)}


@one_thread()
def common_of(recordings: Mapping[str, Recording], settings: SegmenterSettings) -> CommonResult:
    """Return the common noise of recordings that were made at the same time, by label.

    The samples at rest of all recordings are kept in memory. Raises AllanError if the recordings
    have no axis or no time in common.
    """
    known: list[dict[str, Samples]] = []
    for recording in recordings.values():
        known.append({})
        for part in filter(None, (recording, recording.accel)):
            stream = ImuStream(settings, sensor=part.sensor, with_samples=True)
            for batch in part.batches():
                stream.update(batch)
            stream.end()
            known[-1].update({axis: Samples(*each) for axis, each in stream.samples().items()})
    rows: list[CommonNoise] = []
    labels = list(recordings)
    axes = [axis for axis in AXES if all(axis in samples for samples in known)]
    if len(known) > 1:
        for axis in axes:
            rows += common_noise(axis, [samples[axis] for samples in known], labels)
    for sensor in SENSORS if len(known) == 1 else ():
        own = [axis for axis in axes if sensor_of(axis) == sensor]
        if len(own) > 1:
            rows += common_of_axes(own, [known[0][axis] for axis in own], labels[0])
    if not rows:
        found = (
            f'{label} has {", ".join(samples) or "none"}' for label, samples in zip(labels, known)
        )
        raise AllanError(
            f'no two axes to compare: of data at rest, {"; ".join(found)}: choose topics with '
            '--topic and --accel-topic, or record longer'
        )
    return CommonResult(tuple(rows))


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


def _text(row: CommonNoise, tau: float) -> str:
    times, *numbers = row.coherence
    distance = np.abs(np.log(times / tau))
    at = int(np.argmin(distance))
    if distance[at] > np.log(NEAR):
        return ''
    # 0.0 is added to write -0.00 as 0.00
    return '{:.2f} ({:.2f} to {:.2f})'.format(*(round(number[at], 2) + 0.0 for number in numbers))
