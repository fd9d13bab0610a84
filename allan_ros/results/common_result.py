# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise that several IMUs, or the axes of one IMU, have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from ..core.allan.common_noise import CommonNoise, Samples, common_noise, common_of_axes
from ..core.allan.transfer import LARGEST_LEAK
from ..core.errors import AllanError
from ..core.fields import plain
from ..core.findings import Finding, finding
from ..core.imu import AXES, SENSORS, sensor_of
from ..core.settings import SegmenterSettings
from ..core.stream.health import sums_findings
from ..core.stream.pipeline import ImuStream
from ..readers import Recording
from .analysis import one_thread

OPPOSITE = -0.3
"""An axis is reported to point in the opposite direction if the complete 95 % interval of its
coherence with the other IMUs lies below this number at some averaging time. The coherence is 0 for
independent noise, and positive for common noise of parallel axes."""


@dataclass(frozen=True)
class CommonResult:
    """Noise that several IMUs on one body, or the axes of one IMU, have in common.

    ``rows`` has a `CommonNoise` for each common axis of each IMU, or for each pair of axes of a
    sensor of a single IMU. ``findings`` maps the label of each IMU to the findings about its
    recording.
    """

    rows: tuple[CommonNoise, ...]
    findings: Mapping[str, tuple[Finding, ...]] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """Return the result as a JSON object of the schema ``allan_ros/common/1``, in SI."""
        finding_objects = {
            label: [plain(f) for f in findings] for label, findings in self.findings.items()
        }
        return {
            'schema': 'allan_ros/common/1',
            'rows': plain(self.rows),
            'findings': finding_objects,
        }


@one_thread()
def common_of(recordings: Mapping[str, Recording], settings: SegmenterSettings) -> CommonResult:
    """Return the noise that recordings made at the same time have in common.

    The samples at rest of all recordings are kept in memory.

    Parameters
    ----------
    recordings : mapping of str to Recording
        Label -> recording of one IMU. The axes of a single recording are compared with each other.
    settings : SegmenterSettings
        How the data at rest are selected.

    Raises
    ------
    AllanError
        When the recordings have no axis or too little time in common, when their rates differ by
        more than 1 %, when a single recording has at most one axis of each sensor, or when a
        recording cannot be read.
    """
    samples_of_imus: list[dict[str, Samples]] = []
    findings: dict[str, tuple[Finding, ...]] = {}
    for label, recording in recordings.items():
        samples_of_imus.append({})
        for topic_recording in filter(None, (recording, recording.accel)):
            stream = ImuStream(settings, sensor=topic_recording.sensor, with_samples=True)
            for batch in topic_recording.batches():
                stream.update(batch)
            stream.end()
            result = stream.result()
            all_findings = (
                *topic_recording.findings,
                *result.findings,
                *chain(*map(sums_findings, result.sums)),
            )
            relevant_findings = (
                f
                for f in all_findings
                if not f.axes or not {*f.axes}.isdisjoint(topic_recording.axes)
            )
            findings[label] = tuple(dict.fromkeys((*findings.get(label, ()), *relevant_findings)))
            samples_of_imus[-1].update(
                {axis: Samples(*pair) for axis, pair in stream.samples().items()}
            )
    rows: list[CommonNoise] = []
    labels = list(recordings)
    axes = [axis for axis in AXES if all(axis in samples for samples in samples_of_imus)]
    if len(samples_of_imus) > 1:
        for axis in axes:
            rows += common_noise(axis, [samples[axis] for samples in samples_of_imus], labels)
    for sensor in SENSORS if len(samples_of_imus) == 1 else ():
        sensor_axes = [axis for axis in axes if sensor_of(axis) == sensor]
        if len(sensor_axes) > 1:
            rows += common_of_axes(
                sensor_axes, [samples_of_imus[0][axis] for axis in sensor_axes], labels[0]
            )
    if not rows:
        imu_texts = (
            f'{label} has data at rest of {", ".join(samples) or "no axis"}'
            for label, samples in zip(labels, samples_of_imus)
        )
        raise AllanError(
            f'no two axes to compare, because {"; ".join(imu_texts)}: choose topics with '
            '--topic and --accel-topic, or record longer'
        )
    opposite_axes = set()
    for row in rows if len(samples_of_imus) > 1 else ():
        if len(row.coherence.tau) and row.coherence.high.min() < OPPOSITE:
            coherence = float(row.coherence.value[np.argmin(row.coherence.high)])
            opposite_finding = finding('axis_opposite', (row.axis,), coherence=coherence)
            findings[row.label] = (*findings[row.label], opposite_finding)
            opposite_axes.add(row.axis)
    for row in rows:
        # own N of equal samples is unknown, too, although the IMUs measure the same noise
        is_unequal = row.measured is not None and row.leak >= LARGEST_LEAK
        if is_unequal and row.axis not in opposite_axes:
            unequal_finding = finding('unequal_transfer', (row.axis,), share=row.leak)
            findings[row.label] = (*findings[row.label], unequal_finding)
    return CommonResult(tuple(rows), findings)
