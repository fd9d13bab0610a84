# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings about a live input: no messages, lost messages, and events of the last minute.

The counts of a stream never decrease, so an event would be reported as long as a node runs.
Therefore, only recent events are reported.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, replace

from ..findings import Finding, finding
from .cleaning import BACKWARD_RUN
from .health import StreamHealth, event_findings, events
from .timing import LEARN

LATELY_S = 60.0
"""Time in s for which an event is reported."""

LATELY = ' in the last minute'
"""`LATELY_S`, as text of a finding."""

REPORTED_LOST_SHARE = 1e-3
"""Smallest share of messages lost in transport that is reported."""

LEAP_S = 2.0
"""If the stamps advance by this much more than the elapsed time, in s, the clock of the stamps was
set forward."""

STARTUP_S = 5.0
"""Missing messages are not reported during the first seconds, because discovery takes time."""

NEVER_STILL_S = 10.0
"""Time in s after which uninterrupted motion since the start is reported."""

LIVE_FINDINGS = (
    *('stamps_unusable', 'stamps_from_rate', 'stamps_missing', 'rate_differs', 'axis_absent'),
    *('sensor_all_zero', 'zero_filled', 'held', 'never_still', 'no_noise', 'gyro_unit'),
    *('accel_unit', 'accel_scale', 'clipped', 'stamps_mixed', 'repeated'),
)
"""Ids of findings about a complete stream that a node also reports while the stream continues."""


@dataclass
class TransportStatistics:
    """Numbers of received, lost and unusable messages of a subscription."""

    received: int = 0
    sent_before: int = 0  # sent before the first received one: before the subscription, or lost
    skipped_numbers: int = 0  # missing sequence numbers of the publishers
    reported_lost: int = 0  # losses reported by the middleware
    malformed: int = 0  # received messages that are not Imu messages
    incompatible_qos: int = 0  # publishers with an incompatible QoS, whose messages do not arrive

    @property
    def lost(self) -> int:
        """Lost messages: the larger of ``skipped_numbers`` and ``reported_lost``."""
        return max(self.skipped_numbers, self.reported_lost)


