# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that nodes publish for each IMU: one with the Allan sums, one with the bias at rest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.node import Node

from ..core.allan.at_rest import TurnOnBias
from ..core.allan.periods import KEPT_SEGMENTS, MIN_MEANS
from ..core.allan.sums import AllanSums
from ..core.errors import AllanError, one_line
from ..core.estimate import Estimate
from ..core.fields import Fields
from ..core.filters.bias import BiasModel, BiasTracker
from ..core.findings import Finding
from ..core.imu import AXES, ImuIdentity
from ..core.stream.drive_recorder import NO_DRIVES, Drives
from ..core.stream.health import Means
from ..readers.files import parse_json
from ..readers.recording_sums import with_accel
from ..results.checkpoint import Total
from ..results.documents import (
    finding_from_document,
    sums_file_from_document,
    sums_file_to_document,
)
from ..results.results import Results
from ..view.finding_text import texts_of
from .shell import LATCHED

REPLACED_SHARE = 0.1
"""Largest share of samples that Allan sums may lose before the coefficients fitted to them are
invalidated. A small loss is normal: when a motion is detected, the samples from the start of this
motion are removed."""

TWIST_ROWS = {axis: (i + 3) % 6 for i, axis in enumerate(AXES)}
"""Axis -> row in the 6x6 covariance of a twist: linear x, y, z, then angular x, y, z."""

NO_VARIANCE = -1.0
"""Value in place of a variance if the bias of the axis is unknown, as in sensor_msgs/Imu."""


@dataclass(frozen=True)
class Snapshot:
    """The Allan sums at one time, and the IMU that is connected at that time.

    ``total`` contains the Allan sums and their provenance. ``frame_id``, ``hardware_id`` and
    ``axes`` describe the messages that are received at that time; the sums may come from another
    IMU. ``axes`` are also known while there are no sums. ``means`` are means over 1 s of the latest
    samples at rest, in SI; all axes in a `Means` have the same sample rate. ``faults`` are
    findings about the present samples: faults, motion, and more noise than in the sums. ``drives``
    are the latest drives between two rests; the document of a snapshot does not contain the drives.
    """

    total: Total
    frame_id: str = ''
    hardware_id: str = ''
    axes: tuple[str, ...] = ()
    means: tuple[Means, ...] = ()
    faults: tuple[Finding, ...] = ()
    drives: Drives = NO_DRIVES

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """The `AllanSums` of all axes: one, or several if the sample rates or topics differ.

        The tuple is empty before the first static data.
        """
        return self.total[0]

    def with_accel(self, accel: Snapshot) -> Snapshot:
        """Return this snapshot, extended by the snapshot of an accelerometer with its own topic."""
        sums, provenance = self.total
        identity = sums[0].identity if sums else ImuIdentity(self.frame_id, self.hardware_id)
        return replace(
            self,
            total=(
                with_accel(sums, accel.sums, identity),
                provenance.with_accel(accel.total[1]),
            ),
            axes=self.axes + accel.axes,
            means=self.means + accel.means,
            faults=self.faults + accel.faults,
        )

    def to_document(self) -> dict[str, Any]:
        """Return the JSON object of a sums file with three more keys: imu, means and faults.

        The key ``imu`` describes the connected IMU.
        """
        imu = {'frame_id': self.frame_id, 'hardware_id': self.hardware_id, 'axes': [*self.axes]}
        means = [
            {
                'axes': list(stream_means.axes),
                'end_ns': stream_means.end_ns.tolist(),
                'values': [[float(f'{value:.9g}') for value in row] for row in stream_means.values],
            }
            for stream_means in self.means
        ]
        faults = [fault.document() for fault in self.faults]
        return {
            **sums_file_to_document(*self.total),
            'imu': imu,
            'means': means,
            'faults': faults,
        }

    @classmethod
    def from_json(cls, text: str) -> Snapshot:
        """Return the snapshot in a JSON text; raise AllanError if the text is invalid."""
        document = parse_json(text, 'sums')
        total = sums_file_from_document(document, 'sums')
        fields = Fields(document, 'sums')
        imu = fields.optional_fields('imu')
        if imu is None:
            return cls(total)
        axes = imu.sequence('axes')
        return cls(
            total,
            imu.text('frame_id', ''),
            imu.text('hardware_id', ''),
            tuple(axis for axis in AXES if axis in axes),
            _means(document.get('means', []) if isinstance(document, dict) else []),
            tuple(map(finding_from_document, fields.each('faults'))) if 'faults' in fields else (),
        )


