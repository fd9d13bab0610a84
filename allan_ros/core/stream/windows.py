# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of consecutive samples: statistics, classification, and the latest windows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..imu import Flags, Floats, ImuBatch
from ..memory import aligned

STUCK_SHARE = 0.75
"""An axis is stuck in a window if it repeats one value, without interruption, for at least this
share of the samples."""

ROUNDING_OF_MEANS = 1e-13
"""A standard deviation below this fraction of the mean is a rounding error: no sensor has a
resolution of 43 bits."""


@dataclass(frozen=True)
class Windows:
    """Mean, variance and largest deviation from the mean of k windows: ``values``, (3, axes, k).

    Means and deviations are in the unit of the samples, and variances in the squared unit.
    """

    values: Floats

    mean = property(lambda self: self.values[0])
    variance = property(lambda self: self.values[1])
    peak = property(lambda self: self.values[2])

    @classmethod
    def of(cls, rows: Floats, size: int) -> Windows:
        """Compute the statistics of windows of ``size`` samples of ``rows``, (axes, n).

        Samples after the last complete window are ignored.
        """
        windows = rows[:, : rows.shape[1] // size * size].reshape(len(rows), -1, size)
        mean = np.add.reduce(windows, axis=2) / size
        deviations = np.subtract(windows, mean[:, :, None], out=aligned(windows.shape))
        variance = np.einsum('ijk,ijk->ij', deviations, deviations) / max(size - 1, 1)
        peak = np.abs(deviations, out=deviations).max(axis=2)
        # the variance of constant samples is 0, but rounding of their mean makes it positive
        variance[variance <= (ROUNDING_OF_MEANS * mean) ** 2] = 0.0
        return cls(np.stack([mean, variance, peak]))

    @classmethod
    def joined(cls, parts: Iterable[Windows]) -> Windows:
        """Concatenate the windows of at least one part."""
        return cls(_concatenated([part.values for part in parts]))


def idle_share(rows: Floats, size: int) -> Floats:
    """Return the share of idle samples in windows of ``size`` samples, (k,).

    ``rows`` are the samples of one sensor, (axes, n); samples after the last complete window are
    ignored. A sample is idle if it is zero on all axes, or repeats the previous sample on all axes.
    """
    number = rows.shape[1] // size
    first_axis, *other_axes = rows[:, : number * size]
    is_repeated, is_zero = first_axis[1:] == first_axis[:-1], first_axis == 0.0
    for values in other_axes:
        # the common case: no sample is idle
        if not (np.count_nonzero(is_repeated) or np.count_nonzero(is_zero)):
            return np.zeros(number)
        is_repeated &= values[1:] == values[:-1]
        is_zero &= values == 0.0
    is_idle = is_zero | np.concatenate([[False], is_repeated])
    return np.asarray(is_idle.reshape(-1, size).mean(axis=1))


def is_stuck(rows: Floats, size: int) -> Flags:
    """Return in which windows of ``size`` samples an axis repeats one value, (axes, k).

    ``rows`` are the samples, (axes, n), and samples after the last complete window are ignored. The
    axis must repeat the value without interruption for at least `STUCK_SHARE` of the window. It may
    change in the remaining part, for example when a fault begins or ends.
    """
    windows = rows[:, : rows.shape[1] // size * size].reshape(len(rows), -1, size)
    index = np.arange(size)
    has_changed = np.ones(windows.shape, bool)
    has_changed[:, :, 1:] = windows[:, :, 1:] != windows[:, :, :-1]
    run_lengths = index - np.maximum.accumulate(np.where(has_changed, index, 0), axis=2) + 1
    return np.asarray(run_lengths.max(axis=2, initial=0) >= STUCK_SHARE * size)


def von_neumann_ratio(parts: Iterable[Floats]) -> Floats:
    """Return the von Neumann ratio per axis, (axes,): 1 for white noise, near 0 for slow motion.

    The ratio is half the sum of the squared differences between neighboring samples, divided by the
    sum of the squared deviations from the mean of each part. Each part, (axes, n), is a sequence of
    samples without a gap. The ratio of constant samples is NaN, or 0 if their mean is rounded.
    Source: J. von Neumann, Annals of Mathematical Statistics 12 (1941), 367.
    """
    parts = list(parts)
    differences = sum((np.diff(rows, axis=1) ** 2).sum(axis=1) for rows in parts)
    deviations = sum(rows.var(axis=1) * rows.shape[1] for rows in parts)
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(0.5 * np.asarray(differences) / deviations)


class WindowClass(NamedTuple):
    """Classification of k windows; each field is an array of flags, (k,)."""

    moving: Flags  # a statistic exceeds its limit, or the window is ``decreased`` or ``foreign``
    quiet: Flags  # the window is at rest, and its noise is below the limits at which a motion ends
    stuck: Flags  # an axis with much smaller noise repeats one value
    decreased: Flags  # the noise of an axis is much smaller than the noise floor
    foreign: Flags  # the samples are not measurements in the units of the noise floor
    rotating: Flags  # the window differs from a quiet window only in its mean angular rate


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
    """Consecutive windows in one or several parts, between which gaps are possible.

    Except for ``samples`` and ``still``, the properties require at least one window.
    """

    def __init__(self, parts: tuple[WindowPart, ...] = ()) -> None:
        self._parts = parts

    def __len__(self) -> int:
        return sum(len(part.still) for part in self._parts)

    def with_part(self, part: WindowPart, most: int) -> RecentWindows:
        """Return these windows followed by ``part``, but at most the last ``most`` windows."""
        return RecentWindows((*self._parts, part)).last(most)

    def last(self, number: int) -> RecentWindows:
        """Return the last ``number`` windows, or all windows if there are fewer."""
        parts: list[WindowPart] = []
        for part in reversed(self._parts):
            if number <= 0:
                break
            parts.insert(0, part.last(number) if number < len(part.still) else part)
            number -= len(part.still)
        return RecentWindows(tuple(parts))

    @property
    def samples(self) -> list[ImuBatch]:
        """The samples of all windows, one batch for each part without a gap."""
        return [part.samples for part in self._parts]

    @property
    def rows(self) -> Floats:
        """The samples of all windows, (axes, n), in the unit of the received samples."""
        return _concatenated([part.samples.rows for part in self._parts])

    @property
    def windows(self) -> Windows:
        """The statistics of all windows."""
        return Windows.joined(part.windows for part in self._parts)

    @property
    def still(self) -> Flags:
        """Which windows are at rest, (k,)."""
        return _concatenated([part.still for part in self._parts] or [np.zeros(0, bool)])

    @property
    def found(self) -> WindowClass:
        """The classification of all windows."""
        return WindowClass(*map(_concatenated, zip(*(part.found for part in self._parts))))

    @property
    def can_be_larger_noise(self) -> bool:
        """Whether no window is at rest, and larger noise can be the reason.

        Larger noise cannot be the reason if any window is ``decreased`` or ``foreign``
        (`WindowClass`).
        """
        found = self.found
        return not (self.still.any() or (found.decreased | found.foreign).any())

    @property
    def is_steady(self) -> bool:
        """Whether all windows are quiet, or would be quiet if the gyro had another bias."""
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


def _concatenated(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate one or more arrays along the last dimension; a single array is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=-1)
