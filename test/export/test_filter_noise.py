# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files for filters: the right axis, the right unit, and no value that a reader rejects."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import Any

import pytest
import yaml
from support.exports import with_coefficient

from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate, Status
from allan_ros.core.filters.motion_factors import (
    DriveRatio,
    NoiseInMotion,
    SensorInMotion,
)
from allan_ros.core.findings import finding
from allan_ros.export import (
    TARGETS,
    ExportOptions,
    make_export,
    target_of,
    target_rows,
)
from allan_ros.results.results import Results
from allan_ros.view.finding_text import explained, finding_line

BARE = ExportOptions(fidelity='coefficients')


@pytest.fixture
def results(known_results: Results) -> Results:
    return known_results


def test_inflation_multiplies_the_worst_axis_and_a_topic_is_named(results: Results) -> None:
    options = ExportOptions('10', topic='/imu7', fidelity='coefficients')
    read = yaml.safe_load(make_export(results, 'kalibr', options).text)
    assert read['gyroscope_noise_density'] == pytest.approx(10.0 * 1e-3, rel=1e-5)
    assert read['rostopic'] == '/imu7'


@pytest.mark.parametrize('target', ['kalibr', 'kf_gins', 'gazebo', 'state_space'])
@pytest.mark.parametrize('status', ['estimated', 'not_observable'])
def test_a_value_without_interval_is_stated(results: Results, target: str, status: Status) -> None:
    unsure = results
    for axis in results.axes:  # K is the only drift; it is likely, or its method gives no interval
        for term in ('B', 'R'):
            unsure = with_coefficient(
                unsure, axis, term, Estimate(None, None, 1e-12, 'not_observable')
            )
        unsure = with_coefficient(unsure, axis, 'K', Estimate(4e-6, None, 5e-6, status))
    made = make_export(unsure, target)
    assert 'values without a 95 % interval: ' in made.text
    assert 'export_no_interval' in [found.id for found in made.findings]


@pytest.mark.parametrize('missing', ['accel', 'gyro_x'])
def test_absent_sensors_and_axes_are_named(results: Results, missing: str) -> None:
    axes = {n: a for n, a in results.axes.items() if not n.startswith(missing)}
    with pytest.raises(AllanError, match=f'no {missing} in these results'):
        make_export(replace(results, axes=axes), 'kalibr')


@pytest.mark.parametrize('tau0', [0.0, -1.0, math.nan, math.inf])
def test_results_without_a_rate_are_rejected(results: Results, tau0: float) -> None:
    with pytest.raises(AllanError, match='no sample rate'):
        make_export(replace(results, tau0=tau0), 'kalibr')


def wrong_units(results: Results) -> Results:
    found = finding('gyro_unit', n=0.1, rate=0.2, unit='deg/s')
    return replace(
        results,
        findings=(*results.findings, finding('noise_increased', ratio=3.0, seconds=9.0), found),
    )


@pytest.mark.parametrize('target', TARGETS)
def test_wrong_units_refuse_every_file_and_every_parameter(results: Results, target: str) -> None:
    for use in (make_export, target_rows):
        with pytest.raises(AllanError, match='--force') as caught:
            use(wrong_units(results), target)
        assert 'probably deg/s.' in str(explained(caught.value))
    text = make_export(wrong_units(results), target, ExportOptions(force=True), finding_line).text
    assert 'The gyro at rest has N' in text[text.index('warning:') :].splitlines()[0]
    assert 'warning: The noise increased to 3.0 times' in text
    if not target_of(target).file_name.endswith('.json'):
        assert any('warning: ' in line for line in text.splitlines()[:2])


def test_rows_have_names_units_and_intervals(results: Results) -> None:
    rows = {row.name: row for row in target_rows(results, 'fast_lio', BARE)}
    assert list(rows) == [f'mapping.{name}_cov' for name in ('gyr', 'acc', 'b_gyr', 'b_acc')]
    gyro = rows['mapping.gyr_cov']
    assert gyro.values == (pytest.approx(1e-3**2 * 200.0),)
    assert gyro.interval == pytest.approx((0.81 * gyro.value, 1.21 * gyro.value))
    assert gyro.unit == '(rad/s)^2'
    for target in TARGETS:
        for row in target_rows(results, target):
            low, high = row.interval
            inside = low <= max(row.values) * 1.00001 and min(row.values) <= high * 1.00001
            assert inside or 'lies outside' in row.words, (target, row.name)


@pytest.mark.parametrize(
    'given', ['gyro=2,accel=3', ' accel = 3, gyro=2.0', {'gyro': 2, 'accel': 3}]
)
def test_each_sensor_has_its_own_factor(results: Results, given: Any) -> None:
    text = make_export(results, 'kalibr', ExportOptions(inflate=given)).text
    plain, inflated = map(yaml.safe_load, (make_export(results, 'kalibr').text, text))
    for sensor, factor in (('gyroscope', 2.0), ('accelerometer', 3.0)):
        for key in (f'{sensor}_noise_density', f'{sensor}_random_walk'):
            assert inflated[key] == pytest.approx(factor * plain[key], rel=1e-5)
    assert 'inflation: gyro x2, accel x3 on every N, K and bias' in text


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ('', "inflate is '': a number is expected"),
        ('gyro=2,magnet=3', 'inflate is gyro=2,magnet=3: write a factor such as 2, or one for'),
        ('gyro=0.5', 'inflate is 0.5: it must lie between 1 and 1000'),
        ('nan', 'inflate is nan'),
        ('gyro=two', "inflate is 'two': a number is expected"),
        ({'gyro': None}, "inflate is 'None': a number is expected"),
        (True, 'inflate is True: a text is expected'),
        ([2.0, 3.0], 'a text is expected'),
    ],
)
def test_a_wrong_factor_is_refused(given: Any, said: str) -> None:
    with pytest.raises(AllanError, match=re.escape(said)):
        ExportOptions(inflate=given)


