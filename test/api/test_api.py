# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public functions: every kind of source, units, tables, pictures and files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.core.imu import AXES, DEGREE, STANDARD_GRAVITY

RATE = 100.0
QUICK = {'method': 'paper'}
"""The fastest method, for tests that do not depend on the fit."""


@pytest.fixture(scope='module')
def noise() -> np.ndarray:
    return np.random.default_rng(7).normal(scale=1e-3, size=(8000, 6))


@pytest.fixture(scope='module')
def results() -> ar.Results:
    return ar.analyze(ar.simulate(hours=0.1, rate=50, seed=1))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError):
        _ = ar.nothing


@pytest.mark.parametrize(
    ('columns', 'axes', 'found'),
    [
        (1, None, AXES[:1]),
        (1, 'accel_z', ('accel_z',)),
        (2, ['accel_y', 'gyro_z'], ('gyro_z', 'accel_y')),
        (3, None, AXES[:3]),
        (3, 'accel', AXES[3:]),
        (4, ['gyro_x', 'accel_x', 'accel_y', 'accel_z'], (AXES[0], *AXES[3:])),
        (6, None, AXES),
    ],
)
def test_one_to_six_axes(
    noise: np.ndarray, columns: int, axes: str | list[str] | None, found: tuple[str, ...]
) -> None:
    samples = noise[:, :columns]
    r = ar.analyze(samples[:, 0] if columns == 1 else samples, rate=RATE, axes=axes, **QUICK)
    assert tuple(r) == found
    assert not r.findings or all(f.id != 'sensor_absent' for f in r.findings)


def test_one_axis_gives_the_same_sums_as_among_six(noise: np.ndarray) -> None:
    alone = ar.analyze(noise[:, 2], rate=RATE, axes='gyro_z', motion_gate=False, **QUICK)
    among = ar.analyze(noise, rate=RATE, motion_gate=False, **QUICK)
    assert np.array_equal(alone['gyro_z'].curve.adev, among['gyro_z'].curve.adev)


def test_units_of_samples(noise: np.ndarray) -> None:
    si = ar.analyze(noise, rate=RATE, **QUICK)
    scaled = noise.copy()
    scaled[:, :3] /= DEGREE
    scaled[:, 3:] /= STANDARD_GRAVITY
    other = ar.analyze(scaled, rate=RATE, gyro_unit='deg/s', accel_unit='g', **QUICK)
    for axis in AXES:
        assert other[axis].N.value == pytest.approx(si[axis].N.value, rel=1e-9)


def test_a_mapping_names_its_columns_and_times(noise: np.ndarray) -> None:
    times = np.arange(len(noise)) / RATE
    columns = {'time': times, 'wz [deg/s]': noise[:, 2], 'temperature': times}
    r = ar.analyze(columns, **QUICK)
    assert tuple(r) == ('gyro_z',)
    assert r.rate_hz == pytest.approx(RATE)
    plain = ar.analyze(noise[:, 2], rate=RATE, axes='gyro_z', gyro_unit='deg/s', **QUICK)
    assert r['gyro_z'].N.value == pytest.approx(plain['gyro_z'].N.value, rel=1e-6)


def test_a_data_frame_by_name_and_date(noise: np.ndarray) -> None:
    pandas = pytest.importorskip('pandas')
    index = pandas.date_range('2026-01-01', periods=len(noise), freq='10ms')
    frame = pandas.DataFrame(noise[:, 3:], columns=['ax', 'ay', 'az'], index=index)
    r = ar.analyze(frame, **QUICK)
    assert tuple(r) == AXES[3:]
    assert r.rate_hz == pytest.approx(RATE)
    assert len(r.table()) == 15


