# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan compare`, `allan sensors` and `--sensor` from the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from allan_ros.cli.main import main
from allan_ros.results.datasheets import sensor_names


def test_analyze_prints_and_keeps_the_comparison_with_a_datasheet(
    recording: Path, tmp_path: Path, capsys
) -> None:
    words = ['--sensor', 'adis16475-3', '-o', str(tmp_path)]
    assert main(['analyze', str(recording), *words]) == 0
    found = json.loads((tmp_path / 'results.json').read_text())['datasheet']
    assert found['name'] == 'ADIS16475-3'
    assert found['axes']['gyro_x']['N']['verdict'] == 'within'
    said = capsys.readouterr().out
    assert 'compared with the datasheet of ADIS16475-3 plus 20 %: ' in said
    assert 'gyro  N  x y z within: limit 0.300 deg/sqrt(h) (stated 0.3 deg/sqrt(h))' in said


def test_a_recording_and_its_results_compare_equally(
    analyzed: Path, recording: Path, capsys
) -> None:
    assert main(['compare', str(analyzed), str(recording), '--fail-on-difference']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert said.startswith(f'{recording.stem} and {analyzed.name} do not differ significantly')
    assert f'{recording.stem} ratio' in said


@pytest.mark.parametrize('noisy', [False, True])
def test_results_of_a_simulation_are_scored(tmp_path: Path, capsys, noisy: bool) -> None:
    """False alarms: 5 %, the probability of a difference in `compare`; the seed is fixed."""
    recording = tmp_path / 'made.csv'
    made = ['simulate', str(recording), '--gyro', 'N=0.3', '--accel', 'N=0.05', '--seed', '1']
    assert main([*made, '--hours', '0.05', '--rate', '50']) == 0
    truth = tmp_path / 'made.csv.truth.json'
    if noisy:
        document = json.loads(truth.read_text())
        document['noise']['gyro_z']['N']['value'] /= 2.0
        truth.write_text(json.dumps(document))
    capsys.readouterr()
    words = ['compare', str(recording), str(truth), '--json', '--fail-on-difference']
    assert main(words) == (3 if noisy else 0)
    (pair,) = json.loads(capsys.readouterr().out)['pairs']
    found = {(d['axis'], d['quantity']): d for d in pair['differences']}
    n = found['gyro_z', 'N']
    assert n['verdict'] == ('higher' if noisy else 'alike')
    assert n['ratio'] == pytest.approx(2.0 if noisy else 1.0, rel=0.1)
    assert found['gyro_z', 'B']['ratio'] is None, 'a term that was not simulated'


def test_a_difference_fails_only_with_the_option(analyzed: Path, tmp_path: Path, capsys) -> None:
    document = json.loads((analyzed / 'results.json').read_text())
    noise = document['axes']['gyro_z']['noise']
    noise['N']['value'] *= 2
    noise['N']['ci95'] = [2 * end for end in noise['N']['ci95']]
    hidden = next(term for term in 'KBR' if noise[term]['status'] != 'estimated')
    value = 1000 * noise[hidden]['upper95']  # of this ratio, only a limit is known
    noise[hidden].update(value=value, ci95=[0.99 * value, 1.01 * value])
    noise[hidden].update(upper95=None, status='estimated')
    worse = tmp_path / 'worse.json'
    worse.write_text(json.dumps(document))
    words = ['compare', str(analyzed), str(worse)]
    assert main(words) == 0
    said = ' '.join(capsys.readouterr().out.split())  # without the line breaks of the terminal
    assert re.match(rf'worse differs .* most in gyro z {hidden}: > 9\d\d times', said)
    assert 'gyro z N' in said or '2.00 (' in said
    assert main([*words, '--fail-on-difference', '--json']) == 3
    assert json.loads(capsys.readouterr().out)['differs'] is True
    assert main(['compare', str(worse), 'sensor:adis16475-3', '--fail-on-difference']) == 3
    said = capsys.readouterr().out
    assert re.match(r'worse exceeds the datasheet of ADIS16475-3 in gyro z N,', said)


@pytest.mark.parametrize(
    'words, said',
    [
        (['{run}'], 'nothing to compare'),
        (['sensor:adis16475-3'], 'nothing to compare'),
        (['{run}', '{run}'], 'an input is given twice'),
        (['{run}', 'sensor:none'], "no datasheet 'none'"),
        (['{run}', '--margin', '-1'], 'margin is -1.0: it must lie between 0 and 1'),
    ],
)
def test_incomparable_inputs_give_one_line(
    analyzed: Path, capsys, words: list[str], said: str
) -> None:
    assert main(['compare', *(word.format(run=analyzed) for word in words)]) == 1
    error = capsys.readouterr().err
    assert said in error and error.count('\n') == 1


def test_the_list_fits_the_terminal(monkeypatch, capsys) -> None:
    monkeypatch.setenv('COLUMNS', '60')
    assert main(['sensors']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 60
    assert [line.split()[0] for line in lines[1 : len(sensor_names()) + 1]] == sensor_names()


def test_one_datasheet_is_shown_with_its_sources(capsys) -> None:
    assert main(['sensors', 'ADIS16475-3']) == 0
    said = capsys.readouterr().out
    assert said.startswith('ADIS16475-3 (Analog Devices)\n')
    assert 'gyro_x, gyro_y, gyro_z N: stated 0.3 deg/sqrt(h)' in said
    assert main(['sensors', 'adis16475-3', '--json']) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown['limits']['gyro_x']['N']['stated'] == '0.3 deg/sqrt(h)'
    assert main(['sensors', '--json']) == 0
    assert shown in json.loads(capsys.readouterr().out)['sensors']
    assert main(['sensors', 'adis16475']) == 1


def test_equality_is_answered_and_sets_the_exit_code(
    analyzed: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = ['compare', str(analyzed), str(recording), '--fail-on-difference']
    assert main([*pair, '--within', '20%']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert f'{recording.stem} is the same as {analyzed.name} to 20 % in' in said
    assert main([*pair, '--within', '0.01%', '--json']) == 3
    document = json.loads(capsys.readouterr().out)
    assert document['within'] == pytest.approx(1e-4)
    assert document['pairs'][0]['differences'][0]['equivalence'] == 'undecided'
    assert main([*pair, '--within', '0.2', '--margin', '30%']) == 0
    for wrong in ('--within=5', '--margin=5', '--margin=5%%', '--within=x%'):
        with pytest.raises(SystemExit):
            main([*pair, wrong])
        assert 'write a percentage such as 5%' in capsys.readouterr().err
