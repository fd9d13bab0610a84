# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Collects the drives of a stream: the samples between two rests, in bounded memory."""

from __future__ import annotations

import copy
import itertools
import math
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from ..imu import AXES, Floats, ImuBatch
from .drives import REST_S, Drive, DriveErrors, Rest, drive_errors

LEAST_STOP_S = 1.0
"""Shortest duration in s of a rest before or after a drive. The mean of the gyro over a rest of 1 s
has an error of N / sqrt(1 s). In a drive of 30 s, this error causes an angle error of 30 s times
N / sqrt(1 s), five times the angle error due to the white noise during the drive."""

LEAST_DRIVES = 5
"""Smallest number of drives for which the factors in motion are computed. With five drives,
Student's t distribution has three degrees of freedom. The intervals are then 1.6 times as wide as
with many drives (quantiles 3.2 and 1.96)."""

LEAST_DRIVE_S, LONGEST_DRIVE_S = 2.0, 180.0
"""Shortest and longest duration in s of a drive that is used. In a longer drive, the errors are no
longer small, and a state estimator also uses other sensors."""

LONGEST_AHEAD_S = 60.0
"""Longest time in s until motion detection confirms that samples are at rest. A drive is too long
if the time since the last sample at rest exceeds `LONGEST_DRIVE_S` plus this time, or if more than
`MOST_KEPT` samples are buffered."""

MOST_RATE = 200.0
"""Samples are averaged down to at most this rate in Hz before the integration."""

MOST_KEPT = 1 << 20
"""Largest number of samples that are kept of a drive, of the beginning of a rest, and of the end of
a rest (48 MiB each). At the end of a rest, up to one block more is kept, because only complete
blocks are removed."""

MOST_DRIVES = 60
"""Largest number of drives whose errors are stored, about 50 kB each; the oldest are removed."""

Unused = Literal['short', 'long', 'gap', 'short_rest']
"""Why a drive is not used: the drive is too short or too long, samples of it are missing, or one of
its rests is shorter than `LEAST_STOP_S`."""


class Drives(NamedTuple):
    """Errors of the latest drives of a stream, and numbers of drives that are not used.

    ``errors`` contains the errors of up to `MOST_DRIVES` drives. ``unused`` maps each reason for
    which drives are not used to the number of these drives.
    """

    errors: tuple[DriveErrors, ...] = ()
    unused: Mapping[Unused, int] = MappingProxyType({})

    def __add__(self, other: Drives) -> Drives:  # type: ignore[override]
        """Return the drives of two recordings of one IMU, at most the last `MOST_DRIVES`."""
        errors = (*self.errors, *other.errors)[-MOST_DRIVES:]
        return Drives(errors, Counter(self.unused) + Counter(other.unused))


NO_DRIVES = Drives()


class _Pending(NamedTuple):
    """A drive whose second rest is not complete."""

    start: float  # time of the first sample of the drive in s
    rows: Floats  # samples of the drive, (n, 6)
    before: Rest  # the rest before the drive
    follows: bool  # whether another used drive ended at the rest before this drive


