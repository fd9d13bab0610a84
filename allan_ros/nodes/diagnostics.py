# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values of core as diagnostic statuses: words and units, no formula."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ..core.findings import Finding
from ..core.health import StreamHealth
from ..core.input_health import Reception
from ..core.sums import AllanSums
from ..io.shown import duration_text

LEVELS: Mapping[str, bytes] = {
    'info': DiagnosticStatus.OK,
    'warning': DiagnosticStatus.WARN,
    'error': DiagnosticStatus.ERROR,
}
"""Severity of a finding -> level of a status (`bytes` in Python)."""


@dataclass(frozen=True)
class InputView:
    """All that is shown of one input.

    ``received_age_s`` is None before the first message; ``stamp_age_s`` is the ROS time since the
    last header stamp; ``path`` says how messages are taken in.
    """

    topic: str
    health: StreamHealth
    reception: Reception
    findings: tuple[Finding, ...]
    noted: tuple[Finding, ...]
    sums: tuple[AllanSums, ...]
    publishers: tuple[str, ...]
    declared_rate: float
    path: str
    received_age_s: float | None = None
    stamp_age_s: float | None = None
    checkpoint: str = ''
    checkpoint_age_s: float | None = None


def diagnostic_array(node: Node, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Return the statuses as one message of now."""
    array = DiagnosticArray(status=list(statuses))
    array.header.stamp = node.get_clock().now().to_msg()
    return array


def status_name(node: Node, *words: str) -> str:
    """Return ``<node>: <words>``, with the namespace where there is one."""
    return f'{node.get_fully_qualified_name().strip("/")}: {" ".join(w for w in words if w)}'


def key_values(pairs: Iterable[tuple[str, object]]) -> list[KeyValue]:
    """Return the pairs as the strings the message wants; None is 'unknown'."""
    return [KeyValue(key=key, value=_text(value)) for key, value in pairs]


def worst_level(findings: Iterable[Finding]) -> bytes:
    """Return the level of the gravest finding; OK without one."""
    return max((LEVELS[f.severity] for f in findings), default=DiagnosticStatus.OK)


def message_of(findings: Sequence[Finding], otherwise: str) -> str:
    """Return what to read first: the first warning or error, else the state of things."""
    grave = [f for f in findings if f.severity != 'info']
    if not grave:
        return otherwise
    more = f' (and {len(grave) - 1} more)' if len(grave) > 1 else ''
    return f'{grave[0]}{more}'


def input_status(name: str, hardware_id: str, view: InputView) -> DiagnosticStatus:
    """Return the status of one input."""
    h, c, r = view.health, view.health.counts, view.reception
    evidence = max((s.elapsed_ns * 1e-9 for s in view.sums), default=0.0)
    pairs: list[tuple[str, object]] = [
        ('topic', view.topic),
        ('state', h.state),
        ('rate [Hz]', h.rate_hz),
        ('declared rate [Hz]', view.declared_rate or None),
        ('evidence [s]', evidence),
        ('segments', max((s.segment_count for s in view.sums), default=0)),
        ('share of still time', h.still_share),
        ('received [messages]', r.received),
        ('sent before the first came [messages]', r.sent_before),
        ('lost on the way [messages]', r.lost),
        ('malformed [messages]', r.malformed),
        ('used [samples]', c.used),
        ('missing by the stamps [samples]', c.lost),
        ('bridged [samples]', c.bridged),
        ('moving [samples]', c.moving),
        ('stuck [samples]', c.stuck),
        ('saturated [samples]', c.saturated),
        ('not finite [samples]', c.not_finite),
        ('duplicate [samples]', c.duplicate),
        ('stamped backward [samples]', c.backward),
        ('without a time [samples]', c.untimed),
        ('skipped at the start [samples]', c.skipped),
        *((f'cuts by {reason}', count) for reason, count in sorted(c.cuts.items())),
        ('message age [s]', view.received_age_s),
        ('stamp age [s]', view.stamp_age_s),
        ('publishers', ', '.join(view.publishers) or 'none'),
        ('publishers of incompatible QoS', r.incompatible_qos),
        ('stamps used', h.stamps),
        ('messages taken by', view.path),
        ('checkpoint', view.checkpoint or 'none'),
        ('checkpoint age [s]', view.checkpoint_age_s),
        *((f'finding: {f.id}', f) for f in (*view.findings, *view.noted)),
    ]
    return DiagnosticStatus(
        level=worst_level(view.findings),
        name=name,
        message=message_of(view.findings, _state_text(view, evidence)),
        hardware_id=hardware_id,
        values=key_values(pairs),
    )


def _state_text(view: InputView, evidence: float) -> str:
    h = view.health
    gathered = f'{duration_text(evidence)} of evidence'
    if h.state == 'waiting':
        return 'waiting for the first message'
    if h.state == 'learning':
        return 'learning rate and noise floor; keep the IMU still'
    rate = f'{h.rate_hz:.4g} Hz' if h.rate_hz else 'unknown rate'
    if h.state == 'moving':
        return f'moving at {rate}: evidence waits, {gathered} so far'
    return f'still at {rate}: {gathered}'


def _text(value: object) -> str:
    if value is None:
        return 'unknown'
    if isinstance(value, float):
        return f'{value:.6g}'
    return str(value)
