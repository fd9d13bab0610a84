# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A fault is shown on its axes, and stops what uses them; a bias is covered by the variance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import TwistWithCovarianceStamped

from allan_ros.core.filters.white_variances import cover_bias, white_ratio
from allan_ros.core.findings import finding
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.nodes.messages import bias_of
from allan_ros.nodes.node_settings import SETTLED_RATIO, RelaySettings
from allan_ros.nodes.relaying import relay_variances
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.results import Results

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


def continued(batch: ImuBatch, before: ImuBatch) -> ImuBatch:
    """Return the batch with stamps that continue the stamps of another one."""
    shift = before.stamps_ns[-1] - batch.stamps_ns[0] + 5_000_000
    return replace(batch, stamps_ns=batch.stamps_ns + shift)


def test_a_stuck_axis_is_an_error_of_this_axis_and_of_the_relay(graph, still_imu) -> None:
    graph.run('monitor', **{'relay.enabled': True})
    publisher = graph.publisher()
    healthy = still_imu(8000)
    graph.send(publisher, healthy)
    said = lambda name, text: (s := graph.status(name)) and text in s.message and s  # noqa: E731
    graph.until(lambda: said('relay', 'covariances of gyro and accel are filled'))
    stuck = continued(still_imu(1000, seed=2), healthy)
    stuck.samples[:, 2] = stuck.samples[0, 2]
    graph.send(publisher, stuck)
    assert graph.until(lambda: said('imu gyro z', 'no longer changes')).level == ERROR
    assert graph.until(lambda: said('relay', 'gyro_z: The value no longer changes')).level == ERROR
    assert graph.value('relay', 'variance of gyro x') is None
    assert graph.value('relay', 'variance of accel x') is not None
    assert graph.status('imu gyro x').level == graph.status('imu accel z').level == OK
    assert graph.value('imu gyro z', 'finding') == 'stuck_now'
    graph.send(publisher, continued(still_imu(200, seed=3), stuck))
    graph.until(lambda: said('relay', 'covariances of gyro and accel are filled'))
    assert graph.until(lambda: (s := graph.status('imu gyro z')).level == OK and s)


def test_wrong_units_and_silence_are_errors_of_the_axes(graph, still_imu) -> None:
    graph.run('monitor', **{'relay.enabled': True, 'input.stale_after': 5.0})
    publisher = graph.publisher()
    batch = still_imu(6000)
    batch.samples[:, 3:] /= 9.80665
    graph.send(publisher, batch)
    status = graph.until(
        lambda: (s := graph.status('imu accel z')) and 'unit is probably g' in s.message and s
    )
    assert status.level == ERROR and graph.status('imu gyro z').level == OK
    assert graph.until(lambda: (s := graph.status('relay')) and s.level == ERROR and s)
    assert graph.value('relay', 'variance of accel x') is None
    graph.until(lambda: 'No samples arrive' in graph.status('imu gyro z').message)
    assert graph.value('imu gyro z', 'finding') == 'no_data'


def test_the_covariance_follows_noise_that_doubles_and_a_fan(graph, still_imu) -> None:
    """10 s of data are enough; the model is still the model of the 40 s before."""
    graph.run('monitor', **{'relay.enabled': True})
    publisher = graph.publisher()
    healthy = still_imu(8000)
    graph.send(publisher, healthy)
    variance = lambda: float(graph.value('relay', 'variance of gyro x') or 'nan')  # noqa: E731
    graph.until(lambda: variance() > 0.0)
    before, latest = variance(), healthy
    for ratio, seed in ((2.0, 2), (6.0, 3)):
        noise = still_imu(2000, seed=seed)
        noise.samples[:] = noise.samples[0] + ratio * (noise.samples - noise.samples.mean(axis=0))
        noise.samples[:, :3] -= noise.samples[:, :3].mean(axis=0)
        noise.samples[:, 3:] += [0, 0, 9.8] - noise.samples[:, 3:].mean(axis=0)
        latest = continued(noise, latest)
        graph.send(publisher, latest)
        # sd of the present level is 4 %: 5 sigma
        graph.until(lambda: variance() > 0.64 * ratio**2 * before)  # noqa: B023
        assert graph.status('relay').level == OK
    quiet = continued(still_imu(3000, seed=4), latest)
    graph.send(publisher, quiet)
    graph.until(lambda: variance() < 4.0 * before)


