# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The relay changes only the covariances of a message, and loses none."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from std_msgs.msg import String

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.white_variances import white_variances
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers.cdr import CovariancePatch, encode_imus, imu_dtype
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.documents import results_to_document
from allan_ros.results.results import Results

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
OUT = 'imu/data_with_covariance'


@pytest.fixture(scope='module')
def results() -> Results:
    """Return the results of 20 s of an IMU with gyro N 1e-3/sqrt(200) and accel N
    1e-2/sqrt(200).
    """
    rng = np.random.default_rng(7)
    samples = rng.normal(0.0, [1e-3] * 3 + [1e-2] * 3, (4000, 6))
    stamps = 10**18 + np.arange(4000) * 5_000_000
    accumulator = ImuStream()
    accumulator.update(ImuBatch(stamps, samples, frame_id='imu'))
    accumulator.end()
    return analyze_sums(accumulator.result().sums, Provenance(), 'likelihood')


def publish_model(graph: Any, results: Results) -> Any:
    """Publish a noise model, latched, as the estimator does."""
    from rclpy.qos import DurabilityPolicy, QoSProfile

    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = graph.node.create_publisher(String, 'noise_model', qos)
    publisher.publish(String(data=json.dumps(results_to_document(results, curves=False))))
    return publisher


def raw(graph: Any, topic: str = OUT) -> list[bytes]:
    """Subscribe to the relayed messages and return the list to which their bytes are appended.

    Call it before `Graph.publisher`, which waits until the relay has discovered this subscriber.
    """
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Imu

    received: list[bytes] = []
    graph.node.create_subscription(Imu, topic, received.append, QoSProfile(depth=2000), raw=True)
    return received


def filled(graph: Any) -> Any:
    return graph.until(
        lambda: (s := graph.status('relay')) and s.message.startswith('covariances') and s
    )


def payloads(batch: ImuBatch) -> list[bytes]:
    return [bytes(p) for p in encode_imus(batch, 'cdr')]


def variances(results: Results) -> dict[str, Any]:
    """Return N^2 f of each axis in full precision, after a check against values computed by
    hand.
    """
    fits = {name: axis.fit for name, axis in results.axes.items()}
    found = white_variances(fits, results.rate_hz)
    for sensor, values in found.items():
        by_hand = [fits[f'{sensor}_{a}'].noise['N'].value ** 2 * 200.0 for a in 'xyz']
        np.testing.assert_allclose(values, by_hand, rtol=1e-9)
    return found


@pytest.mark.parametrize('thread', [True, False])
def test_only_the_covariances_change_and_no_burst_is_lost(
    graph, still_imu: Callable[..., ImuBatch], results: Results, monkeypatch, thread: bool
):
    """Also with a version of rclpy that has no wait set."""
    if not thread:
        monkeypatch.setattr('allan_ros.nodes.relaying.ImuRelay._wait_set', lambda _: None)
    graph.run('relay', **{'relay.debiased': True})
    received = raw(graph)
    publisher = graph.publisher()
    model = publish_model(graph, results)
    status = filled(graph)
    assert status.message == 'covariances of gyro and accel are filled'
    assert graph.value('relay', 'messages taken by') == ('a thread' if thread else 'a callback')
    sent: list[bytes] = []
    for burst in range(3):
        batch = still_imu(400, seed=burst)
        graph.send(publisher, batch)
        sent += payloads(batch)
        graph.until(lambda enough=len(sent): len(received) >= enough)
    patch = CovariancePatch(variances(results))
    assert received == [patch.patch(payload) for payload in sent]
    covariance = np.frombuffer(received[-1], imu_dtype('cdr', '<', 4))['gyro_covariance'][0]
    # N = 1e-3 / sqrt(200), so N^2 f = 1e-6; 4000 samples determine it to a few percent
    np.testing.assert_allclose(covariance.reshape(3, 3), np.diag([1e-6] * 3), rtol=0.15)
    graph.until(lambda: graph.value('relay', 'filled') == '1200')
    model.destroy()


