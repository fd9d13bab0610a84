# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which axes tick together: one lane of six axes, or one a sensor where their rates differ.

Drivers that put a slower accelerometer into every gyro message repeat its last sample, or fill the
missing half with zeros. Both would be read as noise that is not there (a 250 Hz accelerometer held
on 400 Hz stamps reads N half again too high), so such a sensor gets a lane of its own with only its
own samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .batch import AXES, SENSORS
from .findings import Finding, finding

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

SHARE = 0.1
"""Least share of repeated or zero samples that makes a sensor held or zero-filled."""

HELD_LOG_RATIO = 2.0 / 3.0
"""Three axes that repeat together much more often than by chance are held: by chance the logarithm
of the joint share is the sum of the three logarithms; held together it is a third of that."""

Sieve = Literal['all', 'held', 'zero']


@dataclass(frozen=True)
class LanePlan:
    """The axes of a lane, and which samples of the stream are none of its own."""

    axes: tuple[str, ...]
    sieve: Sieve = 'all'


class LaneSieve:
    """Picks the samples of one lane out of the six-axis stream."""

    def __init__(self, plan: LanePlan) -> None:
        self.plan = plan
        self._rows = [AXES.index(axis) for axis in plan.axes]
        self._whole = self._rows == list(range(len(AXES)))
        self._last: Floats = np.full(len(self._rows), np.nan)

    def pick(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Return stamps (k,) and rows (axes of the lane, k) of its samples; rows is (6, n)."""
        own = rows if self._whole else rows[self._rows]
        if self.plan.sieve == 'all' or not len(stamps):
            return stamps, own
        if self.plan.sieve == 'zero':
            keep = own.any(axis=0)
        else:
            before = np.concatenate([self._last[:, None], own[:, :-1]], axis=1)
            keep = (own != before).any(axis=0)
            self._last = own[:, -1].copy()
        return stamps[keep], own[:, keep]


def plan_lanes(rows: Floats) -> tuple[tuple[LanePlan, ...], tuple[Finding, ...]]:
    """Return the lanes of a stream from its first samples, and what there is to say of them.

    rows : (6, n) array; NaN where a sensor is absent.
    """
    plans: list[LanePlan] = []
    findings: list[Finding] = []
    for sensor, place in SENSORS.items():
        axes = AXES[place]
        own = rows[place]
        if not np.isfinite(own).any():
            findings.append(finding('sensor_absent', axes, sensor=sensor))
            continue
        zero = ~own.any(axis=0)
        if zero.all():
            findings.append(finding('sensor_all_zero', axes, sensor=sensor))
            continue
        repeats = own[:, 1:] == own[:, :-1]
        together = float(repeats.all(axis=0).mean()) if repeats.size else 0.0
        if zero.mean() > SHARE:
            plans.append(LanePlan(axes, 'zero'))
            findings.append(finding('zero_filled', axes, sensor=sensor, share=zero.mean()))
        elif together > SHARE and _held(repeats, together):
            plans.append(LanePlan(axes, 'held'))
            findings.append(finding('held', axes, sensor=sensor, share=together))
        else:
            plans.append(LanePlan(axes))
    if len(plans) == len(SENSORS) and all(p.sieve == 'all' for p in plans):
        plans = [LanePlan(AXES)]
    return tuple(plans), tuple(findings)


def _held(repeats: NDArray[np.bool_], together: float) -> bool:
    """Return whether three axes repeat together more often than by chance."""
    if together == 1.0:
        return False  # constant values are a fault of another kind
    alone = repeats.mean(axis=1)
    return bool(np.log(together) > HELD_LOG_RATIO * np.log(alone).sum())