def held(x: np.ndarray) -> np.ndarray:
    return x[np.arange(len(x)) // 2 * 2]


def without_gravity(x: np.ndarray) -> np.ndarray:
    return x - [0, 0, 0, 0, 0, 9.8]


def in_g(x: np.ndarray) -> np.ndarray:
    return x / [1, 1, 1, 9.80665, 9.80665, 9.80665]


@pytest.mark.parametrize(
    'fault, name', [(held, 'held'), (without_gravity, 'gravity_removed'), (in_g, 'accel_unit')]
)
def test_a_fault_in_mid_run_is_named_and_leaves_nothing_behind(
    graph, still_imu, fault, name: str
) -> None:
    graph.run('monitor')
    publisher = graph.publisher()
    healthy = still_imu(8000)
    graph.send(publisher, healthy)
    graph.until(lambda: float(graph.value('input', 'static data') or 0) > 30.0)
    bad = continued(still_imu(2000, seed=2), healthy)
    bad.samples[:] = fault(bad.samples)
    graph.send(publisher, bad)
    found = graph.until(lambda: graph.value('input', f'finding: {name}'))
    assert found.startswith('now: ') and graph.status('input').level != OK
    graph.send(publisher, continued(still_imu(6000, seed=3), bad))
    graph.until(lambda: float(graph.value('input', 'static data') or 0) > 60.0)
    assert graph.until(lambda: (s := graph.status('input')).level == OK and s)
    assert not (graph.value('input', f'finding: {name}') or '').startswith('now')


def test_a_robot_that_never_rests_is_warned_about_covariances_of_zero(graph, still_imu) -> None:
    graph.run('monitor', **{'relay.enabled': True})
    batch = still_imu(6000)
    turn = 0.3 * np.sin(2 * np.pi * 0.3 * np.arange(len(batch)) / 200.0)
    batch.samples[:] += turn[:, None] * [0.2, 0.1, 1.0, 3.0, 2.0, 1.0]
    graph.send(graph.publisher(), batch)
    graph.until(lambda: (s := graph.status('input')) and 'never_still' in str(s.values))
    status = graph.until(
        lambda: (
            (s := graph.status('relay')) and 'covariances of zero are passed on' in s.message and s
        )
    )
    assert status.level == WARN and graph.value('relay', 'variance of gyro x') is None


def results_of(seconds: int, method: str) -> Results:
    """Return the results of white noise at 200 Hz."""
    n = 200 * seconds
    samples = np.random.default_rng(7).normal(0.0, [1e-3] * 3 + [1e-2] * 3, (n, 6))
    samples[:, 5] += 9.8
    stream = ImuStream()
    stream.update(ImuBatch(10**18 + np.arange(n) * 5_000_000, samples, frame_id='imu'))
    stream.end()
    return analyze_sums(stream.result().sums, Provenance(), method)


@pytest.fixture(scope='module')
def results() -> Results:
    return results_of(20, 'paper')


@pytest.mark.parametrize('seconds', [12, 900])
def test_a_variance_with_a_horizon_covers_the_white_noise_and_says_how_well_it_is_known(
    seconds: int,
) -> None:
    """White noise alone has the variance 1e-6; a short record allows much drift."""
    found = results_of(seconds, 'likelihood')
    fits = {name: axis.fit for name, axis in found.axes.items()}
    ratio = white_ratio(fits, 10.0)
    x, y, z = relay_variances(found, RelaySettings(horizon=10.0), 200.0)['gyro']
    assert min(x, y, z) > 0.5e-6
    if ratio <= SETTLED_RATIO:
        assert max(x, y, z) < 2.25e-6
    assert (ratio <= SETTLED_RATIO) == (seconds > 100)


def test_a_sensor_with_a_fault_has_no_variances(graph, results: Results) -> None:
    (relay,) = graph.run('relay')._parts
    relay.offer(results, {})
    assert set(relay._variances) == {'gyro', 'accel'}
    found = finding('stuck_now', ('gyro_z',))
    relay.offer(replace(results, findings=(*results.findings, found)), {})
    assert set(relay._variances) == {'accel'}
    relay.offer(results, {})
    assert set(relay._variances) == {'gyro', 'accel'}


@pytest.mark.parametrize('horizon', [0.0, 10.0])
def test_the_variance_covers_the_bias(results: Results, horizon: float) -> None:
    """Over the horizon, white noise adds as much to the angle as the noise and the bias."""
    rate, message = 200.0, TwistWithCovarianceStamped()
    message.twist.twist.angular.x = 1.7e-3
    bias = bias_of(message)
    noise = relay_variances(results, RelaySettings(), rate)
    messages = max(horizon * rate, 1.0)
    with_bias = cover_bias(noise, bias, horizon * rate)
    growth = np.array(with_bias['gyro']) * messages / rate**2  # of the variance of the angle
    expected = np.array(noise['gyro']) * messages / rate**2
    expected[0] += (1.7e-3 * messages / rate) ** 2
    np.testing.assert_allclose(growth, expected, rtol=1e-9)
    assert with_bias['accel'] == noise['accel']
    message.twist.covariance[21] = -1.0  # unknown
    assert 'gyro_x' not in bias_of(message)
    assert cover_bias(noise, bias_of(message), 1.0) == noise
