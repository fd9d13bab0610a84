# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings about a live input: present faults first, then the latest events.

The counts of a stream include all events since the start, so an event would be reported as long as
a node runs. Therefore, only recent events are reported.

Pauses, losses and steps of the clock
-------------------------------------
Three events look alike in the stamps: no message was sent for a while, messages were lost in
transport, or the clock that stamps the messages was set. `Arrivals` separates them by the times of
reception on a steady clock, the stamps, and the sequence numbers of the messages.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..findings import LIVE, UNUSABLE, Finding, by_consequence, finding
from ..imu import AXES, NANOSECONDS
from .cleaning import BACKWARD_RUN
from .health import StreamHealth, event_findings, events
from .timing import LEARN

LATELY_S = 20.0
"""Time in s after an event for which the event is reported."""

LATELY = f' in the last {LATELY_S:g} s'
"""Text in findings for the time of past events."""

UNTIL_NOW = f'{LATELY} until now'
"""Text in findings for the time of events that still occur."""

REPORTED_LOST_SHARE = 1e-3
"""Smallest share of messages lost in transport that is reported."""

PRESENT_S = 3.0
"""An event is reported as a present fault until this time in s after its last occurrence, and as a
past event afterwards."""

STEP_S = 0.2
"""A forward step of the clock that makes the stamps is reported only if it is larger than this time
in s."""

SILENCE_S = 1.0
"""Shortest time in s without messages that is reported as an interruption."""

ENVELOPE_S = 5.0
"""Time in s over which the smallest delay between stamp and reception is determined."""

LIVE_PACE = 0.2
"""An input is regarded as live if the speeds of its stamps and of its times of reception differ by
at most this fraction. If a recording is played at another speed, steps of the clock cannot be
distinguished from gaps."""

CAUSES_OF_LOSS = ('messages_lost', 'silent_s', 'stamps_leapt', 'frame_changed', 'dropped')
"""Keys of the counts of events that are known to cause missing samples."""

EXCUSED = 10
"""An event of `CAUSES_OF_LOSS` explains missing samples until `TransportMonitor.observe` was called
this number of times with new usable samples."""

STARTUP_S = 5.0
"""Before the first message, missing messages are not reported until this time in s after the start,
because the discovery of publishers takes time."""

STUCK_S, STUCK_RUNS = 1.0, 20
"""An axis is stuck if its value has not changed for more than `STUCK_S` seconds, and for more than
`STUCK_RUNS` times as many samples as in its longest earlier run of equal values. Earlier runs in
which the axis was stuck do not count."""


@dataclass
class TransportStatistics:
    """Numbers of received, lost and unusable messages of a subscription."""

    received: int = 0
    sent_before: int = 0  # messages sent before the first received message, and perhaps lost
    skipped_numbers: int = 0  # missing sequence numbers of the publishers
    reported_lost: int = 0  # lost messages that the middleware reported
    malformed: int = 0  # received messages that are not Imu messages
    interruptions: int = 0  # pauses of at least `SILENCE_S` in which no message was sent
    silent_s: float = 0.0  # total duration of the interruptions
    leapt_s: float = 0.0  # sum of the forward steps, above `STEP_S`, of the clock of the stamps

    @property
    def lost(self) -> int:
        """Lost messages: the larger of ``skipped_numbers`` and ``reported_lost``."""
        return max(self.skipped_numbers, self.reported_lost)