def _means(documents: Any) -> tuple[Means, ...]:
    """Return the means in a document; raise AllanError unless they are rows of finite numbers."""
    try:
        means = tuple(
            Means(
                tuple(str(axis) for axis in part['axes']),
                np.array(part['end_ns'], np.int64),
                np.array(part['values'], float).reshape(len(part['end_ns']), len(part['axes'])),
            )
            for part in documents
        )
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        raise AllanError(f'sums: its means cannot be read ({error!r})') from error
    if not all(np.isfinite(part.values).all() for part in means):
        raise AllanError('sums: its means are not finite numbers')
    return means


def replaced_share(before: Sequence[AllanSums], after: Sequence[AllanSums]) -> float:
    """Return the share of the samples in ``before`` that are missing in ``after``.

    If ``before`` contains several `AllanSums`, their largest share is returned. The share is 0
    while sums only grow, and 1 if ``after`` has no sums of the same IMU and axes. The missing
    samples are counted from the starts and lengths of the segments, and are at least the decrease
    of the total number of samples. Segments that are too short to be listed in the block means are
    not counted.
    """
    shares = [0.0]
    for old in before:
        matching_sums = [s for s in after if s.axes == old.axes and old.identity.can_be(s.identity)]
        if not matching_sums:
            return 1.0
        shares.append(_lost(old, matching_sums[0]) / max(old.samples, 1))
    return max(shares)


REPLACING = ('relearned', 'noise_increased', 'noise_decreased', 'gyro_unit_changed', 'clock_jumps')
"""Ids of findings that explain why samples were removed from the Allan sums of a stream."""


def replaced_because(before: Sequence[AllanSums], snapshot: Snapshot) -> str:
    """Return a clause that states why samples in the sums ``before`` are missing in a snapshot."""
    present_identity = ImuIdentity(snapshot.frame_id, snapshot.hardware_id)
    former_identity = next((s.identity for s in before), present_identity)
    if not present_identity.can_be(former_identity):
        former_name, present_name = (
            one_line(str(i.hardware_id or i.frame_id)) for i in (former_identity, present_identity)
        )
        return f'messages of "{present_name}" arrive instead of "{former_name}"'
    if not snapshot.sums:
        return 'the Allan sums were reset'
    reasons = [f for f in snapshot.total[1].findings if f.id in REPLACING]
    if reasons:
        message = texts_of(reasons[0]).message.rstrip('.')
        return f'{message[0].lower()}{message[1:]}'
    return 'the IMU moved or had a fault'


def _lost(old: AllanSums, new: AllanSums) -> int:
    """Return how many samples of the old sums are known to be missing in the new sums."""
    new_samples = _samples_by_start(new)
    fewest_listed = min(new_samples.values()) if len(new_samples) >= KEPT_SEGMENTS else 0
    # a segment is listed only if it has enough blocks, and the blocks become longer as sums grow
    fewest_listed = max(fewest_listed, MIN_MEANS * max((m.step for m in new.means), default=0) - 1)
    lost = sum(
        samples - min(samples, new_samples[start])
        for start, samples in _samples_by_start(old).items()
        # short segments may be missing only because they are too short for the list of segments
        if start in new_samples or samples > fewest_listed
    )
    return max(lost, old.samples - new.samples)


def _samples_by_start(sums: AllanSums) -> Counter[int]:
    """Return stamp in ns of the start -> number of samples, for each listed segment."""
    samples: Counter[int] = Counter()
    for segment in sums.means:
        samples[segment.start_ns] += segment.samples
    return samples


def kinds_of(faults: Iterable[Finding]) -> frozenset[tuple[str, tuple[str, ...], int]]:
    """Return the kinds of the findings ``faults`` about the present samples.

    When the kinds change, the Allan sums are published at once. A kind consists of the id, the
    axes, and the ratio of the noise to earlier noise (1 if the finding has no ratio), rounded to a
    power of 2^(1/4).
    """
    ratios = ((f, float(f.values.get('ratio') or 1.0)) for f in faults)
    return frozenset((f.id, f.axes, round(4.0 * math.log2(ratio))) for f, ratio in ratios)


