# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Levels of the noise at rest: each has its own noise floor, Allan sums and counts.

When the noise changes, a new level begins. At first, the new level is on trial: the Allan sums of
the previous level remain the result of the stream, and continue if the previous noise returns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from ..allan.replaced_stretches import RunningStretches
from ..allan.running import RunningSums
from ..allan.sums import AllanSums
from ..imu import Flags, Floats, ImuBatch, ImuIdentity
from .health import LISTED_SEGMENTS, Counts, Longest, Segment
from .noise_floor import NoiseFloor
from .sensors import MIN_CLIPPED, Clipping

Change = Literal['noise_decreased', 'noise_increased']
"""How the noise of a level differs from the noise of the previous level. If an axis begins to be
clipped, its noise counts as decreased."""

ExcludedAs = Literal['moving', 'stuck', 'noise_decreased', 'noise_increased']
"""Field of `Counts` that counts the samples of a noise level that is excluded from the result."""


class StreamSums(NamedTuple):
    """Allan sums and longest segments of data at one sample rate."""

    sums: AllanSums
    segments: tuple[Segment, ...]


class NoiseLevel:
    """Allan sums, segments and counts of the samples at rest at one noise level.

    ``floor`` is the noise floor, None before it is known. ``counts`` are the numbers of used and
    excluded samples, and of shocks, since the level began. ``first_ns`` and ``last_ns`` are the
    first and the last stamp of the used samples in ns, 0 before the first sample. ``kept`` contains
    these samples if ``with_samples`` is set.
    """

    def __init__(
        self, identity: ImuIdentity, axes: tuple[str, ...], with_samples: bool = False
    ) -> None:
        self.floor: NoiseFloor | None = None
        self.counts = Counts()
        self.kept: list[ImuBatch] = []
        self.first_ns = self.last_ns = 0
        self._with_samples = with_samples
        self._engine = RunningSums(identity, axes)
        self._replaced = RunningStretches(len(axes))
        self.axes, self._clipping = axes, Clipping(len(axes))
        self._segments: Longest[Segment] = Longest(LISTED_SEGMENTS)
        # first stamp of the present segment, and reason for the split before this segment
        self._start_ns, self._cut = 0, ''

    @property
    def samples(self) -> int:
        """Number of samples in the Allan sums of this level."""
        return self._engine.samples

    @property
    def is_examined(self) -> bool:
        """Whether samples were searched for clipped values."""
        return self._clipping.samples > 0

    @property
    def clipped(self) -> dict[str, float]:
        """Axis -> clipped share of its examined samples, for shares of at least `MIN_CLIPPED`."""
        shares = zip(self.axes, self._clipping.shares.tolist())
        return {axis: share for axis, share in shares if share >= MIN_CLIPPED}

    @property
    def result(self) -> StreamSums:
        """The Allan sums of this level, and the longest of its segments that have ended."""
        sums = replace(self._engine.sums, replaced=self._replaced.table)
        return StreamSums(sums, self._segments.items)

    def add(self, block: ImuBatch) -> None:
        """Add samples at rest. They directly follow the previous samples if ``block.cut`` is ''."""
        if block.cut:
            self.close()
        if not len(block):
            return
        if not self._engine.open_samples:
            self._start_ns, self._cut = int(block.stamps_ns[0]), block.cut
        if not self._engine.samples:
            self.first_ns = self._start_ns
        self.last_ns = int(block.stamps_ns[-1])
        self.counts.used += len(block)
        self._replaced.add(block.filled)
        self._clipping.add(block.rows)
        interpolated = None if block.filled is None else np.asarray(block.filled.any(axis=0))
        self._engine.update(block.samples, int(block.stamps_ns[0]), self.last_ns, interpolated)
        if self._with_samples:
            self.kept.append(block.copy())

    def close(self) -> None:
        """End the present segment."""
        samples = self._engine.open_samples
        if samples:
            duration_s = (self.last_ns - self._start_ns) * 1e-9
            self._segments.add(samples, Segment(self._start_ns, samples, duration_s, self._cut))
            self._engine.end_segment()
            self._replaced.add(None)

    def counted_as(self, excluded: ExcludedAs) -> Counts:
        """Return the counts of this level if its samples are excluded for the given reason."""
        counts = replace(
            self.counts, used=0, shocks=0, replaced=0, splits=self.counts.splits.copy()
        )
        if excluded in ('moving', 'stuck'):  # the noise seemed to decrease when the motion ended
            counts.moving, counts.noise_decreased = counts.moving + counts.noise_decreased, 0
        setattr(counts, excluded, getattr(counts, excluded) + self.counts.used)
        return counts


