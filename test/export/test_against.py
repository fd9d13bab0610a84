# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The user's file for a filter is read back, and its drift compared with the measured drift."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.exports import with_process

from allan_ros.core.errors import AllanError
from allan_ros.core.noise.model import Model
from allan_ros.export import TARGETS, ExportOptions, make_export, target_of
from allan_ros.export.own_file import compare_drifts, file_models, verdicts
from allan_ros.results.results import Results

COMPARED = [n for n in TARGETS if {'K', 'sigma'} & {key.what for key in target_of(n).keys}]


@pytest.mark.parametrize('rate', [0.0, 400.0])
@pytest.mark.parametrize('name', COMPARED)
def test_what_export_writes_is_read_back(known_results: Results, name: str, rate: float) -> None:
    known = known_results
    if 'sigma' in {key.what for key in target_of(name).keys}:
        for axis in known.axes:
            known = with_process(known, axis, 2e-4, 0.05)
    options = ExportOptions(fidelity='coefficients', filter_rate=rate)
    text = make_export(known, name, options).text
    models = file_models(target_of(name), text, rate or target_of(name).rate_hz or 200.0)
    for axis, n, k in (('gyro_z', 1e-3, 1e-5), ('accel_z', 2e-3, 3e-5)):
        model = models[axis]
        assert pytest.approx(n, rel=1e-5) == model.value('N')
        if model.shaped.parts:
            ((process, sigma, *_),) = model['gauss_markov']
            assert 10.0 < process.correlation_time < 1000.0 and 1e-4 < sigma < 1e-3
        else:
            assert pytest.approx(3e-5 if name == 'glim' else k, rel=1e-5) == model.value('K')


@pytest.mark.parametrize('name', COMPARED)
def test_an_exported_file_covers_the_measured_drift(known_results: Results, name: str) -> None:
    text = make_export(known_results, name).text
    drifts = compare_drifts(known_results, target_of(name), text)
    assert len(drifts) == 6 * 3
    for drift in drifts:
        within = drift.after <= target_of(name).horizon_s
        assert drift.ratio < 1.01 or not within  # an expected K is no state of an INS
        assert drift.ratio > 0.1
    assert all('covers the measured drift' in line for line in verdicts(drifts[:2]))


def test_a_file_with_a_hundredth_of_the_noise_is_overconfident(known_results: Results) -> None:
    mine = (
        'imu0:\n  T_i_b:\n  - [1.0, 0.0]\n  accelerometer_noise_density: 2.0e-05 # mine\n'
        '  accelerometer_random_walk: 0.0\n  gyroscope_noise_density: 1e-05\n'
        '  gyroscope_random_walk: 1.0e-07\n  update_rate: 200.0\n'
    )
    drifts = compare_drifts(known_results, target_of('openvins'), mine)
    one = next(d for d in drifts if d.axis == 'gyro_z' and d.after == 1.0)
    # white noise of 1e-3, and its mean over 30 s: 1e-3 sqrt(1 + 1/30); B adds a tenth
    assert one.measured == pytest.approx(1.02e-3, rel=0.05)
    assert one.file == pytest.approx(1.0165e-5, rel=1e-3)
    assert one.ratio == pytest.approx(100.0, rel=0.05) and one.overconfident
    gyro, accel = verdicts(drifts)
    assert gyro.startswith('gyro: a filter with your file is overconfident by ')
    assert 'accel_z after 60 s' in accel
    assert str(one) == (
        'gyro_z after 1 s: your file 0.00058 deg, measured 0.059 (0.051..0.067) deg, 100 times'
    )


@pytest.mark.parametrize(
    'mine, said',
    [
        ('gyr_n: 0.1\nacc_n: 0.1\nacc_w: 0.1\n', 'contains no number of gyr_w'),
        ('gyr_n: 0.1\nacc_n: 0\ngyr_w: 1\nacc_w: 1', r'acc_n of your file is 0: give'),
        (
            'gyr_n: 1e200\nacc_n: 1e200\ngyr_w: 1e200\nacc_w: 1e200',
            r'of your file is 1e200: give',
        ),
        ('acc_n: 0.1\nother:\n  acc_n: 0.2\n', 'contains several values of acc_n'),
        ('acc_n: [0.1, 0.2]\n', 'contains several values of acc_n'),
        ('\0\1', 'contains no number of acc_n'),
    ],
)
def test_a_file_that_lacks_a_number_is_rejected(
    known_results: Results, mine: str, said: str
) -> None:
    with pytest.raises(AllanError, match=said):
        compare_drifts(known_results, target_of('vins_fusion'), mine)


@pytest.mark.parametrize('name', sorted(set(TARGETS) - set(COMPARED)))
def test_a_target_without_a_noise_model_is_rejected(known_results: Results, name: str) -> None:
    with pytest.raises(AllanError, match='has no noise model to compare'):
        compare_drifts(known_results, target_of(name), make_export(known_results, name).text)


def test_absent_axes_are_not_compared(known_results: Results) -> None:
    text = make_export(known_results, 'kalibr').text
    gyro = {name: axis for name, axis in known_results.axes.items() if name.startswith('gyro')}
    drifts = compare_drifts(replace(known_results, axes=gyro), target_of('kalibr'), text)
    assert {drift.axis for drift in drifts} == set(gyro)


def test_results_without_noise_cannot_be_compared(known_results: Results) -> None:
    text = make_export(known_results, 'kalibr').text
    axes = {
        name: replace(axis, fit=replace(axis.fit, model=Model.of()))
        for name, axis in known_results.axes.items()
    }
    with pytest.raises(AllanError, match='record longer at rest'):
        compare_drifts(replace(known_results, axes=axes), target_of('kalibr'), text)
