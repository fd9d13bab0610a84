# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decides which axes form a stream, and excludes or interpolates samples that were not measured.

Repeated samples
----------------
Drivers that publish a slower accelerometer in every gyro message repeat its last sample (sample and
hold), or fill it with zeros. Both change the noise (N of a 250 Hz accelerometer repeated at 400 Hz
is 5 % too high). So each such sensor becomes a separate stream that contains only its measurements.
Samples that a driver repeats at random, because the sensor had no new data, are interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..findings import Finding, finding
from ..imu import AXES, LARGEST, SENSORS, Flags, Floats, ImuBatch

REPEATED_SHARE = 0.1
"""Smallest share of repeated or zero samples that indicates a sample-and-hold or zero-filled
sensor."""

LEAST_REPEATS, CHANCE_SHARE = 5, 0.15
"""Smallest number of separate runs of repeated samples, among the first samples, that indicates a
driver that repeats samples, and the largest share of them that may be equal by chance."""

REGULAR_REPEATS, LARGEST_RANDOM_SHARE = 0.03, 0.6
"""If the share of repeats is below the first value, they are regarded as random, because they are
too few to decide. Above the second, they are attributed to a slower sensor."""

REGULAR_VARIANCE, REGULAR_VARIANCE_RATIO = 0.5, 0.01
"""Repeats are regular if the variance of their cumulative number about a straight line is less than
this, or less than this fraction of the variance of a binomial count. Less than 0.1 % of random
repeats have a variance below the fraction."""

TOGETHER_LOG_RATIO = 2.0 / 3.0
"""Axes repeat (or are zero) together if log(p) / sum(log(p_i)) is smaller than this, where p is the
share of samples in which all axes repeat and p_i the share in which axis i repeats. For three axes,
the ratio is 1 if they repeat independently (coarse resolution), and 1/3 if they always repeat
together."""


@dataclass(frozen=True)
class SensorPlan:
    """The axes of a sensor stream, and which of its samples to drop.

    ``drop`` is '' for none, 'repeated' for samples that repeat the previous one on all axes, or
    'zero' for samples that are zero on all axes. ``random_repeats`` are groups of axes. A sample
    that repeats the previous one on all axes of a group is interpolated on these axes.
    """

    axes: tuple[str, ...]
    drop: Literal['', 'repeated', 'zero'] = ''
    random_repeats: tuple[tuple[str, ...], ...] = ()


MIN_CLIPPED = 0.05
"""Smallest share of samples that are equal to the maximum or minimum and indicate clipping."""

CLIPPED_RATIO, CLIPPED_VALUES = 3, 8
"""Clipping requires that the maximum (or minimum) occurs this many times as often as the next
value, and that the axis has at least this number of different values. (At a coarse resolution, most
samples of an unclipped axis have one of two values.)"""


ROUNDING_ERROR = 1e-9
"""Values that differ by less than this share of their range are equal, as differences of a counter
that were computed with rounding errors."""


def clipped_share(samples: Floats) -> float:
    """Return the share of samples, (n,), that are clipped at their maximum or minimum.

    A share below `MIN_CLIPPED` is returned as 0.

    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(size=1000)
    >>> clipped_share(noise), round(clipped_share(np.minimum(noise, 1.0)), 2)
    (0.0, 0.15)
    """
    samples = samples[np.abs(samples) <= LARGEST]
    error = ROUNDING_ERROR * np.ptp(samples) if len(samples) else 0.0
    values, counts = np.unique(np.round(samples / (error or 1.0)), return_counts=True)
    if len(values) < CLIPPED_VALUES:
        return 0.0
    ends = ((values[0], counts[0], counts[1]), (values[-1], counts[-1], counts[-2]))
    clipped = [count for value, count, near in ends if value and count >= CLIPPED_RATIO * near]
    share = float(max(clipped, default=0) / counts.sum())
    return share if share >= MIN_CLIPPED else 0.0


