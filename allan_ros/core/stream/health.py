# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""State of a stream of samples: counts, events, segments and means, and findings about them."""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np

from ..allan.sums import LEAST_EQUAL, AllanSums
from ..fields import SignedInt
from ..findings import Finding, finding
from ..imu import AXES, SAMPLE_UNITS, SENSORS, STANDARD_GRAVITY, UNITS, Floats, Stamps, sensor_of
from ..settings import SegmenterSettings

State = Literal['waiting', 'learning', 'at_rest', 'moving', 'noise_increased', 'noise_decreased']
"""'waiting': no usable sample yet. 'learning': the sample rate or the noise floor is not known yet.
'at_rest': the IMU is at rest, or motion detection is switched off, and its data are used. 'moving':
the IMU moves, an axis is stuck, or the samples are not plausible measurements. 'noise_increased':
the IMU is at rest, but its noise is larger than the noise floor. 'noise_decreased': the noise of an
axis is much smaller than the noise floor, or the axis is clipped and was not before."""

PLAUSIBLE_RATE_HZ = 0.1, 1e5
"""Smallest and largest plausible sample rate in Hz. At another rate, the unit of the stamps is
probably wrong."""

RATE_CHANGE = 0.02
"""Relative difference between two sample periods above which the rate has changed."""

REPORTED_DROPPED_SHARE = 0.02
"""For bursty stamps, 'stamps_mixed' is reported if more than this share of the samples is excluded
because of backward stamps. The gaps that excluded samples leave in bursty stamps cannot be found.
With this share, N is 1 % too large."""

REPORTED_INTERPOLATED_SHARE = 1e-3
"""Share of interpolated samples above which they are reported."""

INCREASE_SHARE = 0.5
"""A finding about increased noise names the axes whose ratio of noise to noise floor exceeds this
fraction of the largest ratio of all axes."""

SHORT_S = 60.0
"""Data shorter than this time in s are reported. At a sample rate of 100 Hz, the 95 % interval of N
from 60 s is +-2 %."""

LEAST_SPIKES, LEAST_SPIKE_SHARE = 3, 1e-6
"""Isolated spikes are reported if there are at least `LEAST_SPIKES`, and at least the fraction
`LEAST_SPIKE_SHARE` of the number of used samples. In white noise, this fraction is below 1e-7."""

LARGEST_N, LARGEST_REST_RATE = 3e-3, 0.2
"""Angle random walk in rad/s/sqrt(Hz) (10 deg/sqrt(h)) and mean rate at rest in rad/s (11 deg/s)
above which the declared unit of a gyro is regarded as wrong."""

USUAL_N = 3e-4
"""Angle random walk in rad/s/sqrt(Hz) (1 deg/sqrt(h)) of a typical gyro. The unit in which N is
nearest to this value is the most probable unit."""

UNIT_ERROR, LARGEST_ACCEL_RATIO = 0.2, 3.0
"""Limits for the ratio of the present to the earlier noise, by which a changed unit of the gyro is
recognized: largest relative difference between the ratio of the gyro and the conversion factor of
the other unit, and largest ratio of the accelerometer."""

NO_AXES = np.zeros(0)

G_BAND = 0.15
"""A mean acceleration is regarded as gravity if it differs from gravity by less than this
fraction."""

EXCHANGED_UNITS = ('rad/s', 'm/s^2'), ('rad/s', 'g'), ('deg/s', 'm/s^2')
"""Units of the gyro and the accelerometer in which exchanged columns of the sensors are recognized:
only the gyro seems to measure gravity. The pair deg/s and g is not used, because a gyro may have a
bias of 1 deg/s."""

SAME_SUMS = 1e-6
"""Largest relative difference, due to rounding, between the Allan sums of two equal axes."""

WEIGHTLESS = 0.05
"""Gravity was removed from the data if the magnitude of the mean acceleration at rest is below this
value in m/s^2, whether the samples are in m/s^2 or in g. If samples in m/s^2 showed gravity before,
the limit is this fraction of gravity."""


