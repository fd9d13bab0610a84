# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sample period of a stream, from its stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]

LEARN = 1024
"""Number of samples from which the period of a stream is learned."""

CLOCK_BLOCK = 256
"""Number of samples that are processed together."""

LOOK_AHEAD = 64
"""Samples before and after a silence that are considered if stamps are regular."""

BURST_LOOK_AHEAD_S, BURST_LOOK_AHEAD = 4.0, 4096
"""The same for bursty stamps, in s and at most in samples, because a burst follows later."""

BURST_SILENCE_S = 0.25
"""Shortest silence and smallest shift, in s, that can be a loss if stamps are bursty, because the
envelope itself varies by several samples."""

LATE = 1.5
"""If stamps are regular, a step above this many periods is a silence."""

REGULAR_SHARE = 0.6
"""Stamps are regular if this share of the steps lies within 50 % of the median step, and if the
mean of these steps is at least this share of the mean of all steps."""

JITTER_SHARE = 0.01
"""Stamps have jitter if more than this fraction of the steps is below half the period."""

LATTICE_RANGE, LATTICE_TRACKING = 0.05, 0.003
"""Ranges of the search for the period, as fractions of it: for the first search, and for later
ones."""

LATTICE_GAP = 16.0
"""Longest silence, in periods, after which the phase of the samples is assumed to continue."""

LATTICE_STEP = 0.25
"""Phase difference, in cycles over all stamps, between two tried periods."""


@dataclass(frozen=True)
class Clock:
    """Working period and median step of the stamps of a stream.

    ``bursty`` stamps come in bursts, so single steps contain no information. With ``jitter``, some
    single losses are not detected.
    """

    period_ns: float
    step_ns: float
    bursty: bool
    jitter: bool = False

    @property
    def look_ahead(self) -> int:
        """Number of samples before and after a silence that are considered."""
        if not self.bursty:
            return LOOK_AHEAD
        wanted = BURST_LOOK_AHEAD_S * 1e9 / self.period_ns
        return int(min(max(wanted, LOOK_AHEAD), BURST_LOOK_AHEAD))

    @property
    def silence_ns(self) -> float:
        """Smallest step between two stamps that is a silence, in ns."""
        late = LATE * self.period_ns
        return max(late, BURST_SILENCE_S * 1e9) if self.bursty else late

    @property
    def least_loss(self) -> float:
        """Smallest shift of the envelope, in samples, that is a loss."""
        return max(0.5, BURST_SILENCE_S * 1e9 / self.period_ns) if self.bursty else 0.5


def learn_clock(stamps: Stamps) -> Clock | None:
    """Return the clock of stamps in ns, (n,), or None if no two of them differ.

    The stamps are in the order received; backward stamps are ignored.
    """
    if not len(stamps):
        return None
    step = np.diff(stamps[stamps >= np.maximum.accumulate(stamps)]).astype(float)
    if not step.any():
        return None
    size = max(1, min(CLOCK_BLOCK, len(step) // 4))
    # one long gap does not change the median of block means
    mean = float(np.median(step[: len(step) // size * size].reshape(-1, size).mean(axis=1)))
    mean = mean or float(step.mean())
    middle = float(np.median(step))
    near = step[np.abs(step - middle) <= 0.5 * middle]
    if middle > 0.0 and len(near) >= REGULAR_SHARE * len(step):
        period = float(near.mean())
        if period >= REGULAR_SHARE * mean:
            # jitter makes steps longer and shorter, lost samples only longer
            long_steps = np.count_nonzero(step > LATE * period)
            short_steps = np.count_nonzero(step < period / 2)
            if short_steps > JITTER_SHARE * len(step):
                period = lattice_period(stamps, period, LATTICE_RANGE)
                return Clock(period, middle, bursty=False, jitter=True)
            return Clock(mean if 2 * short_steps >= long_steps else period, middle, bursty=False)
    return Clock(mean, middle, bursty=True)


def lattice_period(stamps: Stamps, period: float, reach: float) -> float:
    """Return the period, within a fraction ``reach`` of ``period``, whose multiples fit best.

    It maximises |sum exp(2 pi i t / p)| over p, the Rayleigh statistic of the phases of the stamps
    (K. V. Mardia, P. E. Jupp, Directional Statistics, 2000, section 6.3). Lost samples do not
    change its maximum, and jitter only lowers it.
    """
    step = np.diff(stamps) / period
    t = np.cumsum(np.where(step > LATTICE_GAP, 1.0, step))
    t -= t[len(t) // 2]
    resolution = LATTICE_STEP / max(float(t[-1] - t[0]), 1.0)
    rate = 1.0 + resolution * np.arange(-int(reach / resolution), int(reach / resolution) + 1)
    contrast = np.array([abs(np.exp(2j * np.pi * r * t).sum()) for r in rate])
    return float(period / rate[np.argmax(contrast)])
