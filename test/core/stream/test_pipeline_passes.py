# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stream is split where the recording starts again, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.cleaning import BACKWARD_RUN, PassSplitter


def batch(stamps) -> ImuBatch:
    stamps = np.asarray(stamps, np.int64)
    return ImuBatch(stamps, np.repeat(stamps[:, None], 6, axis=1).astype(float), frame_id='imu')


def runs(stamps, chunk: int, latest: int | None = None) -> list[list[int]]:
    splitter, found = PassSplitter(latest), [[]]
    pieces = [batch(stamps[i : i + chunk]) for i in range(0, len(stamps), chunk)]
    parts = [part for piece in pieces for part in splitter.split(piece)]
    for new_run, part in [*parts, *splitter.flush()]:
        if new_run:
            found.append([])
        found[-1] += part.stamps_ns.tolist()
    return found


@pytest.mark.parametrize('chunk', [1, 7, 16, 17, 1000])
def test_a_loop_is_split_at_its_first_sample(chunk):
    once = list(range(100))
    assert runs(once * 3, chunk) == [once] * 3


@pytest.mark.parametrize('chunk', [1, 5, 1000])
def test_some_backward_stamps_are_left_in_their_run(chunk):
    back = list(range(50, 50 + BACKWARD_RUN - 1))
    stream = [*range(100), *back, *range(100, 200)]
    assert runs(stream, chunk) == [stream]


def test_data_that_were_there_before_count_as_the_run_before():
    again = list(range(100))
    assert runs(again, 30, latest=500) == [[], again]
    assert runs(again, 30, latest=-1) == [again]


@given(st.lists(st.integers(0, 40), max_size=120), st.integers(1, 50))
def test_no_sample_is_lost_and_chunks_do_not_matter(stamps, chunk):
    found = runs(stamps, chunk)
    assert [stamp for run in found for stamp in run] == stamps
    assert found == runs(stamps, max(len(stamps), 1))
