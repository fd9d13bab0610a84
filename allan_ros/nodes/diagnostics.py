# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Makes the statuses of inputs and axes for `/diagnostics`, and their text for Prometheus."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node

from ..core.allan.recent import NoiseStep
from ..core.allan.sums import AllanSums
from ..core.check import Check
from ..core.errors import one_line
from ..core.estimate import LIMIT_DIGITS, Estimate, duration_text, significant, value_text
from ..core.findings import Finding, by_consequence, finding, quantity
from ..core.fit.fit_findings import recommended_duration
from ..core.fit.result import TERMS
from ..core.imu import AXES, sensor_of, shown_unit
from ..core.stream.drive_recorder import LEAST_DRIVES, Drives
from ..core.stream.health import StreamHealth
from ..core.stream.transport import TransportStatistics
from ..results.axis_result import AxisResult
from ..results.datasheets import exceeds_limit
from ..results.motion import INTEGRAL_NAMES, LEAST_REST_S, causes_text
from ..results.results import Results
from ..view.finding_text import finding_line

LEVELS: Mapping[str, bytes] = {
    'info': DiagnosticStatus.OK,
    'warning': DiagnosticStatus.WARN,
    'error': DiagnosticStatus.ERROR,
}
"""Severity of a finding -> level of a status, which is `bytes` in Python."""

NUMBER_TEXT = r'[-+]?\d+(\.\d*)?(e[-+]?\d+)?'
"""Pattern of a finite number. Values of a status that do not match this pattern are not written as
metrics."""

FINDING = 'finding'
"""Key in a status. The value is the id of the finding in the message of the status, or 'none'. The
key ``finding: <id>`` has the text of a finding as its value. This text begins with 'now' or
'earlier', or states when an event happened."""


def status_name(node: Node, *words: str) -> str:
    """Return ``<namespace>/<node>: <words>`` without a leading slash.

    Control characters are escaped, and empty words are omitted.
    """
    return one_line(
        f'{node.get_fully_qualified_name().strip("/")}: {" ".join(w for w in words if w)}'
    )


def key_values(pairs: Iterable[tuple[str, object]]) -> list[KeyValue]:
    """Return (key, value) pairs as KeyValue messages; the value None becomes 'unknown'."""
    return [KeyValue(key=key, value=_text(value)) for key, value in pairs]


def _text(value: object) -> str:
    if isinstance(value, float):
        return f'{value:.6g}'
    return 'unknown' if value is None else one_line(str(value))


OPTION = re.compile(
    r'(?P<open>\()?(allan [a-z]+ )?(?P<option>--[a-z-]+)(; in a node, parameter [a-z_.]+)?'
)
"""Pattern of a command line option in the text of a finding. The match includes the command before
the option and the node parameter after the option, if the text contains these."""

PARAMETERS = {
    '--no-motion-gate': 'parameter segmenter.motion_gate:=false',
    '--stamps': 'parameter segmenter.stamps:=',
    '--rate': 'parameter segmenter.declared_rate:=',
    '--skip': 'parameter segmenter.skip:=',
    '--gyro-unit': 'parameter input.gyro_unit, and restart; with a relay, correct the driver',
    '--accel-unit': 'parameter input.accel_unit, and restart; with a relay, correct the driver',
    '--topic': 'parameter input.topics:=',
    '--accel-topic': 'parameter input.accel_topics:=',
    '--motion': 'parameter relay.motion:=true',
}
"""Command line option -> text that replaces the option in a finding of a node. In the finding, the
value of the parameter follows ``:=``."""


VALUELESS = re.compile(r':=(?=\W|$)(?!\{)')
"""Pattern of ``:=`` without a following value."""


def node_text(found: Finding) -> str:
    """Return the text of a finding, with ROS parameters in place of the options in `PARAMETERS`.

    Other command line options stay, without the command before them.

    Examples
    --------
    >>> from allan_ros.core.findings import finding
    >>> node_text(finding('stamps_missing', what='zero')).split(', or ')[-1]
    'declare the sample rate with parameter segmenter.declared_rate.'
    """
    text = OPTION.sub(_parameter_text, finding_line(found)).replace(':= ', ':=')
    return VALUELESS.sub('', text)


