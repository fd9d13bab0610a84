# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keeps the checkpoint of one IMU up to date, without ever holding up the draining of messages."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..core.sums import AllanSums
from ..core.total import add_sums
from ..io.checkpoint import Checkpoint
from ..io.results import Provenance

SPANS_KEPT = 1000
"""Longest segments that are listed beside the sums."""

Total = tuple[tuple[AllanSums, ...], Provenance]
"""Sums of all runs of an IMU, and where they come from."""


class CheckpointKeeper:
    """Adds the sums of former runs to those of this one, and saves the total.

    Every trouble is a finding, told once in the log: a node goes on without its checkpoint.

    Parameters
    ----------
    path : str
        '' for none: then totals are those of this run, and nothing is saved.
    log : rclpy logger
    """

    def __init__(self, path: str, log: Any) -> None:
        self._log = log
        self._file = Checkpoint(path) if path else None
        self._saved_s: float | None = None
        self._unsaved: Finding | None = None
        self._writer = ThreadPoolExecutor(1)
        self._writing: Future[None] | None = None
        self._news = False
        if self._file is not None:
            self._open(self._file)

    @property
    def path(self) -> str:
        """The path, '' without one."""
        return str(self._file.path) if self._file is not None else ''

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """Sums of the runs before this one."""
        return self._file.sums if self._file is not None else ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong with the file now."""
        loaded = self._file.loaded if self._file is not None else None
        return tuple(f for f in (self._unsaved, loaded) if f is not None)

    def age_s(self, now: float) -> float | None:
        """Return how old the file is (steady clock), None before it was written."""
        return None if self._saved_s is None else now - self._saved_s

    def total(self, sums: tuple[AllanSums, ...], provenance: Provenance) -> Total:
        """Return the sums of all runs; a file of another IMU is refused and left alone."""
        self._news = bool(sums)
        if self._file is None:
            return sums, provenance
        try:
            total = add_sums(self._file.sums, sums)
        except AllanError as error:
            self._log.warning(str(self._file.refuse(str(error))))
            return sums, provenance
        return total, _shortened(self._file.provenance + provenance, provenance.findings)

    def save(self, total: Total) -> bool:
        """Write the total now, where it says more than the file; return whether the file has it."""
        self._wait()
        if self._file is None or self._file.kept:
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
        if self._file is not None and self._news and not self._file.kept:
            self._writing = self._writer.submit(self._file.save, *total)

    def tick(self) -> None:
        """Learn what became of a writing in the background, once it has ended."""
        if self._writing is not None and self._writing.done():
            self._wait()

    def begin_anew(self, total: Total) -> str:
        """Save the total under another name and forget it; return where it is, '' for nowhere."""
        if not self.save(total) or self._file is None:
            return ''
        try:
            return str(self._file.set_aside())
        except AllanError as error:
            self._note(error)
            return ''

    def close(self) -> None:
        """Let the last writing end."""
        self._wait()
        self._writer.shutdown()

    def _open(self, file: Checkpoint) -> None:
        if file.loaded is not None:
            self._log.warning(str(file.loaded))
        elif file.sums:
            samples = max(s.samples for s in file.sums)
            self._log.info(f'continues {file.path} with {samples} samples')
        try:
            file.try_to_write()
        except AllanError as error:
            self._note(error)

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
