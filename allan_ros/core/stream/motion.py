# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion gate: passes on the samples of an IMU at rest.

The stream is classified in windows of about half a second. A window is moving if its variance, its
most distant sample, a step of its mean or its mean rate differs from the noise floor of the sensor
at rest. The thresholds are so high that stationary noise is not trimmed (the probability that a
window of white noise is moving is below 1e-12, so N has no bias), and that a sensor passes whose
noise grew by half. A motion ends at a lower threshold than it begins. Margins before and after it
are excluded, too.

Before, isolated spikes are replaced by the mean of their neighbors. If the noise has heavy tails,
they stay and do not count as motion. Noise that becomes louder while the IMU stays at rest is
distinguished from motion and counted separately.

The floor is learned from the first windows in which the IMU can be at rest. It follows the quiet
quarter of each later block. All decisions count windows from the start of a stretch without gaps,
independent of the chunks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .health import Counts, State
from .noise_floor import (
    LEAST_WINDOW,
    SPIKE_NEIGHBORS,
    NoiseFloor,
    RestLimits,
    Windows,
    without_spikes,
)
from .timing import Block

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short compared with a motion."""

MOST_WINDOW = 1024
"""Longest window in samples."""

BLOCK_WINDOWS = 32
"""Number of windows from which the floor is learned, and after which it is updated."""

MARGIN_BEFORE, MARGIN_AFTER = 1, 4
"""Windows excluded before and after a motion: 0.5 s and 2 s."""

RELEARNED = 'relearned'
"""Reason for a split after which all earlier data of this stream are invalid, because they were
taken in motion."""

LEAVE_RATIO = 0.8
"""Motion ends below this fraction of the standard deviation at which it begins."""

KNOCK_SIGMAS = 20.0
"""A sample this many floor deviations from the mean of its window is a knock."""

STEP_SIGMAS = 8.0
"""Means of neighboring windows that differ by this many of their standard deviations indicate
motion."""

LOUDER_BLOCKS = 2
"""Number of consecutive noisy blocks, about 30 s, that count as louder noise instead of motion."""

LEAST_PLATEAU, PLATEAU_STEP_LSB = 3, 4.0
"""Number of equal samples at the end of the range, and smallest step to them in resolutions, that
count as saturated. At a coarse resolution, the peak of a slow motion has equal samples, too."""


class WindowClass(NamedTuple):
    """Classification of k windows, (k,) bool arrays.

    ``moving``: motion, or an axis ``stuck`` at one value. ``quiet``: may end a motion.
    ``turning_only``: only the mean rate differs from the floor.
    """

    moving: Flags
    quiet: Flags
    stuck: Flags
    turning_only: Flags


class _Judged(NamedTuple):
    """Windows of the present block of windows, with their statistics and class."""

    block: Block
    windows: Windows
    still: Flags
    windows_class: WindowClass


class MotionGate:
    """Passes on the samples at rest; at most the windows of the learning phase are buffered.

    ``counts`` is changed in place. A window is moving above ``motion_ratio`` times the standard
    deviation of the floor, or ``rate_limit`` rad/s away from the mean rate at rest. ``louder`` is
    the present ratio of the noise at rest to the floor, (axes,), or None if the noise is not
    louder; ``loudest`` contains the largest values so far, or 0.
    """

    def __init__(
        self,
        period_ns: float,
        axes: tuple[str, ...],
        counts: Counts,
        motion_ratio: float,
        rate_limit: float,
    ) -> None:
        wanted = round(WINDOW_S * 1e9 / period_ns)
        self.size = int(np.clip(wanted, LEAST_WINDOW, MOST_WINDOW))
        self.moving = False
        self.louder: Floats | None = None
        self.loudest = np.zeros(len(axes))
        self._counts = counts
        self._ratio = motion_ratio
        self._limits = RestLimits.of(axes, rate_limit)
        self._floor: NoiseFloor | None = None
        # stretches that are buffered until the floor is known; samples that do not fill a window
        # yet
        self._learning: list[Block] = []
        self._waiting = Block(np.empty(0, np.int64), np.empty((len(axes), 0)))
        self._before = np.empty((len(axes), 0))  # the last samples before them
        self._extreme = np.zeros(len(axes))  # largest value of each axis, either way
        self._last_mean: Floats | None = None
        self._quiet = 0  # quiet windows since the motion
        self._cut = ''  # why the next still block does not follow the last one
        self._margin: list[Block] = []  # still windows that a motion may yet take back
        self._stretch_cut = ''  # why the waiting samples do not follow those before
        self._block: list[_Judged] = []
        self._in_block = 0
        self._noisy_blocks = 0

    @property
    def state(self) -> State:
        """State of the stream: learning as long as neither the noise floor nor motion is known."""
        if self._floor is None and not self.moving:
            return 'learning'
        if self.louder is not None:
            return 'louder'
        return 'moving' if self.moving else 'still'

    def feed(self, blocks: list[Block]) -> list[Block]:
        """Add consecutive blocks, and return the data that are definitely at rest."""
        out: list[Block] = []
        for stretch in _stretches(blocks):
            if self._floor is None:
                self._learning += stretch
                needed = BLOCK_WINDOWS * self.size
                while self._floor is None and sum(map(len, self._learning)) >= needed:
                    out += self._learn()
            else:
                out += self._take(stretch)
        return out

    def flush(self) -> list[Block]:
        """Return the buffered data at the end of the input."""
        out: list[Block] = []
        while self._floor is None and self._learning:
            out += self._learn()
        return out + self._end_stretch()

    # --- learning ---------------------------------------------------------------------------------

    def _learn(self) -> list[Block]:
        """Learn the floor from the first windows, or drop them if the IMU cannot be at rest in
        them."""
        first, rest = _split(self._learning, BLOCK_WINDOWS * self.size)
        stretches = [np.concatenate([b.rows for b in s], axis=1) for s in _stretches(first)]
        floor = NoiseFloor.learned(stretches, self.size, self._limits)
        if floor.can_be_rest():
            self._floor = floor
            waited, self._learning = self._learning, []
            self.moving = False
            return self.feed(waited)
        self._learning = rest
        self._counts.moving += sum(map(len, first))
        if not self.moving:
            self.moving = True
            self._counts.cuts['motion'] += 1
        self._cut = 'motion'
        return []

    # --- windows ----------------------------------------------------------------------------------

    def _take(self, stretch: list[Block]) -> list[Block]:
        """Add blocks that follow each other; only the first may follow a gap."""
        out: list[Block] = []
        if stretch[0].cut:
            out += self._end_stretch()
        self._stretch_cut = self._stretch_cut or stretch[0].cut
        for block in stretch:
            # only the window that began in the buffer is copied; its look-ahead is the start of the
            # next window, which is a view
            seam = -len(self._waiting) % self.size + SPIKE_NEIGHBORS
            out += self._fill(block.part(slice(None, seam)))
            if len(block) > seam:
                self._waiting = self._waiting.part(slice(0))
                out += self._fill(block.part(slice(seam - SPIKE_NEIGHBORS, None)))
        return out

    def _fill(self, more: Block) -> list[Block]:
        """Classify the complete windows whose look-ahead is available; other samples stay
        buffered."""
        have = Block.joined([self._waiting, more]) if len(self._waiting) else more
        ready = max(0, len(have) - SPIKE_NEIGHBORS) // self.size * self.size
        out = self._windows(have, ready, self.size) if ready else []
        self._waiting = have.part(slice(ready, None)).copy()
        return out

    def _end_stretch(self) -> list[Block]:
        """Classify the last windows of a stretch without look-ahead, and release the margin."""
        out: list[Block] = []
        rest, self._waiting = self._waiting, self._waiting.part(slice(0))
        while len(rest) and self._floor is not None:
            size = min(len(rest), self.size)
            out += self._windows(rest, size, size)
            rest = rest.part(slice(size, None))
        self._before = self._before[:, :0]
        out += self._margin
        self._margin = []
        return out

    def _windows(self, have: Block, samples: int, size: int) -> list[Block]:
        """Classify the first ``samples`` in windows of ``size``; the others are the look-ahead."""
        assert self._floor is not None
        block, after = have.part(slice(samples)), have.rows[:, samples : samples + SPIKE_NEIGHBORS]
        before, self._before = self._before, block.rows[:, -SPIKE_NEIGHBORS:].copy()
        block, windows, spikes = without_spikes(block, size, before, after, self._floor)
        self._counts.spikes += spikes
        out: list[Block] = []
        at, number = 0, samples // size
        while at < number:
            k = min(number - at, BLOCK_WINDOWS - self._in_block)
            part = block.part(slice(at * size, (at + k) * size), self._stretch_cut)
            self._stretch_cut = ''
            out += self._judge(part, size, windows[at : at + k])
            at += k
            if size == self.size:
                self._in_block += k
                if self._in_block == BLOCK_WINDOWS:
                    out += self._end_block()
        return out

    # --- still or moving --------------------------------------------------------------------------

    def _judge(self, block: Block, size: int, windows: Windows) -> list[Block]:
        """Classify the windows of a block; ``block.cut`` is set if it does not follow the last
        block."""
        out: list[Block] = []
        if block.cut:
            out, self._margin = self._margin, []
            self._last_mean = None
            self._cut = self._cut or block.cut
        assert self._floor is not None
        found = classify_windows(windows, self._last_mean, size, self._floor, self._ratio)
        still = ~found.moving
        if self.moving or found.moving.any():
            for i in range(len(still)):
                window = block.part(slice(i * size, (i + 1) * size))
                out += self._step(window, *(bool(v[i]) for v in found[:3]))
                still[i] = not self.moving
        else:
            out += self._pass_on(block.part(slice(None)))
        self._last_mean = windows.mean[:, -1]
        if size == self.size:
            self._block.append(_Judged(block, windows, still, found))
        return out

    def _step(self, window: Block, moving: bool, quiet: bool, stuck: bool) -> list[Block]:
        """Update the state of the gate by one window."""
        if not self.moving and not moving:
            return self._pass_on(window)
        if not self.moving:
            self.moving = True
            reason = 'stuck' if stuck else 'motion'
            self._counts.cuts[reason] += 1
            self._counts.moving += sum(map(len, self._margin))
            self._margin = []
            self._cut = self._cut or reason
        if stuck:
            self._counts.stuck += len(window)
        else:
            self._counts.moving += len(window)
            self._counts.saturated += self._saturated(window.rows)
        self._quiet = self._quiet + 1 if quiet else 0
        if self._quiet >= MARGIN_AFTER:
            self.moving = False
            self._quiet = 0
        return []

    def _pass_on(self, block: Block) -> list[Block]:
        """Release a still block except its last window, since a motion may begin in the next
        one."""
        out = self._margin
        split = max(0, len(block) - MARGIN_BEFORE * self.size)
        cut, self._cut = self._cut, ''
        if split:
            out = [*out, block.part(slice(split), cut)]
            cut = ''
        self._margin = [block.part(slice(split, None), cut)]
        return out

    def _saturated(self, rows: Floats) -> int:
        """Return how many samples of a moving window are at the end of the range.

        The end of the range is the largest value of the axis so far, kept for several samples
        after a large step.
        """
        assert self._floor is not None
        size = np.abs(rows)
        self._extreme = np.maximum(self._extreme, size.max(axis=1))
        top = size >= self._extreme[:, None]
        inside = np.zeros(rows.shape[1], bool)
        for axis in np.flatnonzero(np.count_nonzero(top, axis=1) >= LEAST_PLATEAU):
            edges = np.flatnonzero(np.diff(top[axis], prepend=False, append=False))
            for a, b in edges.reshape(-1, 2):
                outside = [rows[axis, i] for i in (a - 1, b) if 0 <= i < rows.shape[1]]
                step = max((abs(rows[axis, a] - x) for x in outside), default=0.0)
                if b - a >= LEAST_PLATEAU and step >= PLATEAU_STEP_LSB * self._floor.lsb[axis] > 0:
                    inside[a:b] = True
        return int(np.count_nonzero(inside))

    # --- the floor --------------------------------------------------------------------------------

    def _end_block(self) -> list[Block]:
        """Update the floor after a block of windows; restart if the floor was learned in motion."""
        floor = self._floor
        assert floor is not None
        block, self._block, self._in_block = self._block, [], 0
        windows = Windows.joined(judged.windows for judged in block)
        relearned = floor.if_learned_in_motion(windows)
        if relearned is not None:
            self._floor = relearned
            return self._judge_again(block)
        still = np.concatenate([judged.still for judged in block])
        turning = all(judged.windows_class.turning_only.all() for judged in block)
        following = floor.following(windows, still, turning)
        if following.can_be_rest():
            self._floor = following
        self._note_louder(block, windows, still)
        return []

    def _note_louder(self, block: list[_Judged], windows: Windows, still: Flags) -> None:
        """Distinguish a block of louder noise from motion, and count it separately."""
        ratio = None
        if not still.any() and not any(j.windows_class.stuck.any() for j in block):
            assert self._floor is not None
            rows = np.concatenate([judged.block.rows for judged in block], axis=1)
            ratio = self._floor.louder(rows, windows)
        self._noisy_blocks = 0 if ratio is None else self._noisy_blocks + 1
        self.louder = ratio if self._noisy_blocks >= LOUDER_BLOCKS else None
        if self.louder is None:
            return
        blocks = LOUDER_BLOCKS if self._noisy_blocks == LOUDER_BLOCKS else 1
        samples = blocks * BLOCK_WINDOWS * self.size
        self._counts.moving -= samples
        self._counts.louder += samples
        self.loudest = np.maximum(self.loudest, self.louder)

    def _judge_again(self, block: list[_Judged]) -> list[Block]:
        """Classify a block again with the floor learned from it; all earlier data are invalid."""
        # released samples are counted as moving when they are discarded
        self._counts.moving += sum(map(len, self._margin))
        samples = sum(len(j.block) for j in block)
        stuck = self.size * sum(int(np.count_nonzero(j.windows_class.stuck)) for j in block)
        self._counts.moving -= samples - stuck
        self._counts.stuck -= stuck
        self._margin = []
        self._last_mean = None
        self._noisy_blocks, self.louder = 0, None
        self.moving, self._quiet, self._cut = True, 0, 'motion'
        out = [block[0].block.part(slice(0), RELEARNED)]
        for judged in block:
            out += self._judge(judged.block, self.size, judged.windows)
        self._block = []
        return out


def _stretches(blocks: list[Block]) -> list[list[Block]]:
    """Return groups of consecutive blocks."""
    groups: list[list[Block]] = []
    for block in blocks:
        if block.cut or not groups:
            groups.append([])
        groups[-1].append(block)
    return groups


def _split(blocks: list[Block], samples: int) -> tuple[list[Block], list[Block]]:
    """Split consecutive blocks after a number of samples."""
    first: list[Block] = []
    for i, block in enumerate(blocks):
        if len(block) > samples:
            return (
                [*first, block.part(slice(samples), block.cut)] if samples else first,
                [block.part(slice(samples, None), '' if samples else block.cut), *blocks[i + 1 :]],
            )
        first.append(block)
        samples -= len(block)
    return first, []


def classify_windows(
    windows: Windows,
    previous_mean: Floats | None,
    size: int,
    floor: NoiseFloor,
    motion_ratio: float,
) -> WindowClass:
    """Compare windows of ``size`` samples with the floor, by the ``motion_ratio`` of `MotionGate`.

    ``previous_mean``, (axes,), is the mean of the window before the first; None if there is none.
    """
    # (axes, 1) each; infinite if the floor is unknown
    scale, lsb = floor.scale[:, None], floor.lsb[:, None]
    unknown = np.where(scale > 0.0, 0.0, np.inf)
    sigma = np.sqrt(scale)
    step_sigma = np.maximum(np.sqrt(2.0 / size) * sigma, floor.step[:, None])
    # the variance of few samples scatters: short windows are classified by their most distant
    # sample
    unsure = unknown if size >= LEAST_WINDOW else np.full_like(unknown, np.inf)
    most_variance = motion_ratio**2 * scale + unsure
    most_peak = np.maximum(KNOCK_SIGMAS * sigma, 2.5 * lsb) + unknown
    most_step = STEP_SIGMAS * step_sigma + lsb + unsure
    most_turn = np.maximum(floor.limits.turn[:, None], STEP_SIGMAS * step_sigma)
    previous = windows.mean[:, :1] if previous_mean is None else previous_mean[:, None]
    means = np.concatenate([previous, windows.mean], axis=1)
    step = np.abs(means[:, 1:] - means[:, :-1])
    restless = windows.variance > LEAVE_RATIO**2 * most_variance
    knocked = (windows.peak > most_peak) | (step > most_step)
    turning = np.abs(windows.mean - floor.mean[:, None]) > most_turn
    none = np.zeros(windows.mean.shape[1], bool)
    if windows.variance.all() and not (restless | knocked | turning).any():
        return WindowClass(none, ~none, none, none)  # the common case: an IMU at rest
    noisy = (floor.variance > floor.lsb**2)[:, None] & (size >= LEAST_WINDOW)
    stuck = ((windows.variance == 0.0) & noisy).any(axis=0)
    wild = windows.variance > most_variance
    moving = (wild | knocked | turning).any(axis=0) | stuck
    restless_any = (restless | knocked).any(axis=0) | stuck
    return WindowClass(moving, ~(moving | restless_any), stuck, turning.any(axis=0) & ~restless_any)
