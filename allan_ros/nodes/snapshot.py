# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Snapshot of the sums of one IMU, passed from accumulation to estimation as a value or JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.allan.sums import KEPT_SEGMENTS, AllanSums
from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.imu import AXES
from ..core.stream.sensor_stream import Means
from ..io.documents import sums_file_from_document, sums_file_to_document
from ..io.files import parse_json
from ..io.recorded import Provenance

Total = tuple[tuple[AllanSums, ...], Provenance]
"""Sums of an IMU over all runs of the node, and their provenance."""

REPLACED_SHARE = 0.1
"""Sums that lost more than this share of their samples make coefficients invalid. Less is normal:
the last windows before a motion are at rest until the motion is recognized."""


@dataclass(frozen=True)
class Snapshot:
    """The sums at one time, and the IMU that is connected.

    Attributes
    ----------
    total : (sums, provenance)
    frame_id, hardware_id : str
        Of the latest messages; the sums may be of another frame.
    axes : tuple of str
        Axes that messages had values for, also before there are sums.
    means : tuple of Means
        The latest means of static samples over a second, one value for each sensor.
    """

    total: Total
    frame_id: str = ''
    hardware_id: str = ''
    axes: tuple[str, ...] = ()
    means: tuple[Means, ...] = ()

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """One with all axes, or one per sensor where the sensors have different rates."""
        return self.total[0]

    def to_document(self) -> dict[str, Any]:
        """Return the document of ``~/sums``: a sums file with the connected IMU added."""
        imu = {'frame_id': self.frame_id, 'hardware_id': self.hardware_id, 'axes': [*self.axes]}
        means = [
            {
                'axes': list(one.axes),
                'end_ns': one.end_ns.tolist(),
                'values': [[float(f'{value:.9g}') for value in row] for row in one.values],
            }
            for one in self.means
        ]
        return {**sums_file_to_document(*self.total), 'imu': imu, 'means': means}

    @classmethod
    def from_json(cls, text: str) -> Snapshot:
        """Return the snapshot of a message on ``~/sums``.

        Raises
        ------
        AllanError
            Naming what is wrong in the document.
        """
        document = parse_json(text, 'sums')
        total = sums_file_from_document(document, 'sums')
        imu = Fields(document, 'sums').optional_fields('imu')
        if imu is None:
            return cls(total)
        axes = imu.sequence('axes')
        return cls(
            total,
            imu.text('frame_id', ''),
            imu.text('hardware_id', ''),
            tuple(axis for axis in AXES if axis in axes),
            _means(document.get('means', []) if isinstance(document, dict) else []),
        )


def _means(documents: Any) -> tuple[Means, ...]:
    """Return the means of a document.

    Raises
    ------
    AllanError
        When they are not rows of as many finite numbers as there are axes.
    """
    try:
        means = tuple(
            Means(
                tuple(str(axis) for axis in one['axes']),
                np.array(one['end_ns'], np.int64),
                np.array(one['values'], float).reshape(len(one['end_ns']), len(one['axes'])),
            )
            for one in documents
        )
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        raise AllanError(f'sums: its means cannot be read ({error!r})') from error
    if not all(np.isfinite(one.values).all() for one in means):
        raise AllanError('sums: its means are not finite numbers')
    return means


def replaced_share(before: Sequence[AllanSums], after: Sequence[AllanSums]) -> float:
    """Return the largest share of the samples in ``before`` that ``after`` does not hold.

    Sums only grow, unless they are discarded, reset or start again from zero. Growing sums keep
    the start of each segment; of more than 32 segments the longest are listed.
    """
    shares = [0.0]
    for old in before:
        same = [s for s in after if (s.identity, s.axes) == (old.identity, old.axes)]
        if not same:
            return 1.0
        shares.append(_lost(old, same[0]) / max(old.samples, 1))
    return max(shares)


def _lost(old: AllanSums, new: AllanSums) -> int:
    """Return how many samples of the old sums the new ones lack, as far as segments are listed."""
    held = _samples_by_start(new)
    shortest = min(held.values()) if len(new.segments) >= KEPT_SEGMENTS else 0
    lost = sum(
        samples - min(samples, held[start])
        for start, samples in _samples_by_start(old).items()
        if start in held or samples > shortest
    )
    return max(lost, old.samples - new.samples)


def _samples_by_start(sums: AllanSums) -> Counter[int]:
    """Return the samples of the listed segments by their first stamp."""
    found: Counter[int] = Counter()
    for segment in sums.segments:
        found[segment.start_ns] += segment.samples
    return found
