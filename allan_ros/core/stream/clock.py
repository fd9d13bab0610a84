# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Learns the sample period of a stream, and how regular its stamps are, from its first stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .health import RATE_CHANGE

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]

LEARN = 1024
"""Number of samples from which the period of a stream is learned."""

CLOCK_BLOCK = 256
"""Number of samples that are processed together."""

LOOK_AHEAD = 64
"""Number of samples before and after a pause whose delays are compared, for regular stamps."""

BURST_LOOK_AHEAD_S, BURST_LOOK_AHEAD = 4.0, 4096
"""The same for bursty stamps, as a time in s, and the largest number of samples used."""

BURST_PAUSE_S = 0.25
"""Shortest pause and smallest increase of the delay, in s, that can be a loss if stamps are bursty.
In that case the smallest delay varies by several samples without a loss."""

LATE = 1.5
"""If stamps are regular, a step longer than this many periods is a pause."""

REGULAR_SHARE = 0.6
"""Stamps are regular if this share of the steps lies within 50 % of the median step, and if the
mean of these steps is at least this share of the mean of all steps."""

POLLED_SHARE = 0.95
"""Polled samples are evenly spaced on average if this share of the steps between their stamps is
between 0.4 and 2.2 mean steps."""

MANY, EXACT = 0.2, 0.15
"""Samples are missing regularly if at least the first share of the steps is one sample period and
the same share is longer, with deviations of at most the second fraction of a period."""

JITTER_SHARE = 0.01
"""Stamps have jitter if more than this share of the steps is shorter than half the period."""

PERIOD_RANGE, PERIOD_TRACKING = 0.05, 0.003
"""Relative range of `rayleigh_period`: when the period is learned, and when it is updated."""

PHASE_GAP = 16.0
"""Longest pause, in periods, after which the phase of the samples is assumed to continue."""

PHASE_STEP = 0.25
"""Phase difference between two tried periods, in cycles over all stamps."""


@dataclass(frozen=True)
class Clock:
    """Sample period of a stream, and median step between its stamps.

    If the stamps are ``bursty``, many samples have almost the same stamp. If they have ``jitter``,
    the loss of a single sample may not be detected.
    """

    period_ns: float
    step_ns: float
    bursty: bool
    jitter: bool = False
    base_ns: float = 0.0  # if samples are missing regularly: step without a missing one

    @property
    def look_ahead(self) -> int:
        """Number of samples before and after a pause whose delays are compared."""
        if not self.bursty:
            return LOOK_AHEAD
        wanted = BURST_LOOK_AHEAD_S * 1e9 / self.period_ns
        return int(min(max(wanted, LOOK_AHEAD), BURST_LOOK_AHEAD))

    @property
    def pause_ns(self) -> float:
        """Step between two stamps, in ns, above which samples may have been lost."""
        late = LATE * self.period_ns
        return max(late, BURST_PAUSE_S * 1e9) if self.bursty else late

    @property
    def smallest_loss(self) -> float:
        """Increase of the smallest delay after a pause, in periods, that indicates lost samples."""
        return max(0.5, BURST_PAUSE_S * 1e9 / self.period_ns) if self.bursty else 0.5


def learn_clock(stamps: Stamps, polled: bool = False, declared: float = 0.0) -> Clock | None:
    """Estimate the sample period of a stream from its first stamps, (n,), in ns.

    Backward stamps are ignored. If ``polled`` is set, the stamps are those of the messages in which
    a slower sensor had a new sample. The steps between them are multiples of the period of the
    messages, and only their mean is the sample period. If samples are missing regularly, the period
    is the mean step, unless the smallest step is that of the ``declared`` rate in Hz. Returns None
    if all stamps are equal.
    """
    step = np.diff(stamps[stamps >= np.maximum.accumulate(stamps)]).astype(float)
    if not step.any():
        return None
    clock = _clock_of(step, stamps, polled)
    base = 0.0 if polled else _common_step(step)
    if not base or abs(base / clock.period_ns - 1.0) < RATE_CHANGE:
        return clock
    if abs(declared * base * 1e-9 - 1.0) < RATE_CHANGE:
        return Clock(base, 1.5 * base, bursty=False)
    return replace(clock, base_ns=base)


def _common_step(step: Floats) -> float:
    """Return the shortest step, (n,), if all are multiples of it and many are longer, else 0."""
    shortest = float(np.sort(step)[int(MANY * len(step))])
    near = step[np.abs(step - shortest) <= EXACT * shortest]
    base = float(near.mean())
    number = np.rint(step / base) if base else step
    exact = (np.abs(step - number * base) <= EXACT * base) & (number > 0)
    many = min(np.mean(number == 1), np.mean(number > 1)) >= MANY if base else False
    return base if many and exact.mean() >= POLLED_SHARE else 0.0


def _clock_of(step: Floats, stamps: Stamps, polled: bool) -> Clock:
    """Estimate the sample period from the ``step`` between the stamps in ns, (n - 1,)."""
    size = max(1, min(CLOCK_BLOCK, len(step) // 4))
    # one long gap does not change the median of block means
    mean = float(np.median(step[: len(step) // size * size].reshape(-1, size).mean(axis=1)))
    mean = mean or float(step.mean())
    median = float(np.median(step))
    near = step[np.abs(step - median) <= 0.5 * median]
    if polled and len(near) < POLLED_SHARE * len(step):
        polls = np.count_nonzero((step > 0.4 * mean) & (step < 2.2 * mean))
        if polls >= POLLED_SHARE * len(step):
            return Clock(mean, mean, bursty=False)
    if median > 0.0 and len(near) >= REGULAR_SHARE * len(step):
        period = float(near.mean())
        if period >= REGULAR_SHARE * mean:
            # jitter makes steps longer and shorter, lost samples only longer
            long_steps = np.count_nonzero(step > LATE * period)
            short_steps = np.count_nonzero(step < period / 2)
            if short_steps > JITTER_SHARE * len(step):
                period = rayleigh_period(stamps, period, PERIOD_RANGE)
                return Clock(period, median, bursty=False, jitter=True)
            return Clock(mean if 2 * short_steps >= long_steps else period, median, bursty=False)
    return Clock(mean, median, bursty=True)


def rayleigh_period(stamps: Stamps, period: float, relative_range: float) -> float:
    """Return the sample period in ns, near ``period``, that fits stamps with jitter best.

    It maximizes the Rayleigh statistic of the phases of the stamps t, |sum exp(2 pi i t / p)|, over
    periods p that differ from ``period`` by at most the fraction ``relative_range`` (K. V. Mardia,
    P. E. Jupp, Directional Statistics, 2000, section 6.3). Lost samples do not move the maximum.
    """
    step = np.diff(stamps) / period
    t = np.cumsum(np.where(step > PHASE_GAP, 1.0, step))
    t -= t[len(t) // 2]
    resolution = PHASE_STEP / max(float(t[-1] - t[0]), 1.0)
    steps = int(relative_range / resolution)
    rate = 1.0 + resolution * np.arange(-steps, steps + 1)
    statistic = np.array([abs(np.exp(2j * np.pi * r * t).sum()) for r in rate])
    return float(period / rate[np.argmax(statistic)])
