# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drops samples that are not measurements, chooses the stamps, and splits looped recordings.

Duplicates, samples with backward stamps, and repeated or zero-filled values are dropped. Drivers
that publish a slower accelerometer in every gyro message repeat its last sample (sample and hold),
or fill it with zeros. Both change the noise (N of a 250 Hz accelerometer repeated at 400 Hz is 5 %
too high). So each such sensor becomes a separate stream that contains only its measurements.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..findings import Finding, finding
from ..imu import (
    AXES,
    LARGEST,
    NANOSECONDS,
    SENSORS,
    STAMP_UNITS,
    ImuBatch,
    even_stamps,
    joined,
)
from .health import Counts

Floats = NDArray[np.float64]

Stamps = NDArray[np.int64]

BACKWARD_RUN = 16
"""If this number of consecutive samples is stamped earlier than the latest stamp, the clock was set
back. Fewer such samples are dropped."""


REORDER = 32
"""Samples that arrive out of order are sorted if their place is at most this far away."""

DISORDERED_SHARE = 0.25
"""If more than this share of the stamps are earlier than the previous one, although they were
sorted over `REORDER` places, they are not used."""

EPOCH_S = (1e9, 4e9)
"""Present times of a clock, in s: the years 2001 to 2096."""

SLOWEST_S = 0.1
"""Longest sample period, in s, for which the unit of the stamps is recognized."""


def unit_of_stamps(stamps: Stamps) -> str:
    """Return 'us' or 'ms' if stamps, (n,), that should be in ns are times in this unit, else 'ns'.

    >>> import numpy as np
    >>> unit_of_stamps(1_700_000_000_000_000 + 5000 * np.arange(9))
    'us'
    """
    step = np.median(np.abs(np.diff(stamps))) if len(stamps) > 1 else 0
    for unit in ('us', 'ms'):
        second = NANOSECONDS // STAMP_UNITS[unit]
        low, high = (limit * second for limit in EPOCH_S)
        if low <= stamps.min() and stamps.max() < high and 0 < step <= SLOWEST_S * second:
            return unit
    return 'ns'


JUMP_DISTANCE = 4096
"""If the clock was set back this number of samples ago or less, twice as many consecutive earlier
stamps as then are needed to continue. So stamps without order do not split the data endlessly."""


class StampChoice:
    """Chooses the stamps of a stream: from the header, the record times, or the declared rate."""

    def __init__(self, use_record: bool, declared_rate: float) -> None:
        self.use_record = use_record
        self._rate = declared_rate
        self._unit = 1  # of the stamps, in ns
        self._unusable = False  # the stamps are in no order
        # number of samples whose stamps were computed from the rate; None if it is not used
        self._computed: int | None = None

    def learn(self, first: ImuBatch) -> list[Finding]:
        """Choose the stamps from the first samples, and return the findings about the choice."""
        stamps = first.stamps_ns
        if self.use_record:
            return []
        what = 'all equal' if stamps.any() else 'all zero'
        if len(stamps) < 2 or stamps.min() != stamps.max():
            backward = np.diff(StampSorter.all_sorted(stamps, first.samples.T)[0]) < 0
            if np.count_nonzero(backward) <= DISORDERED_SHARE * len(stamps):
                unit = unit_of_stamps(stamps)
                self._unit = STAMP_UNITS[unit]
                return [finding('stamps_unit', unit=unit)] if unit != 'ns' else []
            what, self._unusable = 'in no order', True
        if first.record_ns is not None:
            self.use_record = True
            return [finding('stamps_unusable', what=what)]
        if self._rate:
            self._computed = self._computed or 0
            return [finding('stamps_from_rate', what=what, rate=self._rate)]
        return [finding('stamps_missing', what=what)]

    def of(self, batch: ImuBatch) -> Stamps:
        """Return the chosen stamps of the next batch, (n,), in ns."""
        if self.use_record and batch.record_ns is not None:
            return batch.record_ns
        if self._computed is None:
            stamps = batch.stamps_ns
            if self._unusable:
                return np.zeros_like(stamps)  # `SensorStream` counts them as untimed
            return stamps * self._unit if self._unit > 1 else stamps
        self._computed += len(batch)
        return even_stamps(self._computed - len(batch), len(batch), self._rate)


