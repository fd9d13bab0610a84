# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Removes samples that are not measurements: duplicates, backward stamps, repeated and zero-filled
samples.

Drivers that put a slower accelerometer into every gyro message repeat its last sample, or fill the
missing half with zeros. Both change the noise (a 250 Hz accelerometer repeated at 400 Hz shows N
5 % too high), so such a sensor gets its own sensor stream, which contains only its new samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..findings import Finding, finding
from ..imu import AXES, LARGEST, SENSORS, ImuBatch, even_stamps, joined
from .health import Counts

Floats = NDArray[np.float64]

Stamps = NDArray[np.int64]

BACKWARD_RUN = 16
"""Number of consecutive stamps before the latest one that means that the clock was set back. Fewer
such stamps are dropped."""


class StampChoice:
    """Chooses the stamps of a stream: from the header, the record times, or the declared rate."""

    def __init__(self, use_record: bool, declared_rate: float) -> None:
        self.use_record = use_record
        self._rate = declared_rate
        # samples whose stamps are computed from that rate, if it is used
        self._placed: int | None = None

    def learn(self, first: ImuBatch) -> list[Finding]:
        """Choose the stamps from the first samples of the stream, and return the findings about
        them."""
        stamps = first.stamps_ns
        if self.use_record or len(stamps) < 2 or stamps.min() != stamps.max():
            return []
        what = 'all equal' if stamps.any() else 'all zero'
        if first.record_ns is not None:
            self.use_record = True
            return [finding('stamps_unusable', what=what)]
        if self._rate:
            self._placed = self._placed or 0
            return [finding('stamps_from_rate', what=what, rate=self._rate)]
        return [finding('stamps_missing', what=what)]

    def of(self, batch: ImuBatch) -> Stamps:
        """Return the stamps of the next samples, (n,), in ns."""
        if self.use_record and batch.record_ns is not None:
            return batch.record_ns
        if self._placed is None:
            return batch.stamps_ns
        self._placed += len(batch)
        return even_stamps(self._placed - len(batch), len(batch), self._rate)


class WarmUp:
    """Leaves out the samples of the first seconds of a stream; ``skipped`` counts them."""

    def __init__(self, seconds: float) -> None:
        self.skipped = 0
        self._length_ns = round(seconds * 1e9)
        self._end_ns: int | None = None
        self._over = not self._length_ns

    def take(self, stamps: Stamps) -> int:
        """Return how many of the next samples, at least one, belong to the warm-up."""
        if self._over:  # a later backward clock step skips no further samples
            return 0
        if self._end_ns is None:
            self._end_ns = int(stamps[0]) + self._length_ns
        late = stamps >= self._end_ns
        self._over = bool(late.any())
        count = int(np.argmax(late)) if self._over else len(stamps)
        self.skipped += count
        return count


class StampFilter:
    """Drops samples that are not finite, repeat the previous one, or go back in time."""

    def __init__(self, axes: int, counts: Counts) -> None:
        self._counts = counts
        self._latest: int | None = None
        self._latest_row: Floats = np.full(axes, np.nan)
        self._backward = 0

    def feed(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats, NDArray[np.bool_]]:
        """Take stamps, (n,), and rows, (axes, n); return stamps, rows and flags of the k samples
        kept.

        The third array, (k,), flags backward clock steps.
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
        if len(stamps):
            self._latest, self._latest_row = int(stamps[-1]), rows[:, -1].copy()
        return stamps, rows, jumped

    def _select(
        self, stamps: Stamps, rows: Floats, step: Stamps
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which samples are kept, and which follow a backward clock step."""
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
            if self._backward < BACKWARD_RUN:
                keep[i] = False
                self._counts.backward += 1
            else:
                self._backward = 0
                jumped[i] = True
                latest = stamps[i]
        return keep, jumped


