# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of another node are set once values are known, and only within safe limits."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from support.simulate_drives import MotionErrors, Route, simulate_drives

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.core.noise import Model
from allan_ros.nodes.former_values import Former, FormerValues
from allan_ros.nodes.push_plan import PUSHED_TARGETS, Proposal, load_push_plan
from allan_ros.readers.files import config_names

OK, WARN = b'\x00', b'\x01'
N = 1e-3 / 200**0.5

PLAN = """
schema: allan_ros/push/1
target: kalibr
estimates_bias: true
parameters:
  gyroscope_noise_density: density
  accelerometer_noise_density: fixed   # the node refuses it
  gyroscope_random_walk: later         # not resolved in half a minute
  nothing: missing
"""

QUICK = {'push.period': 0.5}


def said(graph: Any, text: str) -> Any:
    """Wait until the status of the parameters contains a text, and return the status."""
    return graph.until(
        lambda: (
            (s := next((s for n, s in graph.statuses.items() if 'parameters of' in n), None))
            and text in s.message
            and s
        )
    )


def filter_in(graph: Any, name: str) -> Any:
    """Return a node with four parameters, of which it lets nobody change the one named fixed."""
    from rcl_interfaces.msg import SetParametersResult

    node = graph.add_node(name)
    for parameter, value in (('density', 0.1), ('gain', 0.1), ('zeta', 0.0), ('fixed', 1.0)):
        node.declare_parameter(parameter, value)

    def on_set(parameters: list[Any]) -> SetParametersResult:
        allowed = all(p.name != 'fixed' for p in parameters)
        return SetParametersResult(successful=allowed, reason='' if allowed else 'fixed for you')

    node.add_on_set_parameters_callback(on_set)
    return node


def test_parameters_are_set_refused_and_restored(graph, still_imu, tmp_path, capfd):
    from rclpy.parameter import Parameter

    plan = tmp_path / 'plan.yaml'
    plan.write_text(PLAN)
    wide = {'push.max_factor': 1e5, 'push.node': '/imu_filter'}
    monitor = graph.run('monitor', **QUICK, **wide, **{'push.filter': str(plan)})
    graph.send(graph.publisher(), still_imu(6000))
    assert said(graph, '/imu_filter is not running: start it').level == WARN
    graph.model_of(6000)
    node = filter_in(graph, 'imu_filter')
    said(graph, 'set density = ')
    # the gyro has N: 6000 samples determine it to 2 %, the worst of three axes lies above
    assert node.get_parameter('density').value == pytest.approx(N, rel=0.15)
    status = said(graph, 'fixed for you')
    assert status.level == WARN
    for text in ('(was 0.1)', 'missing: kalibr has no number nothing', 'later: '):
        assert text in status.message
    assert any(v.key == 'origin of density' and 'gyro' in v.value for v in status.values)
    monitor.set_parameters([Parameter('push.enabled', value=False)])
    graph.until(lambda: node.get_parameter('density').value == 0.1)
    assert said(graph, 'restored density = 0.1, because push.enabled is false').level == OK
    graph.spin(1.5)  # three periods: the values stay restored
    assert node.get_parameter('density').value == 0.1
    logged = capfd.readouterr().err
    assert 'density of /imu_filter: 0.1 -> ' in logged
    assert logged.count('fixed for you') == 1


GAIN = {'push.node': '/imu_filter_madgwick', 'push.filter': 'imu_filter_madgwick'}


def test_a_gain_is_shown_but_not_set_until_the_errors_in_motion_are_known(graph, still_imu):
    node = filter_in(graph, 'imu_filter_madgwick')
    batch, bias = still_imu(6000), np.radians(0.1)
    batch.samples[:, 0] += bias
    graph.run('monitor', **QUICK, **GAIN, **{'push.max_factor': 1e5})
    graph.send(graph.publisher(), batch)
    graph.model_of(6000)
    status = said(graph, 'the gain has to cover the errors in motion, which are not measured yet')
    assert status.level == WARN and 'drive at least 5 times for 2 to 180 s' in status.message
    shown = graph.until(lambda: graph.value('imu_filter_madgwick', 'gain at rest, not set'))
    assert bias < float(shown) / 0.75**0.5 < 1.5 * bias
    assert 'and the bias' in graph.value('imu_filter_madgwick', 'origin of gain')
    graph.spin(1.5)  # three periods
    assert (node.get_parameter('gain').value, node.get_parameter('zeta').value) == (0.1, 0.0)
    assert said(graph, 'nothing set yet').level == WARN


