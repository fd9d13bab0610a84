# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""About two hundred damaged inputs, always the same; `make fuzz` tries many others."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from datetime import timedelta
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from allan_ros.core.errors import AllanError
from allan_ros.readers import open_recording
from fuzz import mcap_target
from fuzz.reading import MESSAGES, read_and_check

INPUTS = {'mcap': 20, 'folder': 30, 'tables': 40, 'imu': 3, 'losses': 60, 'hostile': 10}
"""Target -> number of inputs."""

TIMES = int(os.environ.get('ALLAN_ROS_FUZZ', '0'))
"""Multiple of these numbers of inputs that `make fuzz` draws, from a new seed each time."""


@pytest.mark.parametrize('name', INPUTS)
def test_damaged_inputs_are_rejected_in_a_line_or_valid(name: str) -> None:
    if name == 'losses':
        pytest.importorskip('rosbags')
    target, tally = import_module(f'fuzz.{name}_target'), Counter[bool]()

    @settings(
        max_examples=INPUTS[name] * max(1, TIMES),
        derandomize=not TIMES,
        deadline=timedelta(seconds=30) if TIMES else None,
        database=None,
        phases=(Phase.generate, Phase.shrink) if TIMES else (Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    @given(target.INPUTS)
    def each(value: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            tally[target.check(value, Path(folder))] += 1

    each()
    assert tally.total() > INPUTS[name] // 2
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


def messages_in(path: Path) -> int:
    """Return the number of messages that can be read; 0 if the file is rejected."""
    try:
        recording = open_recording(path)
        return sum(len(batch) for batch in recording.batches())
    except AllanError:
        return 0
