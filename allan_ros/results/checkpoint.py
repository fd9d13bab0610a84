# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The checkpoint: a `sums.json` that preserves the Allan sums of a node over restarts."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.allan.sums import AllanSums, add_sums, check_same_imu
from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..core.stream.health import unit_findings
from ..readers.files import (
    MAX_BYTES,
    PathLock,
    parse_json,
    read_bounded,
    to_json,
    write_atomic,
)
from ..readers.recording_sums import Provenance
from .documents import SUMS_FILE_SCHEMA, sums_file_from_document, sums_file_to_document

Total = tuple[tuple[AllanSums, ...], Provenance]
"""The Allan sums of an IMU over all runs of a node, and the origin of these sums."""

NOTHING: Total = (), Provenance()


class Checkpoint:
    """A file with the Allan sums of all runs of a node.

    The sums of earlier runs are added to the sums of the present run, and the total is saved. A
    damaged file is renamed if possible. A file whose sums have a wrong unit of measurement is
    renamed as soon as the present samples have the right unit. A file of another version or IMU is
    never overwritten: nothing is written until this file is moved away, or its IMU is connected
    again.

    Only regular files are read, renamed or replaced, and only if no other node has locked the path.
    Problems never stop the node: each is logged when it begins, and becomes a finding.

    Parameters
    ----------
    path : path
        Path of the file; missing folders are created. With '', nothing is loaded or saved.
    log : object
        Logger with the methods ``info`` and ``warning``.
    words : function
        Function that returns the text of a finding for the log.

    Attributes
    ----------
    earlier : (sums, provenance)
        The sums that `total` adds to the sums of the present run: usually the content of the file
        when this run began. Empty after the file was renamed.
    loaded : Finding or None
        Finding that the file is not used, because it was damaged and was renamed, or because its
        sums had a wrong unit of measurement; None if there is no such finding.
    refused : Finding or None
        Finding that the file must not be replaced, for example because it is of another IMU; None
        if there is no such finding.
    """

    def __init__(
        self, path: str | os.PathLike[str], log: Any, words: Callable[[Finding], str] = str
    ) -> None:
        self.path = os.fspath(path)
        self.earlier = NOTHING
        self.loaded: Finding | None = None
        self.refused: Finding | None = None
        self._file, self._log, self._words = Path(path), log, words
        self._lock = PathLock(self._file) if self.path else None
        self._owned = False  # whether there is a path, and no other node has locked it
        self._content: Total | None = NOTHING  # content of the file; None if it cannot be read
        self._saved_s: float | None = None
        self._unsaved: Finding | None = None
        self._in_use: Finding | None = None
        self._writer = ThreadPoolExecutor(1)
        self._writing: Future[None] | None = None
        self._has_new_samples = False
        if self.path:
            self._open()

    @property
    def covered(self) -> tuple[tuple[int, int], ...]:
        """The time that the samples of earlier runs cover: one pair of stamps in ns.

        The pair consists of the first stamp in the Allan sums and the latest known stamp. The
        result is an empty tuple if the sums contain no samples, or if no latest stamp is known.
        """
        sums, provenance = self.earlier
        starts_ns = [p.begin_ns for s in sums for r in s.recordings for p in r.periods]
        ends_ns = [s.start_ns + round(s.duration_s * 1e9) for s in provenance.segments]
        last_ns = max(ends_ns, default=provenance.last_stamp_ns)
        if not starts_ns or last_ns is None:
            return ()
        return ((min(starts_ns), max(last_ns, provenance.last_stamp_ns or last_ns)),)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about problems with the file: current problems, and why it was renamed."""
        problems = (self._in_use, self._unsaved, self.refused, self.loaded)
        return tuple(f for f in problems if f is not None)

    def age_s(self, now: float) -> float | None:
        """Return the time in s since this run last wrote the file; None if it has not written it.

        ``now`` is the present value of `time.monotonic`.
        """
        return None if self._saved_s is None else now - self._saved_s

    def total(self, sums: tuple[AllanSums, ...], provenance: Provenance) -> Total:
        """Return the sums of all runs, given the sums and the provenance of this run.

        Only the sums of this run are returned if there is no path, or if the file cannot be read,
        is used by another node, or contains sums of another IMU, other axes, another sample rate or
        another unit of measurement.
        """
        self._has_new_samples = bool(sums)
        if sums and _has_wrong_unit(self.earlier[0]) and not _has_wrong_unit(sums):
            self._set_earlier_sums_aside()
        if self.refused is not None and not os.path.lexists(self.path):
            self._clear()
        if not self._owned or self._content is None:
            return sums, provenance
        try:
            check_same_imu(self._content[0], sums)
            if self.earlier[0] and _has_wrong_unit(sums) and not _has_wrong_unit(self.earlier[0]):
                raise AllanError(
                    'the present samples have another unit of measurement than the file'
                )
            total = add_sums(self.earlier[0], sums)
        except AllanError as error:
            self._refuse(str(error))
            return sums, provenance
        self.refused = None
        total_provenance = self.earlier[1] + provenance
        sources = tuple(dict.fromkeys(total_provenance.sources))
        return total, replace(total_provenance, sources=sources, findings=provenance.findings)

    def save(self, total: Total) -> bool:
        """Write the total to the file if the present run has samples.

        Returns whether this succeeded or, without such samples, whether this node may write the
        file.
        """
        self._collect()
        return self._writable() and (
            not self._has_new_samples or self._completed(lambda: self._write(total))
        )

    def save_in_background(self, total: Total) -> None:
        """Start to write the total in a thread if the present run has samples.

        Nothing is written if this node may not write the file. A later call, for example of `tick`,
        records whether writing succeeded.
        """
        self._collect()
        if self._has_new_samples and self._writable():
            self._writing = self._writer.submit(self._write, total)

    def tick(self) -> None:
        """Record the success or error of the background write, if it has ended."""
        if self._writing is not None and self._writing.done():
            self._collect()

    def start_over(self, total: Total) -> str:
        """Save the total, rename the file to ``<name>.previous``, and start with empty sums.

        Returns the path ``<name>.previous``, also if there was no file to rename. If the file
        cannot be written or renamed, its sums are kept and '' is returned.
        """
        previous = f'{self.path}.previous'
        if self.save(total):
            try:
                if os.path.lexists(self.path):
                    self._rename(Path(previous))
                self._clear()
                return previous
            except AllanError as error:
                self._report_unwritable(error)
        if self._content is not None:  # the file was not renamed, so its sums are kept
            self.earlier = self._content
        return ''

    def close(self) -> None:
        """Wait for the background write, and release the lock of the file."""
        self._collect()
        self._writer.shutdown()
        if self._lock is not None:
            self._lock.release()

    def _open(self) -> None:
        folder = self._file.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self._report_unwritable(AllanError(f'{folder} cannot be created ({error.strerror})'))
        if not self._locked(on_error=True):  # a file that cannot be locked may still be readable
            return
        self._owned = True
        if os.path.lexists(self.path):
            self._load()

    def _load(self) -> None:
        try:
            data = read_bounded(self.path, MAX_BYTES)
        except (AllanError, OSError) as error:  # not a regular file, too large, or not readable
            self._content = None
            self._refuse(str(error) if isinstance(error, AllanError) else str(error.strerror))
            return
        try:
            document = parse_json(data.decode('utf-8'), self.path)
            schema = document.get('schema') if isinstance(document, dict) else None
            if isinstance(schema, str) and schema != SUMS_FILE_SCHEMA:
                self._content = None
                self._refuse(f'its schema is {schema}, but this version reads {SUMS_FILE_SCHEMA}')
                return
            self.earlier = self._content = sums_file_from_document(document, self.path)
        except (AllanError, UnicodeDecodeError) as error:
            self._rename_damaged(str(error))
            return
        if self.earlier[0]:
            samples = max(s.samples for s in self.earlier[0])
            self._log.info(f'continues {self.path} with {samples} samples')

    def _rename_damaged(self, reason: str) -> None:
        names = (f'{self.path}.corrupt{i or ""}' for i in range(10**6))
        new_path = next(Path(name) for name in names if not os.path.lexists(name))
        try:
            self._rename(new_path)
        except AllanError:
            self._content = None
            self._refuse(reason)
            return
        self.loaded = finding('checkpoint_corrupt', path=self.path, aside=new_path, reason=reason)
        self._log.warning(self._words(self.loaded))

    def _set_earlier_sums_aside(self) -> None:
        """Rename the checkpoint, whose unit is wrong, and no longer add the sums of earlier runs.

        If the checkpoint cannot be renamed, it is left unchanged, and nothing is saved.
        """
        self._collect()
        if self._owned and os.path.lexists(self.path):
            new_path = Path(f'{self.path}.previous')
            try:
                self._rename(new_path)
            except AllanError as error:
                self.earlier, self._content = NOTHING, None
                self._refuse(str(error))
                return
            self.loaded = finding('checkpoint_unit', path=self.path, aside=new_path)
            self._log.warning(self._words(self.loaded))
        self._clear()

    def _rename(self, to: Path) -> None:
        try:
            self._file.replace(to)
        except OSError as error:
            raise AllanError(
                f'{self.path}: cannot be renamed to {to.name} ({error.strerror}): '
                'check the permissions of the folder'
            ) from error

    def _clear(self) -> None:
        """Forget the content of the file, so that there are no sums of earlier runs."""
        self.earlier = self._content = NOTHING
        self.refused = None

    def _refuse(self, reason: str) -> None:
        was_refused = self.refused is not None
        self.refused = finding('checkpoint_refused', path=self.path, reason=reason)
        if not was_refused:
            self._log.warning(self._words(self.refused))

    def _locked(self, on_error: bool) -> bool:
        """Acquire the lock, and return whether this node has it.

        Returns ``on_error`` if the lock file cannot be created.
        """
        try:
            owner = self._lock.acquire() if self._lock is not None else ''
        except AllanError as error:
            self._report_unwritable(error)
            return on_error
        if owner:
            self._in_use = finding('checkpoint_in_use', path=self.path, owner=owner)
            self._log.warning(self._words(self._in_use))
            self._clear()
            self._owned, self.loaded, self._unsaved = False, None, None
        return not owner

    def _writable(self) -> bool:
        """Return whether this node may write the file; lock the file if it is not locked yet."""
        return self._owned and self.refused is None and self._locked(on_error=False)

    def _write(self, total: Total) -> None:
        if total[0]:
            with contextlib.suppress(OSError):  # the folder may have been removed
                self._file.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(self.path, to_json(sums_file_to_document(*total)))
            self._content, self._saved_s = total, time.monotonic()

    def _collect(self) -> None:
        """Wait for the background write, if there is one, and record its success or error."""
        writing, self._writing = self._writing, None
        if writing is not None:
            self._completed(writing.result)

    def _completed(self, write: Callable[[], None]) -> bool:
        """Call ``write``, record its error, if any, and return whether it succeeded."""
        try:
            write()
        except AllanError as error:
            self._report_unwritable(error)
            return False
        self._unsaved = None
        return True

    def _report_unwritable(self, error: AllanError) -> None:
        problem = finding('checkpoint_unwritable', reason=error)
        if self._unsaved is None:
            self._log.warning(self._words(problem))
        self._unsaved = problem


def _has_wrong_unit(sums: tuple[AllanSums, ...]) -> bool:
    """Return whether the noise or the mean of a sensor is implausible in SI units."""
    return any(found.severity == 'error' for found in unit_findings(sums))