class DriveRecorder:
    """Collects the drives between rests from evenly spaced samples of six axes.

    The result does not depend on how the samples are divided into blocks, unless more samples are
    buffered than the limits permit (`LONGEST_AHEAD_S`, `MOST_KEPT`). ``tau0`` is the sample period
    in s.
    """

    def __init__(self, tau0: float) -> None:
        self._drives: deque[DriveErrors] = deque(maxlen=MOST_DRIVES)
        self._unused: Counter[Unused] = Counter()
        self._tau0 = tau0
        self._most = min(round((LONGEST_DRIVE_S + LONGEST_AHEAD_S) / tau0), MOST_KEPT)
        self._rest_samples = max(min(round(REST_S / tau0), MOST_KEPT), 1)
        # samples after the last sample at rest; while there are more than `_most`, the oldest block
        # is removed
        self._raw: deque[ImuBatch] = deque()

        # whether the drive is too long, so that its first samples are removed
        self._is_long = False
        self._at_rest = 0  # number of samples of the present rest
        self._first: list[Floats] = []  # the first samples of the present rest
        self._last: deque[Floats] = deque()  # the last samples of the present rest
        self._follows = False  # whether a used drive ended at the present rest
        self._drive: _Pending | None = None  # the drive before the present rest

    def __deepcopy__(self, memo: object) -> DriveRecorder:
        """Return a copy that shares the samples with this recorder; samples never change."""
        other = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, (deque, list, Counter)):
                setattr(other, name, copy.copy(value))
        return other

    def add_samples(self, blocks: Iterable[ImuBatch]) -> None:
        """Add the next evenly spaced samples, at rest or in motion."""
        self._raw.extend(block for block in blocks if len(block))

    def add_rests(self, blocks: Iterable[ImuBatch]) -> None:
        """Add the samples at rest; `add_samples` has received the same stamps before."""
        for block in blocks:
            if not len(block):
                continue
            if block.cut or not self._at_rest:
                self._begin_rest(block)
            self._continue_rest(block)
        number_buffered = sum(map(len, self._raw))
        while number_buffered > self._most:
            number_buffered -= len(self._raw.popleft())
            self._is_long = True

    @property
    def complete(self) -> Drives:
        """The drives whose second rest is over or long enough, and the drives not used so far."""
        return Drives(tuple(self._drives), Counter(self._unused))

    @property
    def result(self) -> Drives:
        """Errors of the drives as if the input ended here."""
        drives, unused = tuple(self._drives), Counter(self._unused)
        if self._drive is not None:
            second_rest = self._mean(self._first)
            if second_rest is None:
                unused['short_rest'] += 1
            else:
                drives = (*drives, self._errors(self._drive, second_rest))[-MOST_DRIVES:]
        return Drives(drives, unused)

    def _begin_rest(self, block: ImuBatch) -> None:
        """End the previous rest, and the drive after it, if any: ``block`` begins a new rest."""
        self._complete()
        begin_ns = int(block.stamps_ns[0])
        first_rest = self._mean(self._last, latest=True)
        drive_rows, is_split = self._samples_before(begin_ns)
        seconds = len(drive_rows) * self._tau0
        if self._at_rest and block.cut == 'motion':
            reason: Unused | None = None
            if is_split:
                reason = 'gap'
            elif seconds < LEAST_DRIVE_S:
                reason = 'short'
            elif self._is_long or seconds > LONGEST_DRIVE_S:
                reason = 'long'
            elif first_rest is None:
                reason = 'short_rest'
            else:
                self._drive = _Pending(
                    begin_ns * 1e-9 - seconds, drive_rows, first_rest, self._follows
                )
            if reason is not None:
                self._unused[reason] += 1
        self._is_long = self._follows = False
        self._at_rest = 0
        self._first, self._last = [], deque()

    def _continue_rest(self, block: ImuBatch) -> None:
        self._samples_before(int(block.stamps_ns[-1]) + 1)
        number_missing = self._rest_samples - self._at_rest
        if number_missing > 0:
            self._first.append(block.samples[:number_missing].copy())
        self._at_rest += len(block)
        self._last.append(block.samples[-self._rest_samples :].copy())
        while sum(map(len, self._last)) - len(self._last[0]) >= self._rest_samples:
            self._last.popleft()
        if number_missing > 0 and self._at_rest >= self._rest_samples:
            self._complete()

    def _complete(self) -> None:
        """Use or reject the pending drive, if any, when its second rest is over or long enough."""
        if self._drive is None:
            return
        drive, self._drive = self._drive, None
        second_rest = self._mean(self._first)
        if second_rest is None:
            self._unused['short_rest'] += 1
            return
        self._drives.append(self._errors(drive, second_rest))
        self._follows = True

    def _errors(self, pending: _Pending, second_rest: Rest) -> DriveErrors:
        """Return the errors of a drive, whose samples are averaged down to at most `MOST_RATE`."""
        rows, k = pending.rows, max(math.ceil(1.0 / (self._tau0 * MOST_RATE) - 1e-9), 1)
        # up to k - 1 samples at the end of the drive are omitted; the IMU is already at rest then,
        # because the detected rest begins some time after the motion
        end = len(rows) // k * k
        means = rows[:end].reshape(-1, k, len(AXES)).mean(axis=1)
        gyro, accel, tau0 = means[:, :3], means[:, 3:], k * self._tau0
        before, follows = pending.before, pending.follows
        return drive_errors(Drive(pending.start, tau0, gyro, accel, before, second_rest, follows))

    def _mean(self, parts: Iterable[Floats], latest: bool = False) -> Rest | None:
        """Return the means of samples of a rest; None if the rest is shorter than `LEAST_STOP_S`.

        With ``latest``, at most the samples in the last `REST_S` seconds are averaged.
        """
        rows = np.concatenate([np.empty((0, len(AXES))), *parts])
        rows = rows[-self._rest_samples :] if latest else rows
        seconds = len(rows) * self._tau0
        if seconds < LEAST_STOP_S:
            return None
        mean = rows.mean(axis=0)
        return Rest(mean[:3], mean[3:], seconds)

    def _samples_before(self, stamp_ns: int) -> tuple[Floats, bool]:
        """Remove the samples before a stamp; return them, (n, 6), and whether one follows a gap.

        If the first buffered sample has a later stamp, and the clock was then set back, the samples
        before this clock jump are removed, too.
        """
        parts, is_split = [], False
        while self._raw and self._raw[0].stamps_ns[0] > stamp_ns and self._has_jump():
            parts.append(self._raw.popleft().samples)
            is_split = True
        while self._raw and self._raw[0].stamps_ns[0] < stamp_ns:
            block = self._raw.popleft()
            number = int(np.searchsorted(block.stamps_ns, stamp_ns))
            is_split |= bool(block.cut)
            parts.append(block.samples[:number])
            if number < len(block):
                self._raw.appendleft(block.part(slice(number, None)))
        rows = np.concatenate(parts) if parts else np.empty((0, len(AXES)))
        return rows, is_split

    def _has_jump(self) -> bool:
        """Return whether the clock was set back after the first block of the buffered samples."""
        return any(block.cut == 'clock jump' for block in itertools.islice(self._raw, 1, None))