def _parameter_text(match: re.Match[str]) -> str:
    return (match['open'] or '') + PARAMETERS.get(match['option'], match['option'])


def status_of(
    name: str,
    findings: Sequence[Finding],
    otherwise: str,
    pairs: Iterable[tuple[str, object]],
    *,
    noted: Sequence[Finding] = (),
    hardware_id: str = '',
) -> DiagnosticStatus:
    """Return a status with the level of the most severe finding in ``findings``.

    The message of the status is the first warning or error in ``findings``, followed by the ids of
    the others; without warnings and errors, it is ``otherwise``. The values of the status are the
    id of the finding in the message (or 'none'), ``pairs``, and the text of each finding in
    ``findings`` and ``noted``. Findings in ``noted`` are marked as 'earlier', and change neither
    level nor message.
    """
    # a finding about an event already states when the event happened
    marked_findings = [(f, '' if f.values.get('when') else 'now: ') for f in findings]
    marked_findings += [(f, 'earlier: ') for f in noted]
    problems = [f for f in findings if f.severity != 'info']
    other_ids = ', '.join(dict.fromkeys(f.id.replace('_', ' ') for f in problems[1:]))
    also_text = f' (also: {other_ids})' if other_ids else ''
    return DiagnosticStatus(
        level=max((LEVELS[f.severity] for f in findings), default=DiagnosticStatus.OK),
        name=name,
        message=f'{node_text(problems[0])}{also_text}' if problems else otherwise,
        hardware_id=hardware_id,
        values=key_values(
            [
                (FINDING, problems[0].id if problems else 'none'),
                *pairs,
                *((f'{FINDING}: {f.id}', f'{mark}{node_text(f)}') for f, mark in marked_findings),
            ]
        ),
    )


def input_status(
    name: str,
    hardware_id: str,
    health: StreamHealth,
    statistics: TransportStatistics,
    findings: Sequence[Finding] = (),
    noted: Sequence[Finding] = (),
    *,
    static_s: float = 0.0,
    streams: int = 1,
    others: Iterable[tuple[str, object]] = (),
) -> DiagnosticStatus:
    """Return the status of one input.

    ``findings`` determine the level and the message, and ``noted`` are findings that do not change
    them. ``static_s`` is the duration of the data at rest in the Allan sums, in s. ``streams`` is
    the number of different sample rates of gyro and accelerometer. ``others`` are (key, value)
    pairs that are added to the status.
    """
    counts = health.counts
    excluded_counts = {
        'moving': counts.moving,
        'noise increased': counts.noise_increased,
        'noise decreased': counts.noise_decreased,
        'stuck': counts.stuck,
        'not finite': counts.not_finite,
        'duplicate': counts.duplicate,
        'stamped backward': counts.backward,
        'without a time': counts.untimed,
        'skipped': counts.skipped,
        'of another frame_id': counts.other_frame,
    }
    # With two sample rates, most counts are totals over both sensors, but the number of received
    # messages is not.
    known_samples = counts.used + sum(excluded_counts.values())
    undecided_samples = counts.received + counts.interpolated - known_samples
    pairs: list[tuple[str, object]] = [
        ('state', health.state),
        ('rate [Hz]', health.rate_hz),
        ('static data [s]', static_s),
        ('share at rest', health.still_share),
        ('received [messages]', statistics.received),
        ('sent before the first came [messages]', statistics.sent_before),
        ('lost on the way [messages]', statistics.lost),
        ('malformed [messages]', statistics.malformed),
        ('used [samples]', counts.used),
        ('missing by the stamps [samples]', counts.lost),
        ('interpolated [samples]', counts.interpolated),
        *((f'{reason} [samples]', count) for reason, count in excluded_counts.items()),
        ('undecided [samples]', undecided_samples if streams == 1 else None),
        *((f'splits by {reason}', count) for reason, count in sorted(counts.splits.items())),
        ('publishers of incompatible QoS', sum(f.id == 'qos_incompatible' for f in findings)),
        ('stamps used', health.stamps),
        *others,
    ]
    text = _state_text(health, static_s)
    return status_of(name, findings, text, pairs, noted=noted, hardware_id=hardware_id)


