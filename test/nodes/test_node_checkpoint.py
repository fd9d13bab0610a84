# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A checkpoint file belongs to one node and one IMU; no other overwrites it."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

QUICK = {'checkpoint.period': 0.5}


def samples_in(checkpoint: Path) -> dict[str, int]:
    """Return the samples that the file has, by frame_id; none without a file."""
    if not checkpoint.exists():
        return {}
    sums = json.loads(checkpoint.read_text())['sums']
    return {s['frame_id']: sum(n * count for n, count in s['lengths']) for s in sums}


def test_a_path_that_another_node_keeps_is_neither_read_nor_written(
    graph, still_imu, tmp_path: Path, capfd
):
    checkpoint = tmp_path / 'imu.json'
    settings = {**QUICK, 'checkpoint.path': str(checkpoint)}
    first = graph.start('accumulator', **settings)
    publisher = graph.publisher()
    graph.send(publisher, still_imu(2000))
    graph.until(lambda: samples_in(checkpoint) == {'imu': 2000})

    second = graph.run('accumulator', remap={'__node': 'second', 'imu/data': 'imu/b'}, **settings)
    said = graph.until(lambda: graph.value('second: imu/data input', 'finding: checkpoint_in_use'))
    assert f'in use by another node (process {first.pid})' in said
    assert graph.status('second: imu/data input').level != b'\x00'
    graph.send(graph.publisher('imu/b'), still_imu(1500, seed=2))
    graph.until(lambda: graph.value('second: imu/data input', 'used') == '1500')
    saved = graph.call('/second/save')
    assert not saved.success and 'this node saves nothing' in saved.message
    assert first.stop(signal.SIGKILL) == -signal.SIGKILL
    graph.stop(second)
    assert capfd.readouterr().err.count('in use by another node') == 1
    assert samples_in(checkpoint) == {'imu': 2000}

    # the next node gets the lock, and removes the temporary file of a killed writer
    draft = tmp_path / f'.imu.json.{"0a" * 16}.part'
    draft.write_text('{"sums": [')
    third = graph.run('accumulator', remap={'imu/data': 'imu/c'}, **settings)
    graph.until(lambda: not draft.exists())
    assert 'continues' in capfd.readouterr().err
    graph.stop(third)
    assert [p.name for p in tmp_path.glob('*imu.json*')] == ['imu.json']


def test_an_imu_that_overtakes_does_not_overwrite_the_first(graph, still_imu, tmp_path: Path):
    checkpoint = tmp_path / 'imu.json'
    node = graph.run('accumulator', **QUICK, **{'checkpoint.path': str(checkpoint)})
    publisher = graph.publisher()
    second = 10**9
    graph.send(publisher, still_imu(2000, frame_id='left'))
    graph.until(lambda: samples_in(checkpoint) == {'left': 2000})
    right = still_imu(3000, frame_id='right', seed=2, start_ns=10**18 + 100 * second)
    graph.send(publisher, right)
    graph.until(lambda: graph.value('input', 'finding: checkpoint_refused'))
    assert not graph.call('/allan_accumulator/save').success
    assert samples_in(checkpoint) == {'left': 2000}
    again = still_imu(2500, frame_id='left', seed=3, start_ns=10**18 + 200 * second)
    graph.send(publisher, again)  # now it has the most data again
    graph.until(lambda: samples_in(checkpoint) == {'left': 4500})
    graph.stop(node)
    assert samples_in(checkpoint) == {'left': 4500}
