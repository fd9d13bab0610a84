# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan inflate`: how much running motors raise the noise of a robot at rest."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from allan_ros.cli.main import main
from allan_ros.export import ExportOptions

RATE, SECONDS = 50.0, 600


@pytest.fixture(scope='module')
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Return two tables of samples: motors off, and motors on with 4 times the noise of the
    gyro.
    """
    folder = tmp_path_factory.mktemp('recordings')
    rng = np.random.default_rng(3)
    t = np.arange(int(RATE * SECONDS)) / RATE
    paths = []
    for name, factor in (('rest', 1.0), ('running', 4.0)):
        samples = rng.normal(size=(len(t), 6)) * [*[factor * 1e-3] * 3, *[1e-2] * 3]
        # motors off at first: otherwise the motion gate would learn the higher noise floor
        samples[: len(t) // 3, :3] *= 1.0 if name == 'rest' else 0.25
        samples[:, 5] += 9.81
        table = np.column_stack([t, samples])
        path = folder / f'{name}.csv'
        header = 't,gx,gy,gz,ax,ay,az'
        np.savetxt(path, table, delimiter=',', header=header, comments='', fmt='%.9g')
        paths.append(str(path))
    return paths[0], paths[1]


def test_the_factor_is_measured_with_vibration_included(
    recordings: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The motors start after a third of the time, which is excluded: N is 4 times larger."""
    assert main(['inflate', *recordings]) == 0
    shown = capsys.readouterr().out
    assert 'N and K for a filter, over 1 to 30 s' in shown
    assert 'in motion' not in shown
    assert re.search(r'^For `allan export`: --inflate gyro=4\.\d+,accel=1\.\d+$', shown, re.M)
    assert main(['inflate', *recordings, '--json']) == 0
    document = json.loads(capsys.readouterr().out)
    gyro, accel = document['axes']['gyro_x'], document['axes']['accel_y']
    assert gyro['N']['factor'] == pytest.approx(4.0, rel=0.1)
    assert gyro['N']['use'] == gyro['N']['running']
    assert accel['N']['factor'] == pytest.approx(1.0, abs=0.1)
    assert document['factor'] == pytest.approx(4.0, rel=0.1)
    assert ExportOptions(inflate=document['inflate']).factors['gyro'] == pytest.approx(4.0, rel=0.1)
    at_1s = min(gyro['deviation'], key=lambda d: abs(d['tau_s'] - 1.0))
    assert at_1s['ci95'][0] < 4.0 < at_1s['ci95'][1]
    assert main(['inflate', *recordings, '--horizon', '0']) == 1
    assert 'horizon is 0.0: it must lie between' in capsys.readouterr().err
