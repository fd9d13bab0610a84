# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged results.json, sums.json and checkpoints, used as in the command line and the nodes."""

from __future__ import annotations

import io
import json
import logging
from contextlib import redirect_stderr, redirect_stdout
from functools import lru_cache
from pathlib import Path
from typing import Any

import matplotlib.font_manager  # noqa: F401  (builds its cache on first use)
from hypothesis import strategies as st

from allan_ros.cli.main import main
from allan_ros.core.allan.parts import recent_noise
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.io.checkpoint import Checkpoint
from allan_ros.io.documents import (
    results_from_document,
    results_to_document,
    sums_file_from_document,
    sums_file_to_document,
)
from allan_ros.io.exporters import TARGETS, ExportOptions, make_export
from allan_ros.io.files import parse_json, read_json, to_json
from allan_ros.io.readers.recording import SourceInfo
from allan_ros.io.recorded import Provenance
from allan_ros.io.results import analyze_sums

from .damage import any_bytes, as_utf8, damaged_json
from .harness import BrokenRule, Target, check_document, check_line, refused_or_valid
from .reading import small_batch

SAMPLES = 3000
FITTED = 8
"""One of this number of inputs is also fitted, which takes a hundred times as long as reading."""


@lru_cache(maxsize=1)
def seeds() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a valid sums file and a valid results file."""
    accumulator = ImuStream()
    batch = small_batch(SAMPLES)
    for start in (0, SAMPLES // 3):
        moved = batch.stamps_ns[start:] + start * 10**9
        accumulator.update(ImuBatch(moved, batch.samples[start:], None, 'imu'))
    accumulator.end()
    known = accumulator.result()
    source = SourceInfo('a.mcap', '/imu', 'sensor_msgs/msg/Imu', 'mcap')
    provenance = Provenance(
        (source,), known.segments, known.findings, known.health.counts, {'skip': 0.0, 'topic': ''}
    )
    results = analyze_sums(known.sums, provenance)
    return sums_file_to_document(known.sums, provenance), results_to_document(results)


@st.composite
def _texts(draw: Any) -> tuple[str, bytes, int]:
    """Draw the kind of file, its bytes, and a number that selects its use."""
    sums, results = seeds()
    kind = draw(st.sampled_from(['sums', 'results', 'checkpoint']))
    seed = results if kind == 'results' else sums
    if not draw(st.integers(0, 5)):
        data = draw(any_bytes([as_utf8(json.dumps(seed))]))
    else:
        data = as_utf8(draw(damaged_json([seed])))
    return kind, data, draw(st.integers(0, 99))  # few values: all are drawn equally often


def check(made: tuple[str, bytes, int], folder: Path) -> bool:
    """Read the file as the given kind, and use it."""
    kind, data, choice = made
    path = folder / f'{kind}.json'
    path.write_bytes(data)
    if kind == 'checkpoint':
        return _restart(path, data)
    with refused_or_valid() as outcome:
        document = read_json(path)
        if kind == 'results':
            _use_results(document, choice)
        else:
            _use_sums(document, choice)
    if kind == 'sums' and not choice % FITTED:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as output:
            code = main(['analyze', str(path)])
        if code not in (0, 1) or 'Traceback' in output.getvalue():
            raise BrokenRule(f'exit {code}: {output.getvalue()}')
    if list(folder.iterdir()) != [path]:
        raise BrokenRule('reading left a file behind')
    return outcome.valid


def _use_results(document: object, choice: int) -> None:
    results = results_from_document(document, 'results')
    text = to_json(results_to_document(results))
    check_document(text)
    results_from_document(parse_json(text, 'again'))
    for found in results.findings:
        check_line(str(found))
    name = sorted(TARGETS)[choice % len(TARGETS)]
    made = make_export(results, name, ExportOptions())
    made.text.encode()


def _use_sums(document: object, choice: int) -> None:
    sums, provenance = sums_file_from_document(document, 'sums')
    text = to_json(sums_file_to_document(sums, provenance))
    check_document(text)
    sums_file_from_document(parse_json(text, 'again'))
    for one in sums[:4]:
        recent_noise(one, 100.0)
        recent_noise(one + one, 100.0)
    if choice % FITTED:
        return
    results = analyze_sums(sums, provenance)
    check_document(to_json(results_to_document(results, curves=bool(choice % 2))))


def _restart(path: Path, data: bytes) -> bool:
    """Start with a checkpoint as a node does, which may rename the file but not delete it."""
    checkpoint = Checkpoint(path, LOG)
    if checkpoint.loaded is not None:
        check_line(str(checkpoint.loaded))
    kept = [p for p in path.parent.iterdir() if p.read_bytes() == data]
    if not kept:
        raise BrokenRule('the checkpoint is gone')
    checkpoint.close()
    if checkpoint.earlier[0]:
        text = to_json(sums_file_to_document(*checkpoint.earlier))
        sums_file_from_document(parse_json(text, 'again'))
    return checkpoint.loaded is None


LOG = logging.getLogger('fuzz')

TARGET = Target('documents', _texts(), check)
