# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decides which axes form a stream; finds repeated, zero, clipped and interleaved samples.

Repeated samples
----------------
Drivers that publish a slower accelerometer in every gyro message repeat the last sample of the
accelerometer (sample-and-hold), or fill in zeros. Both change the noise (N of a 250 Hz
accelerometer repeated at 400 Hz is 5 % too high). The repeats and zeros are excluded, and such a
sensor gets a separate stream, unless both sensors repeat their samples together.
Samples that a driver repeats at random, because the sensor had no new data, are interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..findings import Finding, finding
from ..imu import AXES, LARGEST, SENSORS, Flags, Floats, ImuBatch

REPEATED_SHARE = 0.1
"""Share of samples above which zeros or repeats that coincide on all axes (`TOGETHER_LOG_RATIO`)
indicate that a driver fills in zeros, or repeats samples. Fewer repeats, and repeats that do not
coincide, are compared with chance (`CHANCE_SHARE`)."""

LEAST_REPEATS, CHANCE_SHARE = 5, 0.15
"""A driver is assumed to repeat samples only if the first samples contain at least `LEAST_REPEATS`
separate sequences of repeats. In addition, the repeats of the axes must coincide
(`TOGETHER_LOG_RATIO`), or the share of samples that are equal by chance must be at most
`CHANCE_SHARE` times the share of repeats."""

REGULAR_REPEATS, LARGEST_RANDOM_SHARE = 0.03, 0.6
"""If the share of repeats among all samples is below `REGULAR_REPEATS`, the repeats are regarded as
random, because there are too few to decide. If the share is above `LARGEST_RANDOM_SHARE`, the
repeats are attributed to a slower sensor."""

REGULAR_VARIANCE, REGULAR_VARIANCE_RATIO = 0.5, 0.01
"""Repeats are regular if the variance of their cumulative number about a straight line is less than
`REGULAR_VARIANCE`, or less than `REGULAR_VARIANCE_RATIO` times the variance of a binomial count.
Random repeats satisfy the second condition with a probability below 0.1 %."""

TOGETHER_LOG_RATIO = 2.0 / 3.0
"""Axes repeat (or are zero) together if log(p) / sum(log(p_i)) is smaller than this value. Here, p
is the share of samples in which all axes repeat, and p_i the share in which axis i repeats. For
three axes, the ratio is 1 if they repeat independently, as with a coarse resolution, and 1/3 if
they always repeat together."""


@dataclass(frozen=True)
class SensorPlan:
    """The axes of a sensor stream, and which of its samples are excluded or interpolated.

    ``drop`` is 'repeated' for samples that repeat the previous sample on all axes, 'zero' for
    samples that are zero on all axes, or '' for no samples. ``random_repeats`` are groups of axes.
    A sample that repeats the previous sample on all axes of a group is interpolated on these axes
    (for exceptions, see `RepeatFilter`).
    """

    axes: tuple[str, ...]
    drop: Literal['', 'repeated', 'zero'] = ''
    random_repeats: tuple[tuple[str, ...], ...] = ()


MIN_CLIPPED = 0.05
"""Smallest share of samples at the maximum or at the minimum that indicates clipping."""

CLIPPED_RATIO, CLIPPED_VALUES = 3, 8
"""An axis is clipped if its maximum (or minimum) is not 0, has a share of at least `MIN_CLIPPED`,
and occurs at least `CLIPPED_RATIO` times as often as the next value, and if the axis has at least
`CLIPPED_VALUES` different values. At a coarse resolution, most samples of an axis that is not
clipped have one of two values."""


ROUNDING_ERROR = 1e-9
"""Values that differ by less than this fraction of the range of all values are regarded as equal.
They differ because the driver rounds its results."""


def clipped_share(samples: Floats) -> float:
    """Return the share of samples, (n,), that are clipped at their maximum or minimum.

    `CLIPPED_RATIO` defines when a maximum or minimum is clipped. The larger of the two shares is
    returned, or 0 if it is below `MIN_CLIPPED`. NaN and values of a magnitude above `LARGEST` are
    ignored.

    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(size=1000)
    >>> clipped_share(noise), round(clipped_share(np.minimum(noise, 1.0)), 2)
    (0.0, 0.15)
    """
    samples = samples[np.abs(samples) <= LARGEST]
    resolution = ROUNDING_ERROR * np.ptp(samples) if len(samples) else 0.0
    values, counts = np.unique(np.round(samples / (resolution or 1.0)), return_counts=True)
    if len(values) < CLIPPED_VALUES:
        return 0.0
    extremes = ((values[0], counts[0], counts[1]), (values[-1], counts[-1], counts[-2]))
    clipped_counts = [
        count
        for value, count, next_count in extremes
        if value and count >= CLIPPED_RATIO * next_count
    ]
    share = float(max(clipped_counts, default=0) / counts.sum())
    return share if share >= MIN_CLIPPED else 0.0


