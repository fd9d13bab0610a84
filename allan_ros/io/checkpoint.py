# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The checkpoint: a `sums.json` in which running sums survive a restart."""

from __future__ import annotations

import os
from pathlib import Path

from ..core.allan.sums import AllanSums, add_sums, check_same_imu
from ..core.errors import AllanError
from ..core.findings import Finding, finding
from .documents import SUMS_SCHEMA, sums_file_from_document, sums_file_to_document
from .files import (
    MAX_BYTES,
    check_replaceable,
    parse_json,
    read_bounded,
    remove_drafts,
    to_json,
    write_atomic,
)
from .recorded import Provenance


class Checkpoint:
    """One checkpoint file, loaded on construction.

    A damaged file is renamed. A file of another version or IMU is never overwritten: nothing is
    written until it is moved away, or until its IMU is back. Only regular files are read, renamed
    or replaced; a folder, FIFO or device at the path is left alone.

    ``sums`` and ``provenance`` are the content of the file, ``loaded`` is what was wrong with it,
    and ``refused`` why nothing is written now.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.sums: tuple[AllanSums, ...] = ()
        self.provenance = Provenance()
        self.loaded: Finding | None = None
        self.refused: Finding | None = None
        self._readable = True
        self._holds: tuple[tuple[AllanSums, ...], Provenance] = (), Provenance()
        if os.path.lexists(self.path):
            self._load()

    def add(self, sums: tuple[AllanSums, ...]) -> tuple[AllanSums, ...]:
        """Return these sums plus those of the file.

        While the file is of another IMU or of other axes, these sums are returned alone.
        """
        if self.refused is not None and not os.path.lexists(self.path):
            self._clear()
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
        """Write the sums, unless there are none or the file must be left alone."""
        if sums and self.refused is None:
            write_atomic(self.path, to_json(sums_file_to_document(sums, provenance)))
            self._holds = sums, provenance

    def try_to_write(self) -> None:
        """Check now, not at the first period, whether the folder can be written."""
        write_atomic(self._trial, '')
        self._trial.unlink(missing_ok=True)

    def remove_drafts(self) -> None:
        """Remove drafts of killed processes; no other process may write this path now."""
        for path in (self.path, self._trial):
            remove_drafts(path, older_s=0.0)

    def set_aside(self) -> Path:
        """Start again: rename the file, if any, to ``<name>.previous`` and return that path."""
        previous = self.path.with_name(f'{self.path.name}.previous')
        if self.path.exists():
            self._rename(previous)
        self._clear()
        return previous

    def resume(self) -> None:
        """Start again from the content of the file, which stays where it is."""
        self.sums, self.provenance = self._holds

    @property
    def _trial(self) -> Path:
        return self.path.with_name(f'{self.path.name}.trial')

    def _load(self) -> None:
        try:
            data = read_bounded(self.path, MAX_BYTES)
        except (AllanError, OSError) as error:  # no regular file, too large, not ours to read
            self._readable = False
            self._refuse(str(error) if isinstance(error, AllanError) else str(error.strerror))
            return
        try:
            document = parse_json(data.decode('utf-8'), str(self.path))
            schema = document.get('schema') if isinstance(document, dict) else None
            if isinstance(schema, str) and schema != SUMS_SCHEMA:
                self._readable = False
                self._refuse(f'it is {schema}, this version reads {SUMS_SCHEMA}')
                return
            self.sums, self.provenance = sums_file_from_document(document, str(self.path))
            self._holds = self.sums, self.provenance
        except (AllanError, UnicodeDecodeError) as error:
            self._set_corrupt_aside(str(error))

    def _clear(self) -> None:
        """Start with empty sums, because the file is removed."""
        self.sums, self.provenance = self._holds = (), Provenance()
        self.refused, self._readable = None, True

    def _refuse(self, reason: str) -> None:
        self.refused = finding('checkpoint_refused', path=self.path, reason=reason)

    def _set_corrupt_aside(self, reason: str) -> None:
        aside = next(
            p
            for i in range(10**6)
            if not os.path.lexists(p := self.path.with_name(f'{self.path.name}.corrupt{i or ""}'))
        )
        try:
            self._rename(aside)
        except AllanError:
            self._readable = False
            self._refuse(reason)
            return
        self.loaded = finding('checkpoint_corrupt', path=self.path, aside=aside, reason=reason)

    def _rename(self, to: Path) -> None:
        for path in (self.path, to):
            check_replaceable(path)
        try:
            self.path.replace(to)
        except OSError as error:
            raise AllanError(
                f'{self.path}: cannot be renamed to {to.name} ({error.strerror}): '
                'check the permissions of the folder'
            ) from error
