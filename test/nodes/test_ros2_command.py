# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`ros2 allan`: every verb is dispatched, also without ros2cli; verbs for running nodes work."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('rclpy')


from support.node_server import PATIENCE_S

from allan_ros.cli.main import VERBS
from allan_ros.ros2_command import NODE_VERBS, AllanCommand

RUN = """
import argparse, sys
from allan_ros.ros2_command import AllanCommand
command, parser = AllanCommand(), argparse.ArgumentParser()
command.add_arguments(parser, 'ros2 allan')
sys.exit(command.main(parser=parser, args=parser.parse_args()))
"""


def ros2_allan(*words: str) -> subprocess.CompletedProcess[str]:
    """Run the command as ros2cli does, in a process of its own."""
    environment = {**os.environ, 'PYTHONPATH': str(Path(__file__).resolve().parents[2])}
    return subprocess.run(
        [sys.executable, '-c', RUN, *words], capture_output=True, text=True, env=environment
    )


def test_it_has_the_verbs_of_allan_and_those_for_nodes() -> None:
    parser = argparse.ArgumentParser()
    AllanCommand().add_arguments(parser, 'ros2 allan')
    for verb in (*VERBS, *NODE_VERBS):
        options = parser.parse_args([verb, 'input', '--help', '-o', 'out'])
        assert (options.verb, options.arguments) == (verb, ['input', '--help', '-o', 'out'])
        assert f'  {verb} ' in parser.format_help()


def test_a_verb_of_allan_runs_with_its_options_and_exit_code() -> None:
    assert 'adis16475-3' in ros2_allan('sensors').stdout
    for verb in ('analyze', 'check'):  # check is also a verb for nodes
        failed = ros2_allan(verb, 'missing.csv')
        assert failed.returncode == 1 and failed.stderr.startswith(f'allan {verb}: ')
    assert ros2_allan('check', '--help').stdout.startswith('usage: allan check')


def test_the_state_of_running_nodes_is_checked(graph: Any) -> None:
    graph.start('monitor', **{'input.stale_after': 2.0})
    graph.publisher()
    told = 'No message on /imu/data'
    graph.until(lambda: (s := graph.status('input')) and told in s.message)
    checked = ros2_allan('check', '--plain', '--seconds', str(PATIENCE_S))
    assert checked.returncode == 4, checked.stdout + checked.stderr
    assert told in checked.stdout
