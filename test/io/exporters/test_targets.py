# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every target: its numbers computed by hand, its file word for word, and read as its reader does.

The numbers by hand are those of the bare coefficients. The golden files under ``golden`` are what
the command writes for the fixed results by default; VERSION stands for the version of the package.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from support.allan_table import allan_table

import allan_ros
from allan_ros.core.errors import AllanError
from allan_ros.core.filters.bias import TurnOnBias
from allan_ros.core.filters.growth import predicted_growth
from allan_ros.core.filters.reductions import STATES
from allan_ros.core.fit import Coefficient, GaussMarkov, Processes
from allan_ros.core.noise import NoiseTerms, ProcessModel
from allan_ros.io.exporters import TARGETS, ExportOptions, make_export, target_of
from allan_ros.io.results import Results

GOLDEN = Path(__file__).parent / 'golden'


def near(value: Any) -> Any:
    """Return what equals a number to the six digits that are written."""
    return pytest.approx(value, rel=2e-6)


def read_yaml(text: str) -> Any:
    return yaml.safe_load(text.removeprefix('%YAML:1.0\n'))


def read_lines(text: str) -> dict[str, float]:
    """Return key -> number of a parameter file, of either autopilot."""
    rows = [line.replace(',', '\t').split('\t') for line in text.splitlines() if line[0] != '#']
    return {
        row[-3] if len(row) > 2 else row[0]: float(row[-2 if len(row) > 2 else 1]) for row in rows
    }


def read_matlab(text: str) -> dict[str, Any]:
    """Return field -> numbers of the assignments to the structure ``imu``."""
    rows = re.findall(r'^imu\.(\w+) = \[(.*)\];$', text, re.MULTILINE)
    return {key: [float(word) for word in values.split()] for key, values in rows}


