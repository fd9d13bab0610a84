# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of an IMU: are they named, does the status recover, and are the good data used?

    python bench/bench_faults.py                          all faults, 5 seeds
    python bench/bench_faults.py frozen 15_percent --seeds 2 --begins boot --numbers

Simulated messages pass the stages of a node without ROS. A fault begins at boot, or 120 to 140 s
later. The four numbers of a cell state for how many percent of the seeds

- a finding names the fault within 10 s,
- from 30 s after the end of the fault on, there is no warning or error and the state is "at rest",
- N of every axis is right at the end,
- at least 90 % of the good data are used.

A dash marks a number that does not apply to the fault.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from allan_ros.core.estimate import Estimate
from allan_ros.core.findings import Finding, finding
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.imu import AXES, STANDARD_GRAVITY, ImuBatch
from allan_ros.core.stream.health import StreamHealth
from allan_ros.core.stream.pipeline import Accumulation, ImuStream
from allan_ros.core.stream.present_faults import noise_now
from allan_ros.core.stream.transport import (
    Arrivals,
    ConstantAxes,
    TransportMonitor,
    TransportStatistics,
)

RATE = 100
"""Sample rate in Hz."""

BEGIN_S, PHASE_S, AFTER_S = 120, 20, 180
"""Time in s before a fault that does not begin at boot, range of the random time that is added, and
time that is simulated after the end of a fault."""

DURATIONS_S = 30, 120
"""Durations in s of faults that end."""

LASTING_S = 180
"""Time in s for which a fault that does not end is simulated."""

NAMED_S, HEALED_S, USED_SHARE = 10.0, 30.0, 0.9
"""Goals: longest time in s from the start of a fault to a finding that names it, longest time in s
from the end of the fault to the last second with a warning, an error or another state than at rest,
and least share of the good data that is used."""

RIGHT, N_SIGMAS, N_ERROR = 0.03, 4.5, 0.1
"""Largest errors of N that count as right.

Without a fit, the Allan deviation at the sample period may differ from the truth by `RIGHT`. This
is 3.8 standard deviations for 120 s of data. The fitted N may differ by `N_SIGMAS` standard errors
(probability of a false alarm on six axes: 4e-5) and by the fraction `N_ERROR`, because an interval
may be wide.
"""

START_NS = 1_700_000_000_000_000_000

SIGMA = np.array([1.5e-3] * 3 + [2e-2] * 3)
LSB = np.array([np.radians(1 / 131)] * 3 + [STANDARD_GRAVITY / 16384] * 3)

Samples = np.ndarray
Rng = np.random.Generator
Change = Callable[[Samples, Rng], Samples]


@dataclass(frozen=True)
class Messages:
    """Messages of an IMU: arrival times in s, stamps in ns, samples, (n, 6), sequence numbers."""

    arrived_s: np.ndarray
    stamps: np.ndarray
    samples: Samples
    numbers: np.ndarray

    def __len__(self) -> int:
        return len(self.stamps)

    def part(self, which: slice | np.ndarray) -> Messages:
        """Return the messages with the given indices."""
        return Messages(
            self.arrived_s[which], self.stamps[which], self.samples[which], self.numbers[which]
        )

    def in_order(self) -> Messages:
        """Return the messages in the order in which they arrive."""
        return self.part(np.argsort(self.arrived_s, kind='stable'))

    @classmethod
    def joined(cls, parts: list[Messages]) -> Messages:
        """Return the messages of all ``parts``, one part after the other."""
        return cls(
            np.concatenate([each.arrived_s for each in parts]),
            np.concatenate([each.stamps for each in parts]),
            np.concatenate([each.samples for each in parts]),
            np.concatenate([each.numbers for each in parts]),
        )


Disturbance = Callable[[Messages, Rng], Messages]


def simulated(seconds: float, rng: Rng, rate: int = RATE) -> Samples:
    """Return samples of an IMU at rest with a bias and a drift, before rounding, (n, 6)."""
    n = round(seconds * rate)
    bias = np.append(rng.normal(size=5) * ([2e-3] * 3 + [0.1] * 2), 9.8)
    drift = rng.normal(size=6) * ([1e-3] * 3 + [1e-2] * 3)
    return bias + np.linspace(0.0, 1.0, n)[:, None] * drift + SIGMA * rng.normal(size=(n, 6))


def rounded(x: Samples) -> Samples:
    """Return the samples, rounded to the resolution `LSB` of a sensor with 16 bits."""
    return np.asarray(np.round(x / LSB) * LSB)


