# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statuses name the state, finite numbers with units, and the next step, also for Prometheus."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus
from support.findings import example
from support.numbers import NO_NUMBER, noiseless_sums, noisy_sums

from allan_ros.core.allan.recent import NoiseStep, noise_steps
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.check import Check
from allan_ros.core.estimate import Estimate
from allan_ros.core.findings import CATALOG, finding
from allan_ros.core.fit.result import TERMS, AxisFit
from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.core.stream.health import Counts, StreamHealth
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.core.stream.transport import TransportStatistics
from allan_ros.nodes import diagnostics
from allan_ros.nodes.diagnostics import AxisView, axis_status, input_status, metrics_text, node_text
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.axis_result import AxisResult
from allan_ros.view.finding_text import finding_line

DEG_PER_SQRT_H = np.pi / 180.0 / 60.0
N = 0.2 * DEG_PER_SQRT_H
NOT_SEEN = Estimate(None, None, 1e-6, 'not_observable')


@pytest.fixture(scope='module')
def sums():
    accumulator = ImuStream()
    noise = np.random.default_rng(0).normal(size=(5000, 6))
    accumulator.update(ImuBatch(10**18 + np.arange(5000) * 5 * 10**6, noise, frame_id='imu'))
    return accumulator.result().sums[0]


def fit(**noise: Estimate) -> AxisResult:
    found = {term: noise.get(term, NOT_SEEN) for term in TERMS}
    found['N'] = noise.get('N', Estimate(N, (0.95 * N, 1.05 * N)))
    terms = {term: c.value or 0.0 for term, c in found.items()}
    return AxisResult(0.005, AxisFit(found, Model.of(**terms)))


def status_of(sums, **changes) -> DiagnosticStatus:
    view = AxisView('gyro_z', sums, fit(), 'likelihood', 3.0, (), (), 0.2, None)
    return axis_status('node: imu gyro z', 'imu', replace(view, **changes))


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {v.key: v.value for v in status.values}


def test_the_coefficients_are_shown_in_both_unit_systems(sums):
    status = status_of(sums)
    told = values(status)
    assert status.level == DiagnosticStatus.OK and status.hardware_id == 'imu'
    assert status.message.startswith('N 0.2000 deg/sqrt(h), B < 0.206 deg/h')
    assert 'from 25 s of static data; K needs 2 h at rest' in status.message
    assert float(told['N [rad/s/sqrt(Hz)]']) == pytest.approx(N, rel=1e-3)
    assert told['N [deg/sqrt(h)]'] == '0.2000'
    assert told['N verdict'] == 'estimated' and told['K verdict'] == 'not observable'
    assert told['B [deg/h]'] == '< 0.206'
    # plain numbers, since plotters draw neither "0.190..0.210" nor "< 0.206"
    assert [float(told[f'N {end} [deg/sqrt(h)]']) for end in ('low', 'high')] == [0.19, 0.21]
    assert float(told['B high [deg/h]']) == 0.206 and 'B low [deg/h]' not in told
    assert told['static data [s]'] == '24.995' and told['fit age [s]'] == '3'


def test_the_status_before_a_fit_is_reported(sums):
    assert status_of(sums, result=None).message.startswith('no coefficients yet, from 25 s')
    assert status_of(None, result=None).message.startswith('no coefficients yet: no static data')


def test_a_failed_fit_is_an_error_with_its_reason(sums):
    failed = status_of(sums, problems=(finding('fit_failed', reason='the numbers are damaged'),))
    assert failed.level == DiagnosticStatus.ERROR
    assert failed.message.startswith('The fit failed: the numbers are damaged.')


def test_only_relevant_terms_are_recommended(sums):
    large, small = (Estimate(2e-5, None, size, 'not_observable') for size in (1e-3, 1e-9))
    status = status_of(sums, result=fit(B=large, K=small))
    assert 'B needs 4 h at rest' in status.message
    assert values(status)['next coefficient'] in status.message
    for quiet in (fit(B=small, K=small), None):
        assert 'at rest' not in status_of(sums, result=quiet).message
    assert 'needs' not in status_of(sums, result=fit(B=large), method='paper').message


def test_a_coefficient_above_its_limit_is_a_warning_with_advice(sums):
    limit, measured = 0.1 * DEG_PER_SQRT_H, Estimate(N, (0.95 * N, 1.05 * N))
    beyond = Check('gyro_z', 'N', 'ADIS', measured, upper=limit, verdict='exceeds')
    within = Check('gyro_z', 'B', 'ADIS', upper=1.0, verdict='within')
    status = status_of(sums, comparisons=(within, beyond))
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith(
        'N is 0.200 deg/sqrt(h) (0.190 to 0.210), above the 0.100 deg/sqrt(h) of ADIS by more than '
        '20 %. Check vibration'
    )
    assert values(status)['N against ADIS'] == 'exceeds, limit 0.100 deg/sqrt(h)'
    assert values(status)['B against ADIS'].startswith('within')
    assert status_of(sums, comparisons=(within,)).level == DiagnosticStatus.OK


def test_a_change_is_reported_in_the_dominant_coefficient(sums):
    step = NoiseStep(0.04, N / 0.04**0.5, 1.5, (1.48, 1.52), 2400.0)
    status = status_of(sums, step=step)
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith(
        'N rose from 0.200 deg/sqrt(h) to 0.300 deg/sqrt(h) 40 min ago '
        '(95 % interval of the ratio: 1.48 to 1.52)'
    )
    flicker = fit(B=Estimate(1.0, (0.9, 1.1)))
    message = status_of(sums, step=step, result=flicker).message
    assert 'the Allan deviation at 0.04 s rose from' in message
    quiet = replace(step, ci95=(1.1, 1.9))
    assert status_of(sums, step=quiet).level == DiagnosticStatus.OK


