# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Present faults of a live input: silence, loss and repairs within the last minute.

The counts of a stream only grow, so a fault would be reported for ever. A node that runs for months
reports only present faults.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace

from ..findings import Finding, finding
from .cleaning import BACKWARD_RUN
from .health import StreamHealth, event_findings, events
from .period import LEARN

LATELY_S = 60.0
"""Time in s for which events are reported; older events only remain in the counts."""

LATELY = ' in the last minute'
"""`LATELY_S` in the text of a finding."""

REPORTED_LOST_SHARE = 1e-3
"""Smallest share of messages lost in transport that is reported."""

LEAP_S = 2.0
"""If stamps advance by this much more than the elapsed time, the clock was set forward: queued
samples arrive later, never earlier."""

STARTUP_S = 5.0
"""Silence before the first message is not an error for this time in s, because discovery takes
seconds."""

NEVER_STILL_S = 10.0
"""Motion since the start is reported after this time in s."""

LIVE_FINDINGS = (
    *('stamps_unusable', 'stamps_from_rate', 'stamps_missing', 'rate_differs', 'axis_absent'),
    *('sensor_all_zero', 'zero_filled', 'held', 'never_still', 'no_noise', 'gyro_unit'),
    *('accel_unit', 'accel_scale', 'clipped', 'stamps_mixed'),
)
"""Findings of a complete stream that are also true while it runs."""


@dataclass
class TransportStatistics:
    """Counts of the messages in transport."""

    received: int = 0
    sent_before: int = 0  # sent before the first received one: before the subscription, or lost
    skipped_numbers: int = 0  # missing sequence numbers of the publishers
    reported_lost: int = 0  # losses reported by the middleware
    malformed: int = 0  # received messages that are not Imu messages
    # publishers whose messages do not arrive because their QoS is incompatible
    incompatible_qos: int = 0

    @property
    def lost(self) -> int:
        """Messages that were sent and did not arrive: the larger of the two counts."""
        return max(self.skipped_numbers, self.reported_lost)