def extreme_shares(rows: Floats) -> Floats:
    """Return the share of the samples of each axis, (axes, n), at their extreme values, (axes,).

    It is the share at the maximum or the share at the minimum, whichever is larger.
    """
    ends = (rows.max(axis=1), rows.min(axis=1))
    counts = [np.count_nonzero(rows == end[:, None], axis=1) for end in ends]
    return np.asarray(np.maximum(*counts) / rows.shape[1])


def clipped_shares(rows: Floats) -> Floats:
    """Return the share of the samples of each axis, (axes, n), that are clipped, (axes,).

    A share below `MIN_CLIPPED` is returned as 0.
    """
    shares = np.zeros(len(rows))
    for axis in np.flatnonzero(extreme_shares(rows) >= MIN_CLIPPED):
        shares[axis] = clipped_share(rows[axis])
    return shares


CLIPPED_CHUNK = 1024
"""Number of samples in which `Clipping` looks for clipped values."""


class Clipping:
    """Counts the clipped samples of each axis, in chunks of `CLIPPED_CHUNK` samples.

    ``samples`` is the number of samples that were examined.

    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(size=(2, 10_000))
    >>> noise[1] = np.minimum(noise[1], 1.0)
    >>> clipping = Clipping(2)
    >>> clipping.add(noise)
    >>> [round(float(share), 2) for share in clipping.shares]
    [0.0, 0.16]
    """

    def __init__(self, axes: int) -> None:
        self._chunk = np.empty((axes, CLIPPED_CHUNK))
        self._filled = 0  # number of samples in the chunk
        self._clipped = np.zeros(axes)
        self.samples = 0

    def add(self, rows: Floats) -> None:
        """Add samples, (axes, n)."""
        while rows.shape[1]:
            room = CLIPPED_CHUNK - self._filled
            part, rows = rows[:, :room], rows[:, room:]
            self._chunk[:, self._filled : self._filled + part.shape[1]] = part
            self._filled += part.shape[1]
            if self._filled == CLIPPED_CHUNK:
                self._examine()

    def _examine(self) -> None:
        """Count the clipped samples of the complete chunk, and begin another one."""
        self._filled = 0
        self.samples += CLIPPED_CHUNK
        self._clipped += CLIPPED_CHUNK * clipped_shares(self._chunk)

    @property
    def shares(self) -> Floats:
        """Share of the samples of each axis that are clipped, (axes,)."""
        return np.asarray(self._clipped / max(self.samples, 1))


ALTERNATE_SIGMAS, ALTERNATE_AXES = 8.0, 2
"""The samples alternate if the means of even and odd ones differ by this number of standard
deviations on this number of axes, and by more than `SEPARATION_STEPS` steps of the resolution: a
counter with carry alternates between adjacent counts."""

SWITCH_SHARE, SEPARATION, SEPARATION_STEPS = 0.25, 8.0, 1.5
"""The samples of an axis come from two IMUs if the largest gap between their values is at least the
second value, in standard deviations on either side, and the third, in steps of the resolution (1
between neighboring levels of rounded noise), and if at least the first value of the differences
cross it."""


