# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of one IMU: passed from accumulation to estimation, and kept in a checkpoint file."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.allan.sums import KEPT_SEGMENTS, AllanSums
from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.findings import Finding, finding
from ..core.imu import AXES
from ..core.stream.health import Means
from ..io.checkpoint import Checkpoint
from ..io.documents import sums_file_from_document, sums_file_to_document
from ..io.files import PathLock, parse_json
from ..io.recorded import Provenance

Total = tuple[tuple[AllanSums, ...], Provenance]
"""Sums of an IMU over all runs of the node, and their provenance."""

REPLACED_SHARE = 0.1
"""Sums that lost more than this share of their samples make coefficients invalid. Less is normal:
the last windows before a motion are at rest until the motion is recognized."""


SEGMENTS_KEPT = 1000
"""Longest segments that are listed next to the sums."""


@dataclass(frozen=True)
class Snapshot:
    """The sums at one time, and the IMU that is connected.

    Attributes
    ----------
    total : (sums, provenance)
    frame_id, hardware_id : str
        Of the latest messages; the sums may be of another frame.
    axes : tuple of str
        Axes that messages had values for, also before there are sums.
    means : tuple of Means
        The latest means of static samples over a second, one value for each sensor.
    """

    total: Total
    frame_id: str = ''
    hardware_id: str = ''
    axes: tuple[str, ...] = ()
    means: tuple[Means, ...] = ()

    @property
    def sums(self) -> tuple[AllanSums, ...]:
        """One with all axes, or one per sensor where the sensors have different rates."""
        return self.total[0]

    def to_document(self) -> dict[str, Any]:
        """Return the document of ``~/sums``: a sums file with the connected IMU added."""
        imu = {'frame_id': self.frame_id, 'hardware_id': self.hardware_id, 'axes': [*self.axes]}
        means = [
            {
                'axes': list(one.axes),
                'end_ns': one.end_ns.tolist(),
                'values': [[float(f'{value:.9g}') for value in row] for row in one.values],
            }
            for one in self.means
        ]
        return {**sums_file_to_document(*self.total), 'imu': imu, 'means': means}

    @classmethod
    def from_json(cls, text: str) -> Snapshot:
        """Return the snapshot of a message on ``~/sums``.

        Raises
        ------
        AllanError
            Naming what is wrong in the document.
        """
        document = parse_json(text, 'sums')
        total = sums_file_from_document(document, 'sums')
        imu = Fields(document, 'sums').optional_fields('imu')
        if imu is None:
            return cls(total)
        axes = imu.sequence('axes')
        return cls(
            total,
            imu.text('frame_id', ''),
            imu.text('hardware_id', ''),
            tuple(axis for axis in AXES if axis in axes),
            _means(document.get('means', []) if isinstance(document, dict) else []),
        )


def _means(documents: Any) -> tuple[Means, ...]:
    """Return the means of a document.

    Raises
    ------
    AllanError
        When they are not rows of as many finite numbers as there are axes.
    """
    try:
        means = tuple(
            Means(
                tuple(str(axis) for axis in one['axes']),
                np.array(one['end_ns'], np.int64),
                np.array(one['values'], float).reshape(len(one['end_ns']), len(one['axes'])),
            )
            for one in documents
        )
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        raise AllanError(f'sums: its means cannot be read ({error!r})') from error
    if not all(np.isfinite(one.values).all() for one in means):
        raise AllanError('sums: its means are not finite numbers')
    return means


def replaced_share(before: Sequence[AllanSums], after: Sequence[AllanSums]) -> float:
    """Return the largest share of the samples in ``before`` that ``after`` does not hold.

    Sums only grow, unless they are discarded, reset or start again from zero. Growing sums keep
    the start of each segment; of more than 32 segments the longest are listed.
    """
    shares = [0.0]
    for old in before:
        same = [s for s in after if (s.identity, s.axes) == (old.identity, old.axes)]
        if not same:
            return 1.0
        shares.append(_lost(old, same[0]) / max(old.samples, 1))
    return max(shares)


def _lost(old: AllanSums, new: AllanSums) -> int:
    """Return how many samples of the old sums the new ones lack, as far as segments are listed."""
    held = _samples_by_start(new)
    shortest = min(held.values()) if len(new.segments) >= KEPT_SEGMENTS else 0
    lost = sum(
        samples - min(samples, held[start])
        for start, samples in _samples_by_start(old).items()
        if start in held or samples > shortest
    )
    return max(lost, old.samples - new.samples)


def _samples_by_start(sums: AllanSums) -> Counter[int]:
    """Return the samples of the listed segments by their first stamp."""
    found: Counter[int] = Counter()
    for segment in sums.segments:
        found[segment.start_ns] += segment.samples
    return found


class CheckpointKeeper:
    """Adds the sums of former runs of the node to the present ones, and saves the total.

    Every problem becomes a finding and is logged once; the node continues without its checkpoint.
    A path that another node has locked is neither read nor written.

    Parameters
    ----------
    path : str
        Missing folders are created. '' for none: then nothing is loaded or saved.
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
        """Sums of the former runs of the node."""
        return self._file.sums if self._file is not None else ()

    @property
    def last_stamp_ns(self) -> int | None:
        """Latest stamp of the samples in the file; None where nothing is known."""
        if self._file is None:
            return None
        ends = [s.start_ns + round(s.duration_s * 1e9) for s in self._file.provenance.segments]
        known = self._file.provenance.last_stamp_ns
        return max(ends if known is None else [known, *ends], default=None)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Present problems of the file."""
        file = self._file
        of_file = (file.refused, file.loaded) if file is not None else ()
        return tuple(f for f in (self._in_use, self._unsaved, *of_file) if f is not None)

    def age_s(self, now: float) -> float | None:
        """Return the age of the file in s (steady clock); None before it was written."""
        return None if self._saved_s is None else now - self._saved_s

    def total(self, sums: tuple[AllanSums, ...], provenance: Provenance) -> Total:
        """Return the sums of all runs; a file of another IMU is left unchanged."""
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
        """Write the total now if there are new samples; return whether the file holds it."""
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
        """Write the total in a thread; the outcome is collected by `tick` or the next call."""
        self._wait()
        if self._news and self._may_write() and self._file is not None:
            self._writing = self._writer.submit(self._file.save, *total)

    def tick(self) -> None:
        """Collect the outcome of a write in the background, once it has ended."""
        if self._writing is not None and self._writing.done():
            self._wait()

    def begin_anew(self, total: Total) -> str:
        """Save the total, rename the file to ``.previous`` and start from zero.

        Returns
        -------
        str
            Path of the renamed file; '' where there is none.
        """
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
        """Wait for the last write, and release the path."""
        self._wait()
        self._writer.shutdown()
        self._lock.release()

    def _open(self) -> None:
        try:
            Path(self.path).parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = f'{Path(self.path).parent} cannot be created ({error.strerror})'
            self._note(AllanError(reason))
        try:
            owner = self._lock.acquire()
        except AllanError as error:  # the file may be readable nevertheless
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
        """Return whether this node may write the file; retries a lock that failed so far."""
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
        """Wait for the write in the background and collect its outcome."""
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
    """Return it in bounded size: the longest segments, and the findings of this run only."""
    longest = sorted(provenance.segments, key=lambda s: -s.samples)[:SEGMENTS_KEPT]
    return replace(
        provenance,
        sources=tuple(dict.fromkeys(provenance.sources)),
        segments=tuple(sorted(longest, key=lambda s: s.start_ns)),
        findings=findings,
    )
