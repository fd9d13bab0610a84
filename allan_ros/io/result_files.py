# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of one analysis, all in one folder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..core.allan.spectrum import spectrum_of
from ..core.errors import AllanError
from ..core.findings import finding
from ..core.imu import SENSORS
from .documents import results_to_document, sums_file_to_document
from .exporters import export, target_of
from .files import write_atomic
from .plot_style import PictureSettings, load_style
from .report import ReportContext, render_report
from .results import Results
from .signal_summary import summarize_signal
from .text import to_json

OUTLINE_BINS = 1000
"""Spans of the raw signal in pictures and page: as many as a plot has pixels across."""

FINGERPRINT_DIGITS = 16
"""Of the hash that tells one evidence from another: 64 bits."""


def write_result_files(
    folder: str | os.PathLike[str],
    results: Results,
    *,
    former: Mapping[str, Results] | None = None,
    margin: float = 0.0,
    command: str = '',
    units: str = 'datasheet',
    targets: Sequence[str] = (),
    pictures: PictureSettings = PictureSettings(),
) -> tuple[Results, list[Path]]:
    """Write results.json, sums.json, imu.yaml, the pictures and the report.

    Parameters
    ----------
    folder : path
    results : Results
        With the sums they were fitted to.
    former : mapping of name to Results
        Earlier runs that the report compares these results with.
    margin : float
        Fraction by which an interval must exceed an earlier run.
    command : str
        The command that repeats the analysis.
    units : 'datasheet' or 'si'
    targets : sequence of str
        Names of `exporters.TARGETS` to write files for, in addition to Kalibr.
    pictures : PictureSettings

    Returns
    -------
    results : Results
        As written: with a finding where a file cannot be made from them (imu.yaml without an
        accelerometer, for example).
    paths : list of Path
        The files that were written.

    Raises
    ------
    AllanError
        When the results have no sums, the folder cannot be made or written, or the style of the
        pictures is unknown.
    """
    # Heavy to import (0.3 s), and merging sums on a robot needs no pictures until here.
    from .plots import sensor_figure, to_form

    recorded = results.recorded
    if recorded is None:
        raise AllanError('these results were read from a file without their sums: analyze again')
    style = load_style(pictures.plot_style)
    folder = made_folder(Path(folder))
    paths = []
    for target in dict.fromkeys(('kalibr', *targets)):
        try:
            paths.append(export(results, target, folder))
        except AllanError as error:
            left_out = finding('file_left_out', file=target_of(target).file_name, why=str(error))
            results = replace(results, findings=(*results.findings, left_out))
    known = results.provenance
    outline = summarize_signal(
        recorded.signals, known.spans, OUTLINE_BINS, known.counts.cuts, recorded.temperatures
    )
    contents: dict[str, str | bytes] = {}
    for sensor in SENSORS:
        figure = sensor_figure(results, sensor, outline, units, style)
        if figure is None:
            continue
        for form in pictures.plot_format:
            contents[f'allan_{sensor}.{form}'] = to_form(figure, form, style)
    sums_document = sums_file_to_document(recorded.sums, results.provenance)
    densities = (
        spectrum_of(of, s.tau0)
        for of, s in zip(recorded.spectra, recorded.sums)
        if s.tau0 is not None
    )
    others = [*(path.name for path in paths), *contents, 'results.json', 'sums.json']
    context = ReportContext(
        outline,
        [density for density in densities if density is not None],
        former or {},
        margin,
        _repeat(command, to_json({'sums': sums_document['sums']})),
        others,
    )
    contents['report.html'] = render_report(results, context, units)
    contents['results.json'] = to_json(results_to_document(results))
    contents['sums.json'] = to_json(sums_document)
    for name, content in contents.items():
        write_atomic(folder / name, content)
        paths.append(folder / name)
    return results, paths


def _repeat(command: str, sums: str) -> dict[str, str]:
    """Return what one needs to do an analysis again, and to know that it was of the same data."""
    digest = hashlib.sha256(sums.encode()).hexdigest()[:FINGERPRINT_DIGITS]
    said = {'fingerprint of the sums': f'{digest} (equal for equal samples)'}
    return {'command': command, **said} if command else said


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