@pytest.mark.parametrize('former, raised', [(5e-5, True), (0.1, False)])
def test_a_gain_is_raised_if_it_does_not_cover_the_errors_in_motion(graph, former, raised):
    """The error of the gyro is its bias of 1 mrad/s at least, since scale factors add to it."""
    from rclpy.parameter import Parameter

    node = filter_in(graph, 'imu_filter_madgwick')
    node.set_parameters([Parameter('gain', value=former)])
    noise = [Model.of(N=7e-5)] * 3, [Model.of(N=1.2e-3)] * 3
    route = Route(drives=10, tilt=0.15, shortest=15.0, longest=25.0, rest=11.0)
    robot = simulate_drives(50.0, *noise, route, MotionErrors(gyro_scale=0.02), seed=1)
    robot.samples[:, 0] += 1e-3
    stamps = 10**18 + np.arange(len(robot.samples)) * 20_000_000
    monitor = graph.run('monitor', **QUICK, **GAIN, **{'push.max_factor': 1e3})
    graph.send(graph.publisher(), ImuBatch(stamps, robot.samples, frame_id='imu'))
    if not raised:
        status = said(graph, 'covers the errors of the gyro in motion, for which 0.00')
        assert status.level == OK and node.get_parameter('gain').value == 0.1
        return
    assert said(graph, 'set gain = 0.00').level == OK
    gain = node.get_parameter('gain').value
    assert 0.87e-3 < gain < 0.02 and node.get_parameter('zeta').value == 0.0
    monitor.set_parameters([Parameter('push.enabled', value=False)])
    graph.until(lambda: node.get_parameter('gain').value == former)


@pytest.mark.parametrize(
    'found, gain, kept',
    [((0.01,), 0.019, True), ((0.01,), 0.021, False), ((0.1,), 0.001, True), ((), 0.01, False)],
)
def test_a_gain_is_never_lowered_and_not_raised_for_little(found, gain, kept):
    for is_gain in (True, False):
        proposal = Proposal('gain', (gain,), (gain, gain), '', is_gain)
        assert bool(proposal.keeps(found)) == (kept and is_gain)


def test_a_value_that_an_operator_changes_is_left_as_it_is(graph, pushing):
    slow, node = pushing
    graph.model_of(6000)
    said(graph, 'set density')
    slow.density = 0.5
    part = node._parts[-1]
    part._due_at = 0.0
    assert 'density was changed to 0.5' in said(graph, 'not set any more').message.replace(':', '')
    graph.call('/allan_monitor/reset')
    graph.spin(1.5)
    assert slow.density == 0.5


class SlowFilter:
    """The parameter services of a filter, on the client node; requests wait until `release`."""

    def __init__(self, graph: Any, density: float = 0.1) -> None:
        from rcl_interfaces.msg import ParameterValue, SetParametersResult
        from rcl_interfaces.srv import GetParameters, SetParameters
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.task import Future

        self.density, self.held, self.holds, self.reason = density, [], '', ''
        self.all_sent: list[float] = []

        async def respond(what: str, response: Any) -> Any:
            if what == self.holds:
                self.held.append(Future())
                await self.held[-1]
            return response

        async def on_get(_: Any, response: Any) -> Any:
            response.values = [ParameterValue(type=3, double_value=self.density)]
            return await respond('get', response)

        async def on_set(request: Any, response: Any) -> Any:
            if not self.reason:
                (self.density,) = (p.value.double_value for p in request.parameters)
                self.all_sent.append(self.density)
            response.results = [SetParametersResult(successful=not self.reason, reason=self.reason)]
            return await respond('set', response)

        for kind, name, answer in (
            (GetParameters, 'get_parameters', on_get),
            (SetParameters, 'set_parameters', on_set),
        ):
            group = ReentrantCallbackGroup()
            graph.node.create_service(kind, f'/slow/{name}', answer, callback_group=group)

    def release(self) -> None:
        self.holds = ''
        for future in self.held:
            future.set_result(None)


@pytest.fixture
def pushing(graph, still_imu, tmp_path) -> tuple[SlowFilter, Any]:
    """Return a filter, and a monitor with a noise model that pushes the density to it."""
    slow, plan = SlowFilter(graph), tmp_path / 'plan.yaml'
    head, *_ = PLAN.partition('  accelerometer')
    plan.write_text(head)
    push = {'push.node': '/slow', 'push.filter': str(plan), 'push.max_factor': 1e5}
    node = graph.run('monitor', **QUICK, **push)
    graph.send(graph.publisher(), still_imu(6000))
    return slow, node


