# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What every format of recordings must fulfill.

The test module of each reader has a function ``example(path, batch)``, which writes samples in its
format. Its stamps are multiples of 1 us, and its values are exact in 32 bits.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from support.recordings import outcome, read, refused

from allan_ros import readers as formats
from allan_ros.cli.analyze import recordings_in
from allan_ros.core.imu import ImuBatch
from allan_ros.readers import FORMATS, SUFFIXES, open_recording
from allan_ros.readers.recording import BATCH

RNG = np.random.default_rng(6)
BATCH_6 = ImuBatch(
    1_700_000_000_000_000_000 + 5_000_000 * np.arange(500),
    RNG.normal(size=(500, 6)).astype(np.float32).astype(float),
    frame_id='imu',
)

Written = tuple[str, Path]
"""Name of a format, and a file with the samples `BATCH_6` in it."""


@pytest.fixture(params=FORMATS)
def written(request: pytest.FixtureRequest, tmp_path: Path) -> Written:
    form = FORMATS[request.param]
    example: Callable[[Path, ImuBatch], None]
    example = import_module(f'readers.test_{form.module}').example
    path = tmp_path / f'imu{form.suffixes[0]}'
    example(path, BATCH_6)
    return request.param, path


def test_the_samples_are_read_again(written: Written) -> None:
    _, path = written
    back = read(path)
    np.testing.assert_allclose(back.samples, BATCH_6.samples, rtol=1e-9)
    steps = back.stamps_ns - back.stamps_ns[0]
    np.testing.assert_allclose(steps, BATCH_6.stamps_ns - BATCH_6.stamps_ns[0], atol=1000)
    assert back.recording.messages in (None, len(BATCH_6))
    assert not back.findings


def test_a_recording_is_read_as_often_as_wanted(written: Written) -> None:
    _, path = written
    recording = open_recording(path)
    first, second = ([*recording.batches()] for _ in range(2))
    assert max(map(len, first)) <= BATCH
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.samples, other.samples)
        np.testing.assert_array_equal(one.stamps_ns, other.stamps_ns)


def test_the_units_of_the_options_apply(written: Written) -> None:
    _, path = written
    back = read(path, gyro_unit='deg/s', accel_unit='g')
    factors = np.repeat([np.pi / 180.0, 9.80665], 3)
    np.testing.assert_allclose(back.samples, BATCH_6.samples * factors, rtol=1e-6)


def test_the_first_bytes_tell_the_format(written: Written) -> None:
    name, path = written
    form = FORMATS[name]
    if form.magics:
        assert path.read_bytes().startswith(form.magics)
        path = path.rename(path.with_suffix('.recording'))
    assert len(read(path).stamps_ns) == len(BATCH_6)


def test_a_file_in_a_folder_of_recordings_is_found(written: Written) -> None:
    _, path = written
    other = path.with_name(f'another{path.suffix}')
    other.write_bytes(path.read_bytes())
    assert recordings_in(str(path.parent)) == sorted([str(other), str(path)])


@pytest.mark.parametrize('share', [0.0, 0.02, 0.5, 0.97])
def test_of_a_truncated_file_no_wrong_sample_is_read(written: Written, share: float) -> None:
    """Either one line says what is wrong, or the samples that remain are read."""
    _, path = written
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    if not share:
        assert 'is empty' in refused(path)
        return
    _, error = outcome(path)
    assert '\n' not in error
    if not error:
        known = {row.tobytes() for row in np.round(BATCH_6.samples, 6)}
        assert all(row.tobytes() in known for row in np.round(read(path).samples[:-1], 6))


def test_every_function_that_opens_a_recording_has_a_format() -> None:
    folder = Path(formats.__file__).parent
    opener = re.compile(r'^def (open_\w+)\(path: Path, options: ReadOptions\) -> Recording:', re.M)
    found = {
        (path.stem, name)
        for path in folder.glob('*.py')
        for name in opener.findall(path.read_text(encoding='utf-8'))
    }
    assert found == {(form.module, form.opener) for form in FORMATS.values()}


def test_no_suffix_belongs_to_two_formats() -> None:
    every = [s for form in FORMATS.values() for s in (*form.suffixes, *form.other_suffixes)]
    assert len({*every}) == len(every)


def test_the_manual_lists_every_suffix(repository: Path) -> None:
    manual = (repository / 'docs' / 'files.md').read_text(encoding='utf-8')
    table = manual.partition('## Recordings')[2].partition('\nSamples are')[0]
    assert [suffix for suffix in SUFFIXES if f'{suffix}`' not in table] == []