def in_motion(results: Results, white: float | None, slow: float | None) -> Results:
    """Return results with factors of the gyro; N and K of the accelerometer have 0.8."""

    def factor(value: float | None) -> Estimate | None:
        return value and Estimate(value, (0.8 * value, 1.2 * value))

    motion = NoiseInMotion(
        SensorInMotion(Estimate(2.8, (2.3, 3.4)), factor(white), factor(slow)),
        SensorInMotion(Estimate(0.8, (0.6, 1.1)), factor(0.8), factor(0.8)),
        (),
        tuple(DriveRatio(20.0, 1.0, 3.0, 0.8) for _ in range(24)),
    )
    return replace(results, motion=motion)


PARTS = [(3.0, None), (None, 4.0), (3.0, 3.0), (3.0, 4.0)]


@pytest.mark.parametrize(
    ('white', 'slow', 'said'),
    [
        (3.0, None, 'N x3.00 (2.40 to 3.60)'),
        (None, 4.0, 'K x4.00 (3.20 to 4.80)'),
        (3.0, 3.0, 'N and K x3.00 (2.40 to 3.60)'),
        (3.0, 4.0, 'N x3.00 (2.40 to 3.60) and K x4.00 (3.20 to 4.80)'),
    ],
)
def test_the_factors_in_motion_raise_the_noise_that_grew(
    results: Results, white: float | None, slow: float | None, said: str
) -> None:
    moved = in_motion(results, white, slow)
    text = make_export(moved, 'kalibr', ExportOptions(motion=True)).text
    plain, raised = map(yaml.safe_load, (make_export(results, 'kalibr').text, text))
    for key, factor in zip(('noise_density', 'random_walk'), (white or 1.0, slow or 1.0)):
        assert raised[f'gyroscope_{key}'] == pytest.approx(factor * plain[f'gyroscope_{key}'], 1e-5)
        # a factor below 1 lowers nothing: the noise at rest is also there in motion
        assert raised[f'accelerometer_{key}'] == plain[f'accelerometer_{key}']
    (line,) = (line for line in text.splitlines() if 'inflation:' in line)
    assert line.endswith(
        f'inflation: in motion, gyro {said}, accel N and K not raised, x0.800 (0.640 to 0.960), '
        'from 24 drives; the levels below are without these factors'
    )


@pytest.mark.parametrize(('white', 'slow'), PARTS)
def test_factors_in_motion_reach_every_computed_file(
    results: Results, white: float | None, slow: float | None
) -> None:
    moved, options = in_motion(results, white, slow), ExportOptions(motion=True)
    gain, plain = (
        target_rows(known, 'imu_filter_madgwick', chosen)[0].value
        for known, chosen in ((moved, options), (results, ExportOptions()))
    )
    assert 1.0 < gain / plain <= 4.001
    before, after = (
        json.loads(make_export(known, 'state_space', chosen).text)
        for known, chosen in ((results, ExportOptions()), (moved, options))
    )
    for factor, key in ((white or 1.0, 'white'), (slow or 1.0, 'walk')):
        ratio = after['axes']['gyro_x'][key] / before['axes']['gyro_x'][key]
        assert ratio == pytest.approx(factor, rel=1e-5)


def test_factors_in_motion_are_refused_if_they_are_not_known(results: Results) -> None:
    with pytest.raises(AllanError, match='no factor in motion; analyze a recording'):
        make_export(results, 'kalibr', ExportOptions(motion=True))
    with pytest.raises(AllanError, match='inflate and motion both multiply'):
        ExportOptions(inflate='gyro=2', motion=True)


def test_a_gain_without_an_interval_has_none(results: Results) -> None:
    unsure = results
    for axis in results.axes:
        unsure = with_coefficient(unsure, axis, 'N', Estimate(1e-4))
    gain, _ = target_rows(unsure, 'imu_filter_madgwick')
    assert gain.ratio == math.inf and gain.value > 0.0


def test_a_gain_from_an_upper_limit_of_n_is_reported(results: Results) -> None:
    limit = Estimate(None, upper95=1e-2, status='not_observable')
    known, unsure = results, with_coefficient(results, 'gyro_y', 'N', limit)
    assert not target_rows(known, 'imu_filter_madgwick')[0].is_limit
    gain, _ = target_rows(unsure, 'imu_filter_madgwick')
    assert gain.is_limit and gain.interval == (0.0, pytest.approx(gain.value, rel=1e-5))
    made = make_export(unsure, 'imu_filter_madgwick')
    assert '# upper limits instead of measurements: gain' in made.text
    assert 'export_limits' in [f.id for f in made.findings]


def test_the_gain_covers_the_bias_at_rest(results: Results) -> None:
    options = ExportOptions(inflate=2.0)
    gain, zeta = target_rows(results, 'imu_filter_madgwick', options)
    biased, same = target_rows(results, 'imu_filter_madgwick', options, {'gyro_y': 1e-2})
    # a factor on the noise does not multiply the bias
    assert biased.value == pytest.approx(math.sqrt(0.75) * 1e-2, rel=1e-2)
    assert gain.value < biased.value and biased.ratio < gain.ratio
    assert same == zeta
