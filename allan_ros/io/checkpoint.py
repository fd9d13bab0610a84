# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The file in which running sums survive a restart. It is a `sums.json` like any other."""

from __future__ import annotations

import os
from pathlib import Path

from ..core.allan.sums import AllanSums, add_sums, check_same_imu
from ..core.errors import AllanError
from ..core.findings import Finding, finding
from .documents import SUMS_SCHEMA, sums_file_from_document, sums_file_to_document
from .files import remove_drafts, write_atomic
from .recorded import Provenance
from .text import read_json, to_json


class Checkpoint:
    """One checkpoint file, loaded when made.

    A file that is not whole is renamed aside. A file of another version or IMU is left alone,
    until it is moved away or its own IMU is back: nothing is ever written over it.

    Attributes
    ----------
    sums : tuple of AllanSums
        What the file held; empty when there was none that can be used.
    provenance : Provenance
        What stood beside them.
    loaded : Finding or None
        What was wrong with the file.
    refused : Finding or None
        Why nothing is written now.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.sums: tuple[AllanSums, ...] = ()
        self.provenance = Provenance()
        self.loaded: Finding | None = None
        self.refused: Finding | None = None
        self._readable = True
        self._holds: tuple[tuple[AllanSums, ...], Provenance] = (), Provenance()
        if self.path.exists():
            self._load()

    def add(self, sums: tuple[AllanSums, ...]) -> tuple[AllanSums, ...]:
        """Return these sums with those of the runs before.

        While they are of another IMU than the file, or of other axes, they come back alone, and
        the file is left alone.
        """
        if self.refused is not None and not self.path.exists():
            self._forget()
        if not self._readable:
            return sums
        try:
            check_same_imu(self._holds[0], sums)
            total = add_sums(self.sums, sums)
        except AllanError as error:
            self._refuse(str(error))
            return sums
        self.refused = None
        return total

    def save(self, sums: tuple[AllanSums, ...], provenance: Provenance) -> None:
        """Write the sums, unless there are none or the file is to be left alone.

        Raises
        ------
        AllanError
            When the file cannot be written.
        """
        if sums and self.refused is None:
            write_atomic(self.path, to_json(sums_file_to_document(sums, provenance)))
            self._holds = sums, provenance

    def try_to_write(self) -> None:
        """Find out now, not at the first period, whether the folder can be written.

        Raises
        ------
        AllanError
            When it cannot.
        """
        write_atomic(self._trial, '')
        self._trial.unlink(missing_ok=True)

    def remove_drafts(self) -> None:
        """Remove what a process that was killed while it wrote left; nobody else may write now."""
        for path in (self.path, self._trial):
            remove_drafts(path, older_s=0.0)

    def set_aside(self) -> Path:
        """Begin anew: the file, if any, becomes ``<name>.previous``; return that path.

        Raises
        ------
        AllanError
            When it cannot be renamed.
        """
        previous = self.path.with_name(f'{self.path.name}.previous')
        if self.path.exists():
            self._rename(previous)
        self._forget()
        return previous

    def resume(self) -> None:
        """Begin anew after what the file holds, as it stays where it is."""
        self.sums, self.provenance = self._holds

    @property
    def _trial(self) -> Path:
        return self.path.with_name(f'{self.path.name}.trial')

    def _load(self) -> None:
        try:
            document = read_json(self.path)
            schema = document.get('schema') if isinstance(document, dict) else None
            if isinstance(schema, str) and schema != SUMS_SCHEMA:
                self._readable = False
                self._refuse(f'it is {schema}, this version reads {SUMS_SCHEMA}')
                return
            self.sums, self.provenance = sums_file_from_document(document, str(self.path))
            self._holds = self.sums, self.provenance
        except AllanError as error:
            self._set_corrupt_aside(str(error))

    def _forget(self) -> None:
        """Begin with nothing: the file is not there, or will not be."""
        self.sums, self.provenance = self._holds = (), Provenance()
        self.refused, self._readable = None, True

    def _refuse(self, reason: str) -> None:
        self.refused = finding('checkpoint_refused', path=self.path, reason=reason)

    def _set_corrupt_aside(self, reason: str) -> None:
        aside = next(
            p
            for i in range(10**6)
            if not (p := self.path.with_name(f'{self.path.name}.corrupt{i or ""}')).exists()
        )
        try:
            self._rename(aside)
        except AllanError:
            self._readable = False
            self._refuse(reason)
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