@dataclass
class Counts:
    """Numbers of used, excluded, lost and interpolated samples since the start of a stream.

    If the sensors are in two streams, the counts of both sensor streams are added, except for
    ``received``, ``skipped``, ``other_frame`` and ``reordered``. For one sensor stream without
    repeated or zero samples, received + interpolated = used + skipped + other_frame + not_finite +
    duplicate + backward + untimed + moving + stuck + noise_increased + noise_decreased + the
    samples that are still buffered.
    """

    received: int = 0
    used: int = 0  # samples in the Allan sums, including interpolated samples
    skipped: int = 0  # samples in the warm-up time, or in a time that earlier samples cover
    other_frame: int = 0  # samples with a frame_id whose Allan sums were discarded
    not_finite: int = 0  # samples with a value that is NaN, infinite, or too large for any IMU
    duplicate: int = 0  # samples whose stamp and values repeat the previous sample
    backward: int = 0  # excluded samples with a stamp that is earlier than the latest stamp
    reordered: int = 0  # samples that arrived after a later sample, and were sorted
    untimed: int = 0  # first samples whose stamps advance too rarely to show the sample period
    lost: int = 0  # samples that are missing according to the stamps
    interpolated: int = 0  # lost samples that were interpolated
    moving: int = 0  # excluded samples in motion, or next to a motion
    stuck: int = 0  # excluded samples while an axis repeats one value
    noise_increased: int = 0  # excluded samples at rest whose noise exceeds the noise floor
    noise_decreased: int = 0  # excluded samples with much less noise, or with a newly clipped axis
    spikes: int = 0  # isolated values that were replaced, counted per axis
    shocks: int = 0  # shocks whose samples were replaced
    replaced: int = 0  # samples of shocks that were replaced by a line; also counted as used

    # reason -> number of times that the data were split
    splits: Counter[str] = field(default_factory=Counter)

    def add(self, other: Counts) -> None:
        """Add the counts ``other``, for example of another stream."""
        for f in fields(self):
            if f.name != 'splits':
                setattr(self, f.name, getattr(self, f.name) + getattr(other, f.name))
        self.splits.update(other.splits)


class Event(NamedTuple):
    """A time in which samples were excluded or replaced: motion, shock, or change of the noise.

    ``kind`` is 'shock', 'motion', 'stuck' (an axis repeats one value), 'noise_increased' (the noise
    increased at rest) or 'noise_decreased' (the noise of an axis became much smaller, or the axis
    was clipped). ``changes`` maps axes to changes of the mean that noise does not explain, in the
    unit of the samples. A changed mean of the accelerometer indicates a tilt.
    """

    kind: str
    start_ns: SignedInt
    duration_s: float
    changes: Mapping[str, float] = {}


class Segment(NamedTuple):
    """Used samples without a gap between them, the first of which has the stamp ``start_ns``.

    ``cut`` is the reason for the split before the segment, such as 'gap' or 'motion'; '' if none
    is known, as before the first segment of an IMU that is at rest from the start.
    """

    start_ns: SignedInt
    samples: int
    duration_s: float
    cut: str = ''


LISTED_EVENTS, LISTED_SEGMENTS = 200, 1000
"""Largest numbers of events and of segments that are listed; the longest ones are kept."""


T = TypeVar('T', Event, Segment)


