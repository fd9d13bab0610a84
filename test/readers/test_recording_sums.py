# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gyro and accelerometer on two topics of a bag."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.cli.main import main
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.stream.signal import BIN_STATISTICS, SignalEnvelope, summarize_signal
from allan_ros.readers import ReadOptions
from allan_ros.readers.recording_sums import ReadJob, RecordingSums, add_recordings, read_recording
from allan_ros.results.analysis import analyze_recorded
from allan_ros.view.finding_text import explained, texts_of
from allan_ros.view.verdict_text import used_samples
from fuzz.reading import write_bag

pytest.importorskip('rosbags')

GYRO, ACCEL = '/camera/gyro/sample', '/camera/accel/sample'
BOTH = {'topic': GYRO, 'accel_topic': ACCEL}
START_NS = 1_700_000_000 * 10**9


def camera(seconds: float, unused: float = 0.0, start_ns: int = START_NS) -> dict[str, ImuBatch]:
    """Return the samples of a gyro at 200 Hz and an accelerometer at 63 Hz on two topics."""
    rng = np.random.default_rng(3)
    batches = {}
    for topic, rate, offset in ((GYRO, 200.0, 0), (ACCEL, 63.0, 1_234_567)):
        n = int(seconds * rate)
        samples = rng.normal(0.0, [1e-3] * 3 + [1e-2] * 3, (n, 6)) + [0, 0, 0, 0, 0, 9.8]
        if topic == GYRO:
            samples[:, 3:] = unused
        else:
            samples[:, :3] = unused
        stamps = start_ns + offset + np.rint(np.arange(n) * 1e9 / rate).astype(np.int64)
        batches[topic] = ImuBatch(stamps, samples, frame_id=f'{topic[8:].split("/")[0]}_frame')
    return batches


def read(path: Path, **options: str) -> RecordingSums:
    return read_recording(ReadJob(str(path), ReadOptions(**options), with_context=True))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
@pytest.mark.parametrize('unused', [0.0, np.nan])
def test_two_topics_give_the_sums_of_each(tmp_path: Path, storage: str, unused: float) -> None:
    path = write_bag(tmp_path / 'camera.bag', camera(70.0, unused), storage)
    both = read(path, **BOTH)
    gyro, accel = read(path, topic=GYRO), read(path, topic=ACCEL)
    assert both.sums == (
        gyro.sums[0],
        replace(accel.sums[0], identity=gyro.sums[0].identity),
    )
    assert [s.axes for s in both.sums] == [AXES[:3], AXES[3:]]
    assert used_samples(analyze_recorded(both, 'paper')) == '14,000 samples'
    assert [round(1.0 / (s.tau0 or 0.0)) for s in both.sums] == [200, 63]
    assert [source.topic for source in both.provenance.sources] == [GYRO, ACCEL]
    assert both.provenance.segments == gyro.provenance.segments
    assert not both.provenance.findings
    assert both.sums == read(path, accel_topic=ACCEL.lstrip('/')).sums  # the only other topic


def test_a_serial_number_is_short() -> None:
    with pytest.raises(AllanError, match='10000 characters'):
        ReadJob('imu.csv', hardware_id='1' * 10_000)


def test_the_other_fields_of_both_topics_are_ignored(tmp_path: Path) -> None:
    clean, disturbed = camera(70.0), camera(70.0)
    disturbed[GYRO].samples[3000:9000, 3:] = np.random.default_rng(4).normal(size=(6000, 3))
    disturbed[ACCEL].samples[2000:, :3] = 7.0
    paths = [write_bag(tmp_path / n, b) for n, b in (('clean', clean), ('disturbed', disturbed))]
    one, other = (read(path, **BOTH) for path in paths)
    assert one.sums == other.sums
    assert one.provenance.counts == other.provenance.counts


def test_recordings_of_two_topics_are_added(tmp_path: Path) -> None:
    later = START_NS + 100 * 10**9
    paths = [
        write_bag(tmp_path / 'a', camera(40.0)),
        write_bag(tmp_path / 'b', {t: b[50:] for t, b in camera(60.0, start_ns=later).items()}),
    ]
    parts = [read(path, **BOTH) for path in paths]
    total = add_recordings(parts)
    assert [s.samples for s in total.sums] == [8000 + 11950, 2520 + 3730]