class Arrivals:
    """Finds interruptions, and forward steps of the clock that makes the stamps.

    In ``statistics``, interruptions are counted, and their durations and the forward steps of the
    clock are added up.

    The stamp of a message minus its time of reception is the offset of the clock minus the delay of
    the message. The clock counts as set forward if, after a gap in the stamps of a live input, this
    difference exceeds its largest value in the `ENVELOPE_S` before the gap by more than `STEP_S`.
    """

    def __init__(self, statistics: TransportStatistics) -> None:
        self._statistics = statistics
        self._origin_ns = self._lost = 0
        # largest stamp since the clock was last set back, and time of reception of the latest
        # message, in s
        self._latest: tuple[float, float] | None = None
        # time of reception, and stamp minus this time, of the messages within `ENVELOPE_S`
        self._offsets: deque[tuple[float, float]] = deque()

    def update(self, stamps_ns: NDArray[np.int64], received_s: NDArray[np.float64]) -> None:
        """Process the next n messages.

        ``stamps_ns``, (n,), are the stamps in ns, and ``received_s``, (n,), are the times of
        reception on a steady clock in s. The statistics must already count the messages that were
        lost before and between these n messages.
        """
        lost, self._lost = self._statistics.lost - self._lost, self._statistics.lost
        if not len(stamps_ns):
            return
        if self._latest is None:
            self._origin_ns = int(stamps_ns[0])
        stamps = (stamps_ns - self._origin_ns) / NANOSECONDS
        latest = 0.0 if self._latest is None else self._latest[0]
        # a new part begins at a stamp that differs by more than `STEP_S` from the former stamp, or
        # from the largest stamp so far
        former = np.append(latest, stamps[:-1])
        largest_step = np.maximum(
            np.abs(stamps - former), np.abs(stamps - np.maximum.accumulate(former))
        )
        part_starts = np.flatnonzero(largest_step > STEP_S)
        for part in np.split(np.arange(len(stamps)), part_starts):
            if len(part):
                self._add(stamps[part], received_s[part], lost)

    def _add(self, stamps: NDArray[np.float64], received_s: NDArray[np.float64], lost: int) -> None:
        """Process messages of which only the first can follow a step of the stamps.

        The stamps and the times of reception are in s. ``lost`` is the number of messages that were
        lost since the previous call of `update`.
        """
        first_stamp, last_received = float(stamps[0]), float(received_s[-1])
        latest_stamp = first_stamp if self._latest is None else self._latest[0]
        if first_stamp - latest_stamp > STEP_S:
            self._judge(first_stamp, float(received_s[0]), lost)
        self._offsets.extend(zip(received_s.tolist(), (stamps - received_s).tolist()))
        oldest_s = float(received_s.max()) - ENVELOPE_S
        while self._offsets[0][0] < oldest_s:
            self._offsets.popleft()
        was_set_back = first_stamp < latest_stamp - STEP_S
        largest_stamp = float(stamps.max())
        if not was_set_back:
            largest_stamp = max(largest_stamp, latest_stamp)
        self._latest = largest_stamp, last_received

    def _judge(self, stamp: float, received_s: float, lost: int) -> None:
        """Update the statistics if a gap shows an interruption or a forward step of the clock.

        ``stamp`` and ``received_s`` are the stamp and the time of reception in s of the message
        after the gap. ``lost`` is the number of messages that were lost since the previous call of
        `update`. Nothing is updated if the input is not live (`LIVE_PACE`).
        """
        assert self._latest is not None
        silent_s = received_s - self._latest[1]
        first_received_s, offset = self._offsets[0]
        duration_s = self._latest[1] - first_received_s
        if duration_s > 1.0 and abs(self._offsets[-1][1] - offset) > LIVE_PACE * duration_s:
            return
        step = stamp - received_s - max(offset for _, offset in self._offsets)
        if step > STEP_S:
            self._statistics.leapt_s += step
            self._offsets.clear()
        if silent_s >= SILENCE_S and not lost:
            self._statistics.interruptions += 1
            self._statistics.silent_s += silent_s


class ConstantAxes:
    """Finds axes whose value has stopped changing although it changed before."""

    def __init__(self) -> None:
        self._last = np.full(len(AXES), np.nan)
        self._run = np.zeros(len(AXES), np.int64)  # number of equal values up to the latest sample

        # number of equal values in the longest earlier run that was no fault
        self._longest = np.zeros(len(AXES), np.int64)

    def update(self, samples: NDArray[np.float64]) -> None:
        """Process the next samples, (n, 6), at least one, in any unit."""
        for i, column in enumerate(samples.T):
            changes = np.flatnonzero(column != np.append(self._last[i], column[:-1]))
            if len(changes):
                runs = np.diff(changes, prepend=-self._run[i])
                runs = runs[0 if np.isfinite(self._last[i]) else 1 :]
                longest = int(self._longest[i])
                for run in runs[runs > longest].tolist():
                    if run <= STUCK_RUNS * (longest or run):  # in a longer run, the axis was stuck
                        longest = max(longest, run)
                self._longest[i], self._run[i] = longest, 0
            self._run[i] += len(column) - (changes[-1] if len(changes) else 0)
        self._last = samples[-1].copy()

    def stuck(self, rate_hz: float) -> tuple[str, ...]:
        """Return the axes that are stuck; ``rate_hz`` is the sample rate."""
        least_run = np.maximum(STUCK_S * rate_hz, STUCK_RUNS * self._longest)
        is_stuck = (self._longest > 0) & (self._run > least_run) & np.isfinite(self._last)
        return tuple(AXES[i] for i in np.flatnonzero(is_stuck))


