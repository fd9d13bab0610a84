# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise floor, which is the noise of an IMU at rest, and the classification of windows.

The noise floor is learned from short windows of samples. Later windows are compared with the noise
floor, and classified as at rest or moving.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ..imu import Flags, Floats
from ..settings import SegmenterSettings
from .health import changed_gyro_unit, gravity_unit
from .sensors import clipped_shares, extreme_shares
from .windows import WindowClass, Windows, idle_share, is_stuck, von_neumann_ratio

LEAST_WINDOW = 16
"""Smallest number of samples in a window, except for a shorter window before a gap. The variance of
fewer samples is too uncertain."""

QUANTILE = 0.25
"""The noise floor is this quantile of the variances of the windows. Therefore, up to about three
quarters of the windows may contain motion."""

MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation of a zero-mean normal variable to the median of its absolute
value."""

FLOOR_GAIN = 0.25
"""Weight of the latest block of windows when the variance of the noise floor is updated."""

DECREASE_RATIO = 5.0
"""The noise of an axis decreased if its standard deviation in a window is smaller than the noise
floor by more than this factor. Less than 1e-8 of the shortest windows of white noise have so small
a standard deviation (chi-squared with 15 degrees of freedom)."""

SHAKEN_RATIO = 30.0
"""If the standard deviation of at least `MOVING_AXES` axes is larger by more than this factor than
at another time, the IMU was shaken. Fans, motors and settings of the sensor change the noise less.
"""

MOVING_AXES = 2
"""Smallest number of axes whose noise a motion is assumed to increase; a fault may affect only
one."""

SAME_GRAVITY = 0.15
"""Largest relative change of the magnitude of the mean specific force that is attributed to a
motion. A larger change is attributed to a fault or to another unit of measurement."""

GRAVITY_CHANGE = 0.5
"""Largest change of the magnitude of the mean specific force, in m/s^2, that is attributed to a
changed bias."""

IDLE_SHARE = 0.4
"""A window with at least this share of idle samples does not consist of measurements. A sample is
idle if all axes of a sensor are zero or repeat the previous sample. In white noise on three axes
with a standard deviation above the resolution, less than 10 % of the samples are idle."""

COLORED_STEP = 3.0
"""If the steps between window means exceed the steps of white noise by this factor, the noise is
not white."""

LOW_FREQUENCY = 0.2
"""Below this von Neumann ratio, low frequencies dominate the noise."""

OUTLIER_MADS = 6.0
"""An outlier deviates from the median of its window by more than this number of median absolute
deviations (four standard deviations of white noise)."""

HEAVY_SHARE, LEAST_HEAVY = 5e-3, 3
"""Noise has heavy tails if at least `LEAST_HEAVY` samples, and at least the share `HEAVY_SHARE` of
the samples, are outliers. The share of outliers is 5e-5 in white noise, and 7e-3 for a t
distribution with five degrees of freedom."""

EXAMINED = 16
"""After the noise floor is learned, only one in this number of windows is searched for outliers, if
it is at rest. This saves time."""

CLIPPED_SHARE, UNCLIPPED = 0.1, 0.25
"""An axis begins to be clipped when at least the share `CLIPPED_SHARE` of its samples is clipped.
Clipping ends when the share of samples at an extreme value is less than `UNCLIPPED` times the share
that was clipped when the noise floor was learned. With a single limit, a share near this limit
would change the noise level again and again."""

INCREASE_RATIO = 1.5
"""Ratio of the standard deviation of an axis to its noise floor above which the noise counts as
increased."""

INCREASE_SPREAD = 4.0
"""At least 90 % of the variances of windows of stationary noise lie within this factor of their
median."""

INCREASE_SPECTRUM = 0.5
"""The von Neumann ratio of increased noise is at least this fraction of the ratio of the noise
floor or of white noise, whichever is smaller. A motion has a smaller ratio, because a motion has
low frequencies."""

TILT = 0.035
"""Largest angle in rad (2 degrees) between the directions of gravity at two times, relative to the
sensor, for which the IMU counts as not tilted. A tilt by this angle changes the vector of gravity
by the same fraction of its magnitude."""


LEAVE_RATIO = 0.8
"""A motion ends when the standard deviation is below this fraction of the limit at which a motion
begins."""

SHOCK_SIGMAS = 20.0
"""A sample that deviates from the mean of its window by more than this number of standard
deviations of the noise floor is due to a shock or another motion."""

STEP_SIGMAS = 8.0
"""Means of neighboring windows that differ by more than this number of standard deviations of the
difference indicate motion."""

PLAUSIBLE_DEVIATION, PLAUSIBLE_STEP = (0.1, 1.5), (0.0087, 0.15)
"""Two limits for the noise at rest, each for a gyro (rad/s) and an accelerometer (m/s^2). The first
is for the standard deviation in a window if low frequencies dominate the noise. The second is for
the step between the means of neighboring windows if white noise does not explain this step. White
noise has no limit, because very large white noise is due to a wrong unit, not to motion."""


class RestLimits(NamedTuple):
    """Largest statistics of a window at rest, (axes, 1) each.

    ``step`` is the largest difference between the means of neighboring windows, and ``rate`` the
    largest difference between the mean of a window and the mean of the noise floor. For an axis
    with a `NoiseFloor.scale` of 0, all except ``rate`` are infinite. For an accelerometer, ``rate``
    is infinite. For windows with fewer than `LEAST_WINDOW` samples, ``variance`` and ``step`` are
    infinite.
    """

    variance: Floats
    peak: Floats
    step: Floats
    rate: Floats


@dataclass(frozen=True)
class NoiseFloor:
    """The noise of an IMU at rest, estimated from windows of at most ``size`` samples.

    The arrays are (axes,). ``step``, ``mean`` and ``lsb`` are in the unit of the samples.
    """

    size: int
    gyro: Flags  # whether the axis belongs to the gyro
    settings: SegmenterSettings
    variance: Floats  # variance in a window at rest, in the squared unit of the samples
    step: Floats  # standard deviation of the step between the means of neighboring windows
    mean: Floats  # mean of the samples at rest, estimated from the means of the windows
    lsb: Floats  # smallest difference, other than 0, between successive samples; 0 if there is none
    ratio: Floats  # von Neumann ratio of the samples
    clipped: Floats  # share of the samples that are clipped, or 0 if below `MIN_CLIPPED`
    windows: Windows  # windows from which the noise floor was learned
    outliers: Floats  # number of outliers of each axis among the examined samples
    examined: float = 0.0  # number of samples that were searched for outliers

    @classmethod
    def learned(
        cls, parts: list[Floats], size: int, gyro: Flags, settings: SegmenterSettings
    ) -> NoiseFloor:
        """Return the noise floor of samples, of which at least a quarter should be at rest.

        ``gyro``, (axes,), flags the axes of the gyro. Each part, (axes, n), is a sequence of
        samples without a gap. A part with fewer than ``size`` samples is one window, and a part
        with fewer than two samples is ignored. If no part has two samples, all estimates are 0,
        except for ``ratio``, which is NaN. Windows in which an axis repeats one value (`is_stuck`)
        do not contribute to ``variance`` and ``mean`` of this axis, unless there are more than
        three quarters of such windows.
        """
        parts = [rows for rows in parts if rows.shape[1] > 1]
        zeros = np.zeros(len(gyro))
        if not parts:
            return cls(
                size,
                gyro,
                settings,
                variance=zeros,
                step=zeros,
                mean=zeros,
                lsb=zeros,
                ratio=zeros + np.nan,
                clipped=zeros,
                windows=Windows(np.zeros((3, len(gyro), 0))),
                outliers=zeros,
            )
        part_windows = [Windows.of(rows, min(size, rows.shape[1])) for rows in parts]
        windows = Windows.joined(part_windows)
        mean_steps = np.concatenate(
            [np.abs(np.diff(part.mean, axis=1)) for part in part_windows], axis=1
        )
        sample_steps = np.concatenate([np.abs(np.diff(rows, axis=1)) for rows in parts], axis=1)
        lsb = np.where(sample_steps > 0.0, sample_steps, np.inf).min(axis=1)
        lsb = np.where(np.isfinite(lsb), lsb, 0.0)
        stuck_windows = np.concatenate(
            [is_stuck(rows, min(size, rows.shape[1])) for rows in parts], axis=1
        )
        is_mostly_stuck = (stuck_windows.mean(axis=1) > 1.0 - QUANTILE)[:, None]
        axis_windows = [
            Windows(windows.values[:, [axis]][:, :, is_used])
            for axis, is_used in enumerate(~stuck_windows | is_mostly_stuck)
        ]
        return cls(
            size,
            gyro,
            settings,
            variance=np.concatenate([_quantile(w.variance, QUANTILE) for w in axis_windows]),
            step=MAD_TO_SIGMA * _quantile(mean_steps, 0.5) if mean_steps.size else zeros,
            mean=np.concatenate([_quantile(w.mean, 0.5) for w in axis_windows]),
            lsb=lsb,
            ratio=von_neumann_ratio(parts),
            clipped=clipped_shares(np.concatenate(parts, axis=1)),
            windows=windows,
            outliers=zeros,
        )

    @property
    def heavy(self) -> Flags:
        """Which axes have noise with heavy tails, (axes,).

        On these axes, isolated large values are noise, not spikes.
        """
        return np.asarray(self.outliers >= max(LEAST_HEAVY, HEAVY_SHARE * self.examined))

    def with_outliers(self, rows: Floats) -> NoiseFloor:
        """Return this noise floor with the outliers among further samples added to its counts.

        ``rows``, (axes, k * size), are the samples of k windows.
        """
        if not rows.size:
            return self
        windows = rows.reshape(len(rows), -1, self.size)
        deviation = np.abs(windows - _quantile(windows, 0.5)[:, :, None]).reshape(len(rows), -1)
        # half the resolution is added, because the deviations are rounded
        limit = OUTLIER_MADS * (_quantile(deviation, 0.5) + 0.5 * self.lsb)
        outliers = np.count_nonzero(deviation > limit[:, None], axis=1)
        examined = self.examined + deviation.shape[1]
        return replace(self, outliers=self.outliers + outliers, examined=examined)

    @cached_property
    def scale(self) -> Floats:
        """Variance from which the limits are computed, (axes,): at least (lsb / 2)^2."""
        return np.maximum(self.variance, 0.25 * self.lsb**2)

    @property
    def rate_limit(self) -> Floats:
        """Lower bound of the limit for the change of a mean rate at rest, (axes,), in rad/s.

        Noise can make the limit larger. The bound is infinite for accelerometers.
        """
        return np.where(self.gyro, self.settings.rate_limit, np.inf)

    def changed_unit(self, ratio: Floats) -> str:
        """Return the unit of the gyro if the noise shows that the unit is not rad/s, else ''.

        ``ratio``, (axes,), is the standard deviation of the noise, divided by the standard
        deviation at another time, at which the unit was rad/s. The result is also '' for fewer than
        three axes of the gyro, or if the noise of the accelerometer is much larger, too.
        """
        return changed_gyro_unit(ratio[self.gyro], ratio[~self.gyro])

    def is_plausible(self) -> bool:
        """Return whether an IMU at rest can have this noise; if not, the IMU moved."""
        white_step = np.sqrt(2.0 / self.size) * np.sqrt(self.scale)
        is_colored = self.step > COLORED_STEP * white_step
        has_large_steps = (self.step > np.where(self.gyro, *PLAUSIBLE_STEP)) & is_colored
        has_large_noise = self.variance > np.where(self.gyro, *PLAUSIBLE_DEVIATION) ** 2
        return not bool((has_large_steps | (has_large_noise & (self.ratio < LOW_FREQUENCY))).any())

    @cached_property
    def limits(self) -> RestLimits:
        """Limits for the statistics of a window with the ``size`` of this noise floor."""
        return self.limits_of(self.size)

    def limits_of(self, size: int) -> RestLimits:
        """Return the limits for the statistics of a window of ``size`` samples at rest.

        A window before a gap may have fewer samples than the other windows.
        """
        # added to the limits: infinite for an axis without noise
        allowance = np.where(self.scale > 0.0, 0.0, np.inf)
        # the variance of few samples is uncertain, so short windows are classified only by their
        # peak and mean rate
        short_allowance = allowance if size >= LEAST_WINDOW else np.full_like(allowance, np.inf)
        sigma = np.sqrt(self.scale)
        step_sigma = np.maximum(np.sqrt(2.0 / size) * sigma, self.step)
        return RestLimits(
            (self.settings.motion_ratio**2 * self.scale + short_allowance)[:, None],
            (np.maximum(SHOCK_SIGMAS * sigma, 2.5 * self.lsb) + allowance)[:, None],
            (STEP_SIGMAS * step_sigma + self.lsb + short_allowance)[:, None],
            np.maximum(self.rate_limit, STEP_SIGMAS * step_sigma)[:, None],
        )

    def rest(self, block: Windows) -> Flags:
        """Return in which windows the noise agrees with this noise floor, (k,)."""
        scale = self.scale[:, None]
        has_more_noise = (block.variance > self.settings.motion_ratio**2 * scale) & (scale > 0.0)
        return ~np.asarray((self.decreased(block) | has_more_noise).any(axis=0))

    def decreased(self, block: Windows) -> Flags:
        """Return in which windows an axis has much less noise than this floor, (axes, k).

        An axis whose noise floor does not exceed the resolution is never flagged.
        """
        is_resolved = self.variance > self.lsb**2
        is_smaller = DECREASE_RATIO**2 * block.variance < self.variance[:, None]
        return np.asarray(is_resolved[:, None] & is_smaller)

    @cached_property
    def gravity(self) -> float:
        """Magnitude of the mean specific force at rest, in the unit of the samples.

        It is NaN without the three axes of an accelerometer.
        """
        has_three_axes = np.count_nonzero(~self.gyro) == 3
        return float(np.linalg.norm(self.mean[~self.gyro])) if has_three_axes else np.nan

    def foreign(self, rows: Floats, windows: Windows, size: int) -> Flags:
        """Return which windows cannot be measurements in the units of this noise floor, (k,).

        A window is flagged if the magnitude of its mean specific force differs from the magnitude
        at rest by more than `GRAVITY_CHANGE` and `SAME_GRAVITY` allow, or if at least the share
        `IDLE_SHARE` of the samples of a sensor are zero, or repeat the previous sample, on all axes
        of the sensor. The magnitude is compared only if the accelerometer has three axes. Only a
        sensor with three axes, all with noise above the resolution, is searched for zeros and
        repeats. ``rows``, (axes, k * size), are the samples of the windows.
        """
        is_foreign = np.zeros(windows.mean.shape[1], bool)
        for axes in self._known_sensors:
            is_foreign |= idle_share(rows[axes], size) >= IDLE_SHARE
        if np.isfinite(gravity := self.gravity):
            magnitude = np.sqrt((windows.mean[~self.gyro] ** 2).sum(axis=0))
            largest_change = SAME_GRAVITY * np.maximum(magnitude, gravity)
            is_foreign |= np.abs(magnitude - gravity) > np.maximum(GRAVITY_CHANGE, largest_change)
        return np.asarray(is_foreign)

    @cached_property
    def _known_sensors(self) -> list[slice]:
        """One slice of axis indices per sensor with three axes, all with noise above `lsb`."""
        is_resolved = self.variance > self.lsb**2
        return [
            axes for axes in _complete_sensors(tuple(self.gyro.tolist())) if is_resolved[axes].all()
        ]

    def has_wrong_unit(self, later: NoiseFloor) -> bool:
        """Return whether this noise floor has a wrong unit, and a later noise floor the right unit.

        This is so if only the later gravity has the magnitude of gravity in m/s^2, or if the change
        of the noise shows that the unit of the gyro was not rad/s before (`changed_unit`).
        """
        with np.errstate(invalid='ignore', divide='ignore'):
            if self.changed_unit(np.sqrt(self.variance / later.variance)):
                return True
        return gravity_unit(later.gravity) == 'm/s^2' != gravity_unit(self.gravity)

    def newly_clipped(self, rows: Floats) -> Flags:
        """Return which axes are clipped in ``rows``, but were not when the floor was learned.

        At least the share `CLIPPED_SHARE` of the samples must be clipped. ``rows`` are the latest
        samples: (axes, n), or (axes, groups, n) for several groups of n samples. The result is
        (axes,), or (groups, axes) for several groups.
        """
        return np.asarray((self.clipped == 0.0) & (clipped_shares(rows).T >= CLIPPED_SHARE))

    def has_same_clipping(self, rows: Floats) -> bool:
        """Return whether the same axes are clipped in ``rows`` as when the floor was learned.

        ``rows`` are the latest samples: (axes, n), or (axes, groups, n) for several groups of n
        samples. The result is True only if it is True for each group. `CLIPPED_SHARE` and
        `UNCLIPPED` are the limits at which the clipping of an axis begins and ends.
        """
        if self.newly_clipped(rows).any():
            return False
        was_clipped = self.clipped > 0.0
        if not was_clipped.any():
            return True
        shares = extreme_shares(rows[was_clipped]).T
        return not (shares < UNCLIPPED * self.clipped[was_clipped]).any()

    def is_nearer(self, other: NoiseFloor, rows: Floats, windows: Windows) -> bool:
        """Return whether samples, (axes, n), fit this noise floor better than another noise floor.

        ``windows`` are the statistics of the samples. If the two floors have different clipped
        axes, the clipped axes of the samples decide. Otherwise, the noise decides.
        """
        if ((self.clipped > 0.0) != (other.clipped > 0.0)).any():
            return self.has_same_clipping(rows) and not other.has_same_clipping(rows)
        return self.distance(windows) < other.distance(windows)

    def distance(self, windows: Windows) -> float:
        """Return the mean over the axes of abs(log(v / `scale`)).

        v is the lower median of the variances of the windows. Axes for which the logarithm is not
        finite are ignored. The mean of no axes is 0. There must be at least one window.
        """
        with np.errstate(invalid='ignore', divide='ignore'):
            log_ratio = np.log(_quantile(windows.variance, 0.5) / self.scale)
        log_ratio = log_ratio[np.isfinite(log_ratio)]
        return float(np.abs(log_ratio).mean()) if len(log_ratio) else 0.0

    def revived(self, rows: Floats) -> Flags:
        """Return which axes, (axes,), had no noise when the floor was learned, but have noise now.

        Such an axis may have changed in some windows when the floor was learned. ``rows``,
        (axes, n), are the latest samples.
        """
        is_revived = self.variance == 0.0
        if is_revived.any():
            is_revived[is_revived] = is_stuck(rows[is_revived], self.size).mean(axis=1) < 0.5
        return np.asarray(is_revived)

    def shows_motion(self, former: NoiseFloor, axes: Flags) -> bool:
        """Return whether the IMU moved when the noise floor ``former`` was learned.

        This noise floor was learned later. ``axes``, (axes,), flags the axes whose noise is smaller
        than before. The IMU moved if the former noise was very large (`SHAKEN_RATIO`), was not
        stationary or had low frequencies, or if the mean rate or the mean specific force changed.

        The noise may also change without motion: because of a fault of a few axes, a setting of the
        sensor, a fan, or another unit of measurement. The result is therefore False if fewer than
        `MOVING_AXES` of the axes now have noise above the former resolution, or if the magnitude of
        gravity or the unit of the gyro changed. Unless the former noise was very large, the result
        is also False if fewer than the share `QUANTILE` of the former windows agree with the former
        noise.
        """
        axes = axes & (self.variance > former.lsb**2)
        if np.count_nonzero(axes) < MOVING_AXES:
            return False
        gravity_before, gravity_now = (
            np.linalg.norm(floor.mean[~self.gyro]) for floor in (former, self)
        )
        if abs(gravity_before - gravity_now) > SAME_GRAVITY * max(gravity_before, gravity_now):
            return False
        with np.errstate(invalid='ignore', divide='ignore'):
            ratio = np.sqrt(former.variance / self.variance)
        if self.changed_unit(ratio):
            return False
        if np.count_nonzero(axes & (ratio > SHAKEN_RATIO)) >= MOVING_AXES:
            return True
        is_at_rest = former.rest(former.windows)
        windows = Windows(former.windows.values[:, :, is_at_rest])
        has_few_at_rest = np.count_nonzero(is_at_rest) < QUANTILE * len(is_at_rest)
        return not (has_few_at_rest or self._is_at_rest(windows, former.ratio, axes))

    def updated(self, block: Windows, still: Flags, steady: bool) -> NoiseFloor:
        """Return the noise floor updated by a block of k windows.

        ``still``, (k,), flags windows at rest. If at least half of the windows are at rest,
        ``variance`` and ``mean`` are updated from these windows. ``steady`` is the property
        `RecentWindows.is_steady` of the block. If fewer windows are at rest in a steady block, only
        ``mean`` is updated, because the bias of the gyro changed suddenly, or was learned during a
        rotation.
        """
        if 2 * np.count_nonzero(still) >= len(still):
            windows_at_rest = block if still.all() else Windows(block.values[:, :, still])
            recent_variance = _quantile(windows_at_rest.variance, QUANTILE)
            variance = self.variance + FLOOR_GAIN * (recent_variance - self.variance)
            return replace(self, variance=variance, mean=_quantile(windows_at_rest.mean, 0.5))
        return replace(self, mean=_quantile(block.mean, 0.5)) if steady else self

    def increase(self, rows: Floats, block: Windows) -> Floats | None:
        """Return the ratio of the noise of a block at rest to the noise floor, (axes,).

        The ratio of an axis with a `scale` of 0 is 1.

        ``rows``, (axes, n), are the samples of the block, and ``block`` are the statistics of its
        windows. Returns None if no ratio exceeds `INCREASE_RATIO`, if the IMU moves, or if a ratio
        is not finite.
        """
        scale = self.scale
        with np.errstate(invalid='ignore', divide='ignore'):
            ratio = np.sqrt(_quantile(block.variance, 0.5) / scale)
        ratio[scale == 0.0] = 1.0
        has_increased = ratio > INCREASE_RATIO
        if not has_increased.any() or not np.isfinite(ratio).all():
            return None
        return ratio if self._is_at_rest(block, von_neumann_ratio([rows]), has_increased) else None

    def _is_at_rest(self, block: Windows, spectrum: Floats, increased: Flags) -> bool:
        """Return whether the IMU is at rest although the noise of some axes increased.

        ``block`` contains windows with the increased noise, ``spectrum``, (axes,), is the von
        Neumann ratio of this noise, and ``increased``, (axes,), flags these axes. The IMU is at
        rest if the noise is stationary and has no narrow spectrum (`INCREASE_SPECTRUM`), if noise
        explains the steps between window means, and if neither the mean rate nor the mean specific
        force changed. The rate is not compared if the unit of the gyro changed.
        """
        median_variance, scale = _quantile(block.variance, 0.5), self.scale
        is_near_median = block.variance <= INCREASE_SPREAD * median_variance[:, None]
        is_near_median &= INCREASE_SPREAD * block.variance >= median_variance[:, None]
        if (is_near_median[increased].mean(axis=1) < 0.9).any():
            return False
        smallest_ratio = INCREASE_SPECTRUM * np.fmin(self.ratio, 1.0)
        if (spectrum[increased] < smallest_ratio[increased]).any():
            return False
        sigma = np.sqrt(np.maximum(median_variance, scale))
        white_step = np.sqrt(2.0 / self.size) * sigma
        steps = np.abs(np.diff(block.mean, axis=1))
        largest_step = COLORED_STEP * np.maximum(white_step, self.step)
        if (MAD_TO_SIGMA * _quantile(steps, 0.5) > largest_step).any():
            return False
        change = np.abs(_quantile(block.mean, 0.5) - self.mean)
        gravity = float(np.linalg.norm(self.mean[~self.gyro]))
        with np.errstate(invalid='ignore', divide='ignore'):
            unit = self.changed_unit(np.sqrt(median_variance / scale))
        rates = np.inf if unit else self.rate_limit
        largest_change = np.where(self.gyro, rates, TILT * gravity) + white_step
        return not bool((change > largest_change).any())

    def classify(
        self, rows: Floats, windows: Windows, previous_mean: Floats | None, size: int
    ) -> WindowClass:
        """Return which windows of ``size`` samples are at rest, compared with the noise floor.

        ``rows``, (axes, k * size), are the samples of the windows. ``previous_mean``, (axes,), is
        the mean of the window before the first window, or None if it is not known.
        """
        limits = self.limits if size == self.size else self.limits_of(size)
        previous = windows.mean[:, :1] if previous_mean is None else previous_mean[:, None]
        means = np.concatenate([previous, windows.mean], axis=1)
        step = np.abs(means[:, 1:] - means[:, :-1])
        is_noisy = windows.variance > LEAVE_RATIO**2 * limits.variance
        is_shaken = (windows.peak > limits.peak) | (step > limits.step)
        is_rotating = np.abs(windows.mean - self.mean[:, None]) > limits.rate
        no_flags = np.zeros(windows.mean.shape[1], bool)
        has_less_noise = np.asarray(self.decreased(windows) & (size >= LEAST_WINDOW))
        is_foreign = no_flags if size < LEAST_WINDOW else self.foreign(rows, windows, size)
        if not ((is_noisy | is_shaken | is_rotating | has_less_noise).any() or is_foreign.any()):
            return WindowClass(
                no_flags, ~no_flags, no_flags, no_flags, no_flags, no_flags
            )  # the common case: all windows are at rest
        is_decreased, has_stuck_axis = np.asarray(has_less_noise.any(axis=0)), no_flags
        if is_decreased.any():
            has_stuck_axis = np.asarray((has_less_noise & is_stuck(rows, size)).any(axis=0))
        is_moving = ((windows.variance > limits.variance) | is_shaken | is_rotating).any(
            axis=0
        ) | is_decreased
        is_moving |= is_foreign
        is_disturbed = (is_noisy | is_shaken).any(axis=0) | is_decreased | is_foreign
        is_only_rotating = is_rotating.any(axis=0) & ~is_disturbed
        is_quiet = ~(is_moving | is_disturbed)
        return WindowClass(
            is_moving, is_quiet, has_stuck_axis, is_decreased, is_foreign, is_only_rotating
        )


@lru_cache
def _complete_sensors(are_gyro_axes: tuple[bool, ...]) -> list[slice]:
    """Return one slice of axis indices for each sensor that has all of its three axes.

    ``are_gyro_axes`` flags the axes of the gyro.
    """
    first_axes = [
        i
        for i, is_gyro_axis in enumerate(are_gyro_axes)
        if not i or is_gyro_axis != are_gyro_axes[i - 1]
    ]
    return [slice(i, i + 3) for i in first_axes if are_gyro_axes.count(are_gyro_axes[i]) == 3]


def _quantile(values: Floats, share: float) -> Floats:
    """Return a quantile over the last dimension without interpolation (the lower value)."""
    k = int(share * (values.shape[-1] - 1))
    return np.asarray(np.partition(values, k, axis=-1)[..., k])
