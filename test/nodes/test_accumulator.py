# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The accumulator gives the sums of the offline analysis, and no input stops it."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support.node_server import PATIENCE_S

pytest.importorskip('rclpy')

from allan_ros.core.allan.document import sums_to_document
from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.nodes.accumulation import _events
from allan_ros.readers import open_recording
from allan_ros.readers.writing import write_recording

ROOT = Path(__file__).resolve().parents[2]

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
SECOND = 10**9


def offline(*batches: ImuBatch) -> list[dict]:
    """Return the documents of the sums of an offline analysis of the batches."""
    accumulator = ImuStream()
    for batch in batches:
        accumulator.update(batch)
    accumulator.end()
    return [sums_to_document(s) for s in accumulator.result().sums]


def used(graph, samples: int) -> None:
    """Wait until the node has used this number of samples."""
    graph.until(lambda: graph.value('input', 'used') == str(samples))


def sums_in(path: Path) -> list[dict]:
    return json.loads(path.read_text())['sums']


def samples_in(path: Path) -> int:
    return sum(samples * count for samples, count in sums_in(path)[0]['lengths'])


def with_gap_and_shock(still_imu) -> ImuBatch:
    batch = still_imu(12000)
    batch.samples[7000:7040] += np.random.default_rng(5).normal(0.0, 1.0, (40, 6))
    keep = np.ones(len(batch), bool)
    keep[3000:3500] = False  # a gap that splits the data
    keep[5000] = False  # a lost sample that is interpolated
    return ImuBatch(batch.stamps_ns[keep], batch.samples[keep], frame_id=batch.frame_id)