def test_no_message_is_lost_while_the_thread_is_delayed_by_a_fifth_of_a_second_at_20_khz(
    graph, still_imu, monkeypatch
):
    from rclpy.qos import HistoryPolicy, QoSProfile

    from allan_ros.nodes.relaying import ImuRelay

    started, wake, relayed = threading.Event(), threading.Event(), ImuRelay._relay

    def delayed(self: ImuRelay, payload: bytes, *info: Any) -> None:
        started.set()
        wake.wait()
        relayed(self, payload, *info)

    monkeypatch.setattr(ImuRelay, '_relay', delayed)
    topic = 'qos_overrides./imu/data.subscription.'
    graph.run('relay', **{f'{topic}history': 'keep_last', f'{topic}reliability': 'reliable'})
    received: list[bytes] = []
    from sensor_msgs.msg import Imu

    everything = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    graph.node.create_subscription(Imu, OUT, received.append, everything, raw=True)
    publisher = graph.publisher()
    sent = payloads(still_imu(4001, rate=20_000.0))
    publisher.publish(sent[0])
    graph.until(started.is_set)
    for payload in sent[1:]:
        publisher.publish(payload)
    graph.spin(0.5)
    wake.set()
    graph.until(lambda: len(received) == len(sent))
    assert received == sent


def test_it_passes_on_until_there_is_a_model(graph, still_imu, results: Results):
    graph.run('relay')
    received = raw(graph)
    publisher = graph.publisher()
    batch = still_imu(10)
    graph.send(publisher, batch)
    graph.until(lambda: len(received) == 10)
    assert received == payloads(batch)
    status = graph.until(lambda: (s := graph.status('relay')) and s.level == WARN and s)
    assert status.name == 'allan_imu_relay: relay'
    assert 'covariances of zero are passed on' in status.message
    assert 'set estimator.sensor' in status.message
    graph.until(lambda: 'Start allan_estimator' in graph.status('relay').message)
    publish_model(graph, results)
    filled(graph)
    graph.send(publisher, batch)
    graph.until(lambda: len(received) == 20)
    assert received[10:] != payloads(batch)


def gyro_variances(received: list[bytes]) -> Any:
    """Return the variances of x, y, z in each message, (n, 3)."""
    table = np.frombuffer(b''.join(received), imu_dtype('cdr', '<', 4))
    return table['gyro_covariance'][:, [0, 4, 8]]


def test_the_first_message_has_the_covariance_of_the_datasheet(graph, still_imu, results):
    """0.005 deg/s/sqrt(Hz) is a one-sided density: N is 6.2e-5 rad/s/sqrt(Hz)."""
    bias = 4e-3

    def biased(n: int, start_s: int) -> ImuBatch:
        batch = still_imu(n, start_ns=start_s * 10**9)
        batch.samples[:, :3] = batch.samples[:, :3] * 1e-3 + [0.0, bias, 0.0]
        return batch

    graph.run('relay', **{'estimator.sensor': 'mpu-6050'})
    received = raw(graph)
    publisher = graph.publisher()
    density = np.radians(0.005) / 2**0.5
    graph.send(publisher, biased(400, 10**9))
    graph.until(lambda: len(received) == 400)
    first = gyro_variances(received[:1])
    assert np.all(first >= 0.99 * density**2 * 200.0)  # the rate is not known yet
    assert '(gyro and accel from the datasheet)' in filled(graph).message

    for second in range(2, 6):  # the rate of the stamps
        graph.send(publisher, biased(200, 10**9 + second))
        graph.spin(0.2)
    graph.until(lambda: len(received) == 1200)
    del received[:]
    graph.send(publisher, biased(1, 10**9 + 6))
    graph.until(lambda: received)
    # the bias is not known yet, so the mean so far is covered
    covered = density**2 * 200.0 + np.array([0.0, bias**2, 0.0])
    assert gyro_variances(received)[0] == pytest.approx(covered, rel=0.02)
    model = publish_model(graph, results)
    graph.until(lambda: 'datasheet' not in filled(graph).message)
    del received[:]
    graph.send(publisher, biased(1, 10**9 + 7))
    graph.until(lambda: received)
    # the mean of the model is the bias until the bias of this run is known
    assert gyro_variances(received)[0] == pytest.approx(1e-6, rel=0.1)
    model.destroy()


def test_covariances_of_the_driver_need_no_model(graph, still_imu):
    graph.run('relay', remap={'noise_model': 'model'})
    publish = graph.node.create_publisher(String, 'model', 1)  # nothing is published
    received = raw(graph)
    publisher = graph.publisher()
    (whole,) = payloads(still_imu(1))
    driver = CovariancePatch({'gyro': (1.0, 2.0, 3.0), 'accel': (4.0, 5.0, 6.0)}).patch(whole)
    publisher.publish(driver)
    graph.until(lambda: received == [driver])
    graph.spin(0.5)
    status = graph.status('relay')
    assert status.level == OK and 'covariances of the driver are passed on' in status.message
    publisher.publish(whole)
    graph.until(lambda: graph.status('relay').level == WARN)
    publish.destroy()