ModelListener = Callable[[Results, Mapping[str, Estimate]], None]
"""Function that receives a noise model, and axis -> bias at rest in SI for each axis with a known
bias. Results without axes mean that the model is invalidated."""


class BiasPublisher:
    """Estimates the bias of each axis at rest, and publishes the biases.

    ``home`` is the prefix of the topic, such as ``~/`` or ``~/<label>/``.
    """

    def __init__(self, node: Node, home: str) -> None:
        self._tracker = BiasTracker()
        self._publisher = node.create_publisher(TwistWithCovarianceStamped, f'{home}bias', LATCHED)
        self._last_ns = 0
        self._turn_on: dict[str, TurnOnBias] = {}

    def update(self, snapshot: Snapshot) -> None:
        """Update biases with the means in a snapshot; publish them if the latest mean is new."""
        for means in snapshot.means:
            for i, axis in enumerate(means.axes):
                self._tracker.add_means(axis, means.end_ns.tolist(), means.values[:, i].tolist())
        biases, latest = self.at_rest(), self._tracker.end_ns
        if biases and latest != self._last_ns:
            self._last_ns = latest
            self._publisher.publish(bias_message(biases, latest, snapshot.frame_id))

    def set_results(self, results: Results | None) -> None:
        """Use the noise models of these results for the biases; None removes the models."""
        axes = results.axes if results is not None else {}
        self._turn_on = {axis: r.turn_on for axis, r in axes.items() if r.turn_on is not None}
        self._tracker.set_models({axis: BiasModel.of_fit(r.fit) for axis, r in axes.items()})

    def values(self, axis: str, unit: str) -> list[tuple[str, object]]:
        """Return (key, value) pairs for the status of an axis; none while the bias is unknown.

        ``unit`` is the SI unit of the bias.
        """
        bias = self._tracker.bias(axis)
        if bias is None:
            return []
        low, high = bias.ci95 or (math.nan, math.nan)
        pairs: list[tuple[str, object]] = [
            (f'bias at rest [{unit}]', bias.value),
            (f'bias 95 % interval [{unit}]', f'{low:.6g} .. {high:.6g}'),
        ]
        if (turn_on := self._turn_on.get(axis)) and turn_on.scatter.value:
            count = turn_on.recordings
            pairs.append(
                (f'bias scatter between {count} recordings [{unit}]', turn_on.scatter.value)
            )
        return pairs

    def at_rest(self) -> dict[str, Estimate]:
        """Return axis -> bias in SI, for each axis whose bias is known."""
        return {axis: b for axis in AXES if (b := self._tracker.bias(axis)) is not None}


def bias_message(
    known: Mapping[str, Estimate], end_ns: int, frame_id: str
) -> TwistWithCovarianceStamped:
    """Return a twist with the gyro bias as angular part and the accelerometer bias as linear part.

    ``known`` is axis -> bias for each axis whose bias is known; other axes have the variance
    `NO_VARIANCE`. Biases are in SI. ``end_ns`` is the end time of the latest data in ns.
    """
    message = TwistWithCovarianceStamped()
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(end_ns, 10**9)
    covariance = [0.0] * 36
    for axis, row in TWIST_ROWS.items():
        bias = known.get(axis)
        covariance[7 * row] = NO_VARIANCE if bias is None else bias.std**2
        if bias is not None:
            sensor, letter = axis.split('_')
            vector = {'gyro': message.twist.twist.angular, 'accel': message.twist.twist.linear}
            setattr(vector[sensor], letter, bias.value)
    message.twist.covariance = covariance
    return message


def bias_of(message: TwistWithCovarianceStamped) -> dict[str, Estimate]:
    """Return axis -> bias in SI from a message of `bias_message`, for each axis with a bias."""
    twist, biases = message.twist.twist, {}
    for axis, row in TWIST_ROWS.items():
        sensor, letter = axis.split('_')
        vector = twist.angular if sensor == 'gyro' else twist.linear
        if (variance := message.twist.covariance[7 * row]) >= 0.0:
            biases[axis] = Estimate.normal(getattr(vector, letter), math.sqrt(variance))
    return biases
