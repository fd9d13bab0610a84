# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files for filters: the right axis, the right unit, and no value that a reader rejects."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import yaml
from support.exports import with_coefficient

from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate, Status
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
    options = ExportOptions(10.0, topic='/imu7', fidelity='coefficients')
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
    found = finding('gyro_unit', n=0.1, rate=0.2)
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


def test_a_gain_without_an_interval_has_none(results: Results) -> None:
    unsure = results
    for axis in results.axes:
        unsure = with_coefficient(unsure, axis, 'N', Estimate(1e-4))
    gain, _ = target_rows(unsure, 'imu_filter_madgwick')
    assert gain.ratio == math.inf and gain.value > 0.0


def test_the_gain_covers_the_bias_at_rest(results: Results) -> None:
    options = ExportOptions(inflate=2.0)
    gain, zeta = target_rows(results, 'imu_filter_madgwick', options)
    biased, same = target_rows(results, 'imu_filter_madgwick', options, {'gyro_y': 1e-2})
    assert biased.value == pytest.approx(2.0 * math.sqrt(0.75) * 1e-2, rel=1e-2)
    assert gain.value < biased.value and biased.ratio < gain.ratio
    assert same == zeta
