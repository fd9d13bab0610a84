# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the files of an analysis to a folder."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import AllanError, one_line
from ..core.fields import Fields
from ..core.findings import finding
from ..core.imu import SENSORS
from ..core.settings import check_choice
from ..core.stream.signal import summarize_signal
from ..export import TARGETS, check_own_output, make_export, target_of
from ..readers.files import PathLock, read_json, to_json, write_together
from ..results.documents import (
    RESULTS,
    SUMS,
    fingerprint,
    sums_file_to_document,
)
from .finding_text import finding_line
from .report import render_report
from .result_document import result_document

if TYPE_CHECKING:
    from ..results.results import Results

SIGNAL_BINS = 1000
"""Number of time intervals in the plot of the raw signal, about the width of the plot in pixels."""

FIGURE_FORMATS = ('png', 'svg', 'pdf')
"""File formats of figures."""

REPORT = 'report.html'

LOCK_WAIT_S = 60.0
"""Longest time in s to wait while another process writes to the same folder."""


def write_result_files(
    folder: str | os.PathLike[str],
    results: Results,
    *,
    command: str = '',
    units: str = 'deg/h',
    targets: Sequence[str] = (),
    plots: Sequence[str] = (),
    overwrite: bool = False,
) -> tuple[Results, list[Path]]:
    """Write the files of an analysis, as in `Results.save`; return the results and the paths.

    The returned results have a finding for each export target whose file cannot be computed.
    ``command`` is the command that repeats the analysis, which the report shows.

    Raises AllanError if the results have no Allan sums, an export target is unknown, figures are
    requested but matplotlib is missing, a file cannot be written, or another process writes to the
    folder for longer than `LOCK_WAIT_S`. Unless ``overwrite`` is set, also raises AllanError if the
    folder has results of another recording, or a configuration file that would be replaced and was
    not written by this package.
    """
    recorded = results.recorded
    if recorded is None:
        raise AllanError('these results were read from a file without their sums: analyze again')
    folder = Path(folder)
    _files_in(folder, results, overwrite)  # checks the folder before the report is made
    target_files, results = _filter_files(results, targets)
    for name in () if overwrite else target_files:
        check_own_output(folder / name)
    provenance = results.provenance
    summary = summarize_signal(
        recorded.signals, provenance.segments, SIGNAL_BINS, recorded.events, recorded.temperatures
    )
    sums_document = sums_file_to_document(recorded.sums, results.provenance)
    digest = fingerprint(sums_document)
    figures: dict[str, bytes] = {}
    if plots:
        from .plots import figure_files  # this module imports matplotlib

        figures = figure_files(results, plots, units)
    method = {'command': command} if command else {}
    method['fingerprint of the sums'] = f'{digest} (equal for equal samples)'
    file_names = [*target_files, *figures, RESULTS, SUMS]
    report = render_report(results, units, summary, method, file_names)
    contents: dict[str, str | bytes] = {**figures, REPORT: report, **target_files}
    files = sorted({*contents, RESULTS, SUMS})
    document = {
        **result_document(results, units),
        'files': files,
        'fingerprint': digest,
    }
    with _folder_locked(made_folder(folder)):
        # All files except results.json and sums.json are removed first and written last, so that
        # no file of an earlier analysis remains. The fingerprint in results.json shows whether
        # sums.json belongs to the same analysis.
        former_files = _files_in(folder, results, overwrite)
        sums_and_results = {SUMS: to_json(sums_document), RESULTS: to_json(document)}
        write_together(folder, {**sums_and_results, **contents}, former_files.union(contents))
    return results, [folder / name for name in (*contents, *sums_and_results)]


@contextmanager
def _folder_locked(folder: Path) -> Iterator[None]:
    """Lock a folder; raise AllanError if another process locks it for longer than `LOCK_WAIT_S`."""
    lock, deadline = PathLock(folder / RESULTS), time.monotonic() + LOCK_WAIT_S
    while owner := lock.acquire():
        if time.monotonic() > deadline:
            raise AllanError(
                f'{folder}: {owner} is writing to this folder: wait, or give another folder with -o'
            )
        time.sleep(0.1)
    try:
        yield
    finally:
        lock.release()


def _files_in(folder: Path, results: Results, overwrite: bool) -> set[str]:
    """Return the names of the files that an earlier analysis wrote to a folder.

    The names are listed in results.json, and do not include results.json and sums.json. Files that
    this program never writes are ignored. The result is empty if no valid results.json exists.

    Raises AllanError if the folder has results of another recording, unless ``overwrite`` is set.
    Recordings are the same if their file names and topics are equal.
    """
    try:
        document = read_json(folder / RESULTS)
        fields = Fields(document, str(folder / RESULTS))
        listed_names = fields.sequence('files')
        former_sources = [(each.text('path'), each.text('topic')) for each in fields.each('source')]
    except AllanError:
        return set()
    sources = [(source.path, source.topic) for source in results.provenance.sources]
    if _names(former_sources) != _names(sources) and not overwrite:
        raise AllanError(
            f'{folder}: has the results of another recording, '
            f'{", ".join(_names(former_sources))}: give another folder, or --overwrite '
            '(in Python overwrite=True)'
        )
    possible_names = {f'allan_{sensor}.{form}' for sensor in SENSORS for form in FIGURE_FORMATS}
    possible_names |= {REPORT, *(target_of(name).file_name for name in TARGETS)}
    return possible_names.intersection(name for name in listed_names if isinstance(name, str))


def _names(sources: Sequence[tuple[str, str]]) -> list[str]:
    """Return the file name and the topic of each source (path, topic), as sorted texts."""
    return sorted(one_line(f'{Path(path).name} {topic}'.strip()) for path, topic in sources)


def _filter_files(results: Results, targets: Sequence[str]) -> tuple[dict[str, str], Results]:
    files = {}
    for name in dict.fromkeys(('kalibr', *targets)):
        target = target_of(name)
        try:
            files[target.file_name] = make_export(results, name, words=finding_line).text
        except AllanError as error:
            # the results contain the findings of the error, too, so they are not repeated here
            reason = str(error).rstrip(':')
            failure = finding('file_left_out', file=target.file_name, why=reason)
            results = replace(results, findings=(*results.findings, failure))
    return files, results


def check_plots(formats: Sequence[str]) -> None:
    """Raise AllanError for an unknown format of figures, or if matplotlib is needed but missing."""
    for form in formats:
        check_choice(FIGURE_FORMATS, plots=form)
    if formats:
        import_module('.plots', __package__)


def made_folder(folder: Path) -> Path:
    """Create the folder if it is missing, and return it; raise AllanError if this fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AllanError(
            f'{folder}: cannot be created as a folder ({error.strerror}): give another one with -o'
        ) from error
    return folder
