# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The path from a source to results: documents, folders and recordings."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.api.analysis import load, load_sums, results_of
from allan_ros.core.errors import AllanError
from allan_ros.readers.files import to_json
from allan_ros.readers.recording_sums import ReadJob, read_in_processes
from allan_ros.results.documents import fingerprint, results_to_document, sums_file_to_document
from allan_ros.results.results import Results


def written(results: Results, folder: Path) -> Path:
    assert results.recorded is not None
    sums = sums_file_to_document(results.recorded.sums, results.recorded.provenance)
    document = {**results_to_document(results), 'fingerprint': fingerprint(sums)}
    (folder / 'results.json').write_text(to_json(document))
    (folder / 'sums.json').write_text(to_json(sums))
    return folder


def test_a_folder_and_its_documents_give_the_same_results(
    small_results: Results, tmp_path: Path
) -> None:
    folder = written(small_results, tmp_path)
    for path in (folder, folder / 'results.json', folder / 'sums.json'):
        for found in (load(path), results_of(path)):
            assert found.axes['gyro_x'].fit.noise == small_results.axes['gyro_x'].fit.noise
    assert load(folder).recorded is not None
    assert load(folder / 'results.json').recorded is None


@pytest.mark.parametrize('name', ['results.json', 'sums.json'])
def test_another_document_is_rejected_by_its_name(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text('[]')
    for read in (load, load_sums, results_of):
        with pytest.raises(AllanError, match=name.replace('.', r'\.')):
            read(tmp_path / name)


def test_two_spellings_of_a_path_are_one_input(small_results: Results, tmp_path: Path) -> None:
    folder = written(small_results, tmp_path)
    for other in (f'{folder}/', folder / '..' / folder.name):
        with pytest.raises(AllanError, match='given twice'):
            ar.compare(folder, other)


def test_a_folder_without_documents_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(AllanError, match=r'no results\.json in this folder'):
        load(tmp_path)
    with pytest.raises(AllanError, match=r'no sums\.json in this folder'):
        load_sums(tmp_path)


def test_paths_are_read_alone_together_and_in_processes(tmp_path: Path) -> None:
    paths = []
    for seed in (1, 2):
        batch = ar.simulate(hours=0.02, rate=50, seed=seed)
        paths.append(tmp_path / f'{seed}.npz')
        np.savez(paths[-1], imu=np.column_stack([batch.stamps_ns * 1e-9, batch.samples]))
    one = ar.analyze(paths[0])
    both = ar.analyze(paths)
    assert (one.samples, both.samples) == (3600, 7200)
    assert repr(ar.analyze(paths, processes=2)) == repr(both)
    assert [*ar.compare(one, paths[0]).runs.values()][1].samples == one.samples


def test_a_worker_that_dies_is_reported() -> None:
    jobs = [ReadJob(_Deadly(f'{i}')) for i in range(2)]  # type: ignore[arg-type]
    with pytest.raises(AllanError, match=r'one of 2 processes died, .*memory ran out'):
        list(read_in_processes(jobs, 2))


class _Deadly(str):
    """A path that ends the process to which it is sent."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (1,)


def test_a_recording_without_static_data_is_explained_by_its_most_severe_finding(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(1)
    t = np.delete(np.arange(6000), np.arange(2000, 5000, 200)) * 0.01
    moving = 0.5 * np.sin(0.3 * 2.0 * np.pi * t)[:, None] + 1e-3 * rng.normal(size=(len(t), 3))
    accel = [0.0, 0.0, 9.8] + 1e-2 * rng.normal(size=(len(t), 3))
    rows, header = np.column_stack([t, moving, accel]), 't,gx,gy,gz,ax,ay,az'
    np.savetxt(tmp_path / 'imu.csv', rows, delimiter=',', header=header, comments='')
    with pytest.raises(AllanError, match='The IMU was never at rest') as error:
        ar.analyze(tmp_path / 'imu.csv')
    assert 'interpolated' not in str(error.value)
