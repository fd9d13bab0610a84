# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Analyze one unit (IMU) or several units: their results, or the reason why there are none.

Recordings are read in this process, in several processes, or on a Dask cluster.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..api.analysis import ResultSettings, is_document
from ..api.classes import compared
from ..core.errors import AllanError, one_line
from ..core.findings import SEVERITIES, Finding
from ..readers import topics_of
from ..readers.recording_sums import ReadJob, RecordingSums, add_recordings, read_recording
from ..readers.serials import SerialRule
from ..results.analysis import analyze_recorded
from ..results.documents import load, load_sums
from ..results.results import Results
from ..results.unit_check import Decision
from ..view.finding_text import explained, finding_line
from .cluster import on_cluster
from .console import EXIT_ERROR, EXIT_FAULT, Console, fault_text
from .options import settings_of

EXIT_FAILED, EXIT_UNJUDGED = int(Decision.EXCEEDS), int(Decision.NOT_JUDGED)


@dataclass(frozen=True)
class BatchItem:
    """One unit (IMU) of a batch: its name in the summary, and the jobs that read its recordings.

    ``short`` is another unique name, after which the folder of the unit is named; '' if the folder
    is named after ``name``.
    """

    name: str
    jobs: Sequence[ReadJob]
    short: str = ''

    @property
    def folder(self) -> str:
        """Name of the folder for the files of the unit."""
        return folder_name(self.short or self.name)

    @property
    def path(self) -> str:
        """The path of the first recording."""
        return self.jobs[0].path


@dataclass(frozen=True)
class Outcome:
    """The results of one unit, or the reason why there are no results."""

    unit: BatchItem
    results: Results | None = None
    error: str = ''
    code: int = EXIT_ERROR  # exit code if there are no results


def outcomes_of(units: Sequence[BatchItem], args: argparse.Namespace) -> Iterator[Outcome]:
    """Yield the outcome of each unit, in the order of the units.

    The units are analyzed in this process, in several processes, or on a cluster. If one of several
    processes dies, the outcomes that are still missing state this as an error. Raises AllanError if
    the cluster cannot be used.
    """
    if getattr(args, 'scheduler', None):
        recorded_units = on_cluster(
            [unit.jobs[0] for unit in units], args.scheduler, Console.of(args)
        )
        for unit, recorded in zip(units, recorded_units):
            yield outcome_of(unit, args, recorded)
        return
    if min(args.jobs, len(units)) == 1:
        yield from map(outcome_of, units, [args] * len(units))
        return
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    pool = ProcessPoolExecutor(min(args.jobs, len(units)), mp_context=get_context('spawn'))
    try:
        futures = [pool.submit(outcome_of, unit, args) for unit in units]
        for unit, future in zip(units, futures):
            try:
                yield future.result()
            except BrokenProcessPool:
                reason = 'a process died, probably because memory ran out: reduce --jobs'
                yield Outcome(unit, error=f'{unit.path}: {reason}')
    finally:
        pool.shutdown(cancel_futures=True)


def outcome_of(
    unit: BatchItem,
    args: argparse.Namespace,
    recorded: RecordingSums | Finding | Exception | None = None,
) -> Outcome:
    """Read and fit one unit, write its files if a folder is given, and return the outcome.

    An error during the analysis is returned in the outcome, and not raised.

    Parameters
    ----------
    unit : BatchItem
        The unit.
    args : Namespace
        Arguments of the command line.
    recorded : RecordingSums, Finding or Exception, optional
        The Allan sums of the unit, or the reason why there are none. If None, the recordings of the
        unit are read.
    """
    output = getattr(args, 'output', None)
    settings = settings_of(ResultSettings, args)
    try:
        serial = SerialRule(args.serial_from).serial_of(unit.path) if args.serial_from else ''
        if is_document(unit.path) and not output:
            results = load(unit.path, settings.method)
            references = settings.sensor, settings.baseline, settings.stated_margin
            return Outcome(unit, compared(results, *references))
        if recorded is None:
            recorded = add_recordings(
                load_sums(job.path) if is_document(job.path) else read_recording(job)
                for job in unit.jobs
            )
        elif isinstance(recorded, Exception):
            raise recorded
        elif isinstance(recorded, Finding):
            raise AllanError(finding_line(recorded))
        if serial:
            recorded = recorded.with_serial(serial)
        folder = Path(output) / unit.folder if output else None
        return Outcome(unit, fit_and_write(recorded, args, folder)[0])
    except AllanError as error:
        return Outcome(unit, error=str(explained(error)))
    except OSError as error:
        return Outcome(unit, error=one_line(f'{unit.path}: {error}: check the path and the disk'))
    except MemoryError:
        return Outcome(unit, error=f'{unit.path}: not enough memory: use fewer --jobs')
    except Exception as error:  # a bug that one unit causes must not end the batch
        return Outcome(unit, error=one_line(f'{unit.path}: {fault_text(error)}'), code=EXIT_FAULT)


