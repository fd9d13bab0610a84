# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Targets with a Gauss-Markov bias or all processes: KF-GINS, Gazebo, the state space."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from support.exports import near, numbers, refitted, run_python, with_process

from allan_ros.core.allan.at_rest import TurnOnBias
from allan_ros.core.estimate import Estimate
from allan_ros.core.filters.state_space import StateSpace
from allan_ros.core.noise import PROCESSES, Part
from allan_ros.core.noise.processes.sinusoid import Sinusoid
from allan_ros.export import TARGETS, ExportOptions, Row, make_export
from allan_ros.export.target import xml_form
from allan_ros.results.results import Results


def with_one_process(results: Results) -> Results:
    """Return results whose only drift is a Gauss-Markov process of 180 s on each axis."""
    for axis, result in results.axes.items():
        noise = dict.fromkeys('BK', Estimate(None, None, 1e-5, 'not_observable'))
        results = replace(results, axes={**results.axes, axis: refitted(result, noise)})
        results = with_process(results, axis, 5e-4 if axis < 'b' else 1e-4, 0.05)
    return results


def test_a_fitted_process_is_the_bias_of_an_ins_and_of_a_simulator(known_results: Results) -> None:
    known = with_one_process(known_results)
    found = numbers(known, 'kf_gins')
    assert found['gbstd'] == near([20.6265] * 3)  # 1e-4 rad/s is 20.6265 deg/h
    assert found['abstd'] == near([50.0] * 3)
    assert found['corrtime'] == near(0.05)
    assert not make_export(known, 'kf_gins').findings
    gazebo = numbers(known, 'gazebo')
    assert gazebo['dynamic_bias_correlation_time'] == near(180.0)
    assert gazebo['dynamic_bias_stddev'] == near(1.05409e-5)  # 1e-4 sqrt(2 / 180)


def with_rounding(results: Results) -> Results:
    """Return results of samples in steps of 0.02, with a turn-on bias on gyro_x."""
    turn_on = TurnOnBias(3, 0.0, Estimate(2e-3, (1e-3, 1e-2)))
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
    coarse = replace(known.axes['gyro_x'], rounding=1.0)
    known = replace(known, axes={**known.axes, 'gyro_x': coarse})
    stddev = ElementTree.fromstring(make_export(known, 'gazebo').text).find('.//x/noise/stddev')
    assert stddev is not None
    assert float(stddev.text or '') == near(0.6e-3 * 200**0.5 / 2**0.5)


def test_a_bias_without_a_fitted_process_is_explained(known_results: Results) -> None:
    made = make_export(known_results, 'kf_gins')
    assert {said.id for said in made.findings} == {'export_no_gauss_markov'}
    assert numbers(known_results, 'kf_gins')['gbstd'][2] > 20.6265  # more than B alone


def with_drift(results: Results, *processes: Part) -> Results:
    """Return results in which no term but N is resolved, with these processes on each axis."""
    axes = {}
    for axis, result in results.axes.items():
        limit = Estimate(None, None, 1e-5, 'not_observable')
        noise = {**dict.fromkeys(result.fit.noise, limit), 'N': result.fit.noise['N']}
        axes[axis] = refitted(result, noise, processes)
    return replace(results, axes=axes)


@pytest.mark.parametrize('target', ['kf_gins', 'gazebo'])
def test_a_bias_from_the_limit_of_k_is_named_a_limit(known_results: Results, target: str) -> None:
    known = with_drift(known_results)
    made = make_export(known, target)
    assert 'export_limits' in {said.id for said in made.findings}
    assert 'from the 95 % upper limit of K' in made.text
    assert 'upper limits instead of measurements: none' not in made.text


@pytest.mark.parametrize('target', TARGETS)
def test_a_slow_sinusoid_may_be_the_only_drift(known_results: Results, target: str) -> None:
    slow = Part(Sinusoid(0.05), 4e-3, (3e-3, 5e-3), ((0.04, 0.06),))
    known = with_drift(known_results, slow)
    assert make_export(known, target).text


def test_the_loader_of_the_manual_reads_the_matrices(
    known_results: Results, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_export(known_results, 'state_space').text
    (tmp_path / 'state_space.json').write_text(made)
    monkeypatch.chdir(tmp_path)
    manual = (repository / 'docs' / 'targets.md').read_text(encoding='utf-8')
    (loader,) = re.findall(r'```python\n(import json, .*?)```', manual, re.DOTALL)
    assert sum(bool(line) for line in loader.splitlines()) == 5
    read = run_python(loader)
    for axis, one in json.loads(made)['axes'].items():
        phi, noise, sample = read['matrices'](axis)
        members = ((each.pop('sigma'), each.pop('process'), each) for each in one['processes'])
        processes = tuple((sigma, PROCESSES[name](**shape)) for sigma, name, shape in members)
        space = StateSpace(one['white'], one['walk'], processes)
        np.testing.assert_allclose(phi, space.transition(1.0 / 200.0), rtol=1e-11)
        np.testing.assert_allclose(noise, space.noise(1.0 / 200.0), rtol=1e-9)
        assert sample == near(space.sample_variance(200.0))


def test_an_xml_comment_has_no_two_hyphens_in_a_row() -> None:
    text = xml_form([Row(('x',), 1.0)], ['source: a---b ----', 'inflate with --inflate'])
    assert '--' not in text.removeprefix('<!--').replace('-->', '', 1)
    assert ElementTree.fromstring(text).text == '1.0'
