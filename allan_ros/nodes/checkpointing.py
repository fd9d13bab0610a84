# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keeps the checkpoint of one IMU up to date, without ever holding up the draining of messages."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.allan.sums import AllanSums
from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..io.checkpoint import Checkpoint
from ..io.files import PathLock
from ..io.recorded import Provenance

SPANS_KEPT = 1000
"""Longest segments that are listed beside the sums."""

Total = tuple[tuple[AllanSums, ...], Provenance]
"""Sums of all runs of an IMU, and where they come from."""


class CheckpointKeeper:
    """Adds the sums of former runs to those of this one, and saves the total.

    Every trouble is a finding, told once in the log: a node goes on without its checkpoint. A path
    that another node keeps is neither read nor written: the two would overwrite each other's sums.

    Parameters
    ----------
    path : str
        '' for none: then totals are those of this run, and nothing is saved.
    log : rclpy logger
    """

    def __init__(self, path: str, log: Any) -> None:
        self._log = log
        self.path = path
        self._lock = PathLock(Path(path))
        self._file: Checkpoint | None = None
        self._saved_s: float | None = None
        self._unsaved: Finding | None = None
        self._in_use: Finding | None = None
        self._refused = False
        self._writer = ThreadPoolExecutor(1)
        self._writing: Future[None] | None = None
        self._news = False
        if path:
            self._open()

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """Sums of the runs before this one."""
        return self._file.sums if self._file is not None else ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong with the file now."""
        file = self._file
        of_file = (file.refused, file.loaded) if file is not None else ()
        return tuple(f for f in (self._in_use, self._unsaved, *of_file) if f is not None)

    def age_s(self, now: float) -> float | None:
        """Return how old the file is (steady clock), None before it was written."""
        return None if self._saved_s is None else now - self._saved_s

    def total(self, sums: tuple[AllanSums, ...], provenance: Provenance) -> Total:
        """Return the sums of all runs; a file of another IMU is left alone."""
        self._news = bool(sums)
        if self._file is None:
            return sums, provenance
        total = self._file.add(sums)
        if self._file.refused is not None:
            if not self._refused:
                self._log.warning(str(self._file.refused))
            self._refused = True
            return sums, provenance
        self._refused = False
        return total, _shortened(self._file.provenance + provenance, provenance.findings)

    def save(self, total: Total) -> bool:
        """Write the total now, where it says more than the file; return whether the file has it."""
        self._wait()
        if not self._may_write() or self._file is None:
            return False
        if not self._news:
            return True
        try:
            self._file.save(*total)
        except AllanError as error:
            self._note(error)
            return False
        self._saved_s, self._unsaved = time.monotonic(), None
        return True

    def save_in_background(self, total: Total) -> None:
        """Write the total while messages go on; what became of it is learned the next time."""
        self._wait()
        if self._news and self._may_write() and self._file is not None:
            self._writing = self._writer.submit(self._file.save, *total)

    def tick(self) -> None:
        """Learn what became of a writing in the background, once it has ended."""
        if self._writing is not None and self._writing.done():
            self._wait()

    def begin_anew(self, total: Total) -> str:
        """Save the total under another name and forget it; return where it is, '' for nowhere."""
        saved = self.save(total)
        if self._file is None:
            return ''
        try:
            if saved:
                return str(self._file.set_aside())
        except AllanError as error:
            self._note(error)
        self._file.resume()
        return ''

    def close(self) -> None:
        """Let the last writing end, and the path go."""
        self._wait()
        self._writer.shutdown()
        self._lock.release()

    def _open(self) -> None:
        try:
            owner = self._lock.acquire()
        except AllanError as error:  # the file may be read all the same
            self._note(error)
            owner = ''
        if owner:
            self._leave_to(owner)
            return
        self._file = Checkpoint(self.path)
        if self._file.loaded is not None:
            self._log.warning(str(self._file.loaded))
        elif self._file.sums:
            samples = max(s.samples for s in self._file.sums)
            self._log.info(f'continues {self.path} with {samples} samples')
        try:
            self._file.try_to_write()
        except AllanError as error:
            self._note(error)
        else:
            self._file.remove_drafts()

    def _may_write(self) -> bool:
        """Return whether the file is ours, also where its folder could not be written so far."""
        if self._file is None or self._file.refused is not None:
            return False
        try:
            owner = self._lock.acquire()
        except AllanError as error:
            self._note(error)
            return False
        if owner:
            self._leave_to(owner)
        return not owner

    def _leave_to(self, owner: str) -> None:
        self._in_use = finding('checkpoint_in_use', path=self.path, owner=owner)
        self._log.warning(str(self._in_use))
        self._file = self._unsaved = None

    def _wait(self) -> None:
        """Learn what became of the last writing in the background."""
        writing, self._writing = self._writing, None
        if writing is None:
            return
        try:
            writing.result()
        except AllanError as error:
            self._note(error)
        else:
            self._saved_s, self._unsaved = time.monotonic(), None

    def _note(self, error: AllanError) -> None:
        if self._unsaved is None:
            self._log.warning(str(finding('checkpoint_unwritable', reason=error)))
        self._unsaved = finding('checkpoint_unwritable', reason=error)


def _shortened(provenance: Provenance, findings: tuple[Finding, ...]) -> Provenance:
    """Return it as it may stand in a file for years: its longest spans, findings of this run."""
    longest = sorted(provenance.spans, key=lambda span: -span.samples)[:SPANS_KEPT]
    return replace(
        provenance,
        sources=tuple(dict.fromkeys(provenance.sources)),
        spans=tuple(sorted(longest, key=lambda span: span.start_ns)),
        findings=findings,
    )
