# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results and state of a stream of samples: counts, sums, segments, means and findings."""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.sums import LONGEST_FILLED, AllanSums
from ..findings import Finding, finding
from ..imu import AXES, NANOSECONDS, SAMPLE_UNITS, SENSORS, STANDARD_GRAVITY, UNITS, sensor_of
from ..settings import SegmenterSettings

Floats = NDArray[np.float64]

State = Literal['waiting', 'learning', 'at_rest', 'moving', 'noise_increased']
"""'waiting': no sample yet. 'learning': sample rate and noise floor are not known yet. 'at_rest':
the IMU is at rest, and its data are used. 'moving': it moves. 'noise_increased': it is at rest, but
its noise is larger than the noise floor."""

RATE_CHANGE = 0.02
"""Smallest relative difference between two sample periods that is regarded as another rate."""

REPORTED_DROPPED_SHARE = 0.02
"""Smallest share of samples with backward stamps that is reported. If stamps are bursty, the gaps
after dropped samples cannot be found, and at this share N becomes 1 % too large."""

REPORTED_INTERPOLATED_SHARE = 1e-3
"""Smallest share of interpolated samples that is reported."""

INCREASE_SHARE = 0.5
"""A finding names the axes whose noise increased by more than this share of the largest ratio."""

SHORT_S = 60.0
"""Data shorter than this time in s are reported, because the error of N exceeds a few percent."""

LEAST_SPIKES, LEAST_SPIKE_SHARE = 3, 1e-6
"""Smallest number of isolated spikes, and smallest share of the samples, that are reported. The
share in white noise is below 1e-7."""

LARGEST_N, LARGEST_REST_RATE = 3e-3, 0.2
"""Angle random walk in rad/s/sqrt(Hz) (10 deg/sqrt(h)) and mean rate at rest in rad/s (11 deg/s)
above which the unit of a gyro is wrong."""

G_BAND = 0.15
"""Largest relative difference between gravity and a mean acceleration at rest."""

WEIGHTLESS = 0.05
"""Mean acceleration, as a fraction of gravity in any unit, below which gravity was removed."""


@dataclass
class Counts:
    """Numbers of used, dropped, lost and interpolated samples since the start of a stream.

    If the sensors have different rates, the counts of both sensor streams are added, except for
    ``received`` and ``skipped``. For one sensor stream, received + interpolated = used + skipped +
    other_frame + not_finite + duplicate + backward + untimed + moving + stuck + noise_increased +
    the samples still buffered.
    """

    received: int = 0
    used: int = 0  # in the sums, including interpolated ones
    # dropped
    skipped: int = 0  # in the warm-up time at the start
    other_frame: int = 0  # with an earlier frame_id whose sums were dropped
    not_finite: int = 0
    duplicate: int = 0  # the stamp and all values equal those of the previous sample
    backward: int = 0  # the stamp is earlier than the latest one
    reordered: int = 0  # kept: arrived after a sample with a later stamp, and sorted
    untimed: int = 0  # more than a thousand consecutive stamps are equal
    # missing according to the stamps
    lost: int = 0
    interpolated: int = 0  # lost samples that were interpolated
    # not at rest, and dropped
    moving: int = 0
    stuck: int = 0  # an axis repeats one value
    saturated: int = 0  # in motion, at the end of the measurement range, counted per axis
    noise_increased: int = 0  # at rest, but the noise is much larger than the noise floor
    spikes: int = 0  # isolated values that were replaced, counted per axis
    shocks: int = 0  # number of shocks
    replaced: int = 0  # part of `used`: samples of shocks, replaced by a line between means
    # reason -> number of times the data were split
    splits: Counter[str] = field(default_factory=Counter)

    def add(self, other: Counts) -> None:
        """Add the counts of another stream to these."""
        for f in fields(self):
            if f.name != 'splits':
                setattr(self, f.name, getattr(self, f.name) + getattr(other, f.name))
        self.splits.update(other.splits)


class FilledGaps:
    """Counts interpolated gaps by their length in samples.

    ``count``, (lengths, axes), is the number of gaps of 1, 2, ... samples.
    """

    def __init__(self, axes: int) -> None:
        self.count = np.zeros((0, axes), np.int64)
        self._open = [0] * axes  # length of the gap at the end of each axis

    def add(self, filled: NDArray[np.bool_] | None) -> None:
        """Count the gaps in the next samples; ``filled``, (axes, n), flags interpolated values.

        None means that no value is interpolated.
        """
        if filled is None:
            self.end()
            return
        for axis, flags in enumerate(filled):
            edges = np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2)
            if not len(edges) or edges[0, 0]:
                self._close(axis)
            for begin, end in edges.tolist():
                self._open[axis] += end - begin
                if end < len(flags):
                    self._close(axis)

    def end(self) -> None:
        """Count the gaps that reach the end of the samples."""
        if any(self._open):
            for axis in range(len(self._open)):
                self._close(axis)

    def _close(self, axis: int) -> None:
        length, self._open[axis] = self._open[axis], 0
        if not 0 < length <= LONGEST_FILLED:  # longer ones are shocks
            return
        if length > len(self.count):
            longer = np.zeros((length - len(self.count), self.count.shape[1]), np.int64)
            self.count = np.concatenate([self.count, longer])
        self.count[length - 1, axis] += 1


