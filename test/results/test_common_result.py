# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Common noise from recordings: topics of a bag, files, samples in memory; table and document."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.readers.writing import write_recording
from allan_ros.results.common_result import CommonResult
from fuzz.reading import write_bag

RATE = 100.0
WHITE = np.array([1e-3] * 3 + [1e-2] * 3)
"""Standard deviation of the samples of each axis."""


def imus(n: int = 12_000, vibration: float = 3.0) -> list[ImuBatch]:
    """Return three IMUs whose common vibration is a multiple of their own noise."""
    rng = np.random.default_rng(1)
    shared = vibration * rng.normal(size=(n, 6))
    stamps = 10**18 + np.arange(n) * 10_000_000
    return [
        ImuBatch(
            stamps + 1_000_000 * i,
            WHITE * (shared + rng.normal(size=(n, 6))) + [0, 0, 0, 0, 0, 9.8],
            frame_id=f'imu{i}',
        )
        for i in range(3)
    ]


@pytest.fixture(scope='module')
def three() -> list[ImuBatch]:
    return imus()


@pytest.fixture(scope='module')
def common(three: list[ImuBatch]) -> CommonResult:
    return ar.common(*three)


def test_findings_of_each_recording_are_part_of_the_result(three: list[ImuBatch]) -> None:
    first, second, third = three
    in_g = ImuBatch(first.stamps_ns, first.samples / np.repeat([1.0, 9.80665], 3))
    flipped = ImuBatch(second.stamps_ns, second.samples * [1, -1, 1, 1, 1, 1])
    dead = ImuBatch(third.stamps_ns, third.samples * [1, 1, 1, 1, np.nan, 1])
    common = ar.common(in_g, flipped, dead)
    ids = {label: {f.id for f in found} for label, found in common.findings.items()}
    assert 'accel_unit' in ids['A'] and 'axis_absent' in ids['C']
    (opposite,) = (f for f in common.findings['B'] if f.id == 'axis_opposite')
    assert opposite.axes == ('gyro_y',)
    assert not any('axis_opposite' in ids[label] for label in 'AC')
    assert 'error: B: gyro_y: The direction of this axis is opposite to' in repr(common)
    assert {f['id'] for f in common.document()['findings']['B']} == ids['B']


def test_a_delay_leaves_no_own_noise_and_a_factor_is_shown(three: list[ImuBatch]) -> None:
    shared = np.random.default_rng(7).normal(size=(12_001, 6)) * 10.0 * WHITE
    first, second, third = (
        ImuBatch(each.stamps_ns, each.samples + part)
        for each, part in zip(
            imus(vibration=0.0), (shared[1:], 0.5 * (shared[1:] + shared[:-1]), shared[1:])
        )
    )
    delayed = ar.common(first, second, third)
    assert all(row.own is None and row.measured is not None for row in delayed.rows)
    assert 'measure the common noise differently' in repr(delayed)
    larger = ImuBatch(three[1].stamps_ns, three[1].samples * 1.5)
    scaled = ar.common(three[0], larger, three[2])
    assert 'factor' in repr(scaled)
    factors = [row.gain for row in scaled.rows if row.axis == 'gyro_x']
    assert factors[1] / factors[0] == pytest.approx(1.5, rel=0.05)
    own = [row.own.value for row in scaled.rows if row.axis == 'gyro_x' and row.own]
    assert own == pytest.approx([1e-4, 1.5e-4, 1e-4], rel=0.15)


def test_constant_samples_have_no_coherence() -> None:
    noise = np.random.default_rng(1).normal(size=12_000) * 1e-3
    constant = np.full(12_000, 0.01)
    common = ar.common(constant, noise, rate=RATE, motion_gate=False)
    assert all(np.isnan(row.coherence.value).all() for row in common.rows)
    assert 'nan' not in repr(common) and 'at 1 s' not in repr(common)
    assert not any(f.id == 'axis_opposite' for found in common.findings.values() for f in found)


def test_equal_samples_have_no_own_noise_but_no_fault(three: list[ImuBatch]) -> None:
    common = ar.common(three[0], three[0])
    assert all(row.own is None and row.leak == 0.0 for row in common.rows)
    assert 'measure the common noise differently' not in repr(common)


def test_the_same_recording_twice_is_refused(three: list[ImuBatch], tmp_path: Path) -> None:
    write_recording(tmp_path / 'a.npz', [three[0]])
    with pytest.raises(AllanError, match='given twice'):
        ar.common(tmp_path / 'a.npz', str(tmp_path / 'a.npz'))


def test_the_own_noise_of_each_imu(common: CommonResult) -> None:
    assert [(row.axis, row.label) for row in common.rows] == [(a, i) for a in AXES for i in 'ABC']
    for row in common.rows:
        true = WHITE[AXES.index(row.axis)] / np.sqrt(RATE)
        assert row.own is not None and row.measured is not None
        assert row.own.value == pytest.approx(true, rel=0.15)
        assert row.measured.value == pytest.approx(np.sqrt(10.0) * true, rel=0.1)
    lines = repr(common).splitlines()
    assert lines[0].split()[:3] == ['axis', 'IMU', 'N'] and len(lines) == 1 + 18 + 1
    assert 'deg/sqrt(h)' in lines[1] and 'at 1 s' in lines[0]