def test_a_value_whose_answer_was_lost_is_restored(graph, pushing, monkeypatch):
    """The filter is busy for longer than the monitor waits; then the model is invalidated."""
    monkeypatch.setattr('allan_ros.nodes.parameter_push.ANSWER_S', 0.3)
    slow, _ = pushing
    slow.holds = 'set'
    graph.model_of(6000)
    assert '(was 0.1)' in said(graph, 'set density = ').message
    assert slow.density == pytest.approx(N, rel=0.15)
    slow.holds = ''
    graph.call('/allan_monitor/reset')
    graph.until(lambda: slow.density == 0.1)


def test_no_value_of_an_invalidated_model_is_set(graph, pushing):
    slow, _ = pushing
    slow.holds = 'get'
    graph.model_of(6000)
    graph.until(lambda: slow.held)
    models = graph.latched('/allan_monitor/noise_model')
    graph.call('/allan_monitor/reset')
    graph.until(lambda: models and not models[-1]['axes'])
    slow.release()
    graph.spin(1.5)
    assert slow.density == 0.1


def test_nothing_stays_set_when_the_node_ends(graph, pushing):
    slow, node = pushing
    graph.model_of(6000)
    said(graph, 'set density = ')
    graph.stop(node)
    graph.until(lambda: slow.density == 0.1)


@pytest.mark.parametrize('end', [signal.SIGINT, signal.SIGKILL])
def test_the_former_value_survives_the_end_of_the_monitor(graph, still_imu, tmp_path, end):
    """A killed monitor cannot restore the value: the next one does, and it does not take the value
    that it finds for a value of the operator.
    """
    from rclpy.parameter import Parameter

    slow, plan = SlowFilter(graph), tmp_path / 'plan.yaml'
    plan.write_text(PLAN.partition('  accelerometer')[0])
    push = {'push.node': '/slow', 'push.filter': str(plan), 'push.max_factor': 1e5}
    state = {'checkpoint.path': str(tmp_path / 'sums.json')}
    monitor = graph.start('monitor', **QUICK, **push, **state)
    graph.send(graph.publisher(), still_imu(6000))
    graph.model_of(6000)
    graph.until(lambda: slow.density == pytest.approx(N, rel=0.15))
    assert FormerValues('/slow').path.is_file()
    monitor.send_signal(end)
    graph.until(lambda: monitor.poll() is not None)
    assert (slow.density == 0.1) == (end == signal.SIGINT)
    graph.statuses.clear()
    sent = slow.all_sent = []
    again = graph.run('monitor', **QUICK, **push, **state)
    graph.until(lambda: slow.density == pytest.approx(N, rel=0.15) and sent)
    assert sent[0] == 0.1 or end == signal.SIGINT
    graph.until(lambda: graph.value('/slow', 'former density') == '0.1')
    again.set_parameters([Parameter('push.enabled', value=False)])
    graph.until(lambda: slow.density == 0.1)
    graph.until(lambda: not FormerValues('/slow').path.exists())


def test_a_killed_value_is_restored_also_if_nothing_is_set_now(graph, tmp_path):
    slow, former = SlowFilter(graph, 2.0), FormerValues('/slow')
    former.open()
    former.store({'density': Former((0.1,), ((1.0,), (2.0,)))})
    former.close()
    push = {'push.node': '/slow', 'push.filter': 'imu_filter_madgwick', 'push.enabled': False}
    graph.run('monitor', **QUICK, **push)
    said(graph, 'restored density = 0.1, because the program that had set it was killed')
    assert slow.density == 0.1 and not former.path.exists()


def test_a_filter_that_was_started_again_keeps_its_value(graph, tmp_path):
    slow, former = SlowFilter(graph, 0.3), FormerValues('/slow')
    former.open()
    former.store({'density': Former((0.1,), ((2.0,),))})
    former.close()
    graph.run('monitor', **QUICK, **{'push.node': '/slow', 'push.filter': 'noise_densities'})
    graph.until(lambda: not former.path.exists())
    assert slow.density == 0.3