class TransportMonitor:
    """Reports the current problems of the live input ``topic``.

    The argument ``time_s`` is the time of a steady clock in s; in the constructor, it is that of
    the start.
    """

    def __init__(self, topic: str, time_s: float) -> None:
        self._topic = topic
        self._began = time_s
        self._last_message = self._last_usable = time_s
        self._messages = self._usable = self._samples = 0
        # (time, counts at this time) of the last minute
        self._history: deque[tuple[float, Counter[str]]] = deque()
        # samples that are missing according to the stamps, in this pass; in total and by cause
        self._missing = 0
        self._leapt = 0  # the clock was set forward
        self._other_frame = 0  # samples with another frame_id arrived instead
        self._absent = 0  # never sent, as far as is known
        self._absent_before = 0  # at the previous call
        self._frame_changes = 0
        self._lost_before = 0  # messages lost in transport before this pass

    def set_received(self, time_s: float, messages: int) -> None:
        """Store the number of messages received since the start, and when it last increased."""
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
        """Return the current findings, the most severe first; call it about once a second.

        ``transport`` and ``health`` hold the counts since the start. ``publishers`` are the names
        of the publishing nodes. Without a message for ``stale_after`` s, an error is reported.
        ``stream`` are the findings about the complete stream. ``graph`` are findings about
        publishers with an incompatible type or QoS; they are reported instead of missing messages.
        """
        self._update(time_s, transport, health)
        found = [*graph] or self._silence(time_s, transport, publishers, stale_after)
        if len(publishers) > 1:
            names, count = ', '.join(publishers), len(publishers)
            found.append(finding('several_publishers', count=count, topic=self._topic, names=names))
        found += self._recent_findings(health)
        present = {*LIVE_FINDINGS, *(('noise_louder',) if health.state == 'louder' else ())}
        if health.rate_hz and health.counts.moving < NEVER_STILL_S * health.rate_hz:
            present.discard('never_still')
        # a warning instead of an error, because a robot may drive as soon as it is started
        found += [
            replace(f, severity='warning') if f.id == 'never_still' else f
            for f in stream
            if f.id in present
        ]
        order = ('error', 'warning', 'info')
        return tuple(sorted(found, key=lambda f: order.index(f.severity)))

    def _update(self, time_s: float, transport: TransportStatistics, health: StreamHealth) -> None:
        c = health.counts
        self.set_received(time_s, transport.received)
        usable = c.received - c.not_finite - c.duplicate - c.backward - c.untimed
        if health.rate_hz is None and c.received > 2 * LEARN:
            usable = self._usable  # no sensor has usable values: all are NaN, infinite or 0
        passed_s = time_s - self._last_usable
        if usable != self._usable:
            self._last_usable, self._usable = time_s, usable
        if c.received < self._samples:
            # a new pass: the counts of the stream start at 0, those of the transport continue
            self._missing = self._leapt = self._other_frame = 0
            self._absent = self._absent_before = 0
            self._lost_before = transport.lost
            begin = Counter(received=transport.received, lost=transport.lost)
            self._history = deque([(time_s, begin)])
        self._samples = c.received
        self._attribute_missing(passed_s, transport, health)
        counts = events(health)
        counts.update(received=transport.received, lost=transport.lost)
        counts.update(absent=self._absent, leapt=self._leapt)
        self._history.append((time_s, counts))
        while len(self._history) > 2 and self._history[1][0] <= time_s - LATELY_S:
            self._history.popleft()

    def _attribute_missing(
        self, passed_s: float, transport: TransportStatistics, health: StreamHealth
    ) -> None:
        """Update the number of missing samples by cause.

        ``passed_s`` is the time since the last usable samples, in s.
        """
        c = health.counts
        missing, self._missing = c.lost - self._missing, c.lost
        if health.frame_changes != self._frame_changes:
            self._other_frame += max(0, missing)
            self._frame_changes = health.frame_changes
        elif health.rate_hz and missing > (passed_s + LEAP_S) * health.rate_hz:
            self._leapt += missing
        # Dropped samples and messages lost in transport are also missing according to the stamps;
        # a lost message counts twice if there are two sensor streams. They are known before the
        # gap is found, so the difference first decreases, and its maximum is used. The decision on
        # the latest samples may still change, so the smaller value of two calls is used.
        explained = c.not_finite + c.backward + 2 * (transport.lost - self._lost_before)
        absent = c.lost - self._leapt - self._other_frame - explained
        self._absent = max(self._absent, min(absent, self._absent_before))
        self._absent_before = absent

    def _silence(
        self,
        time_s: float,
        transport: TransportStatistics,
        publishers: tuple[str, ...],
        stale_after: float,
    ) -> list[Finding]:
        """Return the finding about missing or unusable messages, if there is one."""
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

    def _recent_findings(self, health: StreamHealth) -> list[Finding]:
        """Return the findings about the last minute, ordered from causes to effects."""
        more = self._history[-1][1].copy()
        more.subtract(self._history[0][1])
        # these samples were dropped because the clock was set back
        more['backward_stamps'] -= (BACKWARD_RUN - 1) * more['clock_jumps']
        found = event_findings(more, health, LATELY)
        if more['leapt'] > 0 and health.rate_hz:
            found.insert(0, finding('stamps_leapt', seconds=more['leapt'] / health.rate_hz))
        received, lost, absent = more['received'], more['lost'], more['absent']
        if lost and lost >= REPORTED_LOST_SHARE * (received + lost):
            found.append(finding('messages_lost', lost=lost, share=lost / (received + lost)))
        # after a change to a lower rate, samples seem to be missing until the rate is learned
        if absent >= REPORTED_LOST_SHARE * (received + absent) > 0 and not more['rate_changed']:
            share = absent / (received + absent)
            found.append(finding('samples_missing', count=absent, share=share))
        if health.frame_id != health.sums_frame_id:
            shown = health.sums_frame_id
            found.append(finding('frame_waits', present=health.frame_id, shown=shown))
        return found
