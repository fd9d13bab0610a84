# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""About two hundred damaged inputs, always the same; `make fuzz` tries many others."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from allan_ros.core.errors import AllanError
from allan_ros.io.readers import open_recordings
from fuzz import mcap_target
from fuzz.harness import TARGETS
from fuzz.reading import MESSAGES, read_and_check

INPUTS = {'mcap': 20, 'folder': 30, 'tables': 40, 'imu': 3, 'losses': 60, 'hostile': 10}
"""Target -> number of inputs."""


@pytest.mark.parametrize('name', INPUTS)
def test_damaged_inputs_are_rejected_in_a_line_or_valid(name: str) -> None:
    if name == 'losses':
        pytest.importorskip('rosbags')
    target, tally = TARGETS[name](), {True: 0, False: 0}

    @seed(1)
    @settings(
        max_examples=INPUTS[name],
        database=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    @given(target.inputs)
    def each(value: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            tally[target.check(value, Path(folder))] += 1

    each()
    assert sum(tally.values()) > INPUTS[name] // 2
    assert tally[False] > 0 or INPUTS[name] < 10, 'every input was accepted'


def test_a_bag_truncated_at_any_record_is_read_or_rejected_in_one_line(tmp_path: Path) -> None:
    data = mcap_target.seeds()[0]
    places = sorted(set(mcap_target.boundaries(data)))
    assert len(places) > MESSAGES  # at least one per message
    path = tmp_path / 'bag.mcap'
    held = []
    for place in places:
        path.write_bytes(data[:place])
        read_and_check(path)
        held.append(messages_in(path))
    assert held == sorted(held) and held[-1] == MESSAGES
    path.write_bytes(data[: places[-2]])
    assert messages_in(path) > 0


HANG = """
import time
from hypothesis import strategies
from fuzz import harness
harness.HANG_SECONDS = 0.5
target = harness.Target('hang', strategies.just('this input'), lambda *_: time.sleep(60))
harness.run_target(target, 1.0, 7, None)
"""


def test_an_input_that_hangs_is_reported_with_its_seed(tmp_path: Path) -> None:
    current = tmp_path / 'current'
    environment = {**os.environ, 'ALLAN_FUZZ_CURRENT': str(current), 'TMPDIR': str(tmp_path)}
    done = subprocess.run([sys.executable, '-c', HANG], env=environment, capture_output=True)
    assert done.returncode == 1
    assert b'Timeout' in done.stderr and b'in <lambda>' in done.stderr
    assert current.read_text() == "seed 7, input 'this input'"


WRITES = """
from pathlib import Path
from hypothesis import strategies
from fuzz import harness
target = harness.Target('writes', strategies.just(0), lambda _, folder: open('outside', 'w'))
print(harness.run_target(target, 0.1, 7, harness.Watch()).crashes)
"""


def test_writing_outside_the_own_folder_breaks_the_rule(tmp_path: Path) -> None:
    environment = {**os.environ, 'PYTHONPATH': os.getcwd()}
    command = [sys.executable, '-c', WRITES]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert "open 'outside' to write" in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []


def messages_in(path: Path) -> int:
    """Return the number of messages that can be read; 0 if the file is rejected."""
    try:
        (recording,) = open_recordings([path])
        return sum(len(batch) for batch in recording.batches())
    except AllanError:
        return 0