class TransportMonitor:
    """Reports the present faults of an input since ``time_s``, a time of a steady clock in s."""

    def __init__(self, topic: str, time_s: float) -> None:
        self._topic = topic
        self._began = time_s
        self._last_message = self._last_usable = time_s
        self._messages = self._usable = self._samples = 0
        self._tallies: deque[tuple[float, Counter[str]]] = deque()  # time, counts at this time
        self._missing = 0  # according to the stamps, in this pass; also the next two
        self._leapt = 0  # by stamps that jumped ahead
        self._elsewhere = 0  # while samples with another frame_id arrived
        self._frame_changes = 0
        self._absent = 0  # never sent
        self._absent_before = 0  # the same, at the last call
        self._lost_before = 0  # in transport, before this pass

    def heard(self, time_s: float, messages: int) -> None:
        """Record how many messages have arrived; called more often than `observe`."""
        if messages != self._messages:
            self._last_message, self._messages = time_s, messages

    def silence_s(self, time_s: float) -> float:
        """Return the time since the last message (or since the start) in s."""
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
        """Return the present findings, the most severe first and causes before their effects.

        It is called about once a second, with the present time and the counts since the start. The
        publishers are names of nodes; silence of ``stale_after`` s is an error. ``stream`` contains
        the findings of the complete stream, ``graph`` the findings about publishers that do not
        match the subscription, which explain silence.
        """
        self._follow(time_s, transport, health)
        found = [*graph] or self._silence(time_s, transport, publishers, stale_after)
        if len(publishers) > 1:
            names, count = ', '.join(publishers), len(publishers)
            found.append(finding('several_publishers', count=count, topic=self._topic, names=names))
        found += self._lately(health)
        present = {*LIVE_FINDINGS, *(('noise_louder',) if health.state == 'louder' else ())}
        if health.rate_hz and health.counts.moving < NEVER_STILL_S * health.rate_hz:
            present.discard('never_still')
        # A robot that has been driving since it was started has no fault: a warning, not an error.
        found += [
            replace(f, severity='warning') if f.id == 'never_still' else f
            for f in stream
            if f.id in present
        ]
        order = ('error', 'warning', 'info')
        return tuple(sorted(found, key=lambda f: order.index(f.severity)))

    def _follow(self, time_s: float, transport: TransportStatistics, health: StreamHealth) -> None:
        c = health.counts
        self.heard(time_s, transport.received)
        usable = c.received - c.not_finite - c.duplicate - c.backward - c.untimed
        if health.rate_hz is None and c.received > 2 * LEARN:
            usable = self._usable  # no sensor has data: all values are NaN, infinite or zero
        passed_s = time_s - self._last_usable
        if usable != self._usable:
            self._last_usable, self._usable = time_s, usable
        if c.received < self._samples:
            # a new pass: its counts start at zero, those of the middleware continue
            self._missing = self._leapt = self._elsewhere = 0
            self._absent = self._absent_before = 0
            self._lost_before = transport.lost
            begin = Counter(received=transport.received, lost=transport.lost)
            self._tallies = deque([(time_s, begin)])
        self._samples = c.received
        self._follow_stamps(passed_s, transport, health)
        counts = events(health)
        counts.update(received=transport.received, lost=transport.lost)
        counts.update(absent=self._absent, leapt=self._leapt)
        self._tallies.append((time_s, counts))
        while len(self._tallies) > 2 and self._tallies[1][0] <= time_s - LATELY_S:
            self._tallies.popleft()

    def _follow_stamps(
        self, passed_s: float, transport: TransportStatistics, health: StreamHealth
    ) -> None:
        """Separate missing samples by cause: clocks that were set, and samples never sent.

        ``passed_s`` is the time since the last usable samples.
        """
        c = health.counts
        missing, self._missing = c.lost - self._missing, c.lost
        if health.frame_changes != self._frame_changes:
            self._elsewhere += max(0, missing)  # another IMU was connected
            self._frame_changes = health.frame_changes
        elif health.rate_hz and missing > (passed_s + LEAP_S) * health.rate_hz:
            self._leapt += missing
        # Dropped samples and messages lost in transport are missing according to the stamps, too;
        # messages in both sensor streams, if there are two. They are dropped before they are
        # found missing, so the maximum is used. The decision on the latest samples may still
        # change, so only the number on which two calls agree is used.
        explained = c.not_finite + c.backward + 2 * (transport.lost - self._lost_before)
        absent = c.lost - self._leapt - self._elsewhere - explained
        self._absent = max(self._absent, min(absent, self._absent_before))
        self._absent_before = absent

    def _silence(
        self,
        time_s: float,
        transport: TransportStatistics,
        publishers: tuple[str, ...],
        stale_after: float,
    ) -> list[Finding]:
        topic, seconds = self._topic, self.silence_s(time_s)
        starting = not transport.received and time_s - self._began < STARTUP_S
        if seconds > stale_after:
            if starting:
                return []
            if count := len(publishers):
                return [finding('input_silent', topic=topic, seconds=seconds, publishers=count)]
            if transport.received:
                return [finding('input_stopped', topic=topic, seconds=seconds)]
            return [finding('no_publisher', topic=topic)]
        unusable = time_s - self._last_usable
        if transport.received and unusable > stale_after:
            return [finding('input_unusable', topic=topic, seconds=unusable)]
        return []

    def _lately(self, health: StreamHealth) -> list[Finding]:
        """Return the findings of the last minute, causes before their effects."""
        more = self._tallies[-1][1].copy()
        more.subtract(self._tallies[0][1])
        # the first stamps after a backward clock step are dropped as backward stamps
        more['backward_stamps'] -= (BACKWARD_RUN - 1) * more['clock_jumps']
        found = event_findings(more, health, LATELY)
        if more['leapt'] > 0 and health.rate_hz:
            found.insert(0, finding('stamps_leapt', seconds=more['leapt'] / health.rate_hz))
        received, lost, absent = more['received'], more['lost'], more['absent']
        if lost and lost >= REPORTED_LOST_SHARE * (received + lost):
            found.append(finding('messages_lost', lost=lost, share=lost / (received + lost)))
        # Until a lower rate is recognized, the samples in between seem to be missing.
        if absent >= REPORTED_LOST_SHARE * (received + absent) > 0 and not more['rate_changed']:
            share = absent / (received + absent)
            found.append(finding('samples_missing', count=absent, share=share))
        if health.frame_id != health.evidence_frame_id:
            shown = health.evidence_frame_id
            found.append(finding('frame_waits', present=health.frame_id, shown=shown))
        return found
