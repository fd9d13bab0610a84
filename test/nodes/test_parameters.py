# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters are checked at start and at run time, and set atomically across groups."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('rclpy')

import rclpy
from rclpy.parameter import Parameter

from allan_ros.core.errors import AllanError
from allan_ros.export import target_of
from allan_ros.nodes.node import Parameters
from allan_ros.nodes.node_settings import GROUPS, EstimatorSettings, PublishSettings
from allan_ros.results.results import Results


@pytest.fixture
def make_node(ros_domain: int) -> Iterator[Any]:
    """Return a function that creates a node with given parameters."""
    from rclpy.node import Node

    context = rclpy.Context()
    rclpy.init(context=context)
    nodes: list[Node] = []

    def make(**given: Any) -> Node:
        overrides = [Parameter(name.replace('__', '.'), value=v) for name, v in given.items()]
        node = Node('test', context=context, parameter_overrides=overrides)
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()
    context.shutdown()


def set_all(node: Any, **values: Any) -> Any:
    made = [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]
    return node.set_parameters_atomically(made)


@pytest.mark.parametrize('group', GROUPS)
def test_every_settings_class_checks_its_values(group: str) -> None:
    """Every class rejects an unknown choice and a number out of range."""
    from allan_ros.core.settings import describe

    for name, info in describe(GROUPS[group]).items():
        bad = 'nonsense' if info.choices else None if info.high is None else info.high * 2 + 1
        if bad is not None:
            with pytest.raises(AllanError, match=name):
                GROUPS[group](**{name: bad})


@pytest.mark.parametrize('value', [5, 'abc', [1.0]])
def test_a_value_of_the_wrong_type_gives_one_line(make_node: Any, value: Any) -> None:
    parameters = Parameters(make_node(publish__sums_period=value))
    with pytest.raises(AllanError, match=r'publish.sums_period is .*: give a value such as'):
        parameters.group('publish', PublishSettings)


def test_a_set_that_spans_two_groups_is_atomic(make_node: Any) -> None:
    node = make_node()
    parameters = Parameters(node)
    publish = parameters.group('publish', PublishSettings)
    estimator = parameters.group('estimator', EstimatorSettings)
    for bad, reason in (
        ({'estimator__method': 'guess'}, 'choose one of likelihood'),
        ({'use_sim_time': 'yes'}, ''),
    ):
        result = set_all(node, publish__sums_period=2.0, estimator__growth=0.5, **bad)
        assert not result.successful and reason in result.reason
        assert (publish.value.sums_period, estimator.value.growth) == (10.0, 0.1)
        assert node.get_parameter('publish.sums_period').value == 10.0
    assert set_all(node, publish__sums_period=2.0, estimator__growth=0.5).successful
    assert (publish.value.sums_period, estimator.value.growth) == (2.0, 0.5)
    assert parameters.changes() == ['publish.sums_period=2.0', 'estimator.growth=0.5']


def test_a_range_holds_at_run_time_and_is_described(make_node: Any) -> None:
    node = make_node()
    parameters = Parameters(node)
    publish = parameters.group('publish', PublishSettings)
    parameters.group('checkpoint', GROUPS['checkpoint'])
    low = set_all(node, publish__diagnostics_period=0.0)
    assert not low.successful and low.reason
    assert set_all(node, publish__diagnostics_period=0.5).successful
    assert publish.value.diagnostics_period == 0.5
    fixed = set_all(node, checkpoint__path='/elsewhere')
    assert not fixed.successful and 'read-only' in fixed.reason
    described = node.describe_parameter('publish.diagnostics_period')
    assert described.description.endswith('[s]') and described.floating_point_range[0].to_value


@pytest.mark.parametrize(
    ('name', 'suggestion'),
    [
        ('checkpoint.pth', '; did you mean checkpoint.path?'),
        ('sensor', '; did you mean estimator.sensor?'),
        ('checkpoint', '; did you mean checkpoint.path?'),
        ('wheel_radius', ''),
    ],
)
def test_an_unknown_parameter_is_named_with_a_suggestion(
    make_node: Any, name: str, suggestion: str
) -> None:
    parameters = Parameters(
        make_node(
            **{
                name: 'x',
                'use_sim_time': False,
                'relay__enabled': True,  # a parameter of another node, in a shared file
                'qos_overrides__/imu/data__subscription__reliability': 'reliable',
            }
        )
    )
    assert parameters.unknown() == [f'parameter {name!r} is unknown and ignored{suggestion}']


@pytest.mark.parametrize(
    ('target', 'node_name', 'parameters'),
    [
        ('lio_sam', 'lio_sam_imuPreintegration', ['imuAccNoise', 'imuGyrBiasN']),
        ('fast_lio', 'laser_mapping', ['mapping.acc_cov', 'mapping.b_gyr_cov']),
        ('imu_filter_madgwick', 'imu_filter', ['gain', 'zeta']),
    ],
)
@pytest.mark.usefixtures('ros_domain')
def test_a_node_finds_exported_parameters_as_doubles(
    small_results: Results, tmp_path: Path, target: str, node_name: str, parameters: list[str]
) -> None:
    small_results.export(target, tmp_path)
    path = tmp_path / target_of(target).file_name
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    try:
        node = rclpy.create_node(
            node_name, context=context, automatically_declare_parameters_from_overrides=True
        )
        values = [node.get_parameter(name).value for name in parameters]
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    assert all(isinstance(value, float) and value > 0.0 for value in values)