class NoiseLevels:
    """The present noise level of a stream, and the other level to which the noise may return.

    ``start`` returns a new level without samples. ``is_tried`` tells whether the present level is
    on trial, so that the Allan sums of the other level are the result. ``change`` tells how the
    noise changed when the latest trial began; it is 'noise_increased' before the first trial.

    ``largest_ratio``, (axes,), are the largest ratios of the noise to the noise floor in the calls
    of `add_increase`, but at least 1. ``smallest_ratio``, (axes,), are the smallest ratios in the
    calls of `add_decrease`, but at most 1. `accept` and `replace_present` reset both to 1.
    """

    def __init__(self, start: Callable[[], NoiseLevel]) -> None:
        self._start = start
        self.present = start()
        self.other: NoiseLevel | None = None
        self.is_tried = False
        self.change: Change = 'noise_increased'
        axes = len(self.present.axes)
        self.largest_ratio, self.smallest_ratio = np.ones(axes), np.ones(axes)
        self._began_ns = 0  # stamp at which the noise changed to the level on trial

        # field of `Counts` for the samples of the other level, while the present level is the
        # `published` level
        self._other_is: ExcludedAs = 'moving'
        self._dropped = Counts()  # counts of the levels that were discarded
        # number of discarded levels that were `published` before a later level replaced them
        self._drops = 0

        # first stamp of the first level with samples; None until this level has ended
        self._first_ns: int | None = None
        # last stamp of the level that `_drops` counted most recently
        self._last_ns = 0

    @property
    def published(self) -> NoiseLevel:
        """The level whose Allan sums are the result of the stream."""
        return self.other if self.is_tried and self.other is not None else self.present

    @property
    def counts(self) -> Counts:
        """Counts of the used and excluded samples of all levels."""
        counts = replace(self._dropped, splits=self._dropped.splits.copy())
        if self.is_tried and self.other is not None:
            counts.add(self.other.counts)
            counts.add(self.present.counted_as(self.change))
            return counts
        counts.add(self.present.counts)
        if self.other is not None:
            counts.add(self.other.counted_as(self._other_is))
        return counts

    @property
    def lost(self) -> int:
        """Number of `published` noise levels that a later level has replaced.

        A level that is `published` again, or has no samples, is not counted. A level that is kept,
        because its noise may return, is counted when the later level has samples.
        """
        return self._drops + (not self.is_tried and self._precedes_present(self.other))

    @property
    def lost_s(self) -> float:
        """Time in s from the first sample at rest to the first sample of the `published` level.

        The time is 0 if `lost` is 0. While the `published` level has no samples, the time ends at
        the last sample of the latest discarded level that `lost` counts.
        """
        if not self.lost:
            return 0.0
        end_ns = self.published.first_ns if self.published.samples else self._last_ns
        return (end_ns - (self._first_ns or 0)) * 1e-9

    @property
    def lasts_longer(self) -> bool:
        """Whether the present level is on trial, but has more samples than the other level."""
        return (
            self.is_tried and self.other is not None and self.present.samples > self.other.samples
        )

    def replace_present(self, floor: NoiseFloor, reason: Literal['moving', 'stuck']) -> None:
        """Discard the present level, whose samples are not usable, and begin another level."""
        if not self.is_tried and self.present.samples:
            self._drops += 1
            self._last_ns = self.present.last_ns
        self._dropped.add(self.present.counted_as(reason))
        self._forget_ratios()
        self._begin(floor)

    def try_another(self, floor: NoiseFloor, change: Change, began_ns: int) -> None:
        """Begin another level on trial. The `published` level remains the same.

        A present level that is on trial is discarded. Otherwise, the present level becomes the
        other level, to which the noise may return.
        """
        if self.is_tried:
            self._dropped.add(self.present.counted_as(self.change))
        else:
            if self.other is not None:
                is_first = not self.present.samples or self._precedes_present(self.other)
                if self.other.samples and is_first:
                    self._drops += 1
                    self._last_ns = self.other.last_ns
                self._dropped.add(self.other.counted_as(self._other_is))
            self.other, self._began_ns = self.present, began_ns
        self.is_tried, self.change = True, change
        self._begin(floor)

    def resume(self) -> int | None:
        """Continue the other stored level, because the noise is at that level again.

        Returns the stamp in ns at which the noise changed, if the present level was on trial; else
        None.
        """
        assert self.other is not None
        self._end_present()
        was_tried, self.is_tried = self.is_tried, False
        if was_tried:
            self._dropped.add(self.present.counted_as(self.change))
            self.present, self.other = self.other, None
            return self._began_ns
        self.present, self.other = self.other, self.present
        self._other_is = self.change if self._other_is == 'moving' else 'moving'
        return None

    def accept(self) -> None:
        """Publish the Allan sums of the present level instead of the sums of the other level.

        The other level is kept, because its noise may return.
        """
        self.is_tried, self._other_is = False, 'moving'
        self._forget_ratios()

    def add_increase(self, ratio: Floats) -> None:
        """Update ``largest_ratio`` with ratios of the noise to the noise floor, (axes,)."""
        self.largest_ratio = np.maximum(self.largest_ratio, ratio)

    def add_decrease(self, variance: Floats, decreased: Flags, floor: Floats) -> None:
        """Update ``smallest_ratio`` with the ratios of decreased noise to the floor in k windows.

        ``variance`` and ``decreased``, (axes, k), are the variances and the flags for decreased
        noise. ``floor``, (axes,), is the variance of the noise floor.
        """
        has_decreased = decreased.any(axis=1)
        variances = np.where(decreased, variance, np.nan)[has_decreased]
        ratio = np.sqrt(np.nanmean(variances, axis=1) / floor[has_decreased])
        self.smallest_ratio[has_decreased] = np.minimum(self.smallest_ratio[has_decreased], ratio)

    def _precedes_present(self, level: NoiseLevel | None) -> bool:
        """Return whether ``level`` has an earlier first stamp than the present level.

        The result is False if ``level`` is None, or if one of the two levels has no samples.
        """
        if level is None or not (level.samples and self.present.samples):
            return False
        return level.first_ns < self.present.first_ns

    def _forget_ratios(self) -> None:
        """Reset the ratios, because they are ratios to a former noise floor."""
        self.largest_ratio = np.ones_like(self.largest_ratio)
        self.smallest_ratio = np.ones_like(self.smallest_ratio)

    def _end_present(self) -> None:
        self.present.close()
        if self._first_ns is None and self.present.samples:
            self._first_ns = self.present.first_ns

    def _begin(self, floor: NoiseFloor) -> None:
        self._end_present()
        self.present = self._start()
        self.present.floor = floor