class PassSplitter:
    """Splits a stream where its stamps jump back permanently, as in a looped recording.

    Single backward stamps are left to `StampFilter`. So samples with earlier stamps are buffered
    until `BACKWARD_RUN` of them follow each other (the first of them begins a new pass), or a
    sample with a later stamp follows. ``latest_ns`` is the latest stamp in existing sums (of a
    checkpoint).
    """

    def __init__(self, latest_ns: int | None = None) -> None:
        self._latest = latest_ns
        self._waiting: ImuBatch | None = None

    def split(self, batch: ImuBatch) -> Iterator[tuple[bool, ImuBatch]]:
        """Yield (begins a new pass, samples) in order; together these are the complete stream."""
        if self._waiting is not None:
            if self._waiting.frame_id == batch.frame_id:
                batch = joined([self._waiting, batch])
            else:
                yield False, self._waiting
            self._waiting = None
        new_pass = False
        while len(batch):
            number, another = self._this_pass(batch)
            if number:
                yield new_pass, batch[:number]
            batch = batch[number:]
            if not another:
                self._waiting = batch if len(batch) else None
                return
            self._latest, new_pass = None, True

    def flush(self) -> Iterator[tuple[bool, ImuBatch]]:
        """Yield the buffered samples at the end of the input."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            yield False, waiting

    def _this_pass(self, batch: ImuBatch) -> tuple[int, bool]:
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


SHARE = 0.1
"""Smallest share of repeated or zero samples that indicates a sample-and-hold or zero-filled
sensor."""

TOGETHER_LOG_RATIO = 2.0 / 3.0
"""If coarse values of a sensor at rest repeat, or are zero, by chance, the logarithm of the share
of all three axes is the sum of their logarithms. If the axes are repeated or filled together, it is
a third of the sum. The threshold lies between the two."""

OwnSamples = Literal['all', 'held', 'zero']


@dataclass(frozen=True)
class SensorPlan:
    """The axes of a sensor stream, and the rule that selects its samples from the messages.

    ``own`` is 'all', 'held' to drop samples that repeat the previous one, or 'zero' to drop
    samples that are zero.
    """

    axes: tuple[str, ...]
    own: OwnSamples = 'all'


class SampleHoldFilter:
    """Selects the samples of one sensor stream from the six-axis stream."""

    def __init__(self, plan: SensorPlan) -> None:
        self.plan = plan
        self._rows = [AXES.index(axis) for axis in plan.axes]
        self._whole = self._rows == list(range(len(AXES)))
        self._last: Floats = np.full(len(self._rows), np.nan)

    def pick(self, stamps: Stamps, rows: Floats) -> tuple[Stamps, Floats]:
        """Return stamps (k,) and rows (own axes, k) of its samples; rows is (6, n)."""
        own = rows if self._whole else rows[self._rows]
        if self.plan.own == 'all' or not len(stamps):
            return stamps, own
        if self.plan.own == 'zero':
            keep = own.any(axis=0)
        else:
            before = np.concatenate([self._last[:, None], own[:, :-1]], axis=1)
            keep = (own != before).any(axis=0)
            self._last = own[:, -1].copy()
        return stamps[keep], own[:, keep]


LEAST_CLIPPED = 0.05
"""Smallest share of equal samples at one end of an axis that indicates clipping."""

CLIPPED_RATIO, CLIPPED_VALUES = 3, 8
"""Clipping also requires that these samples are more than those of the next value by this factor,
and that the axis has at least this number of different values. (At a coarse resolution, most
samples of an unclipped axis have one of two values.)"""


def clipped_share(samples: Floats) -> float:
    """Return the share of samples at an end of the measurement range, 0 if there is none.

    >>> import numpy as np
    >>> noise = np.random.default_rng(0).normal(size=1000)
    >>> clipped_share(noise), round(clipped_share(np.minimum(noise, 1.0)), 2)
    (0.0, 0.15)
    """
    values, counts = np.unique(samples[np.abs(samples) <= LARGEST], return_counts=True)
    if len(values) < CLIPPED_VALUES:
        return 0.0
    ends = [(values[0], counts[0], counts[1]), (values[-1], counts[-1], counts[-2])]
    most = max(
        (
            count
            for value, count, next_count in ends
            if value and count >= CLIPPED_RATIO * next_count
        ),
        default=0,
    )
    share = float(most / counts.sum())
    return share if share >= LEAST_CLIPPED else 0.0


def plan_sensors(
    stamps: Stamps, rows: Floats
) -> tuple[tuple[SensorPlan, ...], tuple[Finding, ...]]:
    """Return the sensor streams, found from the first samples of a stream, and the findings.

    The rows, (6, n), are NaN where a sensor is absent.
    """
    # duplicate messages are dropped later and do not count here
    twice = (np.diff(stamps) == 0) & (rows[:, 1:] == rows[:, :-1]).all(axis=0)
    rows = rows[:, np.concatenate([[True], ~twice])] if len(stamps) else rows
    repeats = rows[:, 1:] == rows[:, :-1]
    plans: list[SensorPlan] = []
    findings: list[Finding] = []
    for sensor, place in SENSORS.items():
        present = np.arange(place.start, place.stop)
        present = present[(np.abs(rows[place]) <= LARGEST).any(axis=1)]
        if not len(present):
            findings.append(finding('sensor_absent', AXES[place], sensor=sensor))
            continue
        axes, own = tuple(AXES[i] for i in present), rows[present]
        lacking = tuple(axis for axis in AXES[place] if axis not in axes)
        if lacking:
            findings.append(finding('axis_absent', lacking, count=rows.shape[1]))
        zeros = own == 0.0
        own_samples: OwnSamples = 'all'
        if zeros.all():
            findings.append(finding('sensor_all_zero', axes, sensor=sensor))
            continue
        if _together(zeros):
            own_samples = 'zero'
            share = float(zeros.all(axis=0).mean())
            findings.append(finding('zero_filled', axes, sensor=sensor, share=share))
        elif _together(repeats[present]):
            own_samples = 'held'
            share = float(repeats[present].all(axis=0).mean())
            findings.append(finding('held', axes, sensor=sensor, share=share))
        for axis, samples in zip(axes, own):
            share = clipped_share(samples)
            if share:
                findings.append(finding('clipped', (axis,), share=share))
        plans.append(SensorPlan(axes, own_samples))
    if len(plans) == len(SENSORS) and _sampled_together(plans, repeats):
        plans = [SensorPlan(plans[0].axes + plans[1].axes, plans[0].own)]
    return tuple(plans), tuple(findings)


def _sampled_together(plans: list[SensorPlan], repeats: NDArray[np.bool_]) -> bool:
    """Return whether both sensors have new samples in the same messages."""
    kinds = {plan.own for plan in plans}
    if kinds == {'held'}:
        gyro, accel = (repeats[[AXES.index(axis) for axis in plan.axes]] for plan in plans)
        apart = gyro.all(axis=0) != accel.all(axis=0)
        return bool(apart.mean() < SHARE)
    return kinds == {'all'}


def _together(flags: NDArray[np.bool_]) -> bool:
    """Return whether the flags of the axes, (axes, n), coincide more often than by chance.

    Flags that are always set are ignored: constant values are another fault.
    """
    joint = float(flags.all(axis=0).mean()) if flags.size else 0.0
    if not SHARE < joint < 1.0:
        return False
    return bool(np.log(joint) > TOGETHER_LOG_RATIO * np.log(flags.mean(axis=1)).sum())