def test_the_results_have_the_noise_of_both(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'camera', camera(120.0))
    results = ar.analyze(path, **BOTH)
    assert tuple(results) == AXES
    for axis in results:
        sigma, rate = (1e-3, 200.0) if axis.startswith('gyro') else (1e-2, 63.0)
        low, high = results[axis].N.ci95
        assert low * 0.97 < sigma / np.sqrt(rate) < high * 1.03
    summary = summarize_signal(results.recorded.signals, results.provenance.segments, 100)
    assert summary is not None and np.isfinite(summary.mean).all()
    assert np.abs(summary.mean[:, 5] - 9.8).max() < 0.01
    folder = tmp_path / 'out'
    results.save(folder)
    assert ACCEL in (folder / 'report.html').read_text()
    assert ar.analyze(folder)['accel_x'].N.value == results['accel_x'].N.value


@pytest.mark.parametrize(('one', 'other'), [(GYRO, ACCEL), (ACCEL, GYRO)])
def test_a_topic_with_one_sensor_names_the_option(
    tmp_path: Path, one: str, other: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bag(tmp_path / 'camera', camera(70.0))
    (found,) = [f for f in read(path, topic=one).provenance.findings if f.id == 'sensor_elsewhere']
    assert other in texts_of(found).message
    assert f'--topic {GYRO} --accel-topic {ACCEL}' in texts_of(found).remedy
    if one == GYRO:
        main(['analyze', str(path)])  # each topic alone
        assert texts_of(found).remedy in capsys.readouterr().err


def test_the_topic_with_the_most_similar_name_is_suggested(tmp_path: Path) -> None:
    batches = camera(70.0)
    path = write_bag(tmp_path / 'bag', {'/imu/data': batches[ACCEL], **batches})
    (found,) = [f for f in read(path, topic=GYRO).provenance.findings if f.id == 'sensor_elsewhere']
    assert found.values['accel'] == ACCEL
    alone = write_bag(tmp_path / 'alone', {GYRO: batches[GYRO]})
    assert [f.id for f in read(alone).provenance.findings] == ['sensor_all_zero']


def test_wrong_topics_are_rejected(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'camera', camera(70.0))
    with pytest.raises(AllanError, match=f'topic {ACCEL}: no static data') as caught:
        read(path, topic=ACCEL, accel_topic=GYRO)
    assert 'All gyro values' in str(explained(caught.value))
    with pytest.raises(AllanError, match='has no topic /accel'):
        read(path, topic=GYRO, accel_topic='/accel')
    table = tmp_path / 'table.csv'
    table.write_text('t,gx\n0,1\n')
    with pytest.raises(AllanError, match='is not a bag: omit --accel-topic'):
        read(table, accel_topic=ACCEL)
    with pytest.raises(AllanError, match='has no topics: omit --topic'):
        read(table, topic=GYRO)


def test_the_joined_signal_has_every_sample_of_the_accelerometer() -> None:
    """A shock must not be lost where the bins of the two topics differ."""
    batches = camera(400.0, np.nan)
    batches[ACCEL].samples[[0, 777, -1], 4] = 50.0
    parts = {topic: SignalEnvelope() for topic in batches}
    for topic, batch in batches.items():
        parts[topic].update(batch)
    joined, accel = parts[GYRO].with_accel(parts[ACCEL]), parts[ACCEL]
    assert joined.bins == parts[GYRO].bins
    for name in ('low', 'high'):
        both, alone = joined.statistics()[name], accel.statistics()[name]
        whole = BIN_STATISTICS[name].reduce
        np.testing.assert_array_equal(whole(both[:, 3:]), whole(alone[:, 3:]))
        np.testing.assert_array_equal(both[:, :3], parts[GYRO].statistics()[name][:, :3])
    assert (joined.statistics()['high'][:, 4] == 50.0).sum() >= 3


def overlapping(tmp_path: Path, start_ns: int, shift_s: float) -> list[RecordingSums]:
    """Return two recordings of 70 s at 100 Hz of which the second begins ``shift_s`` later."""
    recorded = []
    for seed, shift_ns in enumerate((0, round(shift_s * 1e9))):
        samples = np.random.default_rng(seed).normal(size=(7000, 6)) * 1e-3
        stamps = start_ns + shift_ns + np.arange(7000) * 10**7
        path = write_bag(tmp_path / str(seed), [ImuBatch(stamps, samples)], 'mcap')
        recorded.append(read(path))
    return recorded


def test_recordings_that_overlap_in_time_are_not_added(tmp_path: Path) -> None:
    with pytest.raises(AllanError, match='have 50 s in common: samples must not count twice'):
        add_recordings(overlapping(tmp_path, START_NS, 20.0))


@pytest.mark.parametrize(('start_ns', 'shift_s'), [(START_NS, 69.5), (10**9, 20.0)])
def test_recordings_with_a_short_overlap_or_times_since_boot_are_added(
    tmp_path: Path, start_ns: int, shift_s: float
) -> None:
    added = add_recordings(overlapping(tmp_path, start_ns, shift_s))
    assert added.sums[0].samples == 14000