def fit_and_write(
    recorded: RecordingSums, args: argparse.Namespace, folder: str | Path | None
) -> tuple[Results, list[str]]:
    """Fit Allan sums, and write the files of the results.

    Parameters
    ----------
    recorded : RecordingSums
        The Allan sums.
    args : Namespace
        Arguments of the command line.
    folder : path or None
        Folder for the files; None or '' to write no files.

    Returns
    -------
    Results
        The results.
    list of str
        Sorted names of the files; empty if no files are written.

    Raises
    ------
    AllanError
        When there are too few data, a datasheet or an earlier run cannot be read, or the files
        cannot be written, for example because the folder has results of another recording.
    """
    settings = settings_of(ResultSettings, args)
    rest_results = load(settings.noise) if settings.noise else None
    results = analyze_recorded(recorded, settings.method, rest_results)
    results = compared(results, settings.sensor, settings.baseline, settings.margin)
    if not folder:
        return results, []
    from ..view.result_files import write_result_files

    results, paths = write_result_files(
        folder,
        results,
        command=args.command_line,
        units=settings.units,
        targets=settings.export,
        plots=settings.plots,
        overwrite=args.overwrite,
    )
    return results, sorted(path.name for path in paths)


def split_by_topic(jobs: Sequence[ReadJob]) -> list[ReadJob]:
    """Return the jobs, with one job for each topic of a bag that has several Imu topics.

    A job for which a topic is selected is kept.
    """
    separate_jobs = []
    for job in jobs:
        chosen_topic = job.reading.topic or job.reading.accel_topic
        topics = [] if chosen_topic else topics_of(job.path)
        topic_jobs = [replace(job, reading=replace(job.reading, topic=topic)) for topic in topics]
        separate_jobs += topic_jobs if len(topic_jobs) > 1 else [job]
    return separate_jobs


def names_of(jobs: Sequence[ReadJob]) -> list[str]:
    """Return a unique name for each job: the file name, with its topic or a number if needed.

    The folders that are named after the jobs (`folder_name`) are also unique.
    """
    names: list[str] = []
    for job in jobs:
        path_repeats = sum(other.path == job.path for other in jobs) > 1
        name = Path(job.path).name + (f' {job.reading.topic}' if path_repeats else '')
        used_folders, number, unique_name = {folder_name(other) for other in names}, 1, name
        while folder_name(unique_name) in used_folders:
            number += 1
            unique_name = f'{name} {number}'
        names.append(unique_name)
    return names


def folder_name(name: str) -> str:
    """Return a name of letters, digits, +, - and _; each run of other characters becomes one _."""
    return re.sub(r'[^\w+-]+', '_', name)


def fails(results: Results, severity: str | None) -> bool:
    """Return whether ``--fail-on`` applies to the results.

    The option applies if a finding has at least the severity ``severity``, or if the level of the
    results is 'failed'. ``severity`` is None if the option is not given.
    """
    if severity is None:
        return False
    severities = SEVERITIES[: SEVERITIES.index(severity) + 1]
    return results.level == 'failed' or any(f.severity in severities for f in results.findings)


def exit_code_of(results: Results, fail_on: str | None) -> int:
    """Return the exit code of an analysis.

    The code is 3 if ``--fail-on`` applies, 1 if no coefficient has a value, else 0.
    """
    if fails(results, fail_on):
        return EXIT_FAILED
    coefficients = (c for axis in results.axes.values() for c in axis.fit.noise.values())
    return 0 if any(c.value is not None for c in coefficients) else EXIT_ERROR