def test_another_horizon_leaves_no_covariance_empty(graph, still_imu, results: Results):
    """From 20 s, the drift over 100 s is not known well."""
    graph.run('relay')
    received = raw(graph)
    publisher = graph.publisher()
    publish_model(graph, results)
    filled(graph)
    set_parameters(graph, '/allan_imu_relay', relay__horizon=100.0)
    status = graph.until(
        lambda: (s := graph.status('relay')) and 'a horizon of 100 s' in str(s.values) and s
    )
    assert status.message.startswith('covariances of gyro and accel are filled')
    graph.send(publisher, still_imu(10))
    graph.until(lambda: len(received) == 10)
    assert np.all(gyro_variances(received) > 0.9e-6)


def test_until_the_bias_is_known_the_mean_of_the_model_is_covered(graph, still_imu, results):
    """A model from a checkpoint is known at once, the bias of this run 20 s later."""
    from geometry_msgs.msg import TwistWithCovarianceStamped
    from rclpy.qos import DurabilityPolicy, QoSProfile

    graph.run('relay')
    received = raw(graph)
    publisher = graph.publisher()
    axes = dict(results.axes)
    rest = axes['gyro_x'].at_rest
    assert rest is not None
    axes['gyro_x'] = replace(axes['gyro_x'], at_rest=replace(rest, mean=5e-3))
    publish_model(graph, replace(results, axes=axes))
    filled(graph)
    graph.send(publisher, still_imu(1))
    graph.until(lambda: received)
    x, y, _ = gyro_variances(received)[0]
    assert x > 25e-6 and y < 2e-6
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    bias = graph.node.create_publisher(TwistWithCovarianceStamped, 'bias', latched)
    bias.publish(TwistWithCovarianceStamped())  # a bias of 0, known exactly

    def follows() -> bool:
        del received[:]
        graph.send(publisher, still_imu(1))
        graph.until(lambda: received)
        return bool(gyro_variances(received)[0, 0] < 2e-6)

    graph.until(follows)


def test_two_relays_to_one_topic_are_reported(graph):
    graph.run('relay')
    graph.run('relay', remap={'__node': 'other_relay'})
    told = '2 publishers on /imu/data_with_covariance (/allan_imu_relay, /other_relay)'

    def found() -> Any:
        return next((s for s in graph.statuses.values() if s.message.startswith(told)), None)

    assert graph.until(found).level == WARN


def test_messages_that_must_not_be_filled_are_passed_on_unchanged(
    graph, still_imu, results: Results
):
    graph.run('relay', **{'relay.debiased': True})
    received = raw(graph)
    publisher = graph.publisher()
    publish_model(graph, results)
    filled(graph)
    absent = still_imu(1)
    absent.samples[:, :3] = np.nan
    (gyroless,) = payloads(absent)
    (whole,) = payloads(still_imu(1))
    driver = CovariancePatch({'gyro': (1.0, 2.0, 3.0), 'accel': (4.0, 5.0, 6.0)}).patch(whole)
    (other,) = payloads(still_imu(1, frame_id='base_link'))
    sent = [gyroless, driver, other, whole[:100], b'\0\1\0\0', whole]
    for payload in sent:
        publisher.publish(payload)
    graph.until(lambda: len(received) == len(sent))
    only_accel = {'accel': variances(results)['accel']}
    assert received[0] == CovariancePatch(only_accel).patch(gyroless)
    assert received[1:5] == sent[1:5]
    assert received[5] == CovariancePatch(variances(results)).patch(whole)
    status = graph.until(lambda: (s := graph.status('relay')).level == WARN and s)
    assert '"base_link"' in status.message and 'is for "imu"' in status.message
    assert graph.value('relay', 'malformed') == '2'
    assert 'are not valid Imu messages' in graph.value('relay', 'finding: relay_malformed')