def _are_extreme(rows: Floats) -> tuple[Flags, Flags]:
    """Return which samples equal the maximum, and which equal the minimum, of their row.

    ``rows`` and both results are (..., n).
    """
    return rows == rows.max(axis=-1, keepdims=True), rows == rows.min(axis=-1, keepdims=True)


def extreme_shares(rows: Floats) -> Floats:
    """Return the share of the samples of each row that equal its maximum or its minimum.

    The larger of both shares is returned. ``rows`` is (..., n), and the result is (...).
    """
    counts = [np.count_nonzero(flags, axis=-1) for flags in _are_extreme(rows)]
    return np.asarray(np.maximum(*counts) / rows.shape[-1])


def clipped_shares(rows: Floats) -> Floats:
    """Return which share of the samples of each row is clipped.

    ``rows`` is (..., n), and the result is (...). A row contains samples of one axis. The share is
    computed by `clipped_share`, but it is 0 if the samples that equal the maximum or the minimum
    exactly have a share below `MIN_CLIPPED`.
    """
    shares = np.zeros(rows.shape[:-1])
    # the common case: all rows together have too few samples at either extreme for one clipped row
    least = MIN_CLIPPED * rows.shape[-1]
    if all(np.count_nonzero(flags) < least for flags in _are_extreme(rows)):
        return shares
    for row in zip(*np.nonzero(extreme_shares(rows) >= MIN_CLIPPED)):
        shares[row] = clipped_share(rows[row])
    return shares


CLIPPED_CHUNK = 1024
"""Number of consecutive samples among which `Clipping` searches for clipped values at a time."""


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
        self._open = np.empty((axes, 0))  # samples of the incomplete chunk
        self._clipped = np.zeros(axes)
        self.samples = 0

    def add(self, rows: Floats) -> None:
        """Add samples, (axes, n)."""
        rows = np.concatenate([self._open, rows], axis=1)
        end = rows.shape[1] // CLIPPED_CHUNK * CLIPPED_CHUNK
        if end:
            chunks = rows[:, :end].reshape(len(rows), -1, CLIPPED_CHUNK)
            self._clipped += CLIPPED_CHUNK * clipped_shares(chunks).sum(axis=1)
            self.samples += end
            rows = rows[:, end:].copy()
        self._open = rows

    @property
    def shares(self) -> Floats:
        """Share of the examined samples of each axis that are clipped, (axes,)."""
        return np.asarray(self._clipped / max(self.samples, 1))


ALTERNATE_SIGMAS, ALTERNATE_AXES = 8.0, 2
"""The samples alternate between two IMUs if the means of the even and of the odd samples differ by
more than `ALTERNATE_SIGMAS` standard deviations of the difference, and by more than
`SEPARATION_STEPS` steps of the resolution, on at least `ALTERNATE_AXES` axes. A single IMU may
alternate by one step, because some sensors carry the remainder of a rounded value over to the next
value."""

SWITCH_SHARE, SEPARATION, SEPARATION_STEPS = 0.25, 8.0, 1.5
"""The samples of an axis come from two IMUs if a wide gap divides the values into a low and a high
group. The gap must be wider than `SEPARATION` standard deviations of each group, and wider than
`SEPARATION_STEPS` steps of the resolution. More than the share `SWITCH_SHARE` of the differences
between successive samples must cross the gap."""