def messages_of(samples: Samples, rate: int = RATE) -> Messages:
    """Return messages with evenly spaced stamps, each of which arrives at the time of its stamp."""
    index = np.arange(len(samples))
    stamps = START_NS + np.round(index * (1e9 / rate)).astype(np.int64)
    return Messages(index / rate, stamps, samples, index)


# --- changes of the samples -----------------------------------------------------------------------

GYRO, ACCEL, ALL = [0, 1, 2], [3, 4, 5], [0, 1, 2, 3, 4, 5]


def of_axes(axes: list[int], change: Change) -> Change:
    """Return the given change, restricted to the axes with these indices."""

    def changed(x: Samples, rng: Rng) -> Samples:
        out = x.copy()
        out[:, axes] = change(x, rng)[:, axes]
        return out

    return changed


def frozen(x: Samples, rng: Rng) -> Samples:
    """Return the first sample n times, (n, 6)."""
    return np.asarray(x[:1] + 0 * x)


def zeros(x: Samples, rng: Rng) -> Samples:
    """Return zeros, (n, 6)."""
    return 0 * x


def scaled(*factors: float) -> Change:
    """Return the change that multiplies each axis by a factor, like another unit of measurement."""
    return lambda x, rng: x * factors


def noise_times(factor: float) -> Change:
    """Return the change that multiplies the noise by a factor and keeps the means."""
    return lambda x, rng: x.mean(0) + factor * (x - x.mean(0))


def every_second(x: Samples) -> Samples:
    """Return flags that are set for every second sample, (n, 1)."""
    return np.arange(len(x))[:, None] % 2 == 1


def fan(x: Samples, rng: Rng) -> Samples:
    """Return the samples with added vibration at 31 Hz and white noise of three times `SIGMA`."""
    phase = 2 * np.pi * 0.31 * np.arange(len(x))[:, None] + np.arange(6)
    return np.asarray(x + 3.0 * SIGMA * (np.sin(phase) + rng.normal(size=x.shape)))


def driven(x: Samples, rng: Rng) -> Samples:
    """Return the samples with the slow motion and the vibration of a drive added."""
    t = np.arange(len(x)) / RATE
    swing = np.sin(2 * np.pi * 0.3 * t)[:, None] * [0.02, 0.03, 0.4, 1.0, 0.5, 0.2]
    return np.asarray(x + swing + rng.normal(size=x.shape) * ([1e-2] * 3 + [0.3] * 3))


def permuted(x: Samples, rng: Rng) -> Samples:
    """Return the samples with the axes x and z of both sensors exchanged."""
    return x[:, [2, 1, 0, 5, 4, 3]]


# --- changes of the messages ----------------------------------------------------------------------


def of_samples(change: Change) -> Disturbance:
    """Return the disturbance that applies a change to the samples of messages."""
    return lambda m, rng: replace(m, samples=change(m.samples, rng))


def of_stamps(change: Callable[[np.ndarray], np.ndarray]) -> Disturbance:
    """Return the disturbance that applies a change to the stamps (ns) of messages."""
    return lambda m, rng: replace(m, stamps=change(m.stamps))


def lost(share: float) -> Disturbance:
    """Return the disturbance that loses a share of the messages in transport, at random."""
    return lambda m, rng: m.part(rng.random(len(m)) >= share)


def never_sent(m: Messages, rng: Rng) -> Messages:
    """Return no messages, as if the driver had sent none."""
    return m.part(slice(0))


def half_rate(m: Messages, rng: Rng) -> Messages:
    """Return every second message."""
    return numbered(m.part(slice(None, None, 2)), m)


def double_rate(m: Messages, rng: Rng) -> Messages:
    """Return twice as many messages, at twice the sample rate, with the same noise."""
    step = np.median(np.diff(m.stamps)).astype(np.int64) // 2
    between = replace(
        m,
        arrived_s=m.arrived_s + step * 1e-9,
        stamps=m.stamps + step,
        samples=np.roll(m.samples, 100, axis=0),
    )
    return numbered(Messages.joined([m, between]).in_order(), m)


def second_imu(m: Messages, rng: Rng) -> Messages:
    """Return the messages and, between them, the messages of a second IMU with other biases."""
    other = simulated(len(m) / RATE, rng) + [0.01, -0.02, 0.015, 0.3, -0.2, 0.1]
    step = round(0.3e9 / RATE)
    second = Messages(m.arrived_s + step * 1e-9, m.stamps + step, rounded(other), m.numbers)
    return numbered(Messages.joined([m, second]).in_order(), m)