def test_adev_of_one_and_several_columns(noise: np.ndarray) -> None:
    one, several = ar.adev(noise[:, 0], rate=RATE), ar.adev(noise, rate=RATE)
    assert one.adev.shape == one.tau.shape
    assert np.array_equal(several.adev[:, 0], one.adev)
    assert one.tau[0] == pytest.approx(1.0 / RATE)
    assert (one.ci_low < one.adev).all() and (one.adev < one.ci_high).all()
    # overlapping differences of m = 1, by definition
    y = noise[:, 0]
    assert one.adev[0] == pytest.approx(np.sqrt(np.mean(np.diff(y) ** 2) / 2.0), rel=1e-12)


@pytest.mark.parametrize('rate', [1e-300, 7e8, 1e12])
def test_adev_has_exact_averaging_times_at_extreme_rates(noise: np.ndarray, rate: float) -> None:
    one = ar.adev(noise[:100, 0], rate=rate)
    assert one.tau[:3] * rate == pytest.approx([1.0, 2.0, 3.0], rel=1e-12)


def test_adev_needs_a_column() -> None:
    with pytest.raises(ar.AllanError, match=r'shape \(5, 0\)'):
        ar.adev(np.zeros((5, 0)))


def test_adev_agrees_with_allantools(noise: np.ndarray) -> None:
    allantools = pytest.importorskip('allantools')
    curve = ar.adev(noise[:, 1], rate=RATE)
    tau, theirs, *_ = allantools.oadev(noise[:, 1], rate=RATE, data_type='freq', taus=curve.tau[:9])
    assert curve.adev[: len(tau)] == pytest.approx(theirs, rel=1e-9)


def test_quantities_change_units(results: ar.Results) -> None:
    n = results['gyro_x'].N
    shown = n.to('deg/sqrt(h)')
    assert shown.value == pytest.approx(n.value * 60.0 / DEGREE)
    assert shown.to(n.unit).ci95 == pytest.approx(n.ci95)
    assert shown.unit in repr(shown)
    with pytest.raises(ar.AllanError, match='deg/sqrt'):
        n.to('ug')
    limits = [results[a].quantity(t) for a in results for t in 'QBKR']
    assert any(q.value is None and repr(q).startswith('< ') for q in limits)


def test_a_summary_names_every_axis_without_control_characters(results: ar.Results) -> None:
    assert repr(results).startswith('imu_link: 18,000 samples at 50 Hz, 6 min')
    assert all(axis in repr(results) for axis in AXES)
    strange = ar.analyze(ar.simulate(hours=0.05, rate=50, frame_id='\x1b[31m'), **QUICK)
    assert '\x1b' not in repr(strange)


def test_pictures(results: ar.Results) -> None:
    figure = pytest.importorskip('matplotlib.figure').Figure()
    panels = figure.subplots(1, 2)
    assert results.plot('gyro', ax=panels[0]) is panels[0]
    assert len(panels[0].lines) == 6  # points and fit of three axes
    results.plot('accel_z', ax=panels[1], units='SI')
    assert len(results.plot('accel_z').axes) == 1
    assert len(results.plot('accel').axes) == 3
    with pytest.raises(ar.AllanError, match='choose one of'):
        results.plot('mag')


def test_files(results: ar.Results, tmp_path: Path) -> None:
    written = {path.name for path in results.save(tmp_path / 'out', targets=('openvins',))}
    assert {'results.json', 'sums.json', 'imu.yaml', 'report.html'} <= written
    text = results.export('kalibr', tmp_path, inflate=2.0)
    assert (tmp_path / 'imu.yaml').read_text() == text
    again = ar.load(tmp_path / 'out')
    assert repr(again).splitlines()[:4] == repr(results).splitlines()[:4]
    assert ar.analyze(again).samples == results.samples
    lonely = ar.load(tmp_path / 'out' / 'results.json')
    for fails in (lambda: lonely.save(tmp_path / 'x'), lambda: ar.analyze(lonely)):
        with pytest.raises(ar.AllanError, match='without their sums'):
            fails()


