# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The configuration file and the launch file agree with the defaults in the code."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
import yaml

from allan_ros.core.settings import describe
from allan_ros.nodes.node_settings import GROUPS


@pytest.fixture
def config_text(repository: Path) -> str:
    return (repository / 'config' / 'allan_ros.yaml').read_text()


def test_the_configuration_file_contains_every_default(config_text: str):
    parameters = yaml.safe_load(config_text)['/**']['ros__parameters']
    defaults = {
        group: {
            name: list(value) if isinstance(value := getattr(made, name), tuple) else value
            for name in describe(made)
        }
        for group, settings in GROUPS.items()
        for made in [settings()]
    }
    assert parameters == defaults


def test_the_configuration_file_explains_every_parameter(config_text: str):
    words = ' '.join(config_text.replace('#', ' ').split())
    for settings in GROUPS.values():
        for name, info in describe(settings).items():
            assert ' '.join(info.doc.rstrip('.').split()) in words, name
            assert not info.unit or f'[{info.unit}]' in words
            assert info.doc.endswith('.') and info.doc[0].isupper(), name


COMMON = re.compile('/clock|/rosout|.*parameter.*|.*/get_type_description')
"""Topics and services of every node."""


def test_the_docs_list_the_topics_and_services_of_the_nodes(graph, repository: Path):
    text = (repository / 'docs' / 'diagnostics.md').read_text()
    listed = set()
    for head in ('| topic |', '| service |'):
        rows = text[text.index(head) :].partition('\n\n')[0].splitlines()[2:]
        listed |= {name for row in rows for name in re.findall('`/?(.*?)`', row.split('|')[1])}
    used = set()
    for kind in ('accumulator', 'estimator', 'relay', 'monitor'):
        node = graph.run(kind, **({'relay.enabled': True} if kind == 'monitor' else {}))
        names = [end.topic_name for end in (*node.publishers, *node.subscriptions)]
        names += [service.srv_name for service in node.services]
        home = f'{node.get_fully_qualified_name()}/'
        own = {name.replace(home, '~/') for name in names if not COMMON.fullmatch(name)}
        used |= {name.strip('/') for name in own}
    assert listed == used


def test_the_launch_file_names_existing_executables_and_parameters(repository: Path):
    tree = ast.parse((repository / 'launch' / 'allan_ros.launch.py').read_text())
    words = {n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)}
    setup = (repository / 'setup.py').read_text()
    executables = {w for w in words if isinstance(w, str) and w.startswith('allan_')}
    executables = {w for w in executables if not {'/', '.'} & set(w)} - {'allan_ros'}
    relay = {'allan_imu_relay'}
    assert executables == {'allan_monitor', 'allan_accumulator', 'allan_estimator'} | relay
    assert all(f'{name} = ' in setup for name in executables)
    known = {f'{group}.{name}' for group, made in GROUPS.items() for name in describe(made)}
    dotted = {w for w in words if isinstance(w, str) and w.split('.')[0] in GROUPS and '.' in w}
    assert dotted and dotted <= known


def test_every_launch_argument_has_a_launch_test(repository: Path):
    def assigned(file: str, name: str) -> ast.expr:
        tree = ast.parse((repository / file).read_text())
        (value,) = [
            n.value
            for n in tree.body
            if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == name
        ]
        return value

    arguments = ast.literal_eval(assigned('launch/allan_ros.launch.py', 'ARGUMENTS'))
    cases = ast.literal_eval(assigned('test/launch/test_launch_arguments.py', 'CASES'))
    assert {name for given, _, _ in cases.values() for name in given} == {*arguments, 'config'}


def test_several_imus_in_separate_processes_are_rejected(repository: Path):
    pytest.importorskip('launch_ros')
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    import launch

    source = PythonLaunchDescriptionSource(str(repository / 'launch' / 'allan_ros.launch.py'))
    arguments = {'imu': '/left/imu,/right/imu', 'apart': 'true', 'config': ''}
    include = IncludeLaunchDescription(source, launch_arguments=arguments.items())
    service = launch.LaunchService()
    service.include_launch_description(launch.LaunchDescription([include]))
    assert service.run() == 1