def are_interleaved(rows: Floats) -> bool:
    """Return whether samples, (axes, n), seem to come from two IMUs with different biases.

    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(size=(6, 1000))
    >>> are_interleaved(noise), are_interleaved(noise + np.arange(1000) % 2)
    (False, True)
    """
    n = rows.shape[1] // 2 * 2
    if n < 4 * LEAST_REPEATS:
        return False
    with np.errstate(invalid='ignore', divide='ignore'):
        rows = rows[:, :n] - rows[:, :n].mean(axis=1, keepdims=True)
        rows = np.round(rows / (ROUNDING_ERROR * np.ptp(rows, axis=1, keepdims=True)))
        difference = np.abs(rows[:, ::2].sum(axis=1) - rows[:, 1::2].sum(axis=1))
        sigma = np.sqrt(0.5 * n * np.mean((rows[:, 2:] - rows[:, :-2]) ** 2, axis=1))
        levels = np.diff(np.sort(rows))
        steps = np.where(levels > 0.0, levels, np.inf).min(axis=1)
        least = np.maximum(ALTERNATE_SIGMAS * sigma, 0.5 * n * SEPARATION_STEPS * steps)
        if np.count_nonzero(difference > least) >= ALTERNATE_AXES:
            return True
        for values in rows:
            ordered = np.sort(values)
            middle = n // 4 + int(np.argmax(np.diff(ordered[n // 4 : 3 * n // 4]))) + 1
            low, high = ordered[:middle], ordered[middle:]
            switches = np.count_nonzero(np.diff(values >= high[0]))
            gap, levels = high[0] - low[-1], np.diff(ordered)
            step = levels[levels > 0.0].min(initial=gap)
            apart = gap > SEPARATION * max(low.std(), high.std()) > 0.0
            if apart and gap > SEPARATION_STEPS * step and switches > SWITCH_SHARE * n:
                return True
    return False


def plan_sensors(first: ImuBatch, only: str = '') -> tuple[list[SensorPlan], list[Finding]]:
    """Decide from the first samples, at least one, whether the sensors need separate streams.

    Returns a plan for each stream, and the findings about the sensors. The six axes are NaN where a
    sensor is absent. ``only`` is the sensor to use; '' for both.
    """
    # without duplicate messages, which are excluded later
    rows = first.rows
    duplicate = (np.diff(first.stamps_ns) == 0) & (rows[:, 1:] == rows[:, :-1]).all(axis=0)
    rows = rows[:, np.concatenate([[True], ~duplicate])]
    repeats = rows[:, 1:] == rows[:, :-1]
    findings: list[Finding] = []
    used = [sensor for sensor in SENSORS if only in ('', sensor)]
    plans = [p for sensor in used if (p := _plan_sensor(sensor, rows, repeats, findings))]
    random = [plan for plan in plans if plan.random_repeats]
    if random:
        flags = np.array([_all_repeat(plan, repeats) for plan in random])
        axes = tuple(axis for plan in random for axis in plan.axes)
        findings.append(finding('repeated', axes, share=float(flags.any(axis=0).mean())))
    if len(plans) == len(SENSORS) and len({plan.drop for plan in plans}) == 1:
        both, drop = plans[0].axes + plans[1].axes, plans[0].drop
        together = (drop or len(random) == len(SENSORS)) and _repeat_together(plans, repeats)
        groups = (both,) if together else plans[0].random_repeats + plans[1].random_repeats
        if not drop:
            plans = [SensorPlan(both, random_repeats=groups)]
        elif drop == 'repeated' and together:
            plans = [SensorPlan(both, drop)]
    return plans, findings


def zeros_and_repeats(sensor: str, axes: tuple[str, ...], rows: Floats) -> list[Finding]:
    """Return a finding if samples of a sensor, (axes, n), are zero or repeat the one before.

    They are all zero, or some are zero or repeated on all axes.
    """
    zeros = rows == 0.0
    if zeros.all():
        return [finding('sensor_all_zero', axes, sensor=sensor)]
    if _coincide(zeros):
        share = float(zeros.all(axis=0).mean())
        return [finding('zero_filled', axes, sensor=sensor, share=share)]
    if _are_repeated(rows):
        share = float((rows[:, 1:] == rows[:, :-1]).all(axis=0).mean())
        return [finding('held', axes, sensor=sensor, share=share)]
    return []


