# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The file in which running sums survive a restart. It is a `sums.json` like any other."""

from __future__ import annotations

import os
from pathlib import Path

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..core.sums import AllanSums
from .atomic import write_atomic
from .documents import (
    SUMS_SCHEMA,
    read_json,
    sums_file_from_document,
    sums_file_to_document,
    to_json,
)
from .results import Provenance


class Checkpoint:
    """One checkpoint file, loaded when made.

    A file that is not whole is renamed aside. A file of another version is left alone, and so is,
    once `refuse` was called, one of another IMU: nothing is ever written over it.

    Attributes
    ----------
    sums : tuple of AllanSums
        What the file held; empty when there was none that can be used.
    provenance : Provenance
        What stood beside them.
    loaded : Finding or None
        What was wrong with the file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.sums: tuple[AllanSums, ...] = ()
        self.provenance = Provenance()
        self.loaded: Finding | None = None
        self._kept = False
        if self.path.exists():
            self._load()

    @property
    def kept(self) -> bool:
        """Whether the file is somebody else's and must not be written."""
        return self._kept

    def refuse(self, reason: str) -> Finding:
        """Leave the file alone from now on."""
        self.sums, self.provenance, self._kept = (), Provenance(), True
        self.loaded = finding('checkpoint_refused', path=self.path, reason=reason)
        return self.loaded

    def save(self, sums: tuple[AllanSums, ...], provenance: Provenance) -> None:
        """Write the sums, unless there are none or the file is to be left alone.

        Raises
        ------
        AllanError
            When the file cannot be written.
        """
        if sums and not self._kept:
            write_atomic(self.path, to_json(sums_file_to_document(sums, provenance)))

    def try_to_write(self) -> None:
        """Find out now, not at the first period, whether the folder can be written.

        Raises
        ------
        AllanError
            When it cannot.
        """
        trial = self.path.with_name(f'{self.path.name}.trial')
        write_atomic(trial, '')
        trial.unlink(missing_ok=True)

    def set_aside(self) -> Path:
        """Begin anew: the file, if any, becomes ``<name>.previous``; return that path.

        Raises
        ------
        AllanError
            When it cannot be renamed.
        """
        self.sums, self.provenance = (), Provenance()
        previous = self.path.with_name(f'{self.path.name}.previous')
        if not self._kept and self.path.exists():
            self._rename(previous)
        return previous

    def _load(self) -> None:
        try:
            document = read_json(self.path)
            schema = document.get('schema') if isinstance(document, dict) else None
            if isinstance(schema, str) and schema != SUMS_SCHEMA:
                self.refuse(f'it is {schema}, this version reads {SUMS_SCHEMA}')
                return
            self.sums, self.provenance = sums_file_from_document(document, str(self.path))
        except AllanError as error:
            self._set_corrupt_aside(str(error))

    def _set_corrupt_aside(self, reason: str) -> None:
        aside = next(
            p
            for i in range(10**6)
            if not (p := self.path.with_name(f'{self.path.name}.corrupt{i or ""}')).exists()
        )
        try:
            self._rename(aside)
        except AllanError:
            self.refuse(reason)
            return
        self.loaded = finding('checkpoint_corrupt', path=self.path, aside=aside, reason=reason)

    def _rename(self, to: Path) -> None:
        try:
            self.path.replace(to)
        except OSError as error:
            raise AllanError(
                f'{self.path}: cannot be renamed to {to.name} ({error.strerror}): '
                'check the permissions of the folder'
            ) from error