LISTED_EVENTS = 200
"""Largest number of events that are listed; these are the longest ones."""


class Event(NamedTuple):
    """A time when the IMU was not at rest.

    ``kind`` is 'shock', 'motion', 'stuck' (an axis repeats one value) or 'noise_increased' (the
    noise increased at rest). ``changes`` are the changes of the mean of each axis that are larger
    than its noise, in the unit of the samples; a changed acceleration indicates a tilt.
    """

    kind: str
    start_ns: int
    duration_s: float
    changes: Mapping[str, float] = {}


class EventLog:
    """The number of events of each kind, and the longest `LISTED_EVENTS` of them."""

    def __init__(self) -> None:
        self._longest: list[tuple[float, int, Event]] = []  # shortest first

    def add(self, event: Event) -> None:
        """Add an event."""
        insort(self._longest, (event.duration_s, -event.start_ns, event), key=lambda one: one[:2])
        del self._longest[:-LISTED_EVENTS]

    @property
    def events(self) -> tuple[Event, ...]:
        """The listed events, in the order of their times."""
        return tuple(sorted((one[2] for one in self._longest), key=lambda event: event.start_ns))


class Segment(NamedTuple):
    """A part of a stream without a gap, which begins at the stamp ``start_ns``.

    ``cut`` is the reason for the gap before it, such as 'gap' or 'motion'; '' for the first one.
    """

    start_ns: int
    samples: int
    duration_s: float
    cut: str = ''