def play(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run scripts/play.py to its end."""
    command = [sys.executable, str(ROOT / 'scripts' / 'play.py'), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)


def test_a_played_bag_gives_the_sums_of_the_bag(graph, still_imu, tmp_path: Path):
    bag, checkpoint = tmp_path / 'bag', tmp_path / 'sums.json'
    write_recording(bag, [with_gap_and_shock(still_imu)])
    graph.start('accumulator', **{'checkpoint.path': str(checkpoint)})
    assert 'played 11499 messages' in play(str(bag), '--rate', '0').stdout
    saved = graph.call('/allan_accumulator/save')
    assert saved.success, saved.message
    expected = offline(*open_recording(bag).batches())
    assert sums_in(checkpoint) == expected
    assert len(expected[0]['lengths']) > 1
    assert graph.until(lambda: graph.value('input', 'lost on the way')) == '0'


def test_the_shared_memory_profile_is_accepted(graph, monkeypatch):
    """Fast DDS reports a profile that it cannot read, and uses its defaults."""
    profile = ROOT / 'config' / 'fastdds' / 'deep_shared_memory.xml'
    for name in ('FASTDDS', 'FASTRTPS'):  # the second one is for Fast DDS 2
        monkeypatch.setenv(f'{name}_DEFAULT_PROFILES_FILE', str(profile))
    node = graph.start('accumulator')
    played = play('--simulate', '2', '--frequency', '300')
    graph.until(lambda: int(graph.value('input', 'received') or 0) > 300)
    assert 'XML' not in node.output + played.stderr


def test_it_publishes_its_sums_and_health(graph, still_imu):
    graph.run('accumulator')
    documents = graph.latched('/allan_accumulator/sums')
    batch = still_imu(4000)
    graph.send(graph.publisher(), batch)
    graph.until(lambda: documents and documents[-1]['sums'] == offline(batch))
    assert documents[-1]['schema'] == 'allan_ros/sums_file/2'
    used(graph, 4000)
    status = graph.status('imu/data input')
    assert status.level == OK and status.name == 'allan_accumulator: imu/data input'
    assert status.hardware_id == 'imu'
    assert status.message.startswith('at rest, 200 Hz')
    assert graph.value('input', 'rate') == '200'
    assert graph.value('input', 'messages taken by') == 'a thread'
    text = (ROOT / 'docs' / 'diagnostics.md').read_text()
    keys = [v.key for v in status.values if not v.key.startswith('finding: ')]
    assert [key for key in keys if f'| `{key}`' not in text and f', `{key}` |' not in text] == []


def test_the_first_mean_at_rest_is_published_at_once(graph, still_imu):
    """After a restart with a checkpoint, the model is known, but not yet the bias."""
    graph.run('accumulator', **{'publish.sums_period': 3600.0})
    documents = graph.latched('/allan_accumulator/sums')
    publisher, batch = graph.publisher(), still_imu(4400)
    graph.send(publisher, batch[:100])
    graph.until(lambda: documents and documents[-1]['imu']['axes'] == [*AXES])
    graph.send(publisher, batch[100:])
    graph.until(lambda: any(one['end_ns'] for one in documents[-1]['means']))


@pytest.mark.parametrize('signals', [[signal.SIGTERM], [signal.SIGINT] * 2])
def test_a_signal_writes_the_checkpoint(graph, still_imu, tmp_path: Path, signals):
    checkpoint = tmp_path / 'sums.json'
    node = graph.start('accumulator', **{'checkpoint.path': str(checkpoint)})
    batch = still_imu(3000)
    graph.send(graph.publisher(), batch)
    used(graph, 3000)
    assert node.stop(*signals) == 0, node.output
    assert sums_in(checkpoint) == offline(batch)


def test_a_restarted_node_continues_its_sums(graph, still_imu, tmp_path: Path, capfd):
    checkpoint = tmp_path / 'sums.json'
    settings = {'checkpoint.path': str(checkpoint), 'checkpoint.period': 0.5}
    node = graph.run('accumulator', **settings)
    first, second = still_imu(3000), still_imu(2500, start_ns=10**18 + 100 * SECOND, seed=2)
    graph.send(graph.publisher(), first)
    graph.until(lambda: checkpoint.exists() and samples_in(checkpoint) == 3000)
    graph.stop(node)
    graph.statuses.clear()
    # on a topic where no writer waits for the reader that is gone
    node = graph.run('accumulator', remap={'imu/data': 'imu/other'}, **settings)
    graph.send(graph.publisher('imu/other'), second)
    graph.until(lambda: samples_in(checkpoint) == 5500)
    static = f'{(2999 + 2499) * 0.005:.6g}'
    graph.until(lambda: graph.value('input', 'static data') == static)
    assert f'continues {checkpoint} with 3000 samples' in capfd.readouterr().err


def test_a_removed_checkpoint_folder_is_made_again(graph, still_imu, tmp_path: Path):
    checkpoint = tmp_path / 'imus' / 'front' / 'sums.json'
    settings = {'checkpoint.path': str(checkpoint), 'checkpoint.period': 0.5}
    node = graph.run('accumulator', **settings)
    publisher = graph.publisher()
    graph.send(publisher, still_imu(2000))
    graph.until(lambda: checkpoint.exists() and samples_in(checkpoint) == 2000)
    shutil.rmtree(tmp_path / 'imus')
    graph.send(publisher, still_imu(1000, start_ns=10**18 + 10 * SECOND, seed=2))
    graph.until(lambda: checkpoint.exists() and samples_in(checkpoint) == 3000)
    graph.until(lambda: graph.status('input').level == OK)
    assert graph.value('input', 'finding: checkpoint_unwritable') is None
    graph.stop(node)
    assert samples_in(checkpoint) == 3000


def test_a_checkpoint_of_another_node_is_reported_and_kept(graph, still_imu, tmp_path: Path):
    checkpoint = tmp_path / 'sums.json'
    first = graph.run('accumulator', **{'checkpoint.path': str(checkpoint)})
    graph.send(graph.publisher(), still_imu(2000))
    used(graph, 2000)
    assert graph.call('/allan_accumulator/save').success
    other = {'__node': 'second', 'imu/data': 'imu/b'}
    second = graph.run('accumulator', remap=other, **{'checkpoint.path': str(checkpoint)})
    name = 'second: imu/data input'
    graph.until(lambda: graph.value(name, 'finding: checkpoint_in_use'))
    assert graph.status(name).level != OK
    saved = graph.call('/second/save')
    assert not saved.success and 'this node saves nothing' in saved.message
    graph.stop(second)
    graph.stop(first)
    assert samples_in(checkpoint) == 2000


def test_reset_starts_from_zero_and_keeps_the_previous_sums(graph, still_imu, tmp_path: Path):
    checkpoint = tmp_path / 'sums.json'
    graph.run('accumulator', **{'checkpoint.path': str(checkpoint)})
    documents = graph.latched('/allan_accumulator/sums')
    publisher = graph.publisher()
    first, second = still_imu(2000), still_imu(1500, start_ns=10**18 + 100 * SECOND, seed=2)
    graph.send(publisher, first)
    used(graph, 2000)
    assert graph.call('/allan_accumulator/reset').success
    graph.until(lambda: documents and documents[-1]['sums'] == [])
    graph.send(publisher, second)
    graph.until(lambda: documents[-1]['sums'] == offline(second))
    assert sums_in(tmp_path / 'sums.json.previous') == offline(first)


def test_a_looped_recording_counts_once(graph, still_imu, tmp_path: Path):
    checkpoint = tmp_path / 'sums.json'
    graph.run('accumulator', **{'checkpoint.path': str(checkpoint), 'use_sim_time': True})
    publisher = graph.publisher()
    batch = still_imu(2000)
    graph.send(publisher, batch)
    graph.send(publisher, batch)
    repeated = '2,000 samples were excluded'
    graph.until(lambda: repeated in str(graph.value('input', 'finding: time_repeated')))
    used(graph, 2000)
    assert graph.status('input').level == OK
    assert graph.call('/allan_accumulator/save').success
    assert sums_in(checkpoint) == offline(batch)


def test_a_restart_of_a_replay_counts_no_sample_twice(graph, still_imu, tmp_path: Path):
    """Also if the end of the recording is not among the 32 longest segments, or is in motion."""
    checkpoint = tmp_path / 'sums.json'
    settings = {'checkpoint.path': str(checkpoint), 'use_sim_time': True}
    batch = still_imu(22_000)
    for i in range(40):  # segments of decreasing length, and motion at the end
        at = 4000 + 450 * i - 5 * i * (i - 1) // 2
        batch.samples[at : at + 40] += np.random.default_rng(i).normal(0.0, 1.0, (40, 6))
    node = graph.run('accumulator', **settings)
    graph.send(graph.publisher(), batch)
    graph.until(lambda: graph.value('input', 'received') == '22000')
    graph.stop(node)
    first = json.loads(checkpoint.read_text())
    assert first['last_stamp_ns'] == int(batch.stamps_ns[-1])
    # the second start replays the end, and the start before the first listed segment
    graph.statuses.clear()
    node = graph.run('accumulator', remap={'imu/data': 'imu/other'}, **settings)
    graph.send(graph.publisher('imu/other'), batch[21_000:])
    graph.send(graph.publisher('imu/other'), batch[:5000])
    graph.until(lambda: '6,000' in str(graph.value('input', 'finding: time_repeated')))
    graph.stop(node)
    assert json.loads(checkpoint.read_text())['sums'] == first['sums']


def test_a_clock_that_is_set_back_only_splits_the_data(graph, still_imu, tmp_path: Path):
    """Without simulated time the same IMU continues, so the data before and after the step are
    added.
    """
    checkpoint = tmp_path / 'sums.json'
    graph.run('accumulator', **{'checkpoint.path': str(checkpoint)})
    publisher = graph.publisher()
    before, after = still_imu(3000), still_imu(2000, start_ns=10**18 - 3600 * SECOND, seed=2)
    graph.send(publisher, before)
    graph.send(publisher, after)
    graph.until(lambda: graph.value('input', 'received') == '5000')
    assert graph.call('/allan_accumulator/save').success
    assert sums_in(checkpoint) == offline(before, after)
    assert samples_in(checkpoint) > 4900
    assert not (tmp_path / 'sums.json.previous').exists()


def test_simulated_time_that_is_set_back_keeps_the_data(graph, still_imu, tmp_path: Path):
    """The data of 2 s that are simulated again are not counted."""
    from rosgraph_msgs.msg import Clock

    checkpoint = tmp_path / 'sums.json'
    graph.run('accumulator', **{'checkpoint.path': str(checkpoint), 'use_sim_time': True})
    clock, publisher = graph.node.create_publisher(Clock, '/clock', 10), graph.publisher()
    before = still_imu(8000)
    after = still_imu(4000, start_ns=int(before.stamps_ns[-1]) - 2 * SECOND, seed=2)
    for batch in (before, after):
        now = Clock()
        now.clock.sec, now.clock.nanosec = divmod(int(batch.stamps_ns[-1]), SECOND)
        clock.publish(now)
        graph.send(publisher, batch)
    repeated = int(np.count_nonzero(after.stamps_ns <= before.stamps_ns[-1]))
    counted = f'{repeated} samples were excluded'
    graph.until(lambda: counted in str(graph.value('input', 'finding: time_repeated')))
    used(graph, 12_000 - repeated)
    graph.until(lambda: abs(float(graph.value('input', 'stamp age') or 99)) < 1.0)
    assert graph.call('/allan_accumulator/save').success
    assert sums_in(checkpoint) == offline(before, after[repeated:])


EXCLUDED = (
    *(
        'malformed',
        'moving',
        'noise increased',
        'noise decreased',
        'stuck',
        'not finite',
        'duplicate',
    ),
    *('stamped backward', 'without a time', 'skipped', 'of another frame_id'),
)


def test_every_message_is_in_one_count_at_any_time(graph, still_imu):
    """Also while the latest samples are held until it is known whether the IMU was at rest."""
    graph.run('accumulator', **{'publish.sums_period': 3600.0})
    publisher = graph.publisher()
    batch = with_gap_and_shock(still_imu)
    batch.samples[9000:9010] = np.nan
    batch.samples[10_500:, :3] += np.random.default_rng(4).normal(0.0, 0.5, (999, 3))
    graph.until(lambda: graph.value('input', 'received') == '0')
    for at in range(0, len(batch), 900):
        graph.send(publisher, batch[at : at + 900])
        sent = str(min(at + 900, len(batch)))
        graph.until(lambda sent=sent: graph.value('input', 'received') == sent)
    publisher.publish(b'\x00\x01\x00\x00 not an Imu')
    graph.until(lambda: graph.value('input', 'received') == '11500')
    held, told = [], [s for _, s in graph.history if s.name.endswith('input')]
    for values in ({v.key.partition(' [')[0]: v.value for v in s.values} for s in told):
        counts = {key: int(values[key]) for key in (*EXCLUDED, 'used', 'undecided')}
        assert sum(counts.values()) == int(values['received']) + int(values['interpolated'])
        held.append(counts['undecided'])
    assert min(held) == 0 < max(held)


def test_no_input_stops_the_accumulator(graph, still_imu):
    """NaN, inf, zero and backward stamps, absent sensors, garbage, a burst, another frame."""
    graph.run('accumulator')
    publisher = graph.publisher()
    bad = still_imu(2000)
    bad.samples[100:120] = np.nan
    bad.samples[200:210, 0] = np.inf
    bad.stamps_ns[300:310] -= 5 * SECOND
    bad.stamps_ns[400:410] = 0
    graph.send(publisher, bad)
    publisher.publish(b'\x00\x01\x00\x00 not an Imu')
    no_gyro = still_imu(1500, start_ns=10**18 + 100 * SECOND, frame_id='gyroless')
    no_gyro.samples[:, :3] = np.nan
    graph.send(publisher, no_gyro)
    zero_rate = still_imu(1500, start_ns=10**18 + 200 * SECOND)
    zero_rate.stamps_ns[:] = zero_rate.stamps_ns[0]
    graph.send(publisher, zero_rate)
    graph.send(publisher, still_imu(5000, rate=10_000.0, start_ns=10**18 + 300 * SECOND))
    graph.until(lambda: graph.value('input', 'received') == '10001')
    assert graph.value('input', 'malformed') == '1'
    assert int(graph.value('input', 'not finite')) >= 30
    assert 'frame_id changed' in graph.value('input', 'finding: frame_changed')
    assert graph.status('allan_accumulator: node') is None  # no internal error


def test_two_publishers_on_one_topic_are_reported(graph, still_imu):
    graph.run('accumulator')
    graph.send(graph.publisher(), still_imu(100))
    graph.send(graph.publisher(), still_imu(100))
    status = graph.until(lambda: (s := graph.status('input')) and s.level == WARN and s)
    assert '2 publishers on /imu/data (/test_client, /test_client)' in status.message


def test_two_topics_are_published_once_per_period(graph):
    topics = {'input.topics': ('gyro',), 'input.accel_topics': ('accel',)}
    node = graph.run('accumulator', **topics, **{'publish.sums_period': 3600.0})
    gyro, accel = node._parts
    published = []
    gyro.output.add_listener(published.append)
    for watch in (gyro, accel):
        watch.tick(time.monotonic() + 3600.0)
    assert len(published) == 1


def test_gyro_and_accelerometer_on_two_topics(graph, still_imu, tmp_path: Path):
    checkpoint = tmp_path / 'imu.json'
    topics = {'input.topics': ('gyro',), 'input.accel_topics': ('accel',)}
    graph.run('monitor', **topics, **{'checkpoint.path': str(checkpoint)})
    gyro = still_imu(6000, frame_id='gyro_frame')
    accel = still_imu(2500, rate=80.0, start_ns=10**18 + 12_345, seed=2, frame_id='accel_frame')
    gyro.samples[:, 3:] = 0.0
    accel.samples[:, :3] = np.nan
    documents = graph.latched('/allan_monitor/sums')
    models = graph.latched('/allan_monitor/noise_model')
    for topic, batch in (('gyro', gyro), ('accel', accel)):
        graph.send(graph.publisher(topic), batch)
    graph.until(lambda: graph.value('gyro input', 'used') == '6000')
    graph.until(lambda: graph.value('accel input', 'used') == '2500')
    expected = offline(gyro) + [{**s, 'frame_id': 'gyro_frame'} for s in offline(accel)]
    graph.until(lambda: documents and documents[-1]['sums'] == expected)
    assert documents[-1]['imu']['axes'] == [*AXES]
    assert [one['axes'] for one in documents[-1]['means']] == [[*AXES[:3]], [*AXES[3:]]]
    graph.until(lambda: models and [*models[-1]['axes']] == [*AXES])
    assert not graph.value('gyro input', 'finding: sensor_all_zero')
    answer = graph.call('/allan_monitor/save')
    assert answer.success
    assert answer.message.count(' samples') == 2, 'one count for each topic'
    saved = [json.loads(p.read_text())['sums'] for p in (checkpoint, tmp_path / 'imu_accel.json')]
    assert saved == [offline(gyro), offline(accel)]
    assert graph.call('/allan_monitor/reset').success
    graph.until(lambda: documents[-1]['sums'] == [])


def test_the_first_data_at_rest_count_as_an_event(still_imu):
    """Otherwise the findings from before the first sums remain until the next publication."""
    batch, stream = still_imu(1500), ImuStream()
    batch.samples[:300] += np.random.default_rng(3).normal(size=(300, 6))  # the IMU moves at first
    stream.update(batch[:800])
    before = stream.result()
    stream.update(batch[800:])
    after = stream.result()
    assert before.health.state == after.health.state == 'learning'
    assert 'nothing_left' in {f.id for f in before.findings} - {f.id for f in after.findings}
    assert _events(before.health) != _events(after.health)


def test_paused_playback_is_no_fault_of_the_cable(graph, still_imu):
    """The simulated time stands still; then it moves, but the messages do not come back."""
    from builtin_interfaces.msg import Time
    from rosgraph_msgs.msg import Clock

    graph.run('accumulator', **{'use_sim_time': True, 'input.stale_after': 0.5})
    clock = graph.node.create_publisher(Clock, '/clock', 1)
    publisher = graph.publisher()
    graph.introduce(clock)
    clock.publish(Clock(clock=Time(sec=1000)))
    graph.send(publisher, still_imu(10))
    graph.until(lambda: graph.value('input', 'received') == '10')
    status = graph.until(
        lambda: (s := graph.status('input')) and 'playback_paused' in str(s.values) and s
    )
    assert status.level == b'\x00'

    def moves() -> bool:
        moves.now += 1
        clock.publish(Clock(clock=Time(sec=moves.now)))
        return graph.status('input').message.startswith('No message on /imu/data')

    moves.now = 1000
    graph.until(moves)


def test_playback_is_not_paused_while_messages_arrive(graph, still_imu):
    graph.run('accumulator', **{'use_sim_time': True, 'publish.diagnostics_period': 0.5})
    publisher, found = graph.publisher(), []

    def arrive() -> bool:
        graph.send(publisher, still_imu(5))
        status = graph.status('input')
        found.append('playback_paused' in str(status.values))
        return int(graph.value('input', 'received')) > 100

    graph.until(lambda: graph.status('input'))
    graph.send(publisher, still_imu(5))
    graph.until(lambda: graph.value('input', 'received') not in ('', '0'))
    found.clear()
    graph.until(arrive)
    assert not any(found)


def test_two_nodes_with_one_name_are_reported(graph):
    graph.run('accumulator')
    graph.run('accumulator')
    graph.until(lambda: graph.value('input', 'finding: relay_several_publishers'))
    assert '2 publishers on /allan_accumulator/sums' in graph.status('input').message