def test_former_values_are_kept_before_anything_is_set(graph, still_imu, tmp_path, monkeypatch):
    (tmp_path / 'file').touch()
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'file'))
    slow, plan = SlowFilter(graph), tmp_path / 'plan.yaml'
    plan.write_text(PLAN.partition('  accelerometer')[0])
    push = {'push.node': '/slow', 'push.filter': str(plan), 'push.max_factor': 1e5}
    graph.run('monitor', **QUICK, **push)
    graph.send(graph.publisher(), still_imu(6000))
    graph.model_of(6000)
    assert said(graph, 'set ROS_HOME to a writable folder').level == WARN
    graph.spin(1.5)
    assert slow.density == 0.1


def test_former_values_are_locked_and_read_back(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    first, second = FormerValues('/a/b'), FormerValues('/a/b')
    values = {'noise': Former((0.1,), ((0.2,), (0.3,))), 'cov': Former((1.0, 2.0), ((3.0, 4.0),))}
    assert first.open() == {}
    first.store(values)
    with pytest.raises(AllanError, match='sets parameters of /a/b'):
        second.open()
    first.close()
    assert second.open() == values
    second.store({})
    second.close()
    assert not first.path.exists()


@pytest.mark.parametrize('text', ['', '{}', 'null', '{"schema": "allan_ros/former_values/1"}'])
def test_a_damaged_file_of_former_values_is_named(tmp_path, monkeypatch, text):
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    former = FormerValues('/x')
    former.path.parent.mkdir(parents=True)
    former.path.write_text(text)
    with pytest.raises(AllanError, match='former_values'):
        former.open()


def test_a_reason_of_another_node_is_cut_and_safe_to_print(graph, pushing):
    slow, _ = pushing
    slow.reason = 'no\x1b[31m\n' + 500 * 'x'
    graph.model_of(6000)
    message = said(graph, 'refused').message
    assert message.isprintable() and r'no\x1b[31m\n' in message
    assert len(message) < 400 and message.endswith(' ...')


def test_why_a_value_is_not_set_is_said_only_while_values_are_set(graph, pushing):
    from rclpy.parameter import Parameter

    _, node = pushing
    node.set_parameters([Parameter('push.max_factor', value=1.0)])
    graph.model_of(6000)
    said(graph, 'so it is not set')
    node.set_parameters([Parameter('push.enabled', value=False)])
    assert said(graph, 'off: ').message == 'off: push.enabled is false'


def test_a_value_far_from_the_one_that_was_found_is_refused():
    def refusal(value: float, found: float) -> str:
        return Proposal('density', (value,), (value, value), '').refusal((found,), 10.0)

    assert refusal(0.011, 0.1) == refusal(0.9, 0.1) == ''
    assert '11.1 times below the 0.1' in refusal(0.009, 0.1)
    assert '20 times above the 0.1' in refusal(2.0, 0.1)
    for strange in (0.0, -1.0, float('inf'), float('nan')):
        assert f'is {strange:.4g} in the node and is not changed' in refusal(1e-5, strange)
        assert 'is not changed' in refusal(strange, 1e-5)
    three = Proposal('density', (0.1, 0.1, 0.1), (0.1, 0.1), '')
    assert 'has 0 numbers in the node' in three.refusal((), 10.0)


def test_every_plan_of_the_package_can_be_read():
    assert config_names('filters') == ['imu_filter_madgwick', 'noise_densities']
    for name in config_names('filters'):
        assert load_push_plan(name).target in PUSHED_TARGETS


@pytest.mark.parametrize(
    'old, new, reason',
    [
        ('push/1', 'push/2', 'schema'),
        ('target: kalibr', 'target: gazebo', 'target'),
        ('estimates_bias: true', 'estimates_bias: false', 'do not cover the gyro bias'),
        ('estimates_bias: true\n', '', 'do not cover the gyro bias'),
        ('estimates_bias', 'estimate', 'unknown'),
    ],
)
def test_a_bad_plan_is_rejected_with_its_name(tmp_path: Path, old: str, new: str, reason: str):
    path = tmp_path / 'bad.yaml'
    path.write_text(PLAN.replace(old, new))
    with pytest.raises(AllanError) as refused:
        load_push_plan(str(path))
    assert reason in str(refused.value) and 'bad.yaml' in str(refused.value)


def test_former_values_that_cannot_be_removed_are_an_error(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    former = FormerValues('/filter')
    former.open()
    former.store({'gain': Former((0.1,), ())})
    former.path.unlink()
    former.path.mkdir()
    with pytest.raises(AllanError, match='cannot be removed'):
        former.store({})
    former.close()
