# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.cli.main import main
from allan_ros.core.fit.result import TERMS
from allan_ros.core.imu import shown_unit
from allan_ros.core.noise import Model
from allan_ros.core.simulator import PRESETS
from allan_ros.readers import open_recording
from allan_ros.results.datasheets import load_sensor
from allan_ros.results.simulation import read_noise, truth_path

SHORT = ['--hours', '0.01', '--rate', '50']  # 1800 samples


def simulate(out, *arguments):
    assert main(['simulate', str(out), *SHORT, *arguments]) == 0
    recording = open_recording(str(out))
    batches = list(recording.batches())
    return (
        np.concatenate([b.stamps_ns for b in batches]),
        np.concatenate([b.samples for b in batches]),
        read_noise(truth_path(out)),
    )


def test_the_preset_is_table_1_of_the_paper(tmp_path):
    stamps, samples, truth = simulate(tmp_path / 'bag', '--preset', 'paper')
    assert len(stamps) == 1800 and np.array_equal(np.diff(stamps), [20_000_000] * 1799)
    for axis, terms in PRESETS['paper'].items():
        for term in TERMS:
            value = truth[axis].value(term) * shown_unit(axis, term, 'deg/h').factor
            assert value == pytest.approx(terms.get(term, 0.0))
    assert samples[:, 5].mean() == pytest.approx(9.80665, abs=0.01)


@pytest.mark.parametrize('name', ['bag', 'a.csv', 'a.npz', 'a.mcap', 'a.db3'])
def test_every_format_contains_the_same_samples(tmp_path, name):
    reference = simulate(tmp_path / 'reference.npz', '--gyro', 'N=0.3', '--seed', '3')
    for again in ([], ['--overwrite']):
        found = simulate(tmp_path / name, '--gyro', 'N=0.3', '--seed', '3', *again)
        assert (tmp_path / name).is_file() == ('.' in name)
    assert np.array_equal(found[0], reference[0])
    assert np.array_equal(found[1], reference[1])


def test_single_terms_go_before_the_datasheet(tmp_path):
    _, _, truth = simulate(
        tmp_path / 'a.npz', '--sensor', 'adis16475-3', '--gyro-y', 'N=0.5,R=-3', '--accel', 'B=9'
    )
    limits = load_sensor('adis16475-3').limits['gyro_x']
    assert truth['gyro_x'] == Model.of(N=limits['N'].value, B=limits['B'].value)
    assert truth['gyro_y'].value('B') == truth['gyro_x'].value('B')
    for axis, term, stated in (('gyro_y', 'N', 0.5), ('gyro_y', 'R', -3.0), ('accel_z', 'B', 9.0)):
        factor = shown_unit(axis[:-2], term, 'deg/h').factor
        assert truth[axis].value(term) * factor == pytest.approx(stated)


def test_faults_are_passed_on_and_a_truth_can_be_simulated_again(tmp_path):
    spec = tmp_path / 'spec.yaml'
    spec.write_text(
        'faults: {gaps: [[5, 2], [20, 1.5]], motion: [[10, 3]], motion_gyro: 2, lsb_accel: 0.5}\n'
        'noise: {gyro: {N: 0.001}}\n'
    )
    stamps, samples, truth = simulate(tmp_path / 'a.npz', '--spec', str(spec))
    again = simulate(tmp_path / 'b.npz', '--spec', str(truth_path(tmp_path / 'a.npz')))
    assert np.array_equal(samples, again[1]) and truth == again[2]
    steps = np.diff(stamps) / 1e9
    assert sorted(steps[steps > 0.03]) == pytest.approx([1.52, 2.02])
    t = (stamps - stamps[0]) / 1e9
    moving = np.abs(samples[:, 0]) > 0.1
    assert moving.any() and t[moving].min() >= 10 and t[moving].max() < 13
    assert set(samples[~moving, 5]) <= set(np.arange(8.5, 11.5, 0.5))


@pytest.mark.parametrize(
    'arguments, said',
    [
        ([], 'give --preset paper, --sensor NAME, --spec FILE or --gyro N=1e-4'),
        (['--gyro', 'N=-1'], 'noise.gyro: N is'),
        (['--gyro', 'Z=1'], "noise.gyro: 'Z' is unknown"),
        (['--preset', 'paper', '--hours', '-1'], 'duration is -3600.0: it must lie between 0'),
        (['--preset', 'paper', '--hours', 'inf'], 'duration is inf'),
        (['--preset', 'paper', '--rate', '1e-300'], 'rate is 1e-300'),
        (['--preset', 'paper', '--seed', '-1'], 'seed is -1'),
        (['--sensor', 'nothing'], "no datasheet 'nothing'"),
        (['--spec', 'missing.yaml'], 'missing.yaml: cannot be read'),
    ],
)
def test_the_impossible_is_one_line_and_exit_1(tmp_path, capsys, arguments, said):
    out = tmp_path / 'a.npz'
    assert main(['simulate', str(out), *arguments]) == 1
    error = capsys.readouterr().err
    assert said in error and error.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_an_existing_recording_is_kept_by_default(tmp_path, capsys):
    out = tmp_path / 'a.npz'
    simulate(out, '--gyro', 'N=1')
    assert main(['simulate', str(out), *SHORT, '--gyro', 'N=2']) == 1
    assert 'exists already' in capsys.readouterr().err
    kept = read_noise(truth_path(out))['gyro_x']
    assert [kept.value(term) for term in TERMS] == pytest.approx([0.0, np.pi / 180 / 60, 0, 0, 0])
    simulate(out, '--gyro', 'N=2', '--overwrite')