@dataclass(frozen=True)
class StreamHealth:
    """State and counts of a stream."""

    counts: Counts  # a copy; later samples do not change it
    state: State = 'waiting'
    rate_hz: float | None = None  # None before it is learned
    bursty: bool = False  # whether stamps come in bursts
    base_rate_hz: float | None = None  # rate without the samples that are missing regularly
    first_ns: int | None = None  # first and latest stamp with the current frame_id
    last_ns: int | None = None
    stamps: str = 'header'  # which stamps are used: 'header' or 'record'
    frame_id: str = ''  # of the latest sample
    sums_frame_id: str = ''  # of the sums with the longest elapsed time
    frame_changes: int = 0
    discarded: int = 0  # how often sums were discarded because the IMU had been moving
    # axis -> largest ratio of its noise at rest to the noise floor; empty if none increased
    largest_increase: Mapping[str, float] = field(default_factory=dict)
    discarded_s: float = 0.0  # from the start of the discarded sums to the first sample kept
    # axis with heavy tails -> share of its samples that are outliers
    outliers: Mapping[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()  # shocks, motions and changes of the noise
    dropped_frames: int = 0  # number of frame_ids whose sums were dropped

    @property
    def still_share(self) -> float | None:
        """Share of the classified samples that were at rest; None if there are none."""
        c = self.counts
        classified = c.used + c.moving + c.stuck + c.noise_increased
        return c.used / classified if classified else None


LISTED_SEGMENTS = 1000
"""Largest number of segments that are listed; these are the longest ones."""


class StreamSums(NamedTuple):
    """Sums and longest segments of data at one sample rate."""

    sums: AllanSums
    segments: tuple[Segment, ...]

    def joined(self, other: StreamSums) -> StreamSums:
        """Return the combined results of both; raise AllanError if the sample rates differ."""
        segments = sorted(
            [*self.segments, *other.segments], key=lambda segment: (-segment.samples, segment)
        )
        return StreamSums(self.sums + other.sums, tuple(sorted(segments[:LISTED_SEGMENTS])))


@dataclass(frozen=True)
class Accumulation:
    """The results of a stream.

    ``sums`` has one entry for all axes, or one per sensor if their rates differ. A sensor without
    data has no entry. If the sample rate or the frame_id changed, only the sums with the longest
    elapsed time are included. ``segments`` are the segments of the first entry of ``sums``.
    """

    sums: tuple[AllanSums, ...]
    health: StreamHealth
    findings: tuple[Finding, ...]
    segments: tuple[Segment, ...]


KEPT_MEANS = 120
"""Number of latest means that are kept until they are read."""


class Means(NamedTuple):
    """One-second means of static data for the axes of one sensor stream.

    ``end_ns``, (n,), are the ends of the seconds in ns. ``values``, (n, axes), are the means in the
    unit of the samples. They are the input of the bias filter.
    """

    axes: tuple[str, ...]
    end_ns: NDArray[np.int64]
    values: Floats


class RunningMeans:
    """Computes means over consecutive seconds of samples without a gap."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self._axes = axes
        self._kept: deque[tuple[int, Floats]] = deque(maxlen=KEPT_MEANS)
        self.cut()

    def cut(self) -> None:
        """Drop the incomplete mean, because a gap follows."""
        self._start_ns: int | None = None
        self._second, self._count = 0, 0
        self._sum = np.zeros(len(self._axes))

    def update(self, stamps: NDArray[np.int64], rows: Floats) -> None:
        """Add samples without a gap: stamps (n,) in ns, values (axes, n)."""
        if self._start_ns is None:
            self._start_ns = int(stamps[0])
        seconds = (stamps - self._start_ns) // NANOSECONDS
        begins = np.concatenate([[0], np.flatnonzero(np.diff(seconds)) + 1])
        sums = np.add.reduceat(rows, begins, axis=1).T
        counts = np.diff(begins, append=len(stamps)).tolist()
        for second, total, count in zip(seconds[begins].tolist(), sums, counts):
            if second > self._second:
                end_ns = self._start_ns + (self._second + 1) * NANOSECONDS
                self._kept.append((end_ns, self._sum / max(self._count, 1)))
                self._sum, self._count, self._second = np.zeros(len(total)), 0, second
            self._sum = self._sum + total
            self._count += count

    @property
    def means(self) -> Means:
        """The latest `KEPT_MEANS` complete means."""
        end_ns = np.array([end for end, _ in self._kept], np.int64)
        values = np.array([value for _, value in self._kept]).reshape(-1, len(self._axes))
        return Means(self._axes, end_ns, values)


EVENTS = (
    *('clock_jumps', 'frame_changed', 'rate_changed', 'stuck', 'not_finite', 'duplicates'),
    'backward_stamps',
    'reordered',
)
"""Ids of findings about events, ordered from causes to effects."""


def events(health: StreamHealth) -> Counter[str]:
    """Return the number of events since the start, for each finding id in `EVENTS`."""
    c = health.counts
    jumps, changes = c.splits['clock jump'], c.splits['rate change']
    counts = (jumps, health.frame_changes, changes, c.stuck, c.not_finite, c.duplicate, c.backward)
    return Counter(dict(zip(EVENTS, (*counts, c.reordered))))


def event_findings(counts: Counter[str], health: StreamHealth, when: str = '') -> list[Finding]:
    """Return a finding for each event with a count above 0; ``counts`` has finding ids as keys.

    ``when``, such as ' in the last minute', is appended to the text of the findings.
    """
    now: dict[str, Any] = {'frame_id': health.frame_id, 'rate': health.rate_hz or 0.0, 'when': when}
    return [
        finding(id, count=counts[id], times=counts[id], **now) for id in EVENTS if counts[id] > 0
    ]


def stream_findings(
    health: StreamHealth, sums: tuple[AllanSums, ...], settings: SegmenterSettings
) -> list[Finding]:
    """Return the findings about a complete stream and its sums."""
    counts = health.counts
    found = event_findings(events(health), health)

    def add(id: str, present: object, axes: tuple[str, ...] = (), **numbers: Any) -> None:
        if present:
            found.append(finding(id, axes, **numbers))

    rate = 1.0 / sums[0].tau0 if sums and sums[0].tau0 else health.rate_hz
    declared = settings.declared_rate
    if declared and rate:
        differs = abs(rate / declared - 1.0) > RATE_CHANGE
        add('rate_differs', differs, measured=rate, declared=declared)
    base = health.base_rate_hz
    frames, samples = health.dropped_frames, counts.other_frame
    add('frames_dropped', frames, count=frames, samples=samples)
    add('rate_assumed', base and rate, rate=rate, base=base)
    add('bursty_stamps', health.bursty and rate, rate=rate)
    kept = 1.0 - counts.backward / max(counts.received, 1)
    mixed = health.bursty and kept < 1.0 - REPORTED_DROPPED_SHARE
    add('stamps_mixed', mixed, share=1.0 - kept, factor=max(kept, 0.01) ** -0.5)
    add('saturated', counts.saturated, count=counts.saturated)
    gaps = counts.splits['gap']
    add('gaps', gaps, lost=counts.lost, splits=gaps)
    interpolated = counts.interpolated / max(counts.received, 1)
    add(
        'interpolated',
        interpolated > REPORTED_INTERPOLATED_SHARE,
        interpolated=counts.interpolated,
        share=interpolated,
    )
    many = counts.spikes >= max(LEAST_SPIKES, LEAST_SPIKE_SHARE * counts.used)
    add('spikes', many, count=counts.spikes, share=counts.spikes / max(counts.used, 1))
    heavy = tuple(health.outliers)
    add('outliers', heavy, heavy, share=max(health.outliers.values(), default=0.0))
    shocks = [event for event in health.events if event.kind == 'shock']
    share = counts.replaced / max(counts.used, 1)
    add('shocks', counts.shocks, count=counts.shocks, share=share, times=_times(shocks, health))
    tilts = [event for event in health.events if any(map(_is_accel, event.changes))]
    change = max((abs(c) for e in tilts for a, c in e.changes.items() if _is_accel(a)), default=0.0)
    angle = math.degrees(change / STANDARD_GRAVITY)
    axes = tuple(a for a in AXES if _is_accel(a) and any(a in event.changes for event in tilts))
    add('tilted', tilts, axes, change=change, angle=angle, times=_times(tilts, health))
    add('relearned', health.discarded, seconds=health.discarded_s)
    if health.rate_hz and counts.noise_increased and health.largest_increase:
        ratio = max(health.largest_increase.values())
        axes = tuple(
            axis for axis, r in health.largest_increase.items() if r > INCREASE_SHARE * ratio
        )
        add(
            'noise_increased',
            True,
            axes,
            ratio=ratio,
            seconds=counts.noise_increased / health.rate_hz,
        )
    if counts.moving and not counts.used and health.rate_hz:
        add('never_still', True, seconds=counts.moving / health.rate_hz)
    elif counts.moving:
        add(
            'motion',
            True,
            share=counts.moving / (counts.moving + counts.noise_increased + counts.used),
        )
    for each in sums:
        flat = tuple(np.array(each.axes)[each.sum_sq[0] == 0.0].tolist()) if len(each.m) else ()
        add('no_noise', flat, flat)
        found += _unit_findings(each)
    add('nothing_left', counts.received and not sums, received=counts.received)
    return found


def _is_accel(axis: str) -> bool:
    return sensor_of(axis) == 'accel'


def _times(events: list[Event], health: StreamHealth) -> str:
    """Return when the events began, in s since the first sample, as text; at most the first 3."""
    start = health.first_ns or 0
    times = [f'{(event.start_ns - start) * 1e-9:.0f} s' for event in events]
    more = [f'{len(times) - 3} more'] if len(times) > 3 else []
    *first, last = [*times[:3], *more] or ['']
    return ' and '.join([', '.join(first), last] if first else [last])


def sums_findings(sums: AllanSums) -> list[Finding]:
    """Return a finding if all data together last less than `SHORT_S`, else an empty list."""
    seconds = sums.elapsed_ns * 1e-9
    return [finding('short', seconds=seconds)] if seconds < SHORT_S else []


def _unit_findings(sums: AllanSums) -> list[Finding]:
    """Return a finding for each sensor whose noise or mean is impossible in SI units."""
    if not sums.tau0 or not sums.recordings:
        return []
    total = np.sum([r.samples * r.mean for r in sums.recordings], axis=0)
    mean = total / max(sums.samples, 1)
    short = sums.m * sums.tau0 <= 1.0
    found: list[Finding] = []
    for sensor, place in SENSORS.items():
        own = [i for i, axis in enumerate(sums.axes) if sensor_of(axis) == sensor]
        axes = tuple(sums.axes[i] for i in own)
        if sensor == 'gyro' and own:
            rate = float(np.abs(mean[own]).max())
            tau = sums.m[short, None] * sums.tau0
            level = np.sqrt(sums.avar[short][:, own] * tau)
            n = float(np.median(level.min(axis=0))) if len(tau) else 0.0
            if n > LARGEST_N or rate > LARGEST_REST_RATE:
                found.append(finding('gyro_unit', axes, n=n, rate=rate))
        elif len(own) == place.stop - place.start:
            norm = float(np.linalg.norm(mean[own]))
            factors = {unit: UNITS[unit].factor for unit in SAMPLE_UNITS['accel']}
            units = [u for u, f in factors.items() if abs(norm * f / STANDARD_GRAVITY - 1) < G_BAND]
            if units and units[0] != 'm/s^2':
                found.append(finding('accel_unit', axes, norm=norm, unit=units[0]))
            elif not units and norm >= WEIGHTLESS:
                found.append(finding('accel_scale', axes, norm=norm))
    return found
