# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Passes on the windows of an IMU at rest, excludes motions, and replaces spikes and shocks.

Method
------
An isolated spike is replaced by the mean of its neighbors, unless the noise of the axis has heavy
tails. A motion begins with a window above the limits of the noise floor, and ends after some
windows below lower limits. A shock is a short motion that changes neither the mean of an axis nor
the direction of the IMU. Unless too many samples have been replaced, a shock is replaced by
a line between the means before and after the shock, and the segment continues. The windows of a
motion that may be a shock are held until the motion ends. `ImuBatch.filled` marks replaced samples.
"""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from ..imu import Flags, Floats, ImuBatch, joined
from .health import Counts, Event, Longest
from .noise_floor import LEAST_WINDOW, MAD_TO_SIGMA, TILT, NoiseFloor
from .noise_levels import Change, NoiseLevels
from .windows import WindowClass, Windows, is_stuck

SPIKE_SIGMAS = 7.0
"""An isolated sample is a spike if it deviates from the median of its window by more than this
number of standard deviations of the noise floor. At 100 Hz, 1e-10 of the samples of white noise
deviate that much. Their replacement changes the variance by less than the fraction 1e-8."""

SPIKE_NEIGHBORS, NEIGHBOR_RATIO = 4, 0.6
"""Number of samples that are examined on each side of a spike, and largest deviation of an
undisturbed sample, as a fraction of the smallest spike. A spike is isolated if neither of its two
direct neighbors, and at most one other examined sample, deviates more. In a shock, more samples
deviate."""

LONGEST_SHOCK_S = 10.0
"""Longest duration of a shock in s."""

LEVEL_WINDOWS, LEAST_LEVEL = 4, 2
"""Largest and smallest number of windows on each side of a motion whose means are compared."""

LEVEL_SIGMAS = 5.0
"""A difference between the means before and after a motion is attributed to noise unless it exceeds
this number of standard deviations of the difference."""

CHANGED_DIRECTION, NO_ROTATION = np.radians(30.0), np.radians(6.0)
"""Angles in rad. The axes of the accelerometer have changed if the measured direction of gravity
changes by more than the first angle, while the gyro measures a rotation by less than the second."""

REPLACED_SHOCK_SHARE = 0.5
"""Largest number of samples of shocks that are replaced, as a fraction of the samples at rest. Both
numbers begin at 0 after a gap or a change of the noise level."""

MARGIN_BEFORE, MARGIN_AFTER_S = 1, 2.0
"""Number of windows at rest before a motion, and time in s at rest after a motion, that are
excluded. After a motion, at least `LEAST_LEVEL` windows are excluded."""


def without_spikes(
    block: ImuBatch, size: int, before: Floats, after: Floats, floor: NoiseFloor
) -> tuple[ImuBatch, Windows, int]:
    """Replace each isolated spike by the mean of the two samples next to it.

    ``block`` consists of windows of ``size`` samples. ``before`` and ``after``, (axes, n), are up
    to `SPIKE_NEIGHBORS` samples on either side of the block. Returns the block, the statistics of
    its windows, and the number of replaced values. On axes with heavy tails, the spikes stay in the
    block, and are removed only from the statistics. No sample is replaced if ``size`` is below
    `LEAST_WINDOW`, or on an axis in a window in which more than a few samples deviate.
    """
    rows = block.rows
    windows = Windows.of(rows, size)
    threshold = SPIKE_SIGMAS * np.sqrt(floor.scale)
    has_peak = (windows.peak > threshold[:, None]) & (threshold > 0.0)[:, None]
    if not has_peak.any() or size < LEAST_WINDOW:
        return block, windows, 0
    axes, window_at = np.nonzero(has_peak)
    samples = rows.reshape(len(rows), -1, size)[axes, window_at]
    median = np.median(samples, axis=1)
    sigma = MAD_TO_SIGMA * np.median(np.abs(samples - median[:, None]), axis=1)
    # where the noise exceeds the noise floor significantly, the threshold of a spike is higher
    has_more_noise = SPIKE_SIGMAS * sigma > (1.0 + 5.0 / np.sqrt(size)) * threshold[axes]
    spike_height = np.where(has_more_noise, SPIKE_SIGMAS * sigma, threshold[axes])
    deviates = np.abs(samples - median[:, None]) > spike_height[:, None]
    # if more than a few samples deviate, the IMU moves, and no sample is replaced
    has_few_spikes = np.count_nonzero(deviates, axis=1) <= 1 + size // LEAST_WINDOW
    extended_rows = np.concatenate([before, rows, after], axis=1)
    cleaned = rows.copy()
    is_spike = np.zeros(rows.shape, bool)
    for n, k in zip(*np.nonzero(deviates & has_few_spikes[:, None])):
        axis, i = axes[n], window_at[n] * size + k
        values, j = extended_rows[axis], i + before.shape[1]
        begin = max(0, j - SPIKE_NEIGHBORS)
        deviation = np.abs(values[begin : j + SPIKE_NEIGHBORS + 1] - median[n])
        if _is_isolated(deviation > NEIGHBOR_RATIO * spike_height[n], j - begin):
            cleaned[axis, i] = 0.5 * (values[j - 1] + values[j + 1])
            is_spike[axis, i] = True
    has_spike = is_spike.any(axis=0).reshape(-1, size).any(axis=1)
    if not has_spike.any():
        return block, windows, 0
    cleaned_windows = cleaned.reshape(len(rows), -1, size)[:, has_spike].reshape(len(rows), -1)
    windows.values[:, :, has_spike] = Windows.of(cleaned_windows, size).values
    is_spike[floor.heavy] = False
    former_filled = 0 if block.filled is None else block.filled
    filled = np.where(is_spike, 1, former_filled).astype(np.int32)
    replaced = np.where(is_spike, cleaned, rows)
    block = ImuBatch.of_rows(block.stamps_ns, replaced, block.cut, filled)
    return block, windows, int(np.count_nonzero(is_spike))


def _is_isolated(deviates: Flags, i: int) -> bool:
    """Return whether a spike is isolated.

    ``deviates``, (n,), flags the samples that deviate from the median, and ``i`` is the index of
    the spike. A spike is isolated if it has two direct neighbors, neither of them is flagged, and
    at most one other sample is flagged.
    """
    has_neighbors = 0 < i < len(deviates) - 1
    return (
        has_neighbors
        and not (deviates[i - 1] or deviates[i + 1])
        and int(np.count_nonzero(deviates)) <= 2
    )


class RestLevel:
    """Means of the last windows at rest, and numbers of samples.

    ``rest`` is the number of samples at rest, and ``replaced`` the number of replaced samples of
    shocks, both since the last gap or change of the noise level.
    """

    def __init__(self) -> None:
        self.rest = self.replaced = 0
        # one more window than is compared, because the last window before a motion is not used
        self._means: deque[Floats] = deque(maxlen=LEVEL_WINDOWS + 1)

    def add(self, means: Floats, size: int) -> None:
        """Add the means, (axes, k), of windows of ``size`` samples, in the unit of the samples."""
        self.rest += means.shape[1] * size
        self._means.extend(means[:, -LEVEL_WINDOWS - 1 :].T)

    def before(self) -> Floats:
        """Return the means of the last windows, except for the very last one, (k, axes).

        They are the means before a motion that begins now; the result is empty if there are none.
        """
        return np.array(list(self._means)[:-1])


class Motion:
    """A motion that begins at the stamp ``began_ns`` in ns, and its windows up to now.

    ``kind`` is the kind of the `Event` of the motion. ``level`` contains the means before the
    motion, and is None if the motion is known to be no shock.
    """

    def __init__(self, kind: str, began_ns: int, level: RestLevel | None = None) -> None:
        self.kind = kind
        self.began_ns, self.ended_ns = began_ns, began_ns
        self.level = level
        self.windows = 0  # number of windows of the motion
        self.quiet = 0  # number of quiet windows at the end of the motion (see `WindowClass`)
        # number of windows at the end of the motion in which the IMU is at rest or only rotates
        self.steady = 0

        # whether the axes of the accelerometer were exchanged, or changed their signs
        self.axes_changed = False
        # means of the last windows before the motion, (k, axes)
        self.before = level.before() if level is not None else np.empty((0, 0))
        # means of the latest windows of the motion, (axes,) each
        self._after: deque[Floats] = deque(maxlen=LEVEL_WINDOWS)
        self._samples = 0  # number of samples of the motion
        self._total: float | Floats = 0.0  # sum of the samples of the motion, (axes,)

    def add(self, window: ImuBatch, mean: Floats, found: WindowClass) -> None:
        """Add the next window with its mean, (axes,), and its classification."""
        self.quiet = self.quiet + 1 if found.quiet else 0
        self.steady = self.steady + 1 if found.quiet or found.rotating else 0
        if not found.quiet:
            self.ended_ns = int(window.stamps_ns[-1])
        self._after.append(mean)
        self.windows += 1
        self._samples += len(window)
        self._total = self._total + len(window) * mean

    def change(self, floor: NoiseFloor) -> Floats:
        """Return the change of the mean of each axis due to the motion, (axes,).

        The change is in the unit of the samples. It is 0 if noise explains the change, and NaN for
        all axes if fewer than `LEAST_LEVEL` windows before or after the motion can be compared.
        """
        counts = len(self.before), min(self.quiet, len(self._after))
        if min(counts) < LEAST_LEVEL:
            return np.full(len(floor.mean), np.nan)
        mean_after = np.array(list(self._after)[-counts[1] :]).mean(axis=0)
        step = np.maximum(np.sqrt(2.0 / floor.size * floor.scale), floor.step)
        limit = LEVEL_SIGMAS * np.sqrt(0.5 / counts[0] + 0.5 / counts[1]) * step
        limit += np.where(floor.variance < 0.25 * floor.lsb**2, floor.lsb, 0.0)
        change = mean_after - self.before.mean(axis=0)
        return np.asarray(np.where(np.abs(change) > limit, change, 0.0))

    def finds_other_axes(self, floor: NoiseFloor, period_s: float) -> bool:
        """Return whether this call is the first that finds changed axes of the accelerometer.

        The axes changed if gravity has another direction (`CHANGED_DIRECTION`) in the last steady
        windows than before the motion, although the gyro has measured no rotation (`NO_ROTATION`)
        since the motion began. The result is False if a sensor has fewer than three axes.
        """
        gyro, counts = floor.gyro, (len(self.before), min(self.steady, len(self._after)))
        if self.axes_changed or min(counts) < LEAST_LEVEL:
            return False
        if np.count_nonzero(gyro) < 3 or np.count_nonzero(~gyro) < 3:
            return False
        mean_before = self.before.mean(axis=0)
        mean_after = np.array(list(self._after)[-counts[1] :]).mean(axis=0)
        turned_rad = np.linalg.norm((self._total - self._samples * mean_before)[gyro]) * period_s
        norms = np.linalg.norm(mean_before[~gyro]) * np.linalg.norm(mean_after[~gyro])
        cosine = mean_before[~gyro] @ mean_after[~gyro] / norms if norms else 1.0
        self.axes_changed = bool(turned_rad < NO_ROTATION and cosine < np.cos(CHANGED_DIRECTION))
        return self.axes_changed

    def replaced(self, held: list[ImuBatch], floor: NoiseFloor, period_s: float) -> list[ImuBatch]:
        """Return the windows of a shock with replaced samples; empty if the motion is no shock.

        The result is also empty if too many samples would be replaced (`REPLACED_SHOCK_SHARE`), or
        if no window at rest directly precedes the motion.

        ``held`` contains this window, if there is one, and all windows of the motion. Of the
        quiet windows at the end, only the first is replaced. The replaced windows are returned as
        one block, which is followed by the other windows.
        """
        if self.level is None or self.change(floor).any():
            return []
        if len(held) == self.windows:  # another motion ended directly before
            return []
        # means of the quiet windows at the end, except the first, whose samples are also replaced
        means_after = list(self._after)[1 - self.quiet :]
        number_compared = min(len(self.before), len(means_after))
        first_mean, last_mean = (
            np.mean(means, axis=0)
            for means in (self.before[-number_compared:], means_after[:number_compared])
        )
        turned_rad = (self._total - self._samples * first_mean)[floor.gyro] * period_s
        block = joined(held[: 1 - self.quiet])
        n = len(block)
        most_replaced = REPLACED_SHOCK_SHARE * self.level.rest - self.level.replaced
        if np.linalg.norm(turned_rad) > TILT or n > most_replaced:
            return []
        fraction = np.arange(1, n + 1) / (n + 1)
        rows = first_mean[:, None] + (last_mean - first_mean)[:, None] * fraction
        self.level.replaced += n
        filled = np.full(rows.shape, number_compared * floor.size, np.int32)
        return [ImuBatch.of_rows(block.stamps_ns, rows, block.cut, filled), *held[1 - self.quiet :]]


class RestFilter:
    """Passes on windows at rest, and excludes or replaces motions with the windows next to them.

    The passed windows are added to the present noise level of ``levels``. The noise floor of this
    level decides which windows are at rest. ``size`` is the number of samples in a window.
    ``motion`` is the present motion or None, and ``stuck``, (axes,), flags axes that repeated one
    value. ``levels``, ``events`` and ``splits`` (number of splits by reason) are changed in place.
    """

    def __init__(
        self,
        size: int,
        period_s: float,
        axes: tuple[str, ...],
        levels: NoiseLevels,
        events: Longest[Event],
        splits: Counter[str],
    ) -> None:
        self.motion: Motion | None = None
        self.stuck = np.zeros(len(axes), bool)
        self._size, self._period_s, self._axes = size, period_s, axes
        self._levels, self._events, self._splits = levels, events, splits
        self._level, self._last_mean = RestLevel(), np.full(len(axes), np.nan)
        self._cut = ''  # reason for the split before the next block at rest

        # windows not passed on yet: the last window at rest, and the windows of a possible shock
        self._held: list[ImuBatch] = []
        self._out: list[ImuBatch] = []  # blocks that are confirmed to be at rest

    @property
    def floor(self) -> NoiseFloor:
        """The present noise floor, which must be known."""
        floor = self._levels.present.floor
        assert floor is not None
        return floor

    @property
    def _counts(self) -> Counts:
        return self._levels.present.counts

    def take(self) -> list[ImuBatch]:
        """Return the samples that were confirmed to be at rest since the last call."""
        released, self._out = self._out, []
        return released

    def add(
        self, block: ImuBatch, windows: Windows, size: int, only_at_rest: bool = False
    ) -> tuple[Flags, WindowClass] | None:
        """Pass on or exclude k windows of ``size`` samples, and return which of them are at rest.

        Returns flags, (k,), that are True for the windows at rest, and the classification of the
        windows. ``block`` contains the samples of the windows, and ``windows`` their statistics.
        With ``only_at_rest``, nothing happens and None is returned if some of the windows are not
        at rest, or if a motion has not ended.
        """
        has_previous = np.isfinite(self._last_mean).all() and not block.cut
        floor, previous_mean = self.floor, self._last_mean if has_previous else None
        found = floor.classify(block.rows, windows, previous_mean, size)
        is_at_rest = ~found.moving
        all_at_rest = self.motion is None and bool(is_at_rest.all())
        if only_at_rest and not all_at_rest:
            return None
        if block.cut:
            self._pass_held()
            self._forget_level()
            if self.motion is not None:
                self.motion.before = self.motion.before[:0]
            self._cut = self._cut or block.cut
        if found.stuck.any():
            is_axis_stuck = floor.decreased(windows) & is_stuck(block.rows, size)
            self.stuck |= is_axis_stuck.any(axis=1)
        if all_at_rest:
            self._release(block, windows.mean, size)
        else:
            for i in range(len(is_at_rest)):
                window = block.part(slice(i * size, (i + 1) * size))
                self._step(window, windows.mean[:, i], WindowClass(*(v[i] for v in found)))
                is_at_rest[i] = self.motion is None
        self._last_mean = windows.mean[:, -1]
        return is_at_rest, found

    def end_segment(self) -> None:
        """Pass on or exclude the windows that are held, because the segment ends."""
        self.drop_shock()
        self._pass_held()

    def drop(self, samples: list[ImuBatch], kind: str) -> None:
        """Exclude samples in motion before the noise floor is known.

        ``kind`` is the kind of the motion. It is also the reason that is stored for the split
        before the next samples at rest.
        """
        self._counts.moving += sum(map(len, samples))
        if self.motion is None:
            self.motion = Motion(kind, int(samples[0].stamps_ns[0]))
            self._splits[kind] += 1
        self.motion.ended_ns = int(samples[-1].stamps_ns[-1])
        self._cut = kind

    def begin_level(self, split_reason: str) -> None:
        """Continue with another noise level, and split the data for the given reason."""
        self._forget_level()
        self.motion, self._cut = None, split_reason

    def drop_shock(self) -> None:
        """Exclude the windows held for the present motion, if any, because it is no shock."""
        motion = self.motion
        if motion is not None and motion.level is not None:
            self._counts.moving += sum(map(len, self._held))
            self._splits[motion.kind] += 1
            self._cut = self._cut or motion.kind
            motion.level, self._held = None, []

    def name_motion(self, kind: Change, number: int) -> None:
        """Count the last ``number`` samples as a change of the noise (``kind``), not as motion.

        The present motion, if any, becomes an event of this kind, and is no shock.
        """
        self.drop_shock()
        counts = self._counts
        counts.moving -= number
        setattr(counts, kind, getattr(counts, kind) + number)
        if self.motion is not None:
            self.motion.kind = kind

    def log_motion(self) -> None:
        """Add the motion that just ended, if any, to the list of events."""
        motion, self.motion = self.motion, None
        if motion is not None:
            changes = zip(self._axes, motion.change(self.floor).tolist())
            seconds = (motion.ended_ns - motion.began_ns) * 1e-9 + self._period_s
            changed = {axis: change for axis, change in changes if abs(change) > 0.0}
            self._events.add(seconds, Event(motion.kind, motion.began_ns, seconds, changed))

    def _step(self, window: ImuBatch, mean: Floats, found: WindowClass) -> None:
        """Pass on a window at rest, or add the window to a motion.

        A window that is not at rest begins a motion. Until a motion ends, all windows are added.
        """
        if self.motion is None and not found.moving:
            self._release(window, mean[:, None], len(window))
            return
        if self.motion is None:
            kind = 'noise_decreased' if found.decreased else 'motion'
            kind = 'stuck' if found.stuck else kind
            self.motion = Motion(kind, int(window.stamps_ns[0]), self._level)
        motion = self.motion
        if found.decreased:
            self.drop_shock()
            excluded_as = 'stuck' if found.stuck else 'noise_decreased'
            setattr(self._counts, excluded_as, getattr(self._counts, excluded_as) + len(window))
        elif motion.level is None:
            self._counts.moving += len(window)
        else:
            self._held.append(window)
        motion.add(window, mean, found)
        window_s = self._size * self._period_s
        margin_windows = max(LEAST_LEVEL, round(MARGIN_AFTER_S / window_s))
        # tested before the motion ends, because a changed bias of the gyro may prolong the motion
        if motion.steady == margin_windows and motion.finds_other_axes(self.floor, self._period_s):
            self._splits['axes changed'] += 1
        if motion.windows - motion.quiet > int(LONGEST_SHOCK_S / window_s):
            self.drop_shock()
        if motion.quiet >= margin_windows:
            self._end_motion(motion)

    def _end_motion(self, motion: Motion) -> None:
        """End a motion: replace the samples of a shock and pass them on, or else split the data."""
        shock_blocks = motion.replaced(self._held, self.floor, self._period_s)
        if shock_blocks:
            motion.kind = 'shock'
            self._counts.shocks += 1
            self._counts.replaced += len(shock_blocks[0])
            self._held = []
        else:
            self.drop_shock()
        self.log_motion()
        self._pass_on(shock_blocks[:1])
        for window in shock_blocks[1:]:
            self._release(window, window.rows.mean(axis=1)[:, None], len(window))

    def _release(self, block: ImuBatch, means: Floats, size: int) -> None:
        """Pass on windows at rest, except for the last one, because a motion may follow.

        ``means``, (axes, k), are the means of the windows of ``size`` samples.
        """
        self._level.add(means, size)
        self._pass_held()
        number_released = max(0, len(block) - MARGIN_BEFORE * self._size)
        cut, self._cut = self._cut, ''
        if number_released:
            self._pass_on([block.part(slice(number_released), cut)])
            cut = ''
        self._held = [block.part(slice(number_released, None), cut)]

    def _pass_held(self) -> None:
        self._pass_on(self._held)
        self._held = []

    def _pass_on(self, blocks: list[ImuBatch]) -> None:
        self._out += blocks
        for block in blocks:
            self._levels.present.add(block)

    def _forget_level(self) -> None:
        self._level, self._last_mean = RestLevel(), np.full(len(self._axes), np.nan)
