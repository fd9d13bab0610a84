# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise in motion of a recording with rests and drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.simulate_drives import MotionErrors, Route, simulate_drives

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.results.motion import measure_motion
from allan_ros.view.finding_text import texts_of
from allan_ros.view.verdict_text import verdict_of

RATE = 50.0
GYRO, ACCEL = [Model.of(N=7e-5)] * 3, [Model.of(N=1.2e-3)] * 3


def recording(route: Route, errors: MotionErrors = MotionErrors(), seed: int = 1) -> ImuBatch:
    samples = simulate_drives(RATE, GYRO, ACCEL, route, errors, seed).samples
    stamps = 10**18 + np.arange(len(samples)) * round(1e9 / RATE)
    return ImuBatch(stamps.astype(np.int64), samples)


@pytest.fixture(scope='module')
def scaled() -> ar.Results:
    """Return the results of 12 drives with a gyro whose scale factors are wrong by about 1 %."""
    return ar.analyze(recording(Route(drives=12, tilt=0.15), MotionErrors(gyro_scale=0.01)))


def test_the_factor_and_its_cause_are_results(scaled: ar.Results) -> None:
    motion = scaled.motion
    assert motion is not None
    low, high = motion['gyro'].ci95
    assert 1.5 < low < motion['gyro'].value < high
    assert motion.causes[0].name == 'gyro_matrix'
    assert motion.gyro.explained.value < 0.5 * motion['gyro'].value
    assert len(motion.drives) == 12


def test_each_drive_has_the_ratio_of_its_errors_to_the_prediction(scaled: ar.Results) -> None:
    """Without errors the mean square is 1, or less because the Earth does not rotate here.

    False alarms: 12 drives have about 24 degrees of freedom; 0.3 and 1.9 are their 0.03 % limits.
    """
    clean = ar.analyze(recording(Route(drives=12, tilt=0.15)))
    squares = {
        name: np.array([(each.rotation**2, each.velocity**2) for each in results.motion.drives])
        for name, results in (('clean', clean), ('scaled', scaled))
    }
    assert np.all((squares['clean'].mean(axis=0) > 0.3) & (squares['clean'].mean(axis=0) < 1.9))
    assert np.all(squares['scaled'].mean(axis=0) > 4.0)


def test_the_sentence_states_the_factor_and_the_cause(scaled: ar.Results) -> None:
    (found,) = (f for f in scaled.findings if f.id == 'error_in_motion' and 'gyro_x' in f.axes)
    message = texts_of(found).message
    assert 'angle error' in message
    assert '12 drives' in message
    assert 'scale factors or misalignments of the gyro' in message


def test_the_document_keeps_everything(scaled: ar.Results, tmp_path: Path) -> None:
    scaled.save(tmp_path / 'out')
    again = ar.load(tmp_path / 'out' / 'results.json')
    assert again.motion == scaled.motion


def test_the_exported_file_has_the_factor(
    scaled: ar.Results, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scaled.save(tmp_path)
    assert main(['export', str(tmp_path), '--to', 'openvins', '--motion']) == 0
    text = capsys.readouterr().out
    assert 'inflation: in motion, gyro ' in text and 'from 12 drives' in text
    assert 'n motion the angle error is' in text
    assert text == scaled.export('openvins', motion=True)
    assert text != scaled.export('openvins')


def test_the_sums_of_an_analysis_keep_the_drives_out(scaled: ar.Results, tmp_path: Path) -> None:
    """A fit of sums alone knows no drives: it states no factor."""
    scaled.save(tmp_path / 'out')
    assert ar.analyze(tmp_path / 'out' / 'sums.json').motion is None


def test_a_perfect_robot_is_as_good_as_at_rest() -> None:
    """The intervals of both sensors contain 1: false alarm of 5 % each, at a fixed seed."""
    motion = ar.analyze(recording(Route(drives=15), seed=3)).motion
    assert motion is not None
    for sensor in ('gyro', 'accel'):
        low, high = motion[sensor].ci95
        assert low < 1.0 < high
    assert motion.causes == ()


def test_drift_that_the_rests_do_not_resolve_is_no_error_in_motion() -> None:
    """In rests of 7 s, flicker noise and a random walk cannot be told from white noise, but they
    are part of the errors of every drive. Four intervals contain 1: false alarm of 5 % each, at
    fixed seeds.
    """
    drifting = [Model.of(N=7e-5, B=2e-5, K=5e-6)] * 3, [Model.of(N=1.2e-3, B=2e-4, K=5e-5)] * 3
    for seed in (4, 7):
        samples = simulate_drives(RATE, *drifting, Route(drives=20), seed=seed).samples
        stamps = 10**18 + np.arange(len(samples)) * round(1e9 / RATE)
        results = ar.analyze(ImuBatch(stamps.astype(np.int64), samples))
        assert not any(results[axis].fit.noise['K'].resolved for axis in results.axes)
        for sensor in ('gyro', 'accel'):
            low, high = results.motion[sensor].ci95
            assert low < 1.0 < high
        assert [f.id for f in results.findings].count('motion_as_at_rest') == 2


def test_too_few_drives_are_named() -> None:
    results = ar.analyze(recording(Route(drives=3, rest=25.0)))
    assert results.motion is None
    (found,) = (f for f in results.findings if f.id == 'motion_not_measured')
    assert '3 of 3 drives' in texts_of(found).message
    assert 'at least 5' in texts_of(found).remedy


def test_a_recording_at_rest_says_how_to_learn_the_noise_in_motion() -> None:
    results = ar.analyze(recording(Route(drives=0, first=120.0)))
    assert results.motion is None
    assert not [f for f in results.findings if 'motion' in f.id]
    assert 'record drives between rests' in verdict_of(results).next_steps[-1]


def test_a_recording_of_motion_alone_says_that_rests_are_needed() -> None:
    moving = recording(Route(drives=1, first=0.1, rest=0.1, shortest=120.0, longest=120.0))
    with pytest.raises(AllanError, match='let the robot stop for 5 s between drives'):
        ar.analyze(moving)


def test_rests_that_do_not_show_the_noise_give_no_factor(scaled: ar.Results) -> None:
    """The rests of a vehicle may be slow driving: then they are no reference."""
    motion, (found,) = measure_motion(
        scaled.recorded.drives, scaled.axes, scaled.duration_s, 0.5, hidden=True
    )
    assert motion is None
    assert found.id == 'motion_without_noise'
    assert '12 drives' in texts_of(found).message
    assert 'another recording' in texts_of(found).remedy


def test_the_noise_of_an_earlier_run_predicts_the_errors(tmp_path: Path) -> None:
    """Rests of less than a minute need the noise of another recording."""
    drives = recording(Route(drives=6, rest=6.0, longest=20.0), seed=4)
    alone = ar.analyze(drives)
    assert alone.motion is None
    bench = ar.analyze(recording(Route(drives=0, first=300.0), seed=5))
    assert ar.analyze(drives, noise=bench).motion is not None
    bench.save(tmp_path / 'bench')
    assert ar.analyze(drives, noise=tmp_path / 'bench').motion is not None