def _state_text(health: StreamHealth, static_s: float) -> str:
    duration = f'{duration_text(static_s, 3)} of static data'
    rate = f'{health.rate_hz:.4g} Hz' if health.rate_hz else 'unknown rate'
    measured_text = f'{duration} so far' if static_s else 'not at rest yet, so nothing is measured'
    return {
        'waiting': 'waiting for the first message',
        'learning': 'learning the rate and the noise floor; keep the IMU at rest',
        'moving': f'moving, {rate}: {measured_text}',
        'noise_increased': f'noise above the noise floor, {rate}: not used, {duration} so far',
        'noise_decreased': f'noise below the noise floor, {rate}: not used, {duration} so far',
        'at_rest': f'at rest, {rate}: {duration}',
    }[health.state]


FIT_NOTES = ('settling', 'not_settled', 'bias_steps', 'level_changes', 'level_changed')
"""Ids of findings of a fit that are listed in the status of an axis, but do not change the level of
the status."""


@dataclass(frozen=True)
class AxisView:
    """Content of the status of one axis.

    ``sums`` are the Allan sums that contain the axis, or None before the first static data.
    ``result`` and ``fit_age_s`` are None without a noise model of the axis. ``problems`` are
    findings about faults of the input, a failed fit or an invalidated model. ``comparisons`` are
    checks against the datasheet and earlier results. ``margin`` is the fraction by which a
    coefficient may exceed its limit, or the noise level may change, without a warning. ``step`` is
    the change of the noise level in the recent window, or None without a change. ``noted`` are
    findings of the fit that do not change the level of the status.
    """

    axis: str
    sums: AllanSums | None
    result: AxisResult | None
    method: str
    fit_age_s: float | None
    problems: tuple[Finding, ...]
    comparisons: tuple[Check, ...]
    margin: float
    step: NoiseStep | None
    noted: tuple[Finding, ...] = ()


def axis_status(name: str, hardware_id: str, view: AxisView) -> DiagnosticStatus:
    """Return the status of one axis.

    The level of the status follows from the problems, a change of the noise level, and exceeded
    limits.
    """
    changes = [*_change_findings(view), *_limit_findings(view)]
    findings = by_consequence([*view.problems, *changes])
    static_s = view.sums.elapsed_ns * 1e-9 if view.sums else 0.0
    next_term = _next_term(view)
    pairs: list[tuple[str, object]] = []
    if view.result is not None:
        noise = view.result.fit.noise
        for term in TERMS:
            pairs += _term_pairs(view.axis, term, noise[term])
        pairs += [
            ('fit method', view.method),
            ('fit age [s]', view.fit_age_s),
            ('next coefficient', next_term or None),
        ]
    pairs += [
        ('static data [s]', static_s),
        ('segments', view.sums.segment_count if view.sums else 0),
        ('longest averaging time [s]', _longest_tau(view.sums) if view.sums else None),
    ]
    for c in view.comparisons:
        unit = shown_unit(view.axis, 'B' if c.tau is not None else c.quantity, 'deg/h')
        limit = f'{significant(c.limit * unit.factor, 3)} {unit.name}'
        pairs.append((f'{c.quantity} against {c.reference}', f'{c.verdict}, limit {limit}'))
    text = _summary(view, static_s, next_term)
    return status_of(name, findings, text, pairs, noted=view.noted, hardware_id=hardware_id)


def _term_pairs(axis: str, term: str, coefficient: Estimate) -> list[tuple[str, object]]:
    """Return the (key, value) pairs of a term for the status of an axis.

    The pairs are the value in SI and in datasheet units, the ends of the 95 % interval in datasheet
    units, and the status of the term. Unknown and infinite ends are omitted. A term that is not
    resolved has only an upper limit.
    """
    si_unit, datasheet_unit = shown_unit(axis, term, 'SI'), shown_unit(axis, term, 'deg/h')
    pairs: list[tuple[str, object]] = [
        (f'{term} [{u.name}]', value_text(coefficient, u)) for u in (si_unit, datasheet_unit)
    ]
    is_resolved = coefficient.status == 'estimated'
    low, high = (is_resolved and coefficient.ci95) or (None, coefficient.upper95)
    for end, value in (('low', low), ('high', high)):
        if value is not None and math.isfinite(value):
            text = significant(value * datasheet_unit.factor, LIMIT_DIGITS)
            pairs.append((f'{term} {end} [{datasheet_unit.name}]', text))
    return [*pairs, (f'{term} verdict', coefficient.status.replace('_', ' '))]