def duplicated(m: Messages, rng: Rng) -> Messages:
    """Return each message twice, as if two bridges forwarded it."""
    return numbered(m.part(np.arange(len(m)).repeat(2)), m)


def late(m: Messages, rng: Rng) -> Messages:
    """Return the messages, of which a tenth are delayed and overtaken by up to six others."""
    delay = rng.uniform(0.01, 0.06, len(m)) * (rng.random(len(m)) < 0.1)
    return numbered(replace(m, arrived_s=m.arrived_s + delay).in_order(), m)


def bursts(m: Messages, rng: Rng) -> Messages:
    """Return the messages as if a host read and stamped ten samples at a time."""
    first = np.arange(len(m)) // 10 * 10
    last = np.minimum(first + 9, len(m) - 1)
    at = m.arrived_s[last] + 1e-4 * (np.arange(len(m)) - first)
    stamps = m.stamps[last] + 10**5 * (np.arange(len(m)) - first)
    return replace(m, arrived_s=at, stamps=stamps)


def numbered(m: Messages, source: Messages) -> Messages:
    """Return the messages with consecutive sequence numbers that begin as in ``source``."""
    return replace(m, numbers=source.numbers[:1] + np.arange(len(m)))


@dataclass(frozen=True)
class Fault:
    """A fault: how it disturbs messages, and the findings that may name it.

    Attributes
    ----------
    names : str
        Ids of findings, separated by spaces, of which one must appear; '' if none need appear.
    disturb : function
        Returns the disturbed messages.
    is_good : bool
        Whether the disturbed data are still good, and should be used.
    noise_changes : bool
        Whether the noise has another level, which is accepted as normal if the fault does not end.
    shows_at_boot : bool
        Whether the fault can be recognized without earlier data.
    """

    names: str
    disturb: Disturbance
    is_good: bool = False
    noise_changes: bool = False
    shows_at_boot: bool = True


STUCK = 'stuck stuck_now no_noise'
ZEROS = f'{STUCK} sensor_all_zero input_unusable'
STAMPS = 'stamps_missing input_unusable stamps_unusable clock_jumps backward_stamps stamps_leapt'