def run_python(text: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(text, names)
    return names


EXPECTED: dict[str, tuple[Callable[[str], Any], tuple[str, ...], dict[str, Any]]] = {
    # N, K as they are: 1e-3, 1e-5 (gyro) and 2e-3, limit 3e-5 (accelerometer).
    'kalibr': (
        read_yaml,
        (),
        {
            'accelerometer_noise_density': 2e-3,
            'accelerometer_random_walk': 3e-5,
            'gyroscope_noise_density': 1e-3,
            'gyroscope_random_walk': 1e-5,
            'update_rate': 200.0,
        },
    ),
    'openvins': (
        read_yaml,
        ('imu0',),
        {
            'accelerometer_noise_density': 2e-3,
            'accelerometer_random_walk': 3e-5,
            'gyroscope_noise_density': 1e-3,
            'gyroscope_random_walk': 1e-5,
            'update_rate': 200.0,
        },
    ),
    # times sqrt(200) = 14.1421
    'vins_fusion': (
        read_yaml,
        (),
        {'acc_n': 0.0282843, 'gyr_n': 0.0141421, 'acc_w': 4.24264e-4, 'gyr_w': 1.41421e-4},
    ),
    'orb_slam3': (
        read_yaml,
        (),
        {
            'IMU.NoiseGyro': 1e-3,
            'IMU.NoiseAcc': 2e-3,
            'IMU.GyroWalk': 1e-5,
            'IMU.AccWalk': 3e-5,
            'IMU.Frequency': 200.0,
        },
    ),
    'lio_sam': (
        read_yaml,
        ('/**', 'ros__parameters'),
        {'imuAccNoise': 2e-3, 'imuGyrNoise': 1e-3, 'imuAccBiasN': 3e-5, 'imuGyrBiasN': 1e-5},
    ),
    # squares times 200
    'fast_lio': (
        read_yaml,
        ('/**', 'ros__parameters', 'mapping'),
        {'acc_cov': 8e-4, 'gyr_cov': 2e-4, 'b_acc_cov': 1.8e-7, 'b_gyr_cov': 2e-8},
    ),
    # squares of 0.6, 0.8 and 1 times the level
    'gtsam': (
        run_python,
        (),
        {
            'accelerometerCovariance': [1.44e-6, 2.56e-6, 4e-6],
            'gyroscopeCovariance': [3.6e-7, 6.4e-7, 1e-6],
            'biasAccCovariance': [1.44e-10, 2.56e-10, 9e-10],
            'biasOmegaCovariance': [3.6e-11, 6.4e-11, 1e-10],
        },
    ),
    'basalt': (
        json.loads,
        ('value0',),
        {
            'imu_update_rate': 200.0,
            'accel_noise_std': [1.2e-3, 1.6e-3, 2e-3],
            'gyro_noise_std': [6e-4, 8e-4, 1e-3],
            'accel_bias_std': [1.2e-5, 1.6e-5, 3e-5],
            'gyro_bias_std': [6e-6, 8e-6, 1e-5],
        },
    ),
    'msckf_vio': (
        read_yaml,
        ('noise',),
        {'gyro': 1e-3, 'acc': 2e-3, 'gyro_bias': 1e-5, 'acc_bias': 3e-5},
    ),
    # times sqrt(200), and squares over 200
    'fusioncore': (
        read_yaml,
        ('/**', 'ros__parameters'),
        {
            'imu.gyro_noise': 0.0141421,
            'imu.accel_noise': 0.0282843,
            'ukf.q_gyro_bias': 5e-13,
            'ukf.q_accel_bias': 4.5e-12,
        },
    ),
    # times sqrt(100), the step of EKF2
    'px4': (
        read_lines,
        (),
        {
            'EKF2_GYR_NOISE': 0.01,
            'EKF2_ACC_NOISE': 0.02,
            'EKF2_GYR_B_NOISE': 1e-4,
            'EKF2_ACC_B_NOISE': 3e-4,
        },
    ),
    # times sqrt(1 / 0.012) = 9.12871, the step of EK3
    'ardupilot': (
        read_lines,
        (),
        {
            'EK3_GYRO_P_NSE': 9.12871e-3,
            'EK3_ACC_P_NSE': 0.0182574,
            'EK3_GBIAS_P_NSE': 9.12871e-5,
            'EK3_ABIAS_P_NSE': 2.73861e-4,
        },
    ),
    # 1e-3 rad/sqrt(s) is 180/pi 60 times that in deg/sqrt(h), 3.43775; 2e-3 m/s/sqrt(s) is 0.12
    # m/s/sqrt(h). The bias is tested below.
    'kf_gins': (
        read_yaml,
        ('imunoise',),
        {'arw': [2.06265, 2.75020, 3.43775], 'vrw': [0.072, 0.096, 0.12]},
    ),
    'ob_gins': (read_yaml, ('imumodel',), {'arw': 3.43775, 'vrw': 0.12}),
    'ic_gvins': (read_yaml, ('imumodel',), {'arw': 3.43775, 'vrw': 0.12}),
    'navego': (
        read_matlab,
        (),
        {'arw': [6e-4, 8e-4, 1e-3], 'vrw': [1.2e-3, 1.6e-3, 2e-3]},
    ),
    # sqrt(3/4 (1e-6/10 + 0.441271 1e-8 + 1e-10 10/3)) and sqrt(3/4) 1e-5 / sqrt(10)
    'imu_filter_madgwick': (
        read_yaml,
        ('/**', 'ros__parameters'),
        {'gain': 2.80285e-4, 'zeta': 2.73861e-6},
    ),
    'state_space': (
        lambda text: json.loads(text)['axes'],
        ('accel_z',),
        {'white': 2e-3},
    ),
    'state_space_python': (run_python, ('AXES', 'gyro_y'), {'white': 8e-4}),
    'gazebo': (
        lambda text: {
            noise.tag: float(noise.text)
            for noise in ElementTree.fromstring(text).find('angular_velocity/z/noise')
        },
        (),
        {'stddev': 0.0141421, 'mean': 0.0},
    ),
    'px4_sitl': (
        lambda text: {e.tag: float(e.text) for e in ElementTree.fromstring(text)},
        (),
        {'gyroscopeNoiseDensity': 1e-3, 'accelerometerNoiseDensity': 2e-3},
    ),
    # 2e-3 m/s^2 is 0.203943 mg; 1e-5 sqrt(500) rad/s is 46.1222 deg/h; 3e-5 sqrt(800) is 86.5261 ug
    'airsim': (
        json.loads,
        ('DefaultSensors', 'Imu'),
        {
            'AngularRandomWalk': 3.43775,
            'VelocityRandomWalk': 0.203943,
            'GyroBiasStability': 46.1222,
            'AccelBiasStability': 86.5257,
        },
    ),
    'gnss_ins_sim': (
        lambda text: {k: list(v) for k, v in run_python(text)['imu_err'].items()},
        (),
        {'gyro_arw': [2.06265, 2.75020, 3.43775], 'accel_vrw': [0.072, 0.096, 0.12]},
    ),
    'isaac_sim': (run_python, ('AXES', 'gyro_x'), {'white': 6e-4}),
    'webots': (run_python, ('AXES', 'gyro_x'), {'white': 6e-4}),
}

FIXED = {'update_rate', 'imu_update_rate', 'IMU.Frequency'}
"""Entries that are no level."""

NO_HEADER = {'mean', 'white'}
"""Entries without words of their own."""


def numbers(results: Results, name: str, **options: Any) -> dict[str, Any]:
    """Return the numbers of a file as its reader finds them, by default the bare coefficients."""
    options = {'fidelity': 'coefficients', **options}
    read, path, _ = EXPECTED[name]
    found = read(make_export(results, name, ExportOptions(**options)).text)
    for key in path:
        found = found[key]
    return found


def test_no_target_is_without_numbers_by_hand() -> None:
    assert list(EXPECTED) == list(TARGETS)


@pytest.mark.parametrize('name', EXPECTED)
def test_the_numbers_are_those_computed_by_hand(known_results: Results, name: str) -> None:
    found = numbers(known_results, name)
    expected = EXPECTED[name][2]
    assert {key: found[key] for key in expected} == {key: near(v) for key, v in expected.items()}


@pytest.mark.parametrize('name', EXPECTED)
def test_the_file_is_word_for_word(known_results: Results, name: str) -> None:
    text = make_export(known_results, name).text
    text = text.replace(f'allan_ros {allan_ros.__version__} ', 'allan_ros VERSION ')
    assert text == (GOLDEN / f'{name}.txt').read_text(encoding='utf-8')


@pytest.mark.parametrize('name', EXPECTED)
def test_the_header_says_all_that_is_asked_of_it(known_results: Results, name: str) -> None:
    text = make_export(known_results, name, ExportOptions(inflate=2.0)).text
    for words in (
        'source: runs/one.mcap /imu/data; 2 h at rest',
        'date: recorded from 2023-11-14 22:13:20 UTC on',
        'convention: ',
        'rate: f = ',
        'axis rule: ',
        'inflation: x2 on every N, K and bias; the levels below are without it',
        'upper limits instead of measurements: ',
    ):
        assert words in text
    for key in EXPECTED[name][2]:
        words = f'{key} of gyro [' if name == 'gazebo' else f'{key} ['
        assert words in text or key in FIXED or key in NO_HEADER


@pytest.mark.parametrize('name', EXPECTED)
def test_inflation_multiplies_what_is_linear_and_squares_what_is_not(
    known_results: Results, name: str
) -> None:
    plain, inflated = (numbers(known_results, name, inflate=factor) for factor in (1.0, 3.0))
    for key in EXPECTED[name][2]:
        power = 2.0 if name in ('fast_lio', 'gtsam') or '.q_' in key else 1.0
        factor = 1.0 if key in FIXED else 3.0**power
        values = plain[key] if isinstance(plain[key], list) else [plain[key]]
        scaled = [factor * value for value in values]
        found = inflated[key] if isinstance(inflated[key], list) else [inflated[key]]
        assert found == [pytest.approx(value, rel=2e-5) for value in scaled], key


@pytest.mark.parametrize('name', EXPECTED)
def test_the_mean_is_the_root_mean_square(known_results: Results, name: str) -> None:
    worst, mean = (numbers(known_results, name, axis=rule) for rule in ('worst', 'mean'))
    for key in ('gyroscope_noise_density', 'gyr_n', 'IMU.NoiseGyro', 'imuGyrNoise', 'gain'):
        if key in worst:
            assert mean[key] == pytest.approx(worst[key] * math.sqrt(2.0 / 3.0), rel=1e-5)


WITH_WALK = [name for name in EXPECTED if target_of(name).walk or name == 'airsim']
"""Targets with K of both sensors."""


@pytest.mark.parametrize('name', WITH_WALK)
def test_strict_refuses_a_limit(known_results: Results, name: str) -> None:
    with pytest.raises(AllanError, match='K of accel_z is not observable'):
        numbers(known_results, name, strict=True)
    # the reduction needs no K: B of the axis is known
    assert make_export(known_results, name, ExportOptions(strict=True)).text


@pytest.mark.parametrize('name', EXPECTED)
def test_a_limit_is_stated_in_the_file_and_as_a_finding(known_results: Results, name: str) -> None:
    made = make_export(known_results, name, ExportOptions(fidelity='coefficients'))
    limits = [said for said in made.findings if said.id == 'export_limits']
    assert ('not observable, 95 % upper limit 3.00e-05' in made.text) == bool(limits)
    assert bool(limits) == (name in WITH_WALK)


@pytest.mark.parametrize('name', WITH_WALK)
def test_k_is_raised_for_what_it_has_to_cover(known_results: Results, name: str) -> None:
    made = make_export(known_results, name)
    horizon = target_of(name).horizon_s
    assert f'error growth of the complete model over 1 to {horizon:g} s' in made.text
    assert 'raised from 1.000e-05 to cover the other terms' in made.text
    assert 'raised from none to cover the other terms' in made.text
    bare = make_export(known_results, name, ExportOptions(fidelity='coefficients'))
    assert 'fidelity: bare coefficients' in bare.text
    assert 'raised' not in bare.text


def test_k_of_the_reduction_bounds_the_growth(known_results: Results) -> None:
    for horizon in (0.0, 5.0, 300.0):
        made = make_export(known_results, 'kalibr', ExportOptions(horizon=horizon))
        read = read_yaml(made.text)
        noise = NoiseTerms(N=read['gyroscope_noise_density'], K=read['gyroscope_random_walk'])
        whole = known_results.axes['gyro_z'].fit.selected
        times = np.geomspace(1.0, horizon or 30.0, 40)
        bound = predicted_growth(ProcessModel(noise), times, horizon or 30.0)
        assert np.all(bound >= 0.999 * predicted_growth(whole, times, horizon or 30.0))
    assert not made.findings


def test_a_sensor_of_gauss_markov_noise_gets_a_warning(known_results: Results) -> None:
    known = with_process(known_results, 'gyro_y', 5e-4, 10.0 / 3600.0)
    made = make_export(known, 'kalibr')
    (said,) = [said for said in made.findings if said.id == 'export_two_numbers']
    assert said.axes == ('gyro_y',)
    assert str(said) in made.text


def test_strict_refuses_a_poor_reduction(known_results: Results) -> None:
    known = with_process(known_results, 'gyro_y', 5e-3, 2.0 / 3600.0)
    options = ExportOptions(strict=True, horizon=300.0)
    with pytest.raises(AllanError, match=r'gyro_y: a random walk misstates .* factor of'):
        make_export(known, 'kalibr', options)
    assert make_export(known, 'state_space', options).text


WHOLE = {'state_space', 'state_space_python', 'isaac_sim', 'webots', 'gazebo'}
"""Targets whose axes are apart in any case."""


@pytest.mark.parametrize('name', EXPECTED)
def test_three_numbers_are_given_where_the_file_takes_them(
    known_results: Results, name: str
) -> None:
    if target_of(name).three and name not in WHOLE:
        found = numbers(known_results, name, axis='each')
        assert any(isinstance(v, list) and len(set(v)) == 3 for v in found.values())
        found = numbers(known_results, name, axis='worst')
        vectors = [found[k] for k, v in EXPECTED[name][2].items() if isinstance(v, list)]
        assert all(len(set(v)) == 1 for v in vectors)
    elif name not in WHOLE:
        with pytest.raises(AllanError, match='one number a sensor'):
            numbers(known_results, name, axis='each')


@pytest.mark.parametrize('name', EXPECTED)
def test_no_character_of_a_path_leaves_the_comment(known_results: Results, name: str) -> None:
    (source,) = known_results.provenance.sources
    odd = replace(source, path='a\nacc_n: 7\rb\u2028c"""\x00', topic='')
    known = replace(known_results, provenance=replace(known_results.provenance, sources=(odd,)))
    assert numbers(known, name).keys() == numbers(known_results, name).keys()
    # as everywhere else: what cannot be printed is escaped
    text = make_export(known, name).text
    assert (
        'a\\\\nacc_n: 7' if target_of(name).file_name.endswith('.json') else 'a\\nacc_n: 7'
    ) in text


def test_the_manual_tells_of_every_target(repository: Path) -> None:
    manual = (repository / 'docs' / 'filters.md').read_text(encoding='utf-8')
    assert [name for name in TARGETS if f'| `{name}` |' not in manual] == []


def test_the_filter_rate_takes_the_place_of_the_recordings(known_results: Results) -> None:
    assert numbers(known_results, 'vins_fusion', filter_rate=400.0)['gyr_n'] == near(0.02)
    assert numbers(known_results, 'px4', filter_rate=400.0)['EKF2_GYR_NOISE'] == near(0.02)
    assert numbers(known_results, 'kalibr', filter_rate=400.0)['update_rate'] == 400.0


def test_vins_exact_propagates_all_of_the_noise(known_results: Results) -> None:
    exact = numbers(known_results, 'vins_fusion', exact=True)
    assert exact['gyr_n'] == near(0.02)  # 1e-3 sqrt(400)
    assert exact['gyr_w'] == near(1.41421e-4)
    assert not any(
        said.id == 'export_half_of_noise'
        for said in make_export(known_results, 'vins_fusion', ExportOptions(exact=True)).findings
    )
    with pytest.raises(AllanError, match='vins_fusion only'):
        numbers(known_results, 'kalibr', exact=True)


def test_orb_slam3_reads_real_numbers(known_results: Results) -> None:
    assert 'IMU.Frequency: 200.0\n' in make_export(known_results, 'orb_slam3').text


@pytest.mark.parametrize('name', ['px4', 'ardupilot'])
def test_a_range_of_the_autopilot_is_kept_and_said(known_results: Results, name: str) -> None:
    quiet = {
        axis: replace(
            result,
            fit=replace(
                result.fit, noise={**result.fit.noise, 'N': Coefficient(1e-7, (9e-8, 1.1e-7))}
            ),
        )
        for axis, result in known_results.axes.items()
    }
    made = make_export(replace(known_results, axes=quiet), name)
    found = read_lines(made.text)
    gyro, accel, *_ = found.values()
    assert (gyro, accel) == (1e-4, 0.01)
    assert [said.id for said in made.findings].count('export_clamped') == 2
    assert 'lies outside [0.0001, 0.1]' in made.text
    loud = numbers(known_results, name, inflate=1000.0)
    high = {'px4': (0.1, 1.0, 0.01, 0.01), 'ardupilot': (0.1, 1.0, 1e-3, 0.02)}[name]
    assert tuple(loud.values()) == high


def with_process(results: Results, axis: str, sigma: float, hours: float) -> Results:
    """Return results where an axis has a Gauss-Markov bias."""
    seconds = 3600.0 * hours
    process = GaussMarkov(
        sigma, (0.9 * sigma, 1.1 * sigma), seconds, (0.8 * seconds, 1.3 * seconds)
    )
    had = results.axes[axis]
    changed = replace(had, fit=replace(had.fit, processes=Processes((process,))))
    return replace(results, axes={**results.axes, axis: changed})


def with_one_process(results: Results) -> Results:
    """Return results whose only drift is one Gauss-Markov process per axis, of 180 s."""
    for axis, result in results.axes.items():
        noise = {**result.fit.noise, 'B': Coefficient(None, None, 1e-5, 'not_observable')}
        noise['K'] = noise['B']
        fit = replace(result.fit, noise=noise)
        results = replace(results, axes={**results.axes, axis: replace(result, fit=fit)})
        results = with_process(results, axis, 5e-4 if axis < 'b' else 1e-4, 0.05)
    return results


def test_a_fitted_process_is_the_bias_of_an_ins(known_results: Results) -> None:
    known = with_one_process(known_results)
    found = numbers(known, 'kf_gins')
    assert found['gbstd'] == near([20.6265] * 3)  # 1e-4 rad/s is 20.6265 deg/h
    assert found['abstd'] == near([50.0] * 3)
    assert found['corrtime'] == near(0.05)
    assert not make_export(known, 'kf_gins').findings
    scalar = numbers(known, 'ob_gins')
    assert (scalar['gbstd'], scalar['corrtime']) == (near(20.6265), near(0.05))
    driven = numbers(known, 'navego')
    assert driven['gb_corr'] == near([180.0] * 3)
    assert driven['gb_psd'] == near([1.05409e-5] * 3)  # 1e-4 sqrt(2 / 180)


def test_a_fitted_process_is_the_bias_of_a_simulator(known_results: Results) -> None:
    known = with_one_process(known_results)
    gazebo = numbers(known, 'gazebo')
    assert gazebo['dynamic_bias_correlation_time'] == near(180.0)
    assert gazebo['dynamic_bias_stddev'] == near(1.05409e-5)  # 1e-4 sqrt(2 / 180)
    sitl = numbers(known, 'px4_sitl')
    assert sitl['gyroscopeRandomWalk'] == near(1.05409e-5)
    assert sitl['accelerometerBiasCorrelationTime'] == near(180.0)
    assert numbers(known, 'gnss_ins_sim')['gyro_b_stability'] == near([20.6265] * 3)


def with_rounding(results: Results) -> Results:
    """Return results of samples in steps of 0.02, with a turn-on bias on gyro_x."""
    turn_on = TurnOnBias(3, 0.0, 2e-3, (1e-3, 1e-2))
    axes = {name: replace(axis, rounding=0.02) for name, axis in results.axes.items()}
    return replace(results, axes={**axes, 'gyro_x': replace(axes['gyro_x'], turn_on=turn_on)})


def test_gazebo_rounds_and_turns_on_like_the_sensor(known_results: Results) -> None:
    known = with_rounding(with_one_process(known_results))
    text = make_export(known, 'gazebo', ExportOptions(inflate=2.0)).text
    imu = ElementTree.fromstring(text)
    noise = imu.find('angular_velocity/x/noise')
    assert noise is not None
    read = {element.tag: float(element.text or '') for element in noise}
    assert noise.get('type') == 'gaussian_quantized'
    assert read['precision'] == 0.02
    # N = 0.6e-3 at 200 Hz, twice: the variance 2.88e-4 less 0.02^2 / 12
    assert read['stddev'] == near((2.88e-4 - 0.02**2 / 12.0) ** 0.5)
    assert read['bias_stddev'] == 4e-3
    assert imu.find('angular_velocity/y/noise/bias_stddev') is None
    assert numbers(known, 'px4_sitl')['gyroscopeTurnOnBiasSigma'] == 2e-3
    coarse = replace(known.axes['gyro_x'], rounding=1.0)
    known = replace(known, axes={**known.axes, 'gyro_x': coarse})
    stddev = ElementTree.fromstring(make_export(known, 'gazebo').text).find('.//x/noise/stddev')
    assert stddev is not None
    assert float(stddev.text or '') == near(0.6e-3 * 200**0.5 / 2**0.5)


def test_a_bias_without_a_fitted_process_is_explained(known_results: Results) -> None:
    made = make_export(known_results, 'kf_gins')
    assert {said.id for said in made.findings} == {'export_no_gauss_markov'}
    assert numbers(known_results, 'kf_gins')['gbstd'][2] > 20.6265  # more than B alone


def test_the_module_has_the_matrices_of_the_document(known_results: Results) -> None:
    document = json.loads(make_export(known_results, 'state_space').text)
    module = run_python(make_export(known_results, 'state_space_python').text)
    for axis, one in document['axes'].items():
        phi, noise, sample = module['matrices'](axis, 1.0 / 200.0)
        np.testing.assert_allclose(phi, one['discrete']['Phi'], rtol=1e-11)
        np.testing.assert_allclose(noise, one['discrete']['Qd'], rtol=1e-9)
        assert sample == near(one['discrete']['R'])
        assert {reduction['states'] for reduction in one['reductions']} == set(STATES)


def test_the_module_simulates_the_model(known_results: Results) -> None:
    """40,000 samples at 1 Hz; the Allan variances at 1, 8 and 64 s are within 5, 10 and 25 %.

    Their standard deviations are 1, 3 and 8 %: a false alarm has a probability below 0.3 %.
    """
    module = run_python(make_export(known_results, 'webots').text)
    noise = module['ImuNoise'](np.random.default_rng(2))
    samples = np.array([noise(1.0)['gyro_z'] for _ in range(40_000)])
    m = np.array([1, 8, 64])
    expected = known_results.axes['gyro_z'].fit.selected.avar(m.astype(float))
    found = allan_table(samples[:, None], m).avar[:, 0]
    for one, other, tolerance in zip(found, expected, (0.05, 0.1, 0.25)):
        assert one == pytest.approx(other, rel=tolerance)
    gyro, accel = noise.add([0.0, 0.0, 1.0], (0.0, 0.0, 9.8), 0.005)
    assert gyro.shape == accel.shape == (3,)


def test_madgwick_takes_the_ramp_where_every_axis_shows_one(known_results: Results) -> None:
    ramp = Coefficient(4e-7, (3e-7, 5e-7), sign=-1)
    known = replace(
        known_results,
        axes={
            axis: replace(r, fit=replace(r.fit, noise={**r.fit.noise, 'R': ramp}))
            for axis, r in known_results.axes.items()
        },
    )
    assert numbers(known, 'imu_filter_madgwick')['zeta'] == near(3.46410e-7)  # sqrt(3/4) 4e-7


def test_madgwick_needs_no_accelerometer(known_results: Results) -> None:
    gyro = {name: axis for name, axis in known_results.axes.items() if name.startswith('gyro')}
    assert numbers(replace(known_results, axes=gyro), 'imu_filter_madgwick')['gain'] > 0.0


def test_a_date_that_is_none_is_said(known_results: Results) -> None:
    def date(start_ns: int) -> str:
        provenance = known_results.provenance
        spans = tuple(span._replace(start_ns=start_ns) for span in provenance.segments)
        known = replace(known_results, provenance=replace(provenance, segments=spans))
        text = make_export(known, 'kalibr').text
        return next(line for line in text.splitlines() if line.startswith('# date: '))

    assert date(12_000_000_000) == '# date: not known: the stamps do not count from 1970'
    assert date(2**62).startswith('# date: recorded from 2116')
    given = make_export(known_results, 'kalibr', ExportOptions(date='last Tuesday')).text
    assert '# date: last Tuesday\n' in given
