# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one analysis, all in one folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..core.batch import SENSORS
from ..core.errors import AllanError
from ..core.findings import finding
from ..core.sums import AllanSums
from .atomic import write_atomic
from .documents import results_to_document, sums_file_to_document, to_json
from .envelope import SignalEnvelope
from .exporters import export, target_of
from .report import Beside, render_report
from .results import Results


def write_result_files(
    folder: str | os.PathLike[str],
    results: Results,
    sums: Sequence[AllanSums],
    signals: Sequence[SignalEnvelope] = (),
    units: str = 'datasheet',
    targets: Sequence[str] = (),
) -> tuple[Results, list[Path]]:
    """Write results.json, sums.json, imu.yaml, the pictures and the report.

    Parameters
    ----------
    targets : sequence of str
        Names of `exporters.TARGETS` to write files for, besides Kalibr.

    Returns
    -------
    results : Results
        As written: with a finding where a file cannot be made of them (imu.yaml without an
        accelerometer, say).
    paths : list of Path
        What was written.

    Raises
    ------
    AllanError
        When the folder cannot be made or written.
    """
    # Heavy to import (0.3 s), and merging sums on a robot needs no pictures until here.
    from .plots import sensor_figure, to_png, to_svg

    folder = made_folder(Path(folder))
    paths = []
    for target in dict.fromkeys(('kalibr', *targets)):
        try:
            paths.append(export(results, target, folder))
        except AllanError as error:
            left_out = finding('file_left_out', file=target_of(target).file_name, why=str(error))
            results = replace(results, findings=(*results.findings, left_out))
    pictures = {}
    contents: dict[str, str | bytes] = {}
    for sensor in SENSORS:
        figure = sensor_figure(results, sensor, signals, units)
        if figure is not None:
            contents[f'allan_{sensor}.png'] = to_png(figure)
            pictures[sensor] = to_svg(figure)
    contents['report.html'] = render_report(results, Beside(pictures, signals), units)
    contents['results.json'] = to_json(results_to_document(results))
    contents['sums.json'] = to_json(sums_file_to_document(sums, results.provenance))
    for name, content in contents.items():
        write_atomic(folder / name, content)
        paths.append(folder / name)
    return results, paths


def made_folder(folder: Path) -> Path:
    """Return the folder, made where it was missing.

    Raises
    ------
    AllanError
        When it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AllanError(
            f'{folder}: cannot be made a folder ({error.strerror}): give another one with -o'
        ) from error
    return folder