class StampSorter:
    """Sorts samples that arrive slightly out of order, as over UDP or from several threads.

    Sorting begins at the first backward stamp, so that a stream in order is not delayed. Windows of
    2 * `REORDER` samples that overlap by half are sorted, except where a sample is later than
    `REORDER` sample periods: then the clock was set back, or there are two clocks. ``sorted`` is
    the number of samples that arrived late.
    """

    def __init__(self, stamps: Stamps = np.empty(0, np.int64)) -> None:
        """Learn the sample period from the first stamps, (n,), in ns."""
        self.sorted = 0
        self.sorting = bool((np.diff(stamps) < 0).any())
        places = min(len(stamps) - 1, REORDER)
        ordered = np.sort(stamps)
        # largest delay that is sorted
        self._longest_ns = np.median(ordered[places:] - ordered[:-places]) if places > 0 else 0.0
        self._stamps: Stamps = np.empty(0, np.int64)  # buffered
        self._rows: Floats = np.empty((len(AXES), 0))
        self._latest: int | None = None  # the last stamp that was returned

    def feed(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Add samples: stamps (n,) in ns, values (6, n); return those whose place is known."""
        start = 0
        if not self.sorting and len(stamps):
            latest = stamps[0] if self._latest is None else self._latest
            backward = np.diff(stamps, prepend=latest) < 0
            self.sorting = bool(backward.any())
            start = int(np.argmax(backward)) if self.sorting else len(stamps)
            self._latest = int(stamps[start - 1]) if start else self._latest
            if not self.sorting:
                return stamps, rows
        self._stamps = np.concatenate([self._stamps, stamps[start:]])
        self._rows = np.concatenate([self._rows, rows[:, start:]], axis=1)
        groups = max(0, len(self._stamps) // REORDER - 1)
        out = self._take(groups * REORDER)
        if not start:
            return out
        before = stamps[:start], rows[:, :start]
        return np.concatenate([before[0], out[0]]), np.concatenate([before[1], out[1]], axis=1)

    def flush(self) -> tuple[Stamps, Floats]:
        """Return the buffered samples at the end of the input."""
        return self._take(len(self._stamps))

    @classmethod
    def all_sorted(cls, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Return complete data sorted in the same way."""
        sorter = cls(stamps)
        (s1, r1), (s2, r2) = sorter.feed(stamps, rows), sorter.flush()
        return np.concatenate([s1, s2]), np.concatenate([r1, r2], axis=1)

    def _take(self, number: int) -> tuple[Stamps, Floats]:
        """Return the first buffered samples, sorted."""
        stamps = self._stamps
        for at in range(0, number, REORDER):
            window = stamps[at : at + 2 * REORDER]
            reached = np.maximum.accumulate(window)
            if self._latest is not None:
                reached = np.maximum(reached, self._latest)
            delay = reached - window
            if delay.any() and delay.max() <= self._longest_ns:
                order = at + np.argsort(window, kind='stable')
                self.sorted += int(np.count_nonzero(delay))
                stamps[at : at + len(order)] = stamps[order]
                self._rows[:, at : at + len(order)] = self._rows[:, order]
            self._latest = int(stamps[min(at + REORDER, len(stamps)) - 1])
        out = stamps[:number], self._rows[:, :number]
        self._stamps, self._rows = stamps[number:].copy(), self._rows[:, number:].copy()
        return out


class StampFilter:
    """Drops samples that are not finite, are duplicates, or have a backward stamp.

    A duplicate has the stamp and the values of the previous sample. Each sample has ``axes``
    values. The dropped samples are added to ``counts``.
    """

    def __init__(self, axes: int, counts: Counts) -> None:
        self._counts = counts
        self._latest: int | None = None
        self._latest_row: Floats = np.full(axes, np.nan)
        self._backward = 0  # consecutive samples with earlier stamps
        # how many of these mean that the clock was set back; more if it was set back recently
        self._needed = BACKWARD_RUN
        self._position = self._last_jump = 0  # number of samples

    def feed(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats, NDArray[np.bool_]]:
        """Return stamps (k,), values (axes, k) and flags (k,) of the samples that are kept.

        A flag is True if the clock was set back just before the sample. ``stamps``, (n,), are in
        ns, and ``rows`` are the values, (axes, n).
        """
        if len(stamps) and not (rows.max() <= LARGEST and rows.min() >= -LARGEST):
            finite = (np.abs(rows) <= LARGEST).all(axis=0)
            self._counts.not_finite += int(np.count_nonzero(~finite))
            stamps, rows = stamps[finite], rows[:, finite]
        if not len(stamps):
            return stamps, rows, np.zeros(0, bool)
        latest = stamps[0] - 1 if self._latest is None else self._latest
        step = np.diff(stamps, prepend=latest)
        jumped = np.zeros(len(stamps), bool)
        if step.min() <= 0 or self._backward:
            keep, jumped = self._select(stamps, rows, step)
            stamps, rows, jumped = stamps[keep], rows[:, keep], jumped[keep]
        self._position += len(step)
        if len(stamps):
            self._latest, self._latest_row = int(stamps[-1]), rows[:, -1].copy()
        return stamps, rows, jumped

    def _select(
        self, stamps: Stamps, rows: Floats, step: Stamps
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return masks (n,) of the samples that are kept and that follow a backward clock step."""
        before = np.concatenate([self._latest_row[:, None], rows[:, :-1]], axis=1)
        repeated = (step == 0) & (rows == before).all(axis=0)
        self._counts.duplicate += int(np.count_nonzero(repeated))
        keep = ~repeated
        jumped = np.zeros(len(stamps), bool)
        latest = stamps[0] if self._latest is None else self._latest
        for i in np.flatnonzero(keep):
            if stamps[i] >= latest:
                self._backward = 0
                latest = stamps[i]
                continue
            self._backward += 1
            if self._backward < self._needed:
                keep[i] = False
                self._counts.backward += 1
                continue
            self._backward = 0
            jumped[i] = True
            latest = stamps[i]
            at = self._position + int(i)
            recently = at - self._last_jump < JUMP_DISTANCE
            self._needed = 2 * self._needed if recently else BACKWARD_RUN
            self._last_jump = at
        return keep, jumped


class PassSplitter:
    """Splits a stream where its stamps jump back permanently, as in a looped recording.

    Each part is a pass. Samples stamped before the latest stamp are buffered. If `BACKWARD_RUN` of
    them are consecutive, the first one begins a new pass; if not, `StampFilter` drops them later.
    ``latest_ns`` is the latest stamp in the checkpoint from which the stream continues, if any.
    """

    def __init__(self, latest_ns: int | None = None) -> None:
        self._latest = latest_ns
        self._pending: ImuBatch | None = None

    def split(self, batch: ImuBatch) -> Iterator[tuple[bool, ImuBatch]]:
        """Yield the samples in order, each part with a flag: whether it begins a new pass."""
        if self._pending is not None:
            if self._pending.frame_id == batch.frame_id:
                batch = joined([self._pending, batch])
            else:
                yield False, self._pending
            self._pending = None
        new_pass = False
        while len(batch):
            number, another = self._count_this_pass(batch)
            if number:
                yield new_pass, batch[:number]
            batch = batch[number:]
            if not another:
                self._pending = batch if len(batch) else None
                return
            self._latest, new_pass = None, True

    def flush(self) -> Iterator[tuple[bool, ImuBatch]]:
        """Yield the samples that are still buffered at the end of the input; the flag is False."""
        pending, self._pending = self._pending, None
        if pending is not None:
            yield False, pending

    def _count_this_pass(self, batch: ImuBatch) -> tuple[int, bool]:
        """Return how many samples belong to this pass, and whether a new pass follows them."""
        stamps = batch.stamps_ns
        latest = stamps[0] if self._latest is None else self._latest
        reached = np.maximum.accumulate(np.concatenate([[latest], stamps]))
        ahead = np.flatnonzero(stamps >= reached[:-1])
        # all samples between two samples with later stamps have earlier stamps
        edges = np.concatenate([[-1], ahead, [len(stamps)]])
        long = np.flatnonzero(np.diff(edges) > BACKWARD_RUN)
        if len(long):
            return int(edges[long[0]]) + 1, True
        self._latest = int(reached[-1])
        return int(edges[-2]) + 1, False


REPEATED_SHARE = 0.1
"""Smallest share of repeated or zero samples that indicates a sample-and-hold or zero-filled
sensor."""

LEAST_REPEATS, CHANCE_SHARE = 5, 0.15
"""Smallest number of separate runs of repeated samples, among the first samples, that indicates a
driver that repeats samples, and the largest share of them that may be equal by chance."""

REGULAR_REPEATS, LARGEST_RANDOM_SHARE = 0.03, 0.6
"""If the share of repeats is below the first value, they are regarded as random, because they are
too few to decide. Above the second, they are regarded as those of a slower sensor."""

REGULAR_VARIANCE, REGULAR_VARIANCE_RATIO = 0.5, 0.01
"""Repeats are regular if the variance of their cumulative number about a straight line is less than
this, or less than this fraction of the variance of a binomial count. Less than 0.1 % of random
repeats have a variance below the fraction."""

TOGETHER_LOG_RATIO = 2.0 / 3.0
"""Axes repeat (or are zero) together if log(p) / sum(log(p_i)) is smaller than this, where p is the
share of samples in which all axes repeat and p_i that of axis i. For three axes, the ratio is 1 if
they repeat independently (coarse resolution), and 1/3 if they always repeat together."""


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


class SampleHoldFilter:
    """Selects the axes of a sensor stream, and drops its repeated or zero-filled samples."""

    def __init__(self, plan: SensorPlan) -> None:
        self._drop = plan.drop
        self._rows = [AXES.index(axis) for axis in plan.axes]
        self._all = self._rows == list(range(len(AXES)))
        self._last: Floats = np.full(len(self._rows), np.nan)

    def select(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Return stamps (k,) and values (axes, k) of the samples that are kept.

        ``stamps``, (n,), and ``rows``, (6, n), are the next samples of the six-axis stream.
        """
        rows = rows if self._all else rows[self._rows]
        if not self._drop or not len(stamps):
            return stamps, rows
        if self._drop == 'zero':
            keep = rows.any(axis=0)
        else:
            before = np.concatenate([self._last[:, None], rows[:, :-1]], axis=1)
            keep = (rows != before).any(axis=0)
            self._last = rows[:, -1].copy()
        return stamps[keep], rows[:, keep]


MIN_CLIPPED = 0.05
"""Smallest share of samples that are equal to the maximum or minimum and indicate clipping."""

CLIPPED_RATIO, CLIPPED_VALUES = 3, 8
"""Clipping requires that the maximum (or minimum) occurs this many times as often as the next
value, and that the axis has at least this number of different values. (At a coarse resolution, most
samples of an unclipped axis have one of two values.)"""


def clipped_share(samples: Floats) -> float:
    """Return the share of samples, (n,), that are clipped at their maximum or minimum.

    A share below `MIN_CLIPPED` is returned as 0.

    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(size=1000)
    >>> clipped_share(noise), round(clipped_share(np.minimum(noise, 1.0)), 2)
    (0.0, 0.15)
    """
    values, counts = np.unique(samples[np.abs(samples) <= LARGEST], return_counts=True)
    if len(values) < CLIPPED_VALUES:
        return 0.0
    ends = ((values[0], counts[0], counts[1]), (values[-1], counts[-1], counts[-2]))
    clipped = [count for value, count, near in ends if value and count >= CLIPPED_RATIO * near]
    share = float(max(clipped, default=0) / counts.sum())
    return share if share >= MIN_CLIPPED else 0.0


ALTERNATE_SIGMAS, ALTERNATE_AXES = 8.0, 2
"""The samples alternate if the means of even and odd ones differ by this number of standard
deviations on this number of axes."""

SWITCH_SHARE, SEPARATION = 0.25, 8.0
"""The samples of an axis are those of two IMUs if the largest gap between their values, in standard
deviations on either side, is at least the second value, and if at least the first value of the
steps cross it."""


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
        difference = np.abs(rows[:, ::2].sum(axis=1) - rows[:, 1::2].sum(axis=1))
        sigma = np.sqrt(0.5 * n * np.mean((rows[:, 2:] - rows[:, :-2]) ** 2, axis=1))
        if np.count_nonzero(difference > ALTERNATE_SIGMAS * sigma) >= ALTERNATE_AXES:
            return True
        for values in rows:
            ordered = np.sort(values)
            middle = n // 4 + int(np.argmax(np.diff(ordered[n // 4 : 3 * n // 4]))) + 1
            low, high = ordered[:middle], ordered[middle:]
            switches = np.count_nonzero(np.diff(values >= high[0]))
            apart = high[0] - low[-1] > SEPARATION * max(low.std(), high.std()) > 0.0
            if apart and switches > SWITCH_SHARE * n:
                return True
    return False


def plan_sensors(
    stamps: Stamps, rows: Floats
) -> tuple[tuple[SensorPlan, ...], tuple[Finding, ...]]:
    """Decide from the first samples whether gyro and accelerometer need separate streams.

    Returns a plan for each stream, and the findings about the sensors. ``stamps``, (n,), are in ns.
    ``rows``, (6, n), are NaN where a sensor is absent.
    """
    # without duplicate messages, which are dropped later
    duplicate = (np.diff(stamps) == 0) & (rows[:, 1:] == rows[:, :-1]).all(axis=0)
    rows = rows[:, np.concatenate([[True], ~duplicate])] if len(stamps) else rows
    repeats = rows[:, 1:] == rows[:, :-1]
    plans: list[SensorPlan] = []
    findings: list[Finding] = []
    for sensor, place in SENSORS.items():
        present = np.arange(place.start, place.stop)
        present = present[(np.abs(rows[place]) <= LARGEST).any(axis=1)]
        if not len(present):
            findings.append(finding('sensor_absent', AXES[place], sensor=sensor))
            continue
        axes = tuple(AXES[i] for i in present)
        lacking = tuple(axis for axis in AXES[place] if axis not in axes)
        if lacking:
            findings.append(finding('axis_absent', lacking, count=rows.shape[1]))
        zeros = rows[present] == 0.0
        plan = SensorPlan(axes)
        if zeros.all():
            findings.append(finding('sensor_all_zero', axes, sensor=sensor))
            continue
        if _coincide(zeros):
            plan = SensorPlan(axes, 'zero')
            share = float(zeros.all(axis=0).mean())
            findings.append(finding('zero_filled', axes, sensor=sensor, share=share))
        elif _are_repeated(rows[present]):
            flags = repeats[present].all(axis=0)
            if _are_regular(flags):
                plan = SensorPlan(axes, 'repeated')
                findings.append(finding('held', axes, sensor=sensor, share=float(flags.mean())))
            else:
                plan = SensorPlan(axes, random_repeats=(axes,))
        for axis, samples in zip(axes, rows[present]):
            if share := clipped_share(samples):
                findings.append(finding('clipped', (axis,), share=share))
        plans.append(plan)
    kept = [AXES.index(axis) for plan in plans if not plan.drop for axis in plan.axes]
    possible = (np.abs(rows[kept]) <= LARGEST).all(axis=0)
    if kept and are_interleaved(rows[kept][:, possible]):
        findings.append(finding('interleaved', tuple(AXES[i] for i in kept)))
    random = [plan for plan in plans if plan.random_repeats]
    if random:
        flags = np.array([_all_repeat(plan, repeats) for plan in random])
        axes = tuple(axis for plan in random for axis in plan.axes)
        findings.append(finding('repeated', axes, share=float(flags.any(axis=0).mean())))
    if len(plans) == len(SENSORS):
        both = plans[0].axes + plans[1].axes
        groups = plans[0].random_repeats + plans[1].random_repeats
        if not any(plan.drop for plan in plans):
            together = len(groups) == len(SENSORS) and _repeat_together(plans, repeats)
            plans = [SensorPlan(both, random_repeats=(both,) if together else groups)]
        elif {plan.drop for plan in plans} == {'repeated'} and _repeat_together(plans, repeats):
            plans = [SensorPlan(both, 'repeated')]
    return tuple(plans), tuple(findings)


def _all_repeat(plan: SensorPlan, repeats: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(repeats[[AXES.index(axis) for axis in plan.axes]].all(axis=0))


def _repeat_together(plans: list[SensorPlan], repeats: NDArray[np.bool_]) -> bool:
    """Return whether both sensors repeat their samples in the same messages."""
    gyro, accel = (_all_repeat(plan, repeats) for plan in plans)
    most = min(REPEATED_SHARE, 0.5 * float(gyro.mean()), 0.5 * float(accel.mean()))
    return bool((gyro != accel).mean() < most)


def _are_repeated(values: Floats) -> bool:
    """Return whether samples, (axes, n), repeat the previous one more often than by chance.

    If all equal samples are in one part of the data, they are no repeats: it has a lower noise.
    Chance is estimated from the shares of single axes, as if these were independent, and from the
    share of changed samples that equal the one before the previous one.
    """
    flags = values[:, 1:] == values[:, :-1]
    both = flags.all(axis=0)
    share = float(both.mean()) if both.size else 0.0
    runs = np.count_nonzero(both[1:] & ~both[:-1])
    if runs < LEAST_REPEATS or _line_variance(both) > share * (1.0 - share) * len(both):
        return False
    if _coincide(flags):
        return True
    # If a share r of the samples is repeated and axis i is equal by chance with probability q, its
    # share of equal samples is r + (1 - r) q. All axes are equal by chance in (1 - r) prod(q).
    least = (1.0 - CHANCE_SHARE) * share
    by_chance = (1.0 - least) * np.prod((flags.mean(axis=1) - least) / (1.0 - least))
    equal_second = (values[:, 2:] == values[:, :-2]).all(axis=0)[~both[1:]].mean()
    return bool(max(by_chance, equal_second) <= CHANCE_SHARE * share)


def _are_regular(repeats: NDArray[np.bool_]) -> bool:
    """Return whether the flagged repeats, (n,), are those of a sensor with a lower, constant rate.

    The repeats of such a sensor follow each other evenly. If a driver repeats samples at random
    instead, new samples have the rate of the messages, and the repeats replace lost samples.
    """
    share = float(repeats.mean())
    if not REGULAR_REPEATS <= share <= LARGEST_RANDOM_SHARE:
        return share > LARGEST_RANDOM_SHARE
    binomial = len(repeats) * share * (1.0 - share)
    return _line_variance(repeats) < max(REGULAR_VARIANCE, REGULAR_VARIANCE_RATIO * binomial)


def _line_variance(flags: NDArray[np.bool_]) -> float:
    """Return the variance of the cumulative number of flags about a straight line.

    For n independent flags of share p, it is n p (1 - p) times Watson's U^2, whose mean is 1/12
    (G. S. Watson, Biometrika 48, 1961).
    """
    return float(np.var(np.cumsum(flags - flags.mean())))


def _coincide(flags: NDArray[np.bool_]) -> bool:
    """Return whether the flags of the axes, (axes, n), coincide more often than by chance.

    Returns False if all flags are set: then the values are constant, which is a different fault.
    """
    joint = float(flags.all(axis=0).mean()) if flags.size else 0.0
    if not REPEATED_SHARE < joint < 1.0:
        return False
    return bool(np.log(joint) > TOGETHER_LOG_RATIO * np.log(flags.mean(axis=1)).sum())