def _limit_findings(view: AxisView) -> list[Finding]:
    """Return a finding for each comparison in which a limit is exceeded."""
    if view.result is None:
        return []
    return [exceeds_limit(c, view.margin, ()) for c in view.comparisons if c.verdict == 'exceeds']


def _change_findings(view: AxisView) -> list[Finding]:
    """Return a list with a finding if the noise level has changed by more than the margin."""
    step = view.step
    if step is None or not step.beyond(view.margin):
        return []
    quantity_name: str = _dominant_term(view, step.tau)
    former_value, tau = step.coefficient_before(quantity_name), None
    sensor_and_term = sensor_of(view.axis), quantity_name
    if former_value is None:
        former_value, quantity_name, tau = step.before, 'the Allan deviation', step.tau
        sensor_and_term = sensor_of(view.axis), 'B'
    low, high = step.ci95
    change = finding(
        'noise_fell' if step.ratio < 1.0 else 'noise_changed',
        what=quantity_name,
        tau=tau,
        before=quantity(former_value, *sensor_and_term),
        after=quantity(former_value * step.ratio, *sensor_and_term),
        ago=step.since_s,
        low=low,
        high=high,
    )
    return [change]


def _dominant_term(view: AxisView, tau: float) -> str:
    """Return the name of the part of the model with the largest Allan deviation at ``tau`` in s.

    The name is '' without static data or without a noise model.
    """
    if view.result is None or view.sums is None or not view.sums.tau0:
        return ''
    parts = view.result.part_adev(np.array([max(1, round(tau / view.sums.tau0))]))
    return max(parts, key=lambda name: float(parts[name][0]), default='')


def _summary(view: AxisView, static_s: float, next_term: str) -> str:
    """Return N, B and K in datasheet units, and which coefficients need more data, as text.

    Without coefficients, the text states that there are none yet.
    """
    if view.sums is None:
        return 'no coefficients yet: no static data so far; keep the IMU at rest for a minute'
    static_text = f'from {duration_text(static_s, 3)} of static data'
    if view.result is None:
        return f'no coefficients yet, {static_text}'
    coefficients = []
    for term in ('N', 'B', 'K'):
        unit = shown_unit(view.axis, term, 'deg/h')
        text = value_text(view.result.fit.noise[term], unit)
        if text != '-':
            coefficients.append(f'{term} {text} {unit.name}')
    coefficients_text = f'{", ".join(coefficients) or "no coefficient"} {static_text}'
    return f'{coefficients_text}; {next_term}' if next_term else coefficients_text


def _next_term(view: AxisView) -> str:
    """Return a text such as 'B and K need 2 h at rest'; '' if more data are not useful.

    The text is also '' without a noise model, and for other methods than 'likelihood'.
    """
    if view.result is None or view.method != 'likelihood':
        return ''
    limits = {c.quantity: c.limit for c in view.comparisons if c.tau is None}
    longest_samples = view.sums.longest if view.sums else 0
    longest_segment_s = longest_samples * view.result.tau0
    advice = recommended_duration(view.result.fit, longest_segment_s, limits)
    if advice is None:
        return ''
    seconds, terms = advice
    verb = 'needs' if len(terms) == 1 else 'need'
    return f'{" and ".join(terms)} {verb} {duration_text(seconds)} at rest'


def _longest_tau(sums: AllanSums) -> float | None:
    # indices of the averaging factors with at least one difference
    indices = np.flatnonzero(sums.count)
    return float(sums.m[indices[-1]] * sums.tau0) if len(indices) and sums.tau0 else None


ENDS = ('', ' low', ' high')
"""Suffixes of the keys for a value, and for the lower and upper end of its 95 % interval."""


