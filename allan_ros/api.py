# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public functions, and the only path from a recording to `Results`.

The command line, the scripts and notebooks call these functions.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, Protocol

from .core.compare import MARGIN
from .core.errors import AllanError
from .core.fit import METHODS
from .core.settings import check, parameter
from .io.comparison import DOCUMENTS, labels_of
from .io.datasheets import load_sensor
from .io.documents import SUMS_SCHEMA, results_from_document, sums_file_from_document
from .io.recorded import ReadJob, RecordingSums, read_recording
from .io.results import Results, analyse_recorded
from .io.text import read_json

RESULTS, SUMS = 'results.json', 'sums.json'
"""Files in the folder of an analysis: the results, and the sums they were computed from."""


@dataclass(frozen=True)
class ResultSettings:
    """How sums are fitted, compared and shown."""

    method: str = parameter(
        'gls',
        'How the curve is fitted: generalised least squares with intervals, least squares with '
        'relative weights, or as the paper did.',
        choices=tuple(METHODS),
    )
    units: str = parameter(
        'datasheet', 'Units shown: those of datasheets, or SI.', choices=('datasheet', 'si')
    )
    export: tuple[str, ...] = parameter(
        (),
        'Further files for filters: kalibr, openvins, px4 ... (`allan export --list` lists all, '
        '`allan export` has more options).',
    )
    sensor: str = parameter(
        '',
        'Datasheet to compare with: a name that `allan sensors` lists, or the path of a .yaml '
        'file.',
    )
    baseline: str = parameter(
        '', 'results.json of an earlier run of this IMU, to compare this one with in the report.'
    )
    margin: float = parameter(
        MARGIN,
        'Fraction by which a whole interval must exceed the limit of the datasheet, or the '
        'earlier run.',
        low=0.0,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check(self)


class Observer(Protocol):
    """Is told how the reading of recordings proceeds."""

    def progress(self, label: str, total: int | None) -> AbstractContextManager[Any]:
        """Return a context whose value has ``advance(samples)``."""

    def timed(self, what: str) -> AbstractContextManager[None]:
        """Return a context around one step."""


class Silent:
    """An `Observer` that does nothing."""

    def progress(self, label: str, total: int | None) -> AbstractContextManager[Any]:
        return contextlib.nullcontext(self)

    def timed(self, what: str) -> AbstractContextManager[None]:
        return contextlib.nullcontext()

    def advance(self, samples: int) -> None: ...


# --- from recordings to sums ----------------------------------------------------------------------


def read_in_turn(jobs: Sequence[ReadJob], observer: Observer = Silent()) -> Iterator[RecordingSums]:
    """Read the recordings one after the other, in this process."""
    # All are opened before the first is read: a wrong name is reported now, not after an hour.
    recordings = [job.open() for job in jobs]
    for job, recording in zip(jobs, recordings):
        bar = observer.progress(job.path, recording.messages)
        with observer.timed(f'read {job.path}'), bar as progress:
            recorded = read_recording(job, recording, progress.advance)
        yield recorded


def read_in_processes(
    jobs: Sequence[ReadJob], processes: int, observer: Observer = Silent()
) -> Iterator[RecordingSums]:
    """Read the recordings in several processes at a time; the result is the same, bit for bit.

    Raises
    ------
    AllanError
        What a job raised, or that a process died.
    """
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    # a fork would copy the locks of numpy's threads, but not the threads
    workers = min(processes, len(jobs))
    pool = ProcessPoolExecutor(workers, mp_context=get_context('spawn'))
    try:
        with _interrupts_blocked():
            futures = [pool.submit(read_recording, job) for job in jobs]
        with observer.progress(f'{len(jobs)} recordings in {workers} processes', None) as progress:
            for future in futures:
                recorded = future.result()
                progress.advance(recorded.provenance.counts.received)
                yield recorded
    except KeyboardInterrupt:
        for child in active_children():  # none of them writes anything
            child.terminate()
        raise
    except BrokenProcessPool as error:
        raise AllanError(
            f'one of {workers} processes died, perhaps for lack of memory: use fewer --jobs'
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT: processes started meanwhile never receive it and leave it to this one."""
    if not hasattr(signal, 'pthread_sigmask'):  # not on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def add_recordings(recordings: Iterable[RecordingSums]) -> RecordingSums:
    """Return the sums of all recordings of one IMU.

    Raises
    ------
    AllanError
        When one is of another IMU than the first, or was given twice.
    """
    return reduce(add, recordings)


def load_sums(path: str | os.PathLike[str]) -> RecordingSums:
    """Return the sums of a sums.json, a checkpoint, or the folder of an analysis.

    Raises
    ------
    AllanError
        When the file is missing or is no such document.
    """
    path = file_in(path, SUMS)
    sums, provenance = sums_file_from_document(read_json(path), path)
    return RecordingSums(path, sums, provenance)


def file_in(path: str | os.PathLike[str], name: str) -> str:
    """Return the path itself, or if it is a folder the file of that name in it.

    Raises
    ------
    AllanError
        When the folder has no such file.
    """
    if not Path(path).is_dir():
        return str(path)
    inside = Path(path) / name
    if not inside.is_file():
        raise AllanError(
            f'{path}: no {name} in this folder: give the folder of an analysis, or the file'
        )
    return str(inside)


# --- from sums to results -------------------------------------------------------------------------


def fit_recorded(recorded: RecordingSums, settings: ResultSettings = ResultSettings()) -> Results:
    """Fit the sums and compare the coefficients with the datasheet that the settings name.

    Raises
    ------
    AllanError
        When there is too little data, or the datasheet cannot be read.
    """
    results = analyse_recorded(recorded, settings.method)
    if settings.sensor:
        return results.against_datasheet(load_sensor(settings.sensor), settings.margin)
    return results


def load_baseline(path: str) -> dict[str, Results]:
    """Return the results of an earlier run by its short name; none where the path is ''.

    Raises
    ------
    AllanError
        When it cannot be read, or is no results.json.
    """
    if not path:
        return {}
    (label,) = labels_of([path])
    return {label: results_from_document(read_json(path), path)}


def load(path: str | os.PathLike[str], method: str = 'gls') -> Results:
    """Return the results of a results.json, or of the folder of an analysis.

    A sums.json or a checkpoint is fitted first. Results of a folder can be merged and saved, since
    the folder holds their sums.

    Raises
    ------
    AllanError
        When the file is missing, or is no such document.
    """
    place = Path(path)
    if place.is_dir():
        place = Path(file_in(path, next((n for n in DOCUMENTS if (place / n).is_file()), RESULTS)))
    document = read_json(place)
    if isinstance(document, dict) and document.get('schema') == SUMS_SCHEMA:
        sums, provenance = sums_file_from_document(document, str(place))
        return analyse_recorded(RecordingSums(str(place), sums, provenance), method)
    results = results_from_document(document, str(place))
    if Path(path).is_dir() and (place.parent / SUMS).is_file():
        return replace(results, recorded=load_sums(path))
    return results


def results_of(
    path: str | os.PathLike[str], method: str = 'gls', observer: Observer = Silent()
) -> Results:
    """Return the results of a document, as `load` does, or of a recording, which is analyzed."""
    place = Path(path)
    if place.suffix.lower() == '.json' or any((place / name).is_file() for name in DOCUMENTS):
        return load(path, method)
    (recorded,) = read_in_turn([ReadJob(str(path))], observer)
    return analyse_recorded(recorded, method)