def set_parameters(graph: Any, node: str, **values: Any) -> list[Any]:
    """Set parameters of a node through its service."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    made = [Parameter(n.replace('__', '.'), value=v).to_parameter_msg() for n, v in values.items()]
    request = SetParameters.Request(parameters=made)
    return list(graph.ask(SetParameters, f'{node}/set_parameters', request).results)


def test_parameters_act_while_it_runs(graph, still_imu, results: Results):
    graph.run('relay', **{'relay.debiased': True})
    received = raw(graph)
    publisher = graph.publisher()
    publish_model(graph, results)
    filled(graph)
    (whole,) = payloads(still_imu(1))
    driver = CovariancePatch({'gyro': (1.0, 2.0, 3.0)}).patch(whole)

    def relayed(expected: bytes) -> None:
        """Send until the relayed message equals ``expected``, because a change takes effect
        after a moment.
        """

        def arrives() -> bool:
            del received[:]
            publisher.publish(driver)
            graph.until(lambda: received)
            return received[-1] == expected

        graph.until(arrives)

    def expected(overwrite: bool, **variance: tuple[float, ...]) -> bytes:
        return CovariancePatch(variance, overwrite).patch(driver)

    relayed(expected(False, **variances(results)))
    set_parameters(graph, '/allan_imu_relay', relay__overwrite=True, relay__inflate=2.0)
    relayed(expected(True, **{s: tuple(4.0 * v for v in x) for s, x in variances(results).items()}))
    (refused,) = set_parameters(graph, '/allan_imu_relay', relay__inflate=0.5)
    assert not refused.successful and refused.reason


def test_a_model_that_is_invalidated_or_cannot_be_read_is_reported(
    graph, still_imu, results: Results
):
    graph.run('relay')
    received = raw(graph)
    source = graph.publisher()
    publisher = publish_model(graph, results)
    filled(graph)
    rateless = json.dumps({**results_to_document(results), 'tau0_s': 0.0})
    for text in ('nonsense', '[' * 100_000, '{"schema": "allan_ros/results/3"}', rateless):
        publisher.publish(String(data=text))
        status = graph.until(lambda: (s := graph.status('relay')).level == WARN and s)
        assert 'cannot be read' in status.message
        whole = json.dumps(results_to_document(results))  # with the curves, as results.json
        publisher.publish(String(data=whole))
        filled(graph)
    invalidated = replace(results, axes={}, samples=0)
    publisher.publish(String(data=json.dumps(results_to_document(invalidated, curves=False))))
    status = graph.until(lambda: (s := graph.status('relay')).level == WARN and s)
    assert status.message.startswith('The noise model on /noise_model was invalidated')
    batch = still_imu(10)
    graph.send(source, batch)
    graph.until(lambda: len(received) == 10)
    assert received == payloads(batch)


def test_a_relay_to_itself_is_rejected(graph):
    with pytest.raises(AllanError, match='would be relayed to itself'):
        graph.run('relay', remap={OUT: 'imu/data'})


def test_messages_are_relayed_also_if_waiting_for_them_fails(graph, still_imu):
    from rclpy.impl.implementation_singleton import rclpy_implementation

    relay = graph.run('relay')
    (part,) = relay._parts
    part.close()
    part._stop.clear()
    received = raw(graph)
    publisher = graph.publisher()
    # a wait set without room for a subscription: adding one fails each time
    wait_set = rclpy_implementation.WaitSet(0, 0, 0, 0, 0, 0, relay.context.handle)
    thread = threading.Thread(target=part._work, args=(wait_set,))
    thread.start()
    (payload,) = payloads(still_imu(1))
    publisher.publish(payload)
    try:
        graph.until(lambda: received)
        assert received[0] == payload
        assert [where for where, _ in relay._faults] == ['relay wait']
    finally:
        part._stop.set()
        thread.join()


def test_the_monitor_relays_what_it_measures(graph, still_imu):
    """The relay gets the noise model by a call, and subscribes only to the Imu messages."""
    node = graph.run('monitor', **{'relay.enabled': True, 'relay.debiased': True})
    topics = {s.topic_name for s in node.subscriptions}
    assert topics <= {'/imu/data', '/parameter_events', '/clock'}
    received = raw(graph)
    publisher = graph.publisher()
    batch = still_imu(6000)
    graph.send(publisher, batch)
    model = graph.model_of(6000)
    variance = model['axes']['gyro_x']['white_std_per_sample'] ** 2
    graph.until(
        lambda: (
            (shown := graph.value('relay', 'variance of gyro x')) not in (None, 'unknown')
            and float(shown) == pytest.approx(variance, rel=1e-4)
        )
    )
    again = still_imu(100, start_ns=10**18 + 31 * 10**9, seed=4)
    graph.send(publisher, again)
    kind, end_s = imu_dtype('cdr', '<', 4), again.stamps_ns[-1] // 10**9

    def arrived() -> Any:
        last = np.frombuffer(received[-1], kind)
        return last if last['sec'][0] == end_s else None

    last = graph.until(arrived)
    np.testing.assert_allclose(last['gyro_covariance'][0, [0, 4, 8]], 1e-6, rtol=0.15)
    np.testing.assert_allclose(last['accel_covariance'][0, [0, 4, 8]], 1e-4, rtol=0.15)
    assert graph.status('relay').name == 'allan_monitor: relay'