class Longest(Generic[T]):
    """Keeps the longest events or segments, at most ``number`` of them."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._items: list[tuple[float, int, T]] = []  # (length, -start, item), the shortest first

    def add(self, length: float, item: T) -> None:
        """Add an item, and remove the shortest item if there are too many."""
        insort(self._items, (length, -item.start_ns, item), key=lambda each: each[:2])
        del self._items[: -self._number]

    @property
    def items(self) -> tuple[T, ...]:
        """The items in the order of their times."""
        return tuple(sorted((item for *_, item in self._items), key=lambda item: item.start_ns))


@dataclass(frozen=True)
class StreamHealth:
    """State, counts, events and faults of a stream of samples."""

    counts: Counts  # a copy that later samples do not change
    state: State = 'waiting'
    rate_hz: float | None = None  # sample rate; None while it is not known
    bursty: bool = False  # whether stamps come in bursts

    # sample rate that the sensor would have if no samples were missing; None unless samples are
    # missing so regularly that `rate_hz` is lower
    base_rate_hz: float | None = None
    first_ns: int | None = None  # first stamp with the current frame_id
    stamps: str = 'header'  # which stamps are used: 'header' or 'record'
    frame_id: str = ''  # frame_id of the latest sample
    sums_frame_id: str = ''  # frame_id of the first Allan sums; `frame_id` if there are none
    frame_changes: int = 0

    # number of noise levels whose Allan sums were the result until a later level replaced them
    discarded: int = 0

    # axis -> largest ratio of its noise at rest to the noise floor; empty if no noise increased, or
    # if the increased noise now counts as normal
    largest_increase: Mapping[str, float] = field(default_factory=dict)
    discarded_s: float = 0.0  # time in s from the first sample at rest to the first kept sample

    # axis with heavy tails -> share of its examined samples that are outliers
    outliers: Mapping[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()  # shocks, motions and changes of the noise
    dropped_frames: int = 0  # number of frame_ids whose Allan sums were discarded

    # axis -> smallest ratio of its noise to the noise floor; empty if no noise decreased, or if the
    # decreased noise now counts as normal
    largest_decrease: Mapping[str, float] = field(default_factory=dict)
    stuck_axes: tuple[str, ...] = ()  # axes that were stuck at one value for some time

    # axis -> share of its samples at rest that are clipped, at least `MIN_CLIPPED`
    clipped: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[Finding, ...] = ()  # known faults of the latest samples

    # axis -> present standard deviation of its white noise, in the unit of the samples; empty if it
    # is not known
    noise: Mapping[str, float] = field(default_factory=dict)

    @property
    def still_share(self) -> float | None:
        """Share of the classified samples that are used; None if no sample was classified."""
        c = self.counts
        classified = c.used + c.moving + c.stuck + c.noise_increased + c.noise_decreased
        return c.used / classified if classified else None


class Means(NamedTuple):
    """One-second means of static data for the axes of one sensor stream.

    ``end_ns``, (n,), are the ends of the seconds in ns. ``values``, (n, axes), are the means in the
    unit of the samples. `BiasTracker` estimates the bias from these means.
    """

    axes: tuple[str, ...]
    end_ns: Stamps
    values: Floats


def events(health: StreamHealth) -> Counter[str]:
    """Return finding id -> number of events or samples since the start that cause the finding.

    Findings about causes come before findings about their effects.
    """
    c = health.counts
    return Counter(
        clock_jumps=c.splits['clock jump'],
        frame_changed=health.frame_changes,
        axes_changed=c.splits['axes changed'],
        rate_changed=c.splits['rate change'],
        stuck=c.stuck,
        not_finite=c.not_finite,
        duplicates=c.duplicate,
        backward_stamps=c.backward,
        reordered=c.reordered,
    )


def event_findings(counts: Counter[str], health: StreamHealth, when: str = '') -> list[Finding]:
    """Return a finding for each event with a count above 0; ``counts`` has finding ids as keys.

    ``when``, such as ' in the last 20 s', is inserted into the text of the findings.
    """
    numbers: dict[str, Any] = {
        'frame_id': health.frame_id,
        'rate': health.rate_hz or 0.0,
        'when': when,
    }
    ids = [id for id in events(health) if counts[id] > 0]
    axes = {'stuck': health.stuck_axes}
    return [
        finding(id, axes.get(id, ()), count=counts[id], times=counts[id], **numbers) for id in ids
    ]


def stream_findings(
    health: StreamHealth, sums: tuple[AllanSums, ...], settings: SegmenterSettings
) -> list[Finding]:
    """Return the findings about a stream, and about its Allan sums ``sums``.

    A finding about ``health`` is omitted if a present fault has the same id.
    """
    c = health.counts
    findings = [*event_findings(events(health), health), *health.faults]
    fault_ids = {fault.id for fault in health.faults}

    def add(id: str, present: object, axes: tuple[str, ...] = (), **numbers: Any) -> None:
        if present and id not in fault_ids:
            findings.append(finding(id, axes, **numbers))

    received, used = max(c.received, 1), max(c.used, 1)
    rate = 1.0 / sums[0].tau0 if sums and sums[0].tau0 else health.rate_hz
    declared_rate, base_rate = settings.declared_rate, health.base_rate_hz
    rate_differs = declared_rate and rate and abs(rate / declared_rate - 1.0) > RATE_CHANGE
    low, high = PLAUSIBLE_RATE_HZ
    add('rate_implausible', rate and not low <= rate <= high, rate=rate)
    add('rate_differs', rate_differs, measured=rate, declared=declared_rate)
    add('frames_dropped', health.dropped_frames, count=health.dropped_frames, samples=c.other_frame)
    add('rate_assumed', base_rate and rate, rate=rate, base=base_rate)
    add('bursty_stamps', health.bursty and rate, rate=rate)
    kept_share = 1.0 - c.backward / received
    has_mixed_stamps = health.bursty and kept_share < 1.0 - REPORTED_DROPPED_SHARE
    add(
        'stamps_mixed',
        has_mixed_stamps,
        share=1.0 - kept_share,
        factor=max(kept_share, 0.01) ** -0.5,
    )
    gaps = c.splits['gap']
    add('gaps', gaps, lost=c.lost, splits=gaps)
    share = c.interpolated / received
    has_interpolated = share > REPORTED_INTERPOLATED_SHARE
    add('interpolated', has_interpolated, interpolated=c.interpolated, share=share)
    has_spikes = c.spikes >= max(LEAST_SPIKES, LEAST_SPIKE_SHARE * c.used)
    add('spikes', has_spikes, count=c.spikes, share=c.spikes / used)
    for axis, clipped in health.clipped.items():
        add('clipped', clipped, (axis,), share=clipped)
    heavy_axes = tuple(health.outliers)
    add('outliers', heavy_axes, heavy_axes, share=max(health.outliers.values(), default=0.0))
    shocks = [event for event in health.events if event.kind == 'shock']
    times = _times(shocks, health)
    add('shocks', c.shocks, count=c.shocks, share=c.replaced / used, times=times)
    tilts = [event for event in health.events if any(map(_is_accel, event.changes))]
    changes = [(a, abs(c)) for e in tilts for a, c in e.changes.items() if _is_accel(a)]
    change = max((size for _, size in changes), default=0.0)
    axes = tuple(axis for axis in AXES if axis in dict(changes))
    angle = math.degrees(change / STANDARD_GRAVITY)
    add('tilted', tilts, axes, change=change, angle=angle, times=_times(tilts, health))
    add('relearned', health.discarded, seconds=health.discarded_s)
    rate = health.rate_hz or math.inf
    ratios = health.largest_increase
    ratio = max(ratios.values(), default=0.0)
    axes = tuple(axis for axis, r in ratios.items() if r > INCREASE_SHARE * ratio)
    has_increased = health.rate_hz and c.noise_increased and ratio
    gyro_axes = tuple(axis for axis in ratios if not _is_accel(axis))
    accel_ratios = np.array([ratios[axis] for axis in ratios if axis not in gyro_axes])
    gyro_ratios = np.array([ratios[axis] for axis in gyro_axes])
    unit = changed_gyro_unit(gyro_ratios, accel_ratios) if has_increased else ''
    add('gyro_unit_changed', unit, gyro_axes, ratio=ratio, unit=unit)
    seconds = c.noise_increased / rate
    add('noise_increased', has_increased and not unit, axes, ratio=ratio, seconds=seconds)
    ratios, seconds = health.largest_decrease, c.noise_decreased / rate
    has_decreased = health.rate_hz and c.noise_decreased and ratios
    smallest_ratio = min(ratios.values(), default=1.0)
    add('noise_decreased', has_decreased, tuple(ratios), ratio=smallest_ratio, seconds=seconds)
    never_at_rest = c.moving and not c.used and health.rate_hz
    add('never_still', never_at_rest, seconds=c.moving / rate)
    classified = max(c.moving + c.noise_increased + c.used, 1)
    add('motion', c.moving and not never_at_rest, share=c.moving / classified)
    for stream_sums in sums:
        axes_without_noise: tuple[str, ...] = ()
        if len(stream_sums.m) and stream_sums.count[0] >= LEAST_EQUAL:
            has_no_noise = stream_sums.sum_sq[0] == 0.0
            axes_without_noise = tuple(np.array(stream_sums.axes)[has_no_noise].tolist())
        add('no_noise', axes_without_noise, axes_without_noise)
        findings += _equal_axes(stream_sums)
    findings += unit_findings(sums)
    add('nothing_left', c.received and not sums, received=c.received)
    return findings


def _is_accel(axis: str) -> bool:
    return sensor_of(axis) == 'accel'


def _times(events: list[Event], health: StreamHealth) -> str:
    """Return a text with the times of at most three events in s since ``health.first_ns``.

    The text ends with the number of further events, if there are any.
    """
    start = health.first_ns or 0
    times = [f'{(event.start_ns - start) * 1e-9:.0f} s' for event in events]
    further = [f'{len(times) - 3} more'] if len(times) > 3 else []
    *first, last = [*times[:3], *further] or ['']
    return ' and '.join([', '.join(first), last] if first else [last])


def changed_gyro_unit(gyro: Floats, accel: Floats = NO_AXES) -> str:
    """Return the unit to which a gyro changed from rad/s, or '' if it did not change.

    ``gyro`` and ``accel``, (axes,), are the ratios of the present to the earlier noise. The unit
    changed if the ratios of all three axes of the gyro agree with the factor of a unit
    (`UNIT_ERROR`), and no ratio of the accelerometer exceeds `LARGEST_ACCEL_RATIO`. The result is
    '' for fewer than three axes of the gyro.

    >>> changed_gyro_unit(np.array([57.0, 58.0, 57.3])), changed_gyro_unit(np.full(3, 9.0))
    ('deg/s', '')
    """
    if len(gyro) < 3 or accel.max(initial=0.0) > LARGEST_ACCEL_RATIO:
        return ''
    for unit in SAMPLE_UNITS['gyro'][1:]:
        if (np.abs(gyro * UNITS[unit].factor - 1.0) < UNIT_ERROR).all():
            return unit
    return ''


def probable_gyro_unit(n: float) -> str:
    """Return the unit, other than rad/s, with which N is nearest to N of a typical gyro.

    ``n`` is N, computed from samples in the unknown unit. A value below `LARGEST_N` is replaced by
    `LARGEST_N`.
    """
    factors = {unit: UNITS[unit].factor for unit in SAMPLE_UNITS['gyro'][1:]}
    return min(factors, key=lambda unit: abs(math.log(max(n, LARGEST_N) * factors[unit] / USUAL_N)))


def sums_findings(sums: AllanSums) -> list[Finding]:
    """Return one finding if all segments together last less than `SHORT_S`, else none."""
    seconds = sums.elapsed_ns * 1e-9
    return [finding('short', seconds=seconds)] if seconds < SHORT_S else []


def _equal_axes(sums: AllanSums) -> list[Finding]:
    """Return a finding for each pair of axes with equal Allan sums.

    Such axes are copies of one axis, because of an error in the driver. Axes without noise are not
    compared.
    """
    if not len(sums.sum_sq):
        return []
    first, second = sums.sum_sq[:, :, None], sums.sum_sq[:, None, :]
    are_equal = (np.abs(first - second) <= SAME_SUMS * np.abs(second)).all(axis=0)
    are_equal &= sums.sum_sq[0, :, None] > 0.0
    equal_pairs = np.argwhere(np.tril(are_equal.T, -1)).tolist()
    return [finding('axes_equal', (sums.axes[i], sums.axes[j])) for j, i in equal_pairs]


def unit_findings(sums: Sequence[AllanSums]) -> list[Finding]:
    """Return findings about sensors whose values are implausible in SI units or without gravity.

    ``sums`` are the Allan sums of an IMU, of both sensors together or of each sensor. Of a gyro, N
    and the mean rate are examined, and of an accelerometer with three axes, the magnitude of the
    mean. If the two sensors are probably exchanged, only this is reported.
    """
    columns = {
        sensor: (stream_sums, indices)
        for stream_sums in sums
        if stream_sums.tau0 and stream_sums.recordings
        for sensor in SENSORS
        if (indices := [i for i, a in enumerate(stream_sums.axes) if sensor_of(a) == sensor])
    }
    norms = {
        sensor: _norm_at_rest(*pair)
        for sensor, pair in columns.items()
        if len(pair[1]) == len(AXES[SENSORS[sensor]])
    }
    exchanged = _findings_about_exchange(**norms) if len(norms) == len(SENSORS) else []
    if exchanged:
        return exchanged
    accel_axes = AXES[SENSORS['accel']]
    accel_findings = gravity_findings(norms['accel'], accel_axes) if 'accel' in norms else []
    if 'gyro' not in columns:
        return accel_findings
    # if no unit explains the values of the accelerometer, both sensors may have raw counts
    may_be_counts = any(f.id == 'accel_scale' for f in accel_findings)
    return [*_rate_findings(*columns['gyro'], may_be_counts), *accel_findings]


def _rate_findings(sums: AllanSums, columns: list[int], may_be_counts: bool) -> list[Finding]:
    """Return a finding if N or the mean rate of a gyro is implausible in rad/s.

    ``columns`` are the indices of the axes of the gyro in ``sums``. The finding states the probable
    unit, unless the samples may be raw counts.
    """
    sample_sums = np.sum([r.samples * r.mean for r in sums.recordings], axis=0)
    mean = sample_sums / max(sums.samples, 1)
    rate = float(np.abs(mean[columns]).max())
    times = sums.m * (sums.tau0 or 0.0)
    densities = np.sqrt(sums.avar[:, columns] * times[:, None])[times <= 1.0]
    n = float(np.median(densities.min(axis=0))) if len(densities) else 0.0
    if n <= LARGEST_N and rate <= LARGEST_REST_RATE:
        return []
    axes = tuple(sums.axes[i] for i in columns)
    unit = None if may_be_counts else probable_gyro_unit(n)
    return [finding('gyro_unit', axes, n=n, rate=rate, unit=unit)]


def _findings_about_exchange(gyro: float, accel: float) -> list[Finding]:
    """Return a finding if the gyro measures gravity and the accelerometer does not.

    ``gyro`` is the magnitude of the mean rate at rest in rad/s, and ``accel`` is the magnitude of
    the mean acceleration in m/s^2.
    """
    if accel > STANDARD_GRAVITY or gravity_unit(accel):
        return []
    for unit, other in EXCHANGED_UNITS:
        mean = gyro / UNITS[unit].factor
        if gravity_unit(mean) == other:
            return [finding('sensors_exchanged', mean=mean, unit=unit, other=other, norm=accel)]
    return []


def _norm_at_rest(sums: AllanSums, axes: list[int]) -> float:
    """Return the magnitude of the mean vector of some axes, averaged over segments.

    The segments with block means are used, and recordings without block means as one segment each.
    Each segment has a mean vector, because the direction of gravity may differ between segments.
    """
    weights, norms = [], []
    for recording in sums.recordings:
        for means in recording.means:
            mean_vector = means.values[:, axes].mean(axis=0) + recording.reference[axes]
            weights.append(float(means.samples))
            norms.append(float(np.linalg.norm(mean_vector)))
        if not recording.means:
            weights.append(float(recording.samples))
            norms.append(float(np.linalg.norm(recording.mean[axes])))
    return float(np.average(norms, weights=weights))


def gravity_unit(norm: float) -> str:
    """Return the unit in which ``norm`` is the magnitude of gravity, or '' if no unit fits.

    ``norm`` is the magnitude of a mean acceleration in an unknown unit. It may differ from gravity
    by less than the fraction `G_BAND`.

    >>> gravity_unit(9.81), gravity_unit(1.0), gravity_unit(5.0)
    ('m/s^2', 'g', '')
    """
    factors = {unit: UNITS[unit].factor for unit in SAMPLE_UNITS['accel']}
    units = [u for u, f in factors.items() if abs(norm * f / STANDARD_GRAVITY - 1) < G_BAND]
    return units[0] if units else ''


def gravity_findings(norm: float, axes: tuple[str, ...]) -> list[Finding]:
    """Return a finding if the magnitude of a mean acceleration at rest differs from gravity.

    ``norm`` is the magnitude in m/s^2. Below `WEIGHTLESS`, the finding is a note, because gravity
    may have been removed on purpose.
    """
    if abs(norm / STANDARD_GRAVITY**2 - 1.0) < G_BAND:
        # g was declared as the unit, but the samples were in m/s^2
        return [finding('accel_unit', axes, norm=norm, unit='m/s^2')]
    unit = gravity_unit(norm)
    if unit:
        is_si = unit == 'm/s^2'
        return [] if is_si else [finding('accel_unit', axes, norm=norm, unit=unit)]
    id = 'accel_scale' if norm >= WEIGHTLESS else 'no_gravity'
    return [finding(id, axes, norm=norm)]
