# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A model whose sums were replaced is invalidated, and no document stops the estimator."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from std_msgs.msg import String

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.findings import finding
from allan_ros.core.imu import ImuBatch, ImuIdentity
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.nodes.messages import Snapshot, replaced_because, replaced_share
from allan_ros.nodes.shell import LATCHED
from allan_ros.readers.recording_sums import Provenance

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


def sums_of(*batches: ImuBatch) -> tuple[Any, ...]:
    stream = ImuStream()
    for batch in batches:
        stream.update(batch)
    return stream.result().sums


def sums_text(*batches: ImuBatch) -> str:
    """Return a message of ``~/sums``."""
    return json.dumps(Snapshot((sums_of(*batches), Provenance())).to_document())


def estimator(graph: Any, method: str = 'paper') -> tuple[Any, list[dict[str, Any]]]:
    """Start an estimator; return a publisher of its sums, and the models."""
    graph.run('estimator', **{'estimator.method': method})
    publisher = graph.node.create_publisher(String, 'sums', LATCHED)
    models = graph.latched('/allan_estimator/noise_model')
    graph.introduce(publisher)
    return publisher, models


def test_growing_sums_are_not_replaced(still_imu) -> None:
    batch = still_imu(12_000)
    batch.samples[6000:6040] += np.random.default_rng(5).normal(0.0, 1.0, (40, 6))  # a shock
    pieces = [sums_of(batch[:n]) for n in range(1000, 12_001, 500)]
    assert max(map(replaced_share, pieces, pieces[1:])) < 0.1
    assert replaced_share((), pieces[0]) == 0.0
    assert replaced_share(pieces[-1], pieces[0]) > 0.8
    assert replaced_share(pieces[0], ()) == 1.0
    unnamed = tuple(replace(s, identity=ImuIdentity()) for s in pieces[0])
    assert replaced_share(unnamed, pieces[1]) < 0.1
    other = sums_of(still_imu(12_000, start_ns=10**18 + 10**12))
    assert replaced_share(pieces[0], other) == 1.0  # more samples, but of another time


def test_short_rests_before_a_long_rest_are_not_replaced() -> None:
    """The block means of short segments are removed when the blocks become longer."""
    running, samples = RunningSums(), np.random.default_rng(1).normal(size=(3000, 6))
    for i in range(31):
        running.update(samples[:112], i * 10**11, i * 10**11 + 111 * 10**7)
        running.end_segment()
    sums = []
    for i in range(4):
        start_ns = 10**13 + i * 3000 * 10**7
        running.update(samples, start_ns, start_ns + 2999 * 10**7)
        sums.append((running.sums,))
    assert [len(each[0].means) for each in sums] == [32, 32, 1, 1]
    assert max(map(replaced_share, sums, sums[1:])) == 0.0


def test_replaced_sums_withdraw_the_model_at_once_and_are_fitted(graph, still_imu) -> None:
    """The sums of a robot that was driven at boot are discarded when it comes to rest. Sums of
    other samples with the same stamps replace them, too.
    """
    publisher, models = estimator(graph)
    publisher.publish(String(data=sums_text(still_imu(8000))))
    graph.until(lambda: models and models[-1]['samples'] == 8000)
    rest = still_imu(2000, start_ns=10**18 + 10**11, seed=2)
    publisher.publish(String(data=sums_text(rest)))
    graph.until(lambda: models[-1]['samples'] == 2000)
    assert [model['samples'] for model in models] == [8000, 0, 2000]
    invalidated = models[1]
    assert invalidated['axes'] == {} and invalidated['findings'][-1]['id'] == 'model_invalidated'
    assert '100 %' in invalidated['findings'][-1]['message']
    status = graph.until(
        lambda: (s := graph.status('imu gyro x')) and s.message.startswith('N') and s
    )
    assert status.level == OK
    again = still_imu(1000, start_ns=10**18 + 10**11, seed=3)
    publisher.publish(String(data=sums_text(again)))
    graph.until(lambda: models[-1]['samples'] == 1000)
    assert [model['samples'] for model in models[2:]] == [2000, 0, 1000]


def test_a_failed_fit_is_an_error_with_the_reason(graph, still_imu) -> None:
    """Sums whose numbers no fit can use, or no reader accepts, are an error in either case."""
    publisher, models = estimator(graph, 'likelihood')
    document = json.loads(sums_text(still_imu(4000)))
    for key in ('sum_sq', 'group_sum_sq'):
        document['sums'][0][key] = [[1e140] * 6 for _ in document['sums'][0][key]]
    publisher.publish(String(data=json.dumps(document)))
    error = graph.until(lambda: next((s for _, s in graph.history if s.level == ERROR), None))
    assert 'The fit failed: ' in error.message or 'cannot be read: ' in error.message
    publisher.publish(String(data=sums_text(still_imu(4000))))
    graph.until(lambda: models and models[-1]['samples'] == 4000)


HOSTILE = (('elapsed_ns', 0), ('intervals', 0), ('count', [1]), ('sum_sq', []))


def test_no_sums_document_stops_the_estimator(graph, still_imu) -> None:
    """The topic is latched: a document that stops a node once would stop it at every start."""
    publisher, models = estimator(graph)
    good = sums_text(still_imu(4000))
    texts = ['nonsense', '[' * 100_000, '{"schema": "allan_ros/sums_file/2", "sums": [3]}']
    for key, value in HOSTILE:
        document = json.loads(good)
        document['sums'][0][key] = value
        texts.append(json.dumps(document))
    for text in texts:
        graph.statuses.clear()
        publisher.publish(String(data=text))
        status = graph.until(lambda: (s := graph.status('sums')) and s.level == ERROR and s)
        assert 'cannot be read' in status.message, text[:100]
        graph.statuses.clear()
        publisher.publish(String(data=good))
        graph.until(lambda: (s := graph.status('sums')) and s.level == OK)
    graph.until(lambda: models and models[-1]['samples'] == 4000)
    assert graph.status('allan_estimator: node') is None  # no internal error


def test_why_a_model_is_invalidated_is_said(graph, still_imu) -> None:
    graph.run('monitor')
    publisher = graph.publisher()
    graph.send(publisher, still_imu(4000))
    graph.model_of(4000)
    graph.call('/allan_monitor/reset')
    status = graph.until(
        lambda: (s := graph.status('imu gyro x')) and 'invalidated' in s.message and s
    )
    assert 'invalidated, because the Allan sums were reset: 100 % of their data' in status.message


def test_another_imu_and_a_finding_of_the_stream_explain_missing_samples(still_imu) -> None:
    sums = sums_of(still_imu(4000))
    empty = Provenance()
    assert replaced_because(sums, Snapshot(((), empty), 'imu')) == 'the Allan sums were reset'
    other = Snapshot((sums, empty), 'other')
    assert replaced_because(sums, other) == 'messages of "other" arrive instead of "imu"'
    moved = finding('relearned', seconds=12.0)
    snapshot = Snapshot((sums, replace(empty, findings=(moved,))), 'imu')
    assert 'the first 12 s were excluded' in replaced_because(sums, snapshot)
    moved = Snapshot((sums, empty), 'imu')
    assert replaced_because(sums, moved) == 'the IMU moved or had a fault'


def test_the_axes_have_a_status_from_the_first_message(graph, still_imu) -> None:
    """An aggregator treats a missing status as an error."""
    graph.run('monitor')
    graph.send(graph.publisher(), still_imu(3))
    status = graph.until(lambda: graph.status('imu accel z'))
    assert status.level == OK and status.message.startswith('no coefficients yet')
