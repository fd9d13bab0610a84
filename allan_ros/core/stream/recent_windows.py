# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The latest windows of a stream: samples, statistics and classification."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..imu import Flags, Floats, ImuBatch
from .noise_floor import WindowClass, Windows


class WindowPart(NamedTuple):
    """Consecutive windows without a gap: samples, statistics and classification."""

    samples: ImuBatch
    windows: Windows
    still: Flags
    found: WindowClass

    def last(self, number: int) -> WindowPart:
        """Return the last ``number`` windows; there must be at least this number."""
        first = len(self.still) - number
        size = len(self.samples) // len(self.still)
        return WindowPart(
            self.samples.part(slice(first * size, None), '' if first else self.samples.cut),
            Windows(self.windows.values[:, :, first:]),
            self.still[first:],
            WindowClass(*(flags[first:] for flags in self.found)),
        )


class RecentWindows:
    """Consecutive windows in one or several parts, between which gaps are possible."""

    def __init__(self, parts: tuple[WindowPart, ...] = ()) -> None:
        self._parts = parts

    def __len__(self) -> int:
        return sum(len(part.still) for part in self._parts)

    def with_part(self, part: WindowPart, most: int) -> RecentWindows:
        """Return the last ``most`` windows, or all windows, after ``part`` is appended."""
        return RecentWindows((*self._parts, part)).last(most)

    def last(self, number: int) -> RecentWindows:
        """Return the last ``number`` windows, or all windows if there are fewer."""
        parts: list[WindowPart] = []
        for part in reversed(self._parts):
            if number <= 0:
                break
            parts.insert(0, part.last(min(number, len(part.still))))
            number -= len(part.still)
        return RecentWindows(tuple(parts))

    @property
    def samples(self) -> list[ImuBatch]:
        """The samples of all windows, one batch for each part without a gap."""
        return [part.samples for part in self._parts]

    @property
    def rows(self) -> Floats:
        """The samples of all windows, (axes, n), in the unit of the messages."""
        return np.concatenate([part.samples.rows for part in self._parts], axis=1)

    @property
    def windows(self) -> Windows:
        """The statistics of all windows."""
        return Windows.joined(part.windows for part in self._parts)

    @property
    def still(self) -> Flags:
        """Which windows are at rest, (k,)."""
        return np.concatenate([np.zeros(0, bool), *(part.still for part in self._parts)])

    @property
    def found(self) -> WindowClass:
        """The classification of all windows."""
        return WindowClass(*map(np.concatenate, zip(*(part.found for part in self._parts))))

    @property
    def can_be_larger_noise(self) -> bool:
        """Whether the noise may be larger: no window is at rest, has less noise, or is foreign."""
        found = self.found
        return not (self.still | found.decreased | found.foreign).any()

    @property
    def is_steady(self) -> bool:
        """Whether all windows are at rest, or would be if the gyro had another bias."""
        found = self.found
        return bool((found.quiet | found.rotating).all())

    @property
    def white_noise(self) -> Floats:
        """Standard deviation of the white noise, (axes,), in the unit of the samples.

        It is the root mean square of the differences of neighboring samples, divided by sqrt(2).
        """
        return np.asarray(np.sqrt(0.5 * np.mean(np.diff(self.rows, axis=1) ** 2, axis=1)))

    @property
    def latest_ns(self) -> int:
        """Stamp of the last sample in ns."""
        return int(self._parts[-1].samples.stamps_ns[-1])

    @property
    def began_ns(self) -> int:
        """Stamp of the first sample in ns."""
        return int(self._parts[0].samples.stamps_ns[0])