def motion_status(
    name: str, hardware_id: str, drives: Drives, results: Results | None, limit: float
) -> DiagnosticStatus:
    """Return the status of the errors in motion of one IMU.

    ``drives`` are the latest drives. ``results`` are None without a noise model; they contain the
    factors in motion if these are known. A factor in motion is the error in motion divided by its
    prediction from the noise at rest. If the 95 % interval of a factor lies above ``limit``, there
    is a warning.
    """
    unused = sum(drives.unused.values())
    pairs: list[tuple[str, object]] = [('drives', len(drives.errors)), ('drives not used', unused)]
    motion = results.motion if results is not None else None
    if motion is None:
        rest_s = results.duration_s if results is not None else 0.0
        text = (
            f'not measured yet: {len(drives.errors)} of at least {LEAST_DRIVES} drives between '
            f'rests, {rest_s:.0f} of at least {LEAST_REST_S:g} s at rest'
        )
        if len(drives.errors) >= LEAST_DRIVES and rest_s >= LEAST_REST_S:
            text = 'not measured: the rests do not show the noise of the sensor'
        return status_of(name, [], text, pairs, hardware_id=hardware_id)
    findings, error_texts = [], []
    for sensor, sensor_motion in motion.sensors.items():
        low, high = sensor_motion.factor.ci95 or (0.0, math.inf)
        ratio, error = sensor_motion.factor.value or 1.0, INTEGRAL_NAMES[sensor]
        ratio_and_ends = [significant(value, 2) for value in (ratio, low, high)]
        error_texts.append('{} error {} ({} to {})'.format(error, *ratio_and_ends))
        factor_key = f'factor of the {error} error'
        pairs += [(f'{factor_key}{end}', text) for end, text in zip(ENDS, ratio_and_ends)]
        for term, factor in sensor_motion.term_factors.items():
            pairs.append((f'factor of {term} of the {sensor}', significant(factor.value or 1.0, 2)))
        if low > limit:
            axes = tuple(axis for axis in AXES if sensor_of(axis) == sensor)
            findings.append(
                finding(
                    'worse_in_motion',
                    axes,
                    error=error,
                    ratio=ratio,
                    low=low,
                    high=high,
                    drives=len(motion.drives),
                    limit=limit,
                )
            )
    pairs.append(('cause', causes_text(motion) or None))
    text = (
        f'in motion: {", ".join(error_texts)} times the noise at rest, {len(motion.drives)} drives'
    )
    return status_of(name, findings, text, pairs, hardware_id=hardware_id)


def metrics_text(statuses: Sequence[DiagnosticStatus]) -> str:
    """Return statuses as the text of a file for the textfile collector of Prometheus.

    Examples
    --------
    >>> from diagnostic_msgs.msg import KeyValue
    >>> status = DiagnosticStatus(name='allan_monitor: imu gyro x', hardware_id='SN 7')
    >>> status.values = [KeyValue(key='N [deg/sqrt(h)]', value='0.24')]
    >>> print(metrics_text([status]).splitlines()[-1])
    allan_ros_value{node="allan_monitor",status="imu gyro x",hardware_id="SN 7",quantity="N",unit="deg/sqrt(h)"} 0.24
    """  # noqa: E501
    # the lines are sorted, because Prometheus requires consecutive lines for each metric
    return '\n'.join([*sorted(line for status in statuses for line in _metrics(status)), ''])


def _metrics(status: DiagnosticStatus) -> Iterator[str]:
    node, _, name = status.name.partition(': ')
    labels = {'node': node, 'status': name, 'hardware_id': status.hardware_id}
    yield _metric('level', int.from_bytes(status.level, 'little'), **labels)
    for pair in status.values:
        quantity, _, unit = pair.key.removesuffix(']').partition(' [')
        if quantity.startswith(f'{FINDING}: '):
            yield _metric('finding', 1, **labels, id=quantity.removeprefix(f'{FINDING}: '))
        elif re.fullmatch(NUMBER_TEXT, pair.value):
            yield _metric('value', pair.value, **labels, quantity=quantity, unit=unit)


def _metric(metric: str, value: object, **labels: str) -> str:
    # JSON escapes quotation marks, backslashes and line breaks in the same way as Prometheus
    label_text = ','.join(
        f'{name}={json.dumps(text, ensure_ascii=False)}' for name, text in labels.items()
    )
    return f'allan_ros_{metric}{{{label_text}}} {value}'
