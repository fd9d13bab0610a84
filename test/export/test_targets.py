# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every target: its numbers computed by hand, its complete file, its options.

The files in ``golden`` are what the command writes by default for the fixed results; VERSION
replaces the version of the package.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.exports import (
    EXPECTED,
    FIXED,
    near,
    numbers,
    read_lines,
    read_yaml,
    refitted,
    with_process,
)

import allan_ros
from allan_ros.core.estimate import Estimate
from allan_ros.core.noise import Model
from allan_ros.export import TARGETS, ExportOptions, make_export, target_of
from allan_ros.results.results import Results
from allan_ros.view.finding_text import finding_line

GOLDEN = Path(__file__).parent / 'golden'


def test_no_target_is_without_numbers_by_hand() -> None:
    assert list(EXPECTED) == list(TARGETS) and all(EXPECTED.values())
    for name, target in TARGETS.items():
        levels = {key.name for key in target.keys if key.what in ('N', 'K')}
        assert levels <= EXPECTED[name].keys(), name


@pytest.mark.parametrize('name', EXPECTED)
def test_the_numbers_are_those_computed_by_hand(known_results: Results, name: str) -> None:
    found = numbers(known_results, name)
    assert {key: found[key] for key in EXPECTED[name]} == {
        key: near(value) for key, value in EXPECTED[name].items()
    }


@pytest.mark.parametrize('name', EXPECTED)
def test_the_file_is_word_for_word(known_results: Results, name: str) -> None:
    text = make_export(known_results, name, words=finding_line).text
    text = text.replace(f'allan_ros {allan_ros.__version__} ', 'allan_ros VERSION ')
    if os.environ.get('STORE_GOLDEN'):  # `make golden`
        (GOLDEN / f'{name}.txt').write_text(text, encoding='utf-8')
    assert text == (GOLDEN / f'{name}.txt').read_text(encoding='utf-8')


@pytest.mark.parametrize('name', EXPECTED)
def test_inflation_multiplies_levels_and_squares_variances(
    known_results: Results, name: str
) -> None:
    plain, inflated = (numbers(known_results, name, inflate=factor) for factor in (1.0, 3.0))
    for key in EXPECTED[name]:
        power = 2.0 if '_cov' in key or name == 'gtsam' else 1.0
        factor = 1.0 if key in FIXED else 3.0**power
        expected = factor * np.asarray(plain[key])
        np.testing.assert_allclose(inflated[key], expected, rtol=2e-5, err_msg=key)
    text = make_export(known_results, name, ExportOptions(inflate=2.0)).text
    said = 'inflation: x2 on every N, K and bias; the levels below are without these factors'
    assert said in text


@pytest.mark.parametrize('name', EXPECTED)
def test_a_reduction_and_bare_coefficients_say_what_they_are(
    known_results: Results, name: str
) -> None:
    bare = make_export(known_results, name, ExportOptions(fidelity='coefficients'))
    walk = target_of(name).walk
    assert ('not resolved, 95 % upper limit 3.00e-05' in bare.text) == walk
    assert ('export_limits' in [said.id for said in bare.findings]) == walk
    assert 'fidelity: N and K as measured' in bare.text and 'raised' not in bare.text
    if walk:
        # the reduction covers B, so K may be unknown
        text = make_export(known_results, name).text
        horizon = target_of(name).horizon_s
        assert f'error growth of the complete model over 1 to {horizon:g} s' in text
        raised = 'raised from 1.000e-05 to cover the error growth of the other terms'
        assert raised in text or name == 'glim'  # only the larger K, of the accelerometer
        assert 'not resolved, set to cover the error growth of the other terms' in text


def test_k_of_the_reduction_bounds_the_growth(known_results: Results) -> None:
    for horizon in (0.0, 5.0, 300.0):
        made = make_export(known_results, 'kalibr', ExportOptions(horizon=horizon))
        read = read_yaml(made.text)
        noise = Model.of(N=read['gyroscope_noise_density'], K=read['gyroscope_random_walk'])
        whole = known_results.axes['gyro_z'].fit.model
        times = np.geomspace(1.0, horizon or 30.0, 40)
        bound = noise.growth(times, horizon or 30.0)
        assert np.all(bound >= 0.999 * whole.growth(times, horizon or 30.0))
    assert not made.findings


