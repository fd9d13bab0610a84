# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings whose number of messages is known: a lost message must be reported."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from allan_ros.readers import open_recording
from allan_ros.readers.writing import write_table

from .damage import damaged
from .reading import BrokenRule, refused_or_valid, small_batch, write_bag

SAMPLES = 600
FORMS = {
    'run.mcap': ('mcap', 'none'),
    'zstd.mcap': ('mcap', 'storage'),
    'run.db3': ('sqlite3', 'none'),
    'run.csv': ('csv', 'none'),
}
"""File -> storage and compression; rosbag2 files have a metadata.yaml next to them."""

REPORTS = {'count_differs', 'bag_cut', 'table_cut'}


@lru_cache(maxsize=1)
def seeds() -> dict[str, dict[str, bytes]]:
    """Return storage format -> file name -> content."""
    found = {}
    for name, (storage, compression) in FORMS.items():
        with tempfile.TemporaryDirectory() as folder:
            path, batches = Path(folder, name), [small_batch(SAMPLES)]
            if storage == 'csv':
                write_table(path, batches)
            else:
                write_bag(path, batches, storage, compression)
            files = path.iterdir() if path.is_dir() else [path]
            found[name] = {file.name: file.read_bytes() for file in files}
    return found


@st.composite
def _damaged(draw: Any) -> tuple[str, bytes]:
    form = draw(st.sampled_from(list(FORMS)))
    data = max(seeds()[form].values(), key=len)
    return form, draw(damaged([data], most=draw(st.sampled_from([1, 1, 1, 3]))))


def check(made: tuple[str, bytes], folder: Path) -> bool:
    """Read the recording; raise when messages are missing and nothing is reported."""
    form, data = made
    files = seeds()[form]
    storage = max(files, key=lambda name: len(files[name]))
    for name, content in files.items():
        (folder / name).write_bytes(data if name == storage else content)
    read = 0
    with refused_or_valid() as outcome:
        recording = open_recording(folder if len(files) > 1 else folder / storage)
        for batch in recording.batches():
            read += len(batch)
        reports = {finding.id for finding in recording.findings}
        ends_with_line = form.endswith('.csv') and data.endswith(b'\n')  # a valid, shorter table
        if read != SAMPLES and not reports & REPORTS and not ends_with_line:
            raise BrokenRule(f'silent loss: {read} of {SAMPLES} messages, findings {reports}')
    return outcome.valid


INPUTS = _damaged()