def of_input(health: StreamHealth, *given, **named) -> DiagnosticStatus:
    return input_status('node: imu input', 'imu', health, TransportStatistics(), *given, **named)


def test_the_message_of_the_input_is_its_most_severe_finding():
    silent = finding('input_silent', topic='/imu', seconds=3.2, publishers=1)
    several = finding('several_publishers', topic='/imu', count=2, names='/a, /b')
    status = of_input(StreamHealth(Counts()), (silent, several))
    assert status.level == DiagnosticStatus.ERROR
    assert status.message.startswith('No message on /imu for 3.2 s')
    assert status.message.endswith('(also: several publishers)')
    assert values(status)['finding: several_publishers'].startswith('now: 2 publishers')
    earlier = of_input(StreamHealth(Counts()), (), (finding('gaps', lost=3, splits=1),))
    assert values(earlier)['finding: gaps'].startswith('earlier: 3 samples')


NOT_LIVE = {
    'unit_assumed',
    'stamp_unit_assumed',
    'columns_unrecognized',
    'rate_implausible',
    'export_no_gauss_markov',
    'export_two_numbers',
}
"""Findings of files and exports, which no node has."""


def test_a_node_names_parameters_not_options():
    for id in CATALOG:
        assert id in NOT_LIVE or not re.search(r'--[a-z]', node_text(example(id))), id
    gate = finding('never_still', seconds=60.0)
    assert node_text(gate).endswith('gate off (parameter segmenter.motion_gate:=false).')
    unit = finding('accel_unit', ('accel_z',), norm=1.0, unit='g')
    assert 'input.accel_unit, and restart; with a relay, correct the driver' in node_text(unit)
    assert of_input(StreamHealth(Counts()), (unit,)).message == node_text(unit)


def test_moving_is_ok_and_foreign_text_is_escaped():
    frame = 'imu\x1b[2J\u202e'
    health = StreamHealth(Counts(), 'moving', 100.0, frame_id=frame)
    status = of_input(health, others=[('publishers', frame)])
    assert status.level == DiagnosticStatus.OK
    assert status.message.startswith('moving, 100 Hz: not at rest yet')
    assert all(v.value.isprintable() for v in status.values)
    assert values(status)['share at rest'] == 'unknown'
    moved = StreamHealth(Counts(received=9000, used=8000, moving=2000), 'at_rest', 200.0)
    assert values(of_input(moved))['share at rest'] == '0.8'


def check_status(status: DiagnosticStatus) -> None:
    assert status.message[:1].strip()
    for said in (status.message, *(f'{v.key}: {v.value}' for v in status.values)):
        assert not NO_NUMBER.search(said), said


@pytest.mark.parametrize('make', [noiseless_sums, noisy_sums])
def test_the_numbers_of_an_axis_are_finite(make: Callable[[], AllanSums]) -> None:
    sums = make()
    results = analyze_sums([sums], Provenance(), 'paper')
    steps = noise_steps(sums, 10.0)
    for axis, result in results.axes.items():
        for fitted in (None, result):
            view = AxisView(axis, sums, fitted, 'paper', 1e300, (), (), 0.2, steps.get(axis))
            check_status(axis_status('node: imu', 'imu', view))


@pytest.mark.parametrize('count', [0, 1, 10**18])
def test_the_numbers_of_an_input_are_finite(count: int) -> None:
    health = StreamHealth(Counts(received=count, used=count), first_ns=0)
    named = {'static_s': float(count), 'others': [('stamp age [s]', -1e300)]}
    check_status(input_status('node: imu', 'imu', health, TransportStatistics(), **named))


LINE = re.compile(r'(allan_ros_\w+)(\{(?:\w+="(?:[^"\\\n]|\\["\\n])*",?)*\})? \S+')


def test_every_line_is_valid_and_unique():
    found = [finding('no_publisher', topic='/imu'), finding('no_noise', ('gyro_x',))]
    pairs = [('N [deg/sqrt(h)]', 0.24), ('rate [Hz]', None), ('topic', '/a "b" \\ c'), ('n', 3)]
    statuses = [
        diagnostics.status_of(name, found, '', pairs, hardware_id='SN "7"')
        for name in ('robot/allan_monitor: imu gyro x', 'allan_monitor: imu/data input')
    ]
    text = metrics_text(statuses)
    lines = text.splitlines()
    assert text.endswith('\n') and all(LINE.fullmatch(line) for line in lines)
    assert len({line.rsplit(' ', 1)[0] for line in lines}) == len(lines)
    metrics = [line.split('{')[0] for line in lines]
    assert metrics == sorted(metrics)  # each metric in one group
    assert sum('quantity="N",unit="deg/sqrt(h)"} 0.24' in line for line in lines) == 2
    assert sum('id="no_publisher"} 1' in line for line in lines) == 2
    assert not any('topic' in line or 'rate' in line for line in lines)
    assert sum(line.startswith('allan_ros_level') and line.endswith(' 2') for line in lines) == 2


def test_the_key_finding_has_the_id_of_the_finding_in_the_message():
    info, error = finding('no_noise', ('gyro_x',)), finding('no_publisher', topic='/imu')
    status = diagnostics.status_of('a: b', [error, info], 'fine', [])
    assert (status.values[0].key, status.values[0].value) == ('finding', 'no_publisher')
    assert status.message.startswith(finding_line(error))
    assert diagnostics.status_of('a: b', [], 'fine', []).values[0].value == 'none'