def faults_of(findings: Iterable[Finding], axis: str = '') -> tuple[Finding, ...]:
    """Return the findings with an `UNUSABLE` id that concern all axes or the given ``axis``.

    Without an axis, all findings with such an id are returned.
    """
    return tuple(
        f for f in findings if f.id in UNUSABLE and (not (axis and f.axes) or axis in f.axes)
    )


class TransportMonitor:
    """Reports the present and recent problems of the live input ``topic``.

    ``time_s`` is the time of a steady clock in s. In the constructor, it is the time of the start.
    """

    def __init__(self, topic: str, time_s: float) -> None:
        self._topic = topic
        self._began = self._last_message = self._last_usable = time_s
        self._messages = self._usable = self._samples = 0
        # (time in s, counts at this time) of the last `LATELY_S`; most keys of the counts are ids
        # of findings
        self._history: deque[tuple[float, Counter[str]]] = deque()
        self._excused = 0  # number of observations for which a cause still explains missing samples
        self._unexplained = 0  # number of missing samples without a known cause

        # number of unexplained missing samples, confirmed by two successive observations
        self._absent = 0

    def set_received(self, time_s: float, messages: int) -> None:
        """Store the number of messages since the start, and the time when it last changed."""
        if messages != self._messages:
            self._last_message, self._messages = time_s, messages

    def silence_s(self, time_s: float) -> float:
        """Return the time in s since a message was last counted, or since the start if none was."""
        return time_s - self._last_message

    def observe(
        self,
        time_s: float,
        transport: TransportStatistics,
        health: StreamHealth,
        publishers: tuple[str, ...],
        stale_after: float,
        stream: tuple[Finding, ...] = (),
        graph: tuple[Finding, ...] = (),
    ) -> tuple[Finding, ...]:
        """Return the current findings; call it about once a second.

        Findings about the present come before findings about past events. In both groups, the
        findings with the most serious consequences come first.

        ``transport`` and ``health`` contain the counts since the start. ``publishers`` are the
        names of the publishing nodes. ``stream`` are the findings about the complete stream.
        ``graph`` are findings about publishers with an incompatible type or QoS. If there are none,
        missing messages are reported after ``stale_after`` s without a message. Before the first
        message, they are not reported in the first `STARTUP_S`.
        """
        self._update(time_s, transport, health)
        present = [*graph] or self._silence(time_s, transport, publishers, stale_after)
        if len(publishers) > 1:
            publisher_names, count = ', '.join(publishers), len(publishers)
            present.append(
                finding('several_publishers', count=count, topic=self._topic, names=publisher_names)
            )
        if health.frame_id != health.sums_frame_id:
            shown = health.sums_frame_id
            present.append(finding('frame_waits', present=health.frame_id, shown=shown))
        noise_findings = {
            'noise_increased': ('noise_increased', 'gyro_unit_changed'),
            'noise_decreased': ('noise_decreased',),
        }
        live_ids = (*LIVE, *noise_findings.get(health.state, ()))
        known_ids = {f.id for f in health.faults}
        present += health.faults
        present += [f for f in stream if f.id in live_ids and f.id not in known_ids]
        events, past = self._recent_findings(health)
        # present findings come first, because a past event must not hide a present fault
        return *by_consequence([*events, *present]), *by_consequence(past)

    def _update(self, time_s: float, transport: TransportStatistics, health: StreamHealth) -> None:
        c = health.counts
        self.set_received(time_s, transport.received)
        usable = c.received - c.not_finite - c.duplicate - c.backward - c.untimed
        if health.rate_hz is None and c.received > 2 * LEARN:
            # the rate is still unknown, so the values or the stamps of the samples are not usable
            usable = self._usable
        has_progress = usable != self._usable
        if has_progress:
            self._last_usable, self._usable = time_s, usable
        counts = Counter(received=transport.received, messages_lost=transport.lost)
        counts.update(interrupted=transport.interruptions)
        counts.update(silent_s=transport.silent_s, stamps_leapt=transport.leapt_s)  # type: ignore
        if c.received < self._samples:
            # after a reset of the sums, the counts of the stream start at 0, but the transport
            # counts continue
            self._unexplained = self._absent = 0
            self._history = deque([(time_s, counts.copy())])
        self._samples = c.received
        previous = self._history[-1][1] if self._history else Counter()
        # A count may decrease: the health from `ImuStream.result` includes buffered samples, but a
        # later health from `ImuStream.present_health` may not include them.
        counts.update({id: max(count, previous[id]) for id, count in events(health).items()})
        counts.update(missing=c.lost, dropped=c.not_finite + c.backward)
        counts.update(spikes=c.spikes, used=c.used)
        self._count_unexplained(_increase_since(previous, counts), has_progress)
        counts.update(samples_missing=self._absent)
        self._history.append((time_s, counts))
        while len(self._history) > 2 and self._history[1][0] <= time_s - LATELY_S:
            self._history.popleft()

    def _count_unexplained(self, new_counts: Counter[str], has_progress: bool) -> None:
        """Count the missing samples that no known cause explains.

        ``new_counts`` are the counts since the previous call. A cause is known before the samples
        are found to be missing, because the samples after a gap must be classified first.
        ``has_progress`` tells whether usable samples arrived.
        """
        if any(new_counts[cause] for cause in CAUSES_OF_LOSS):
            self._excused = EXCUSED
        if not self._excused:
            previous = self._unexplained
            self._unexplained += new_counts['missing']
            # the smaller of two counts, because the latest samples may turn out not to be missing
            self._absent = max(self._absent, min(self._unexplained, previous))
        elif has_progress:
            self._excused -= 1

    def _silence(
        self,
        time_s: float,
        transport: TransportStatistics,
        publishers: tuple[str, ...],
        stale_after: float,
    ) -> list[Finding]:
        """Return the finding about missing or unusable messages, if there is one."""
        topic, seconds = self._topic, self.silence_s(time_s)
        is_starting = not transport.received and time_s - self._began < STARTUP_S
        if seconds > stale_after:
            if is_starting:
                return []
            if count := len(publishers):
                return [finding('input_silent', topic=topic, seconds=seconds, publishers=count)]
            if transport.received:
                return [finding('input_stopped', topic=topic, seconds=seconds)]
            return [finding('no_publisher', topic=topic)]
        unusable_s = time_s - self._last_usable
        if transport.received and unusable_s > stale_after:
            return [finding('input_unusable', topic=topic, seconds=unusable_s)]
        return []

    def _recent_findings(self, health: StreamHealth) -> tuple[list[Finding], list[Finding]]:
        """Return the findings about present events, and about past events within `LATELY_S`."""
        time_s, counts = self._history[-1]
        oldest_counts = self._history[0][1]
        earlier_counts = [
            former_counts
            for time_of_counts, former_counts in self._history
            if time_of_counts <= time_s - PRESENT_S
        ] or [oldest_counts]
        recent_counts = _increase_since(oldest_counts, counts)
        present_counts = _increase_since(earlier_counts[-1], counts)
        # A few samples are excluded before it is found that the clock was set back. They are not
        # reported. If the clock was set back shortly before, more are excluded, and the
        # additional ones are reported.
        recent_counts['backward_stamps'] -= (BACKWARD_RUN - 1) * recent_counts['clock_jumps']
        findings = event_findings(recent_counts, health, LATELY)
        if recent_counts['stamps_leapt'] > 0:
            findings.insert(0, finding('stamps_leapt', seconds=recent_counts['stamps_leapt']))
        if times := recent_counts['interrupted']:
            findings.append(finding('interrupted', times=times, seconds=recent_counts['silent_s']))
        if (spikes := recent_counts['spikes']) > 0:
            share = spikes / max(recent_counts['used'], 1)
            findings.append(finding('spikes', count=spikes, share=share, when=LATELY))
        received, lost = recent_counts['received'], recent_counts['messages_lost']
        absent = recent_counts['samples_missing']
        if lost and lost >= REPORTED_LOST_SHARE * (received + lost):
            findings.append(finding('messages_lost', lost=lost, share=lost / (received + lost)))
        # after a change to a lower rate, samples seem to be missing until the rate is learned
        if (
            absent >= REPORTED_LOST_SHARE * (received + absent) > 0
            and not recent_counts['rate_changed']
        ):
            share = absent / (received + absent)
            findings.append(finding('samples_missing', count=absent, share=share))
        past = [f for f in findings if not present_counts[f.id] > 0]
        return [_until_now(f) for f in findings if f not in past], past


def _until_now(event: Finding) -> Finding:
    """Return the finding about an event; a duration in it is replaced by the duration until now."""
    if 'when' not in event.values:
        return event
    return replace(event, values={**event.values, 'when': UNTIL_NOW})


def _increase_since(before: Counter[str], counts: Counter[str]) -> Counter[str]:
    """Return by how much each of the ``counts`` is larger than ``before``."""
    increase = counts.copy()
    increase.subtract(before)
    return increase