def are_interleaved(rows: Floats) -> bool:
    """Return whether samples, (axes, n), seem to come from two IMUs with different biases.

    The result is False for fewer than 20 samples.

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
        differences = np.abs(rows[:, ::2].sum(axis=1) - rows[:, 1::2].sum(axis=1))
        sigma = np.sqrt(0.5 * n * np.mean((rows[:, 2:] - rows[:, :-2]) ** 2, axis=1))
        level_gaps = np.diff(np.sort(rows))
        resolutions = np.where(level_gaps > 0.0, level_gaps, np.inf).min(axis=1)
        limits = np.maximum(ALTERNATE_SIGMAS * sigma, 0.5 * n * SEPARATION_STEPS * resolutions)
        if np.count_nonzero(differences > limits) >= ALTERNATE_AXES:
            return True
        for values in rows:
            ordered = np.sort(values)
            middle = n // 4 + int(np.argmax(np.diff(ordered[n // 4 : 3 * n // 4]))) + 1
            low, high = ordered[:middle], ordered[middle:]
            switches = np.count_nonzero(np.diff(values >= high[0]))
            gap, level_gaps = high[0] - low[-1], np.diff(ordered)
            resolution = level_gaps[level_gaps > 0.0].min(initial=gap)
            is_apart = gap > SEPARATION * max(low.std(), high.std()) > 0.0
            if is_apart and gap > SEPARATION_STEPS * resolution and switches > SWITCH_SHARE * n:
                return True
    return False


def plan_sensors(first: ImuBatch, only: str = '') -> tuple[list[SensorPlan], list[Finding]]:
    """Decide from the first samples, at least one, whether the sensors need separate streams.

    Returns a plan for each stream, and the findings about the sensors. ``first`` has six axes, with
    NaN for an absent sensor. ``only`` is the sensor to use; '' for both.
    """
    # duplicate messages do not count as repeats, because `SampleFilter` excludes them
    rows = first.rows
    is_duplicate = (np.diff(first.stamps_ns) == 0) & (rows[:, 1:] == rows[:, :-1]).all(axis=0)
    rows = rows[:, np.concatenate([[True], ~is_duplicate])]
    repeats = rows[:, 1:] == rows[:, :-1]
    findings: list[Finding] = []
    sensors = [sensor for sensor in SENSORS if only in ('', sensor)]
    plans = [p for sensor in sensors if (p := _plan_sensor(sensor, rows, repeats, findings))]
    random_plans = [plan for plan in plans if plan.random_repeats]
    if random_plans:
        random_repeats = np.array([_all_repeat(plan, repeats) for plan in random_plans])
        axes = tuple(axis for plan in random_plans for axis in plan.axes)
        findings.append(finding('repeated', axes, share=float(random_repeats.any(axis=0).mean())))
    if len(plans) == len(SENSORS) and len({plan.drop for plan in plans}) == 1:
        all_axes, drop = plans[0].axes + plans[1].axes, plans[0].drop
        repeat_together = (drop or len(random_plans) == len(SENSORS)) and _repeat_together(
            plans, repeats
        )
        groups = (
            (all_axes,) if repeat_together else plans[0].random_repeats + plans[1].random_repeats
        )
        if not drop:
            plans = [SensorPlan(all_axes, random_repeats=groups)]
        elif drop == 'repeated' and repeat_together:
            plans = [SensorPlan(all_axes, drop)]
    return plans, findings


def zeros_and_repeats(sensor: str, axes: tuple[str, ...], rows: Floats) -> list[Finding]:
    """Return a list with a finding if many samples of a sensor, (axes, n), are zero or repeated.

    The finding states that all values are zero, or the share of the samples that are zero on all
    axes, or the share of the samples that repeat the previous sample on all axes.
    """
    is_zero = rows == 0.0
    if is_zero.all():
        return [finding('sensor_all_zero', axes, sensor=sensor)]
    if _coincide(is_zero):
        share = float(is_zero.all(axis=0).mean())
        return [finding('zero_filled', axes, sensor=sensor, share=share)]
    if _are_repeated(rows):
        share = float((rows[:, 1:] == rows[:, :-1]).all(axis=0).mean())
        return [finding('held', axes, sensor=sensor, share=share)]
    return []


def _plan_sensor(
    sensor: str, rows: Floats, repeats: Flags, findings: list[Finding]
) -> SensorPlan | None:
    """Return the plan of one sensor; None if the sensor is absent, or all its samples are zero.

    ``rows``, (6, n), are the samples, and ``repeats``, (6, n - 1), flags the values that equal the
    previous value of the axis. Findings about the sensor are appended to ``findings``.
    """
    sensor_slice = SENSORS[sensor]
    axis_indices = np.arange(sensor_slice.start, sensor_slice.stop)
    axis_indices = axis_indices[(np.abs(rows[sensor_slice]) <= LARGEST).any(axis=1)]
    if not len(axis_indices):
        findings.append(finding('sensor_absent', AXES[sensor_slice], sensor=sensor))
        return None
    axes = tuple(AXES[i] for i in axis_indices)
    if missing_axes := tuple(axis for axis in AXES[sensor_slice] if axis not in axes):
        findings.append(finding('axis_absent', missing_axes, count=rows.shape[1]))
    is_zero = rows[axis_indices] == 0.0
    if is_zero.all():
        findings.append(finding('sensor_all_zero', axes, sensor=sensor))
        return None
    plan = SensorPlan(axes)
    if _coincide(is_zero):
        plan = SensorPlan(axes, 'zero')
        share = float(is_zero.all(axis=0).mean())
        findings.append(finding('zero_filled', axes, sensor=sensor, share=share))
    elif _are_repeated(rows[axis_indices]):
        is_repeat = _all_repeat(plan, repeats)
        if _are_regular(is_repeat):
            plan = SensorPlan(axes, 'repeated')
            findings.append(finding('held', axes, sensor=sensor, share=float(is_repeat.mean())))
        else:
            plan = SensorPlan(axes, random_repeats=(axes,))
    for axis, samples in zip(axes, rows[axis_indices]):
        if share := clipped_share(samples):
            findings.append(finding('clipped', (axis,), share=share))
    return plan


def _all_repeat(plan: SensorPlan, repeats: Flags) -> Flags:
    return np.asarray(repeats[[AXES.index(axis) for axis in plan.axes]].all(axis=0))


def _repeat_together(plans: list[SensorPlan], repeats: Flags) -> bool:
    """Return whether both sensors repeat their samples in the same messages."""
    gyro_repeats, accel_repeats = (_all_repeat(plan, repeats) for plan in plans)
    largest_share = min(
        REPEATED_SHARE, 0.5 * float(gyro_repeats.mean()), 0.5 * float(accel_repeats.mean())
    )
    return bool((gyro_repeats != accel_repeats).mean() < largest_share)


def _are_repeated(values: Floats) -> bool:
    """Return whether samples, (axes, n), repeat the previous sample more often than by chance.

    If all equal samples are in one part of the data, the noise of this part is smaller, and the
    samples are not repeats. The number of samples that are equal by chance is estimated from the
    samples that differ from the previous sample, but equal the sample before the previous sample.
    """
    repeats_value = values[:, 1:] == values[:, :-1]
    is_repeat = repeats_value.all(axis=0)
    share = float(is_repeat.mean()) if is_repeat.size else 0.0
    sequences = np.count_nonzero(is_repeat[1:] & ~is_repeat[:-1])
    if sequences < LEAST_REPEATS or _line_variance(is_repeat) > share * (1.0 - share) * len(
        is_repeat
    ):
        return False
    if _coincide(repeats_value):
        return True
    chance_share = (values[:, 2:] == values[:, :-2]).all(axis=0)[~is_repeat[1:]].mean()
    return bool(chance_share <= CHANCE_SHARE * share)


def _are_regular(repeats: Flags) -> bool:
    """Return whether the flagged repeats, (n,), come from a sensor with a lower, constant rate.

    The repeats of such a sensor follow each other evenly. If a driver repeats samples at random,
    the sensor has the rate of the messages, and the repeats replace lost samples.
    """
    share = float(repeats.mean())
    if not REGULAR_REPEATS <= share <= LARGEST_RANDOM_SHARE:
        return share > LARGEST_RANDOM_SHARE
    binomial = len(repeats) * share * (1.0 - share)
    return _line_variance(repeats) < max(REGULAR_VARIANCE, REGULAR_VARIANCE_RATIO * binomial)


def _line_variance(flags: Flags) -> float:
    """Return the variance of the cumulative number of flags about a straight line.

    If each of n flags is set independently with probability p, this variance is n p (1 - p) times
    Watson's U^2, whose mean is 1/12 (G. S. Watson, Biometrika 48, 1961).
    """
    return float(np.var(np.cumsum(flags - flags.mean())))


def _coincide(flags: Flags) -> bool:
    """Return whether the flags of the axes, (axes, n), coincide more often than by chance.

    Returns False if all flags are set, because constant values are a different fault, and if the
    flags of all axes coincide in at most the share `REPEATED_SHARE` of the samples.
    """
    joint_share = float(flags.all(axis=0).mean()) if flags.size else 0.0
    if not REPEATED_SHARE < joint_share < 1.0:
        return False
    return bool(np.log(joint_share) > TOGETHER_LOG_RATIO * np.log(flags.mean(axis=1)).sum())
