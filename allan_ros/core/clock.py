# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the stamps of a stream are like: its sample period, and whether single steps mean anything.

The samples of an IMU are even; their stamps are not. Some jitter, some come in bursts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]

LEARN = 1024
"""Samples from which the period of a stream is learned."""

BLOCK = 256
"""Samples that are judged together."""

LOOK_AHEAD = 64
"""Samples looked back and ahead at a silence when stamps are regular."""

BURST_LOOK_AHEAD_S, BURST_LOOK_AHEAD = 4.0, 4096
"""The same when they are bursty, in s and at most in samples: a burst needs time to catch up."""

BURST_SILENCE_S = 0.25
"""When stamps are bursty only a silence of this length is looked at, and only a shift of this
length is a loss: the envelope itself wanders by several samples."""

LATE = 1.5
"""When stamps are regular, a step above this many periods is a silence."""

REGULAR_SHARE = 0.6
"""Stamps are regular when this share of the steps lies within 50 % of the median step, and their
mean is at least this share of the mean of all steps."""


@dataclass(frozen=True)
class Clock:
    """What was learned of a stream's stamps.

    ``period_ns`` is the working sample period, ``step_ns`` the median step between two stamps;
    ``bursty`` says that single steps mean nothing.
    """

    period_ns: float
    step_ns: float
    bursty: bool

    @property
    def look_ahead(self) -> int:
        """Samples looked back and ahead at a silence."""
        if not self.bursty:
            return LOOK_AHEAD
        wanted = BURST_LOOK_AHEAD_S * 1e9 / self.period_ns
        return int(min(max(wanted, LOOK_AHEAD), BURST_LOOK_AHEAD))

    @property
    def silence_ns(self) -> float:
        """A longer step between two stamps is a silence."""
        late = LATE * self.period_ns
        return max(late, BURST_SILENCE_S * 1e9) if self.bursty else late

    @property
    def least_loss(self) -> float:
        """Least shift of the envelope, in samples, that is a loss."""
        return max(0.5, BURST_SILENCE_S * 1e9 / self.period_ns) if self.bursty else 0.5


def learn_clock(stamps: Stamps) -> Clock | None:
    """Return period and kind of the stamps, or None when no two of them differ.

    stamps : (n,) int64 array in ns, as they came; backward ones are ignored.
    """
    if not len(stamps):
        return None
    step = np.diff(stamps[stamps >= np.maximum.accumulate(stamps)]).astype(float)
    if not step.any():
        return None
    size = max(1, min(BLOCK, len(step) // 4))
    # the median of block means is a mean that one long gap does not spoil
    mean = float(np.median(step[: len(step) // size * size].reshape(-1, size).mean(axis=1)))
    mean = mean or float(step.mean())
    middle = float(np.median(step))
    near = step[np.abs(step - middle) <= 0.5 * middle]
    if middle > 0.0 and len(near) >= REGULAR_SHARE * len(step):
        period = float(near.mean())
        if period >= REGULAR_SHARE * mean:
            # jitter makes long steps and short ones, lost samples only long ones
            long_steps = np.count_nonzero(step > LATE * period)
            jitter = 2 * np.count_nonzero(step < period / 2) >= long_steps
            return Clock(mean if jitter else period, middle, bursty=False)
    return Clock(mean, middle, bursty=True)