FAULTS = {
    'stuck': Fault(STUCK, of_samples(of_axes([1], frozen))),
    'dead': Fault(STUCK, of_samples(of_axes([1], zeros))),
    'dead_sensor': Fault(ZEROS, of_samples(of_axes(GYRO, zeros))),
    'frozen': Fault(ZEROS, of_samples(frozen)),
    'all_zero': Fault(ZEROS, of_samples(zeros)),
    'nan': Fault(
        'not_finite axis_absent sensor_absent input_unusable',
        of_samples(of_axes(ACCEL, lambda x, rng: x * np.nan)),
    ),
    'every_second_zero': Fault(
        'zero_filled',
        of_samples(of_axes(ACCEL, lambda x, rng: np.where(every_second(x), 0.0, x))),
    ),
    'held': Fault(
        'held repeated', of_samples(of_axes(ACCEL, lambda x, rng: x[np.arange(len(x)) // 2 * 2]))
    ),
    '15_percent': Fault(
        'noise_decreased', of_samples(noise_times(0.15)), noise_changes=True, shows_at_boot=False
    ),
    'toggling': Fault(
        'noise_decreased stuck',
        of_samples(of_axes(GYRO, lambda x, rng: LSB * (rng.random(x.shape) < 0.3))),
        noise_changes=True,
        shows_at_boot=False,
    ),
    'clipped': Fault(
        'clipped stuck noise_decreased',
        of_samples(of_axes([5], lambda x, rng: np.minimum(x, np.quantile(x, 0.02, axis=0)))),
        noise_changes=True,
    ),
    'half_clipped': Fault(
        'clipped',
        of_samples(of_axes([1], lambda x, rng: np.minimum(x, np.quantile(x, 0.7, axis=0)))),
    ),
    'unit_g': Fault('accel_unit', of_samples(scaled(*[1] * 3, *[1 / STANDARD_GRAVITY] * 3))),
    'unit_mg': Fault('accel_unit', of_samples(scaled(*[1] * 3, *[1e3 / STANDARD_GRAVITY] * 3))),
    'unit_deg': Fault(
        'gyro_unit gyro_unit_changed', of_samples(scaled(*[np.degrees(1)] * 3, *[1] * 3))
    ),
    'unit_mrad': Fault('gyro_unit gyro_unit_changed', of_samples(scaled(*[1e3] * 3, *[1] * 3))),
    'no_gravity': Fault(
        'gravity_removed',
        of_samples(lambda x, rng: x - [0, 0, 0, 0, 0, STANDARD_GRAVITY]),
        shows_at_boot=False,
    ),
    'flipped': Fault('axes_changed', of_samples(scaled(1, -1, -1, 1, -1, -1)), shows_at_boot=False),
    'permuted': Fault('axes_changed', of_samples(permuted), shows_at_boot=False),
    'second_imu': Fault(
        'interleaved several_publishers rate_changed stamps_mixed backward_stamps', second_imu
    ),
    'stamps_zero': Fault(STAMPS, of_stamps(lambda t: 0 * t)),
    'stamps_equal': Fault(STAMPS, of_stamps(lambda t: t[:1] + 0 * t)),
    'stamps_reversed': Fault(STAMPS, of_stamps(lambda t: t[::-1])),
    'uptime': Fault(
        STAMPS, of_stamps(lambda t: t - t[:1] + 10**9), is_good=True, shows_at_boot=False
    ),
    'half_rate': Fault('rate_changed', half_rate, noise_changes=True, shows_at_boot=False),
    'double_rate': Fault('rate_changed', double_rate, noise_changes=True, shows_at_boot=False),
    'bursts': Fault('bursty_stamps', bursts, is_good=True),
    'silence': Fault('interrupted input_silent input_stopped no_publisher', never_sent),
    'lost': Fault('messages_lost samples_missing', lost(0.2), is_good=True),
    'duplicates': Fault('duplicates', duplicated, is_good=True),
    'late': Fault('reordered', late, is_good=True),
    'spikes': Fault(
        'spikes',
        of_samples(of_axes([1], lambda x, rng: x + 50 * SIGMA * (rng.random(x.shape) < 0.005))),
        is_good=True,
    ),
    'doubled': Fault(
        'noise_increased noise_now',
        of_samples(noise_times(2.0)),
        noise_changes=True,
        shows_at_boot=False,
    ),
    'fan': Fault(
        'noise_increased noise_now', of_samples(fan), noise_changes=True, shows_at_boot=False
    ),
    'bias_step': Fault('', of_samples(lambda x, rng: x + [0.02, 0, 0, 0.05, 0, 0]), is_good=True),
    'driving': Fault('state:moving', of_samples(driven)),
}


@dataclass
class Seen:
    """Findings and state in the status of each second, and the Allan sums at the end."""

    findings: list[dict[str, str]] = field(default_factory=list)  # of each second: id -> severity
    states: list[str] = field(default_factory=list)
    result: Accumulation | None = None


class Input:
    """The input of a node without ROS: its stream, and the findings of its status."""

    def __init__(self, publish_s: int = 10) -> None:
        self.stream = ImuStream()
        self._publish_s = publish_s  # period in s at which the Allan sums are computed
        self._monitor = TransportMonitor('imu/data', 0.0)
        self._constant = ConstantAxes()
        self._statistics = TransportStatistics()
        self._arrivals = Arrivals(self._statistics)
        self._next_number: int | None = None
        self._sums = self.stream.result().sums
        self._events: object = None

    def begin_numbers(self) -> None:
        """Accept any sequence number as the number of the next message."""
        self._next_number = None

    def status(self, time_s: float, messages: Messages) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Process the messages of a second, and return the health and the findings after it."""
        self._statistics.received += len(messages)
        if len(messages):
            expected = messages.numbers[0] if self._next_number is None else self._next_number
            self._next_number = int(messages.numbers[-1]) + 1
            missing = self._next_number - expected - len(messages)
            self._statistics.skipped_numbers += max(0, int(missing))
            self._constant.update(messages.samples)
        self._arrivals.update(messages.stamps, messages.arrived_s)
        record_ns = START_NS + np.round(messages.arrived_s * 1e9).astype(np.int64)
        self.stream.update(ImuBatch(messages.stamps, messages.samples, record_ns))
        health, found = self.stream.present_health(self._sums)
        c = health.counts
        events = health.state, health.discarded, sum(c.splits.values()), c.used > 0
        # the Allan sums are computed after each event, and at each publication
        if events != self._events or round(time_s) % self._publish_s == 0:
            self._events = events
            result = self.stream.result()
            self._sums, health, found = result.sums, result.health, result.findings
        if health.rate_hz and (stuck := self._constant.stuck(health.rate_hz)):
            found = *found, finding('stuck_now', stuck)
        found = self._monitor.observe(
            time_s, self._statistics, health, ('driver',), 5.0, tuple(found)
        )
        return health, (*found, *noise_now(health, self._sums))


def watched(messages: Messages, seconds: int) -> Seen:
    """Pass messages to a node input second by second, and return what its status showed."""
    live, seen = Input(), Seen()
    edges = np.searchsorted(messages.arrived_s, np.arange(seconds + 1))
    for second, (first, last) in enumerate(itertools.pairwise(edges), start=1):
        health, found = live.status(float(second), messages.part(slice(first, last)))
        seen.findings.append({each.id: each.severity for each in found})
        seen.states.append(health.state)
    live.stream.end()
    seen.result = live.stream.result()
    return seen


@dataclass(frozen=True)
class Outcome:
    """Result of one run; None for a number that does not apply to the fault.

    Attributes
    ----------
    named_s, healed_s : float or None
        Time from the start of the fault to a finding that names it, and from the end of the fault
        to the last second with a warning, an error or another state than at rest.
    error : float or None
        Largest error of N of all axes, divided by the largest error that is permitted.
    used : float or None
        Share of the good samples that are used.
    during, after : str
        Seconds with each warning, error and state, during the fault and from `HEALED_S` after it.
    """

    named_s: float | None
    healed_s: float | None
    error: float | None
    used: float | None
    during: str = ''
    after: str = ''

    @property
    def flags(self) -> tuple[bool | None, ...]:
        """Whether each of the four goals is reached; None for a goal that does not apply."""
        limits = (NAMED_S, HEALED_S, 1.0)
        values = (self.named_s, self.healed_s, self.error)
        flags = [None if v is None else v <= limit for v, limit in zip(values, limits)]
        return *flags, None if self.used is None else self.used >= USED_SHARE


def with_fault(whole: Messages, fault: Fault, place: slice, rng: Rng) -> Messages:
    """Return messages of which the part ``place`` is disturbed, in the order of their arrival.

    If the fault changes how many messages are sent, the later messages get other sequence numbers.
    """
    disturbed = fault.disturb(whole.part(place), rng)
    later = whole.part(slice(place.stop, None))
    if len(disturbed) and fault.disturb in (half_rate, double_rate, second_imu, duplicated):
        later = replace(later, numbers=np.arange(len(later)) + disturbed.numbers[-1] + 1)
    if fault.disturb is never_sent and len(later):
        later = replace(later, numbers=later.numbers - later.numbers[0] + place.start)
    return Messages.joined([whole.part(slice(place.start)), disturbed, later]).in_order()


@dataclass(frozen=True)
class Course:
    """Messages that last ``seconds``, with a fault from ``begin_s`` to ``end_s``."""

    begin_s: float
    end_s: float
    seconds: int
    messages: Messages

    @classmethod
    def of(cls, fault: Fault, at_boot: bool, lasts_s: int | None, seed: int) -> Course:
        """Simulate a fault that begins at boot or at a random time, and ends after ``lasts_s``."""
        rng = np.random.default_rng([seed, at_boot, lasts_s or 0])
        begin_s = 0.0 if at_boot else BEGIN_S + round(PHASE_S * rng.random(), 2)
        end_s = begin_s + (lasts_s or LASTING_S)
        seconds = math.ceil(end_s) + (AFTER_S if lasts_s else 0)
        whole = messages_of(rounded(simulated(seconds, rng)))
        place = slice(round(begin_s * RATE), round(end_s * RATE))
        return cls(begin_s, end_s, seconds, with_fault(whole, fault, place, rng))


def has_name(fault: Fault, at_boot: bool) -> bool:
    """Return whether a finding or a state of the status should name a fault."""
    return bool(fault.names) and (fault.shows_at_boot or not at_boot)


def run(fault: Fault, at_boot: bool, lasts_s: int | None, seed: int) -> Outcome:
    """Simulate a fault, and return when the status names it and when the status recovers."""
    course = Course.of(fault, at_boot, lasts_s, seed)
    begin_s, end_s, seconds = course.begin_s, course.end_s, course.seconds
    seen = watched(course.messages, seconds)
    names = set(fault.names.split())
    named = [
        second - begin_s
        for second, ids in enumerate(seen.findings, start=1)
        if second > begin_s and (names & {*ids, f'state:{seen.states[second - 1]}'})
    ]
    ill = [
        second
        for second, (ids, state) in enumerate(zip(seen.findings, seen.states), start=1)
        if {*ids.values()} & {'warning', 'error'} or state != 'at_rest'
    ]
    healed = max(0.0, max(ill, default=0) - end_s) if lasts_s else None
    good = seconds * RATE
    if not fault.is_good:
        good -= round(end_s * RATE) - round(begin_s * RATE)
    error, used = _numbers(fault, seen, good, lasts_s)
    return Outcome(
        min(named, default=np.inf) if has_name(fault, at_boot) else None,
        healed,
        error,
        used,
        _summary(seen, begin_s, end_s),
        _summary(seen, end_s + HEALED_S, seconds) if lasts_s else '',
    )


def _numbers(
    fault: Fault, seen: Seen, good: int, lasts_s: int | None
) -> tuple[float | None, float | None]:
    """Return the error of N relative to its limit, and the share of good samples that is used."""
    assert seen.result is not None
    # noise that lasts longer than the earlier noise is accepted as the noise of the IMU
    if not good or (fault.noise_changes and not lasts_s):
        return None, None
    sums = seen.result.sums
    used = sum(each.samples for each in sums if 'gyro_x' in each.axes) / good
    levels = {a: math.sqrt(v) for each in sums for a, v in zip(each.axes, each.avar[0])}
    truths = np.sqrt(SIGMA**2 + LSB**2 / 12)
    error = max(abs(levels.get(a, 0.0) / truth - 1.0) for a, truth in zip(AXES, truths)) / RIGHT
    if error < 1.0:
        return error, used
    error = 0.0
    known: dict[str, Estimate] = {}
    for each in sums:
        _, model = fit_stationary(each)
        known |= {axis: fit.noise['N'] for axis, fit in model.axes.items()}
    for axis, truth in zip(AXES, truths / math.sqrt(RATE)):
        estimate = known.get(axis)
        if estimate is None or estimate.value is None or estimate.ci95 is None:
            return np.inf, used
        low, high = np.log(estimate.ci95)
        off = abs(math.log(estimate.value / truth))
        error = max(error, off / (N_SIGMAS * (high - low) / 3.92), off / N_ERROR)
    return error, used


def _summary(seen: Seen, begin_s: float, end_s: float) -> str:
    """Return as text for how many seconds each warning, error and state was shown."""
    place = slice(math.ceil(begin_s), math.ceil(end_s))
    said = Counter(
        id for ids in seen.findings[place] for id, severity in ids.items() if severity != 'info'
    )
    states = Counter(seen.states[place])
    return ', '.join(f'{what} {count}' for what, count in [*said.items(), *states.items()])


def cells(begins: list[str]) -> Iterator[tuple[str, bool, int | None]]:
    """Yield for each column: name, whether the fault begins at boot, duration in s or None."""
    for begin in begins:
        for lasts in (None, *DURATIONS_S):
            yield f'{begin} {f"{lasts} s" if lasts else "lasting"}', begin == 'boot', lasts


def shares(outcomes: list[Outcome]) -> str:
    """Return as text the percentage of the runs that reached each goal."""
    columns = zip(*(outcome.flags for outcome in outcomes))
    return ' '.join(
        f'{"-":>3}' if None in flags else f'{100 * np.mean(flags):3.0f}'
        for flags in map(list, columns)
    )


def main() -> None:
    """Simulate the requested faults, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument('faults', nargs='*', metavar='FAULT', help=', '.join(FAULTS))
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--begins', nargs='+', default=['boot', 'mid'], choices=['boot', 'mid'])
    parser.add_argument('--numbers', action='store_true', help='also print each run')
    options = parser.parse_args()
    columns = list(cells(options.begins))
    print(f'{"":18}' + '  '.join(f'{name:15}' for name, *_ in columns))
    for name in options.faults or FAULTS:
        row = []
        for column, at_boot, lasts in columns:
            seeds = range(options.first_seed, options.first_seed + options.seeds)
            runs = [run(FAULTS[name], at_boot, lasts, seed) for seed in seeds]
            row.append(shares(runs))
            if options.numbers:
                for each in runs:
                    print('   ', name, column, each)
        print(f'{name:18}' + '  '.join(f'{each:15}' for each in row), flush=True)


if __name__ == '__main__':
    main()