def test_the_document_and_the_chart(common: CommonResult) -> None:
    rows = json.loads(json.dumps(common.document()))['rows']
    assert rows[0]['own']['ci95'] == list(common.rows[0].own.ci95)
    assert {len(rows[0]['coherence'][key]) for key in ('tau', 'value', 'low', 'high')} == {
        len(common.rows[0].coherence.tau)
    }
    figure = common.plot()
    assert [panel.get_ylabel() for panel in figure.axes] == [a.replace('_', ' ') for a in AXES]
    assert [len(panel.lines) for panel in figure.axes] == [4] * 6  # three IMUs and zero


def test_files_and_topics_give_the_same_rows(
    three: list[ImuBatch],
    common: CommonResult,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip('rosbags')
    names = ['left', 'right', 'top']
    for name, batch in zip(names, three):
        write_recording(tmp_path / f'{name}.npz', [batch])
    write_bag(tmp_path / 'bag', {f'/{name}': batch for name, batch in zip(names, three)})
    files = ar.common(*(tmp_path / f'{name}.npz' for name in names))
    topics = ar.common(tmp_path / 'bag')
    assert [row.label for row in files.rows[:3]] == ['left', 'right', 'top']
    assert [row.label for row in topics.rows[:3]] == ['/left', '/right', '/top']
    for found in (files, topics):
        assert [row.own for row in found.rows] == [row.own for row in common.rows]
    two = ar.common(tmp_path / 'bag', tmp_path / 'left.npz')
    assert [row.label for row in two.rows[:4]] == ['bag /left', 'bag /right', 'bag /top', 'left']
    one = ar.common(tmp_path / 'bag', topic='/left')
    assert {row.label for row in one.rows} == {'bag /left'} and 'own N' not in repr(one)
    pair = repr(ar.common(*three[:2])).splitlines()
    assert 'own N, mean of both' in pair[0] and '-0.00' not in ' '.join(pair)
    assert main(['compare', str(tmp_path / 'bag'), 'b', '--topic', '/left']) == 1  # not --common
    capsys.readouterr()
    assert main(['compare', str(tmp_path / 'bag'), '--common', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['rows']


def test_only_the_time_at_rest_of_all_imus_is_used(three: list[ImuBatch]) -> None:
    """The first IMU is moved, the second one starts late."""
    moved = ImuBatch(three[0].stamps_ns, three[0].samples.copy(), frame_id='a')
    moved.samples[5000:6000] += np.random.default_rng(2).normal(scale=0.5, size=(1000, 6))
    found = ar.common(moved, three[1][800:], three[2])
    for row in found.rows[:9]:
        assert row.own is not None and row.own.value == pytest.approx(1e-4, rel=0.15)


def test_the_axes_of_one_imu_are_compared() -> None:
    (batch, *_) = imus(6000, 0.0)
    batch.samples[:, 1] += 2.0 * batch.samples[:, 0]
    found = ar.common(batch)
    assert len(found.rows) == 6 and all(row.own is None for row in found.rows)
    first, *others = found.rows
    assert first.axis == 'gyro_x gyro_y' and first.coherence.low[0] > 0.8
    assert all(abs(row.coherence.value[0]) < 0.1 for row in others)
    assert 'gyro_x gyro_y' in repr(found)


def test_wrong_inputs_are_rejected(three: list[ImuBatch], tmp_path: Path) -> None:
    gyro = {'gyro_x': np.random.default_rng(3).normal(scale=1e-3, size=3000)}
    accel = {'accel_x': np.random.default_rng(4).normal(scale=1e-2, size=3000)}
    for wrong, why in (
        (
            lambda: ar.common(gyro, accel, rate=100),
            'at rest of gyro_x; B has data at rest of accel_x: choose topics',
        ),
        (lambda: ar.common(gyro, rate=100), 'no two axes to compare'),
        (ar.common, 'no recording is given'),
        (lambda: ar.common(tmp_path / 'missing.mcap'), 'missing.mcap'),
        (lambda: ar.common(three[0], three[1][:50]), 'too little time in common'),
        (lambda: ar.common(three[0], no_such_option=1), 'no_such_option'),
    ):
        with pytest.raises(AllanError, match=why):
            wrong()


@pytest.mark.parametrize('option', ['--fail-on-difference', '--margin=.5', '--method=paper'])
def test_an_option_without_effect_is_rejected(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['compare', 'a.mcap', 'b.mcap', '--common', option]) == 1
    assert '--common judges and fits nothing' in capsys.readouterr().err


@pytest.mark.parametrize('given', ['sensor:bmi088', 'results', 'sums.json'])
def test_inputs_without_samples_have_no_common_noise(
    given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path('results').mkdir()
    Path('results/results.json').write_text('{}')
    assert main(['compare', 'a.mcap', given, '--common']) == 1
    assert f'{given}: --common needs the samples' in capsys.readouterr().err