def test_a_curve_of_another_tool_is_fitted() -> None:
    curve = ar.adev(np.random.default_rng(5).normal(scale=1e-3, size=60_000), rate=RATE)
    for given in (curve, (curve.tau, curve.adev)):
        axis = ar.fit(given, axis='accel_y', record=600.0)
        assert axis.N.value == pytest.approx(1e-4, rel=0.05)
        assert axis.N.to('m/s/sqrt(h)').unit == 'm/s/sqrt(h)'
    backward = ar.fit((curve.tau[::-1], curve.adev[::-1]), axis='accel_y', record=600.0)
    assert backward.tau0 == axis.tau0 and (backward.curve.m == axis.curve.m).all()
    assert backward.N == axis.N


def test_the_model_has_the_averaging_times_of_lists() -> None:
    tau = np.geomspace(0.1, 1000.0, 60)
    assert ar.fit((tau, 1e-3 / np.sqrt(tau))).model_line().adev * np.sqrt(tau) == pytest.approx(
        1e-3, rel=1e-3
    )


def test_results_from_the_same_sums_are_equal(results: ar.Results) -> None:
    assert ar.analyze(results) == ar.analyze(results)
    assert results['gyro_x'].curve != results['gyro_y'].curve
    assert ar.adev([1.0, 2.0]) != 3


def test_the_error_growth_of_unknown_noise_has_no_interval() -> None:
    axis = ar.analyze(np.ones(2000), rate=RATE)['gyro_x']
    assert {(each.std.value, each.std.ci95) for each in axis.growth} == {(0.0, None)}


def test_results_are_added() -> None:
    parts = [ar.simulate(hours=0.05, rate=50, seed=i) for i in range(2)]
    one, two = (ar.analyze(part, **QUICK) for part in parts)
    assert ar.analyze([one, two], **QUICK).samples == sum(len(part) for part in parts)
    with pytest.raises(ar.AllanError, match='give each recording once'):
        ar.analyze([one, one])


def test_a_comparison_keeps_its_margin_until_another_is_stated(tmp_path: Path) -> None:
    plain = ar.analyze(ar.simulate(hours=0.05, rate=50), **QUICK)
    lenient = plain.compared('adis16475-3', margin=0.5)
    lenient.save(tmp_path)
    for results in (lenient, ar.load(tmp_path)):
        assert results.margin == 0.5 and results.datasheet_checks
        assert results.compared().comparisons == lenient.comparisons
        strict, expected = results.compared(margin=0.0), plain.compared('adis16475-3', margin=0.0)
        assert (strict.comparisons, strict.findings) == (expected.comparisons, expected.findings)
    assert ar.analyze(lenient, **QUICK).datasheet is None


def test_each_axis_may_have_its_own_noise() -> None:
    def simulated(**noise: Any) -> np.ndarray:
        return ar.simulate(hours=0.01, rate=100, preset='', **noise).samples

    three = simulated(gyro={'x': {'N': 0.1}, 'y': {'N': 0.2}})
    same = simulated(gyro={'N': 0.1})
    assert three.shape == (3600, 6) and not three[:, 2].any()
    np.testing.assert_array_equal(three[:, 0], same[:, 0])
    np.testing.assert_allclose(three[:, 1], 2.0 * same[:, 1], rtol=1e-9)
    one = simulated(gyro={'N': 0.1}, accel={'z': {'N': 0.02}})
    assert not one[:, 3:5].any() and one[:, 5].std() > 0


def test_auto_is_accepted_in_python() -> None:
    white = np.random.default_rng(0).normal(scale=0.01, size=3000)
    named, default = (
        ar.analyze(white, rate=100, axes='gyro_z', **o) for o in ({'skip': 'auto'}, {})
    )
    assert repr(named) == repr(default)
    assert named.provenance.settings == default.provenance.settings


def test_results_are_compared_with_an_earlier_run_at_once() -> None:
    white = np.random.default_rng(0).normal(scale=0.01, size=20_000)
    before = ar.analyze(white, rate=100, axes='gyro_z')
    for factor in (1.0, 1.5):
        after = ar.analyze(factor * white[::-1], rate=100, axes='gyro_z', baseline=before)
        assert (after.verdict.level == 'failed') == (factor > 1.0)