def test_a_sensor_of_gauss_markov_noise_gets_a_warning(known_results: Results) -> None:
    known = with_process(known_results, 'gyro_y', 5e-4, 10.0 / 3600.0)
    made = make_export(known, 'kalibr')
    (said,) = [said for said in made.findings if said.id == 'export_two_numbers']
    assert said.axes == ('gyro_y',)
    assert str(said) in made.text


@pytest.mark.parametrize('name', EXPECTED)
def test_no_character_of_a_path_ends_the_comment(known_results: Results, name: str) -> None:
    (source,) = known_results.provenance.sources
    odd = replace(source, path='a\nacc_n: 7\rb\u2028c"""\x00', topic='')
    known = replace(known_results, provenance=replace(known_results.provenance, sources=(odd,)))
    assert numbers(known, name).keys() == numbers(known_results, name).keys()
    # characters that cannot be printed are escaped
    text = make_export(known, name).text
    assert (
        'a\\\\nacc_n: 7' if target_of(name).file_name.endswith('.json') else 'a\\nacc_n: 7'
    ) in text


def test_the_manual_lists_every_target(repository: Path) -> None:
    manual = (repository / 'docs' / 'targets.md').read_text(encoding='utf-8')
    assert [name for name in TARGETS if f'| `{name}` |' not in manual] == []


def test_the_filter_rate_replaces_the_rate_of_the_recording(known_results: Results) -> None:
    assert numbers(known_results, 'vins_fusion', filter_rate=400.0)['gyr_n'] == near(0.02)
    assert numbers(known_results, 'px4', filter_rate=400.0)['EKF2_GYR_NOISE'] == near(0.02)
    assert numbers(known_results, 'kalibr', filter_rate=400.0)['update_rate'] == 400.0


@pytest.mark.parametrize('name', ['px4', 'ardupilot'])
def test_numbers_are_clamped_to_the_ranges_of_the_autopilot(
    known_results: Results, name: str
) -> None:
    low = {'N': Estimate(1e-7, (9e-8, 1.1e-7))}
    quiet = {axis: refitted(result, low) for axis, result in known_results.axes.items()}
    made = make_export(replace(known_results, axes=quiet), name)
    found = read_lines(made.text)
    gyro, accel, *_ = found.values()
    assert (gyro, accel) == (1e-4, 0.01)
    assert [said.id for said in made.findings].count('export_clamped') == 2
    assert 'lies outside [0.0001, 0.1]' in made.text
    loud = numbers(known_results, name, inflate=1000.0)
    high = {'px4': (0.1, 1.0, 0.01, 0.01), 'ardupilot': (0.1, 1.0, 1e-3, 0.02)}[name]
    assert tuple(loud.values()) == high


def test_the_madgwick_gain_includes_a_ramp_of_all_axes(known_results: Results) -> None:
    ramp = Estimate(-4e-7, (-5e-7, -3e-7))
    known = replace(
        known_results,
        axes={axis: refitted(r, {'R': ramp}) for axis, r in known_results.axes.items()},
    )
    assert numbers(known, 'imu_filter_madgwick')['zeta'] == near(3.46410e-7)  # sqrt(3/4) 4e-7


def test_madgwick_needs_no_accelerometer(known_results: Results) -> None:
    gyro = {name: axis for name, axis in known_results.axes.items() if name.startswith('gyro')}
    assert numbers(replace(known_results, axes=gyro), 'imu_filter_madgwick')['gain'] > 0.0


def test_a_missing_date_is_stated(known_results: Results) -> None:
    def date(start_ns: int) -> str:
        provenance = known_results.provenance
        spans = tuple(span._replace(start_ns=start_ns) for span in provenance.segments)
        known = replace(known_results, provenance=replace(provenance, segments=spans))
        text = make_export(known, 'kalibr').text
        return next(line for line in text.splitlines() if line.startswith('# date: '))

    assert date(12_000_000_000) == '# date: not known'
    assert date(2**62).startswith('# date: recorded from 2116')