def _plan_sensor(
    sensor: str, rows: Floats, repeats: Flags, findings: list[Finding]
) -> SensorPlan | None:
    """Return the plan of one sensor, None if it is absent; append to the findings."""
    place = SENSORS[sensor]
    present = np.arange(place.start, place.stop)
    present = present[(np.abs(rows[place]) <= LARGEST).any(axis=1)]
    if not len(present):
        findings.append(finding('sensor_absent', AXES[place], sensor=sensor))
        return None
    axes = tuple(AXES[i] for i in present)
    if lacking := tuple(axis for axis in AXES[place] if axis not in axes):
        findings.append(finding('axis_absent', lacking, count=rows.shape[1]))
    zeros = rows[present] == 0.0
    if zeros.all():
        findings.append(finding('sensor_all_zero', axes, sensor=sensor))
        return None
    plan = SensorPlan(axes)
    if _coincide(zeros):
        plan = SensorPlan(axes, 'zero')
        share = float(zeros.all(axis=0).mean())
        findings.append(finding('zero_filled', axes, sensor=sensor, share=share))
    elif _are_repeated(rows[present]):
        flags = _all_repeat(plan, repeats)
        if _are_regular(flags):
            plan = SensorPlan(axes, 'repeated')
            findings.append(finding('held', axes, sensor=sensor, share=float(flags.mean())))
        else:
            plan = SensorPlan(axes, random_repeats=(axes,))
    for axis, samples in zip(axes, rows[present]):
        if share := clipped_share(samples):
            findings.append(finding('clipped', (axis,), share=share))
    return plan


def _all_repeat(plan: SensorPlan, repeats: Flags) -> Flags:
    return np.asarray(repeats[[AXES.index(axis) for axis in plan.axes]].all(axis=0))


def _repeat_together(plans: list[SensorPlan], repeats: Flags) -> bool:
    """Return whether both sensors repeat their samples in the same messages."""
    gyro, accel = (_all_repeat(plan, repeats) for plan in plans)
    most = min(REPEATED_SHARE, 0.5 * float(gyro.mean()), 0.5 * float(accel.mean()))
    return bool((gyro != accel).mean() < most)


def _are_repeated(values: Floats) -> bool:
    """Return whether samples, (axes, n), repeat the previous one more often than by chance.

    If all equal samples are in one part of the data, they are no repeats: it has a lower noise.
    Chance is estimated from the share of changed samples that equal the one before the previous.
    """
    flags = values[:, 1:] == values[:, :-1]
    both = flags.all(axis=0)
    share = float(both.mean()) if both.size else 0.0
    runs = np.count_nonzero(both[1:] & ~both[:-1])
    if runs < LEAST_REPEATS or _line_variance(both) > share * (1.0 - share) * len(both):
        return False
    if _coincide(flags):
        return True
    equal_second = (values[:, 2:] == values[:, :-2]).all(axis=0)[~both[1:]].mean()
    return bool(equal_second <= CHANCE_SHARE * share)


def _are_regular(repeats: Flags) -> bool:
    """Return whether the flagged repeats, (n,), come from a sensor with a lower, constant rate.

    The repeats of such a sensor follow each other evenly. If a driver repeats samples at random
    instead, new samples have the rate of the messages, and the repeats replace lost samples.
    """
    share = float(repeats.mean())
    if not REGULAR_REPEATS <= share <= LARGEST_RANDOM_SHARE:
        return share > LARGEST_RANDOM_SHARE
    binomial = len(repeats) * share * (1.0 - share)
    return _line_variance(repeats) < max(REGULAR_VARIANCE, REGULAR_VARIANCE_RATIO * binomial)


def _line_variance(flags: Flags) -> float:
    """Return the variance of the cumulative number of flags about a straight line.

    For n independent flags of share p, it is n p (1 - p) times Watson's U^2, whose mean is 1/12
    (G. S. Watson, Biometrika 48, 1961).
    """
    return float(np.var(np.cumsum(flags - flags.mean())))


def _coincide(flags: Flags) -> bool:
    """Return whether the flags of the axes, (axes, n), coincide more often than by chance.

    Returns False if all flags are set: then the values are constant, which is a different fault.
    """
    joint = float(flags.all(axis=0).mean()) if flags.size else 0.0
    if not REPEATED_SHARE < joint < 1.0:
        return False
    return bool(np.log(joint) > TOGETHER_LOG_RATIO * np.log(flags.mean(axis=1)).sum())
