# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan fit`: curves of other tools, good and faulty."""

import json

import numpy as np
import pytest

from allan_ros.cli.main import main
from allan_ros.core.errors import AllanError
from allan_ros.core.fit.simple_methods import fit_curve
from allan_ros.core.noise import NoiseTerms, ProcessModel
from allan_ros.io.user_files import read_curves

TAU = np.geomspace(0.1, 1000.0, 200)


def test_five_terms_are_recovered():
    model = ProcessModel(NoiseTerms(N=1e-3, B=1e-4, K=1e-5))
    fit = fit_curve(TAU, np.sqrt(model.avar(TAU)))
    assert fit.noise['N'].value == pytest.approx(1e-3, rel=0.01)
    assert fit.noise['B'].value == pytest.approx(1e-4, rel=0.05)
    assert fit.noise['K'].value == pytest.approx(1e-5, rel=0.05)
    assert fit.noise['Q'].status == 'not_observable'
    assert not fit.processes.gauss_markov and not fit.processes.sinusoid
    assert fit.deviation is None


def test_a_gauss_markov_process_is_found():
    model = ProcessModel(NoiseTerms(N=1e-3), gauss_markov=((2e-3, 5.0),))
    fit = fit_curve(TAU, np.sqrt(model.avar(TAU)), record=36 * 3600.0)
    (found,) = fit.processes.gauss_markov
    assert found.correlation_time == pytest.approx(5.0, rel=0.1)
    assert found.sigma == pytest.approx(2e-3, rel=0.1)
    assert fit.noise['N'].value == pytest.approx(1e-3, rel=0.05)


def test_too_few_points_are_an_error():
    with pytest.raises(AllanError, match='usable points'):
        fit_curve([0.1, 0.2], [1.0, 0.7])


def test_a_file_with_a_header(tmp_path, capsys):
    path = tmp_path / 'curve.csv'
    rows = '\n'.join(f'{t:.6g},{1e-3 / t**0.5:.6g}' for t in TAU)
    path.write_text(f'tau [s],gyro_x [rad/s]\n{rows}\n')
    assert list(read_curves(path).adev) == ['gyro_x']
    assert main(['fit', str(path), '--units', 'si']) == 0
    assert 'N rad/s/sqrt(Hz)    0.001000' in capsys.readouterr().out


def test_published_values_too_large_and_too_small_are_doubted(tmp_path, capsys):
    path, kalibr = tmp_path / 'curve.csv', tmp_path / 'imu.yaml'
    rows = '\n'.join(f'{t:.6g},{1e-3 / t**0.5:.6g}' for t in TAU)
    path.write_text(f'tau,gyro_x\n{rows}\n')
    for value, said in ((1e-2, '9.9 times the largest'), (1e-4, '9.9 times smaller than')):
        kalibr.write_text(f'gyroscope_noise_density: {value}\n')
        assert main(['fit', str(path), '--published', str(kalibr)]) == 0
        assert f'The published N of the gyro is {said}' in ' '.join(capsys.readouterr().out.split())
    for text, said in (('rate: 3\n', 'contains none of'), ('\xff', 'cannot be read')):
        kalibr.write_text(text, encoding='latin-1')
        assert main(['fit', str(path), '--published', str(kalibr)]) == 1
        assert said in capsys.readouterr().err


def test_a_file_that_is_missing_is_an_error(tmp_path, capsys):
    assert main(['fit', str(tmp_path / 'none.csv')]) == 1
    assert 'none.csv: cannot be read' in capsys.readouterr().err


@pytest.mark.parametrize('text', ['', 'tau,speed\n1,2\n', '1 2 3\n', 'tau,gyro_x\n1,x\n'])
def test_an_invalid_curve_is_an_error(tmp_path, text, capsys):
    path = tmp_path / 'curve.csv'
    path.write_text(text)
    assert main(['fit', str(path)]) == 1
    assert 'curve.csv' in capsys.readouterr().err


@pytest.mark.parametrize(('name', 'faulty'), [('alphasense', False), ('adis', True)])
def test_published_values_are_checked(shared_data, name, faulty, capsys):
    """In one of them the z accelerometer was not at rest, so its published N is far too large."""
    folder = shared_data / 'curves'
    curve, published = folder / f'{name}.allan_variance.csv', folder / f'{name}.imu.yaml'
    arguments = [str(curve), '--published', str(published), '--hours', '36', '--json']
    assert main(['fit', *arguments]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document['axes']) >= {'gyro_x', 'accel_z'}
    said = ' '.join(document['doubts'])
    assert ('accel_z rises' in said and 'published N of the accel' in said) is faulty
    assert bool(document['doubts']) is faulty
