# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion gate: only spans in which the IMU is still count as evidence.

The stream is looked at in windows of about half a second. A window is hot when it stands out of
the sensor's own noise floor: by its variance, by its farthest sample, by a step of its mean, or by
a mean rate away from the still one. The thresholds lie so far out that honest noise is not trimmed
(the chance that a window of pure white noise is hot is below 1e-12, so the bias of N is nil), and a
sensor whose noise grew by half still passes. Leaving takes calmer windows than entering, and a
margin before and after is left out with the motion.

The floor is learned from the first windows and follows the quiet quarter of each later block; all
is counted in windows from the start of a stretch without cuts, never in chunks.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .health import Counts
from .noise_floor import NoiseFloor, Windows
from .timing import Block

Floats = NDArray[np.float64]

Stamps = NDArray[np.int64]

Flags = NDArray[np.bool_]


WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short against a motion."""


MOST_WINDOW = 1024
"""Longest window in samples; the shortest is `LEAST_WINDOW`."""


LEARN_WINDOWS = 32
"""Windows the floor is learned from, and after which it is updated."""


MARGIN_BEFORE, MARGIN_AFTER = 1, 4
"""Windows left out before a motion and after it: 0.5 s and 2 s."""


RELEARNED = 'relearned'
"""The cut of a run before which no evidence of this stream counts."""


class _Judged(NamedTuple):
    """Windows of the present block, with what was measured and said of them."""

    run: Block
    windows: Windows
    still: Flags
    verdict: WindowClass


class StillnessStage:
    """Passes on the still spans of runs; at most the learning windows wait."""

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
        self._counts = counts
        self._ratio = motion_ratio
        self._rate_limit = np.array(
            [rate_limit if axis.startswith('gyro') else np.inf for axis in axes]
        )
        self._floor: NoiseFloor | None = None
        self._learning: list[Block] = []  # stretches that wait for the floor
        self._stamps = np.empty(0, np.int64)  # samples that wait to fill a window
        self._rows = np.empty((len(axes), 0))
        self._last_mean: Floats | None = None
        self._calm = 0  # calm windows since the motion
        self._cut = ''  # why the next still run does not follow on the last one
        self._margin: list[Block] = []  # still windows that a motion may yet take back
        self._stretch_cut = ''  # why the samples that wait do not follow on those before
        self._block: list[_Judged] = []
        self._in_block = 0

    @property
    def learning(self) -> bool:
        """The noise floor is not known yet."""
        return self._floor is None

    def feed(self, runs: list[Block]) -> list[Block]:
        """Take runs that came one after the other, return the still ones that are certain."""
        out: list[Block] = []
        for stretch in _stretches(runs):
            if self._floor is None:
                self._learning += stretch
                if sum(len(r.stamps) for r in self._learning) >= LEARN_WINDOWS * self.size:
                    out += self._learn()
            else:
                out += self._take(stretch)
        return out

    def _take(self, stretch: list[Block]) -> list[Block]:
        """Take runs that follow on each other; the cut of the first says if on those before."""
        out: list[Block] = []
        cut = stretch[0].cut
        if cut:
            out += self._end_stretch()
        self._stretch_cut = self._stretch_cut or cut
        for run in stretch:
            # only the window that began before is copied together
            seam = -len(self._stamps) % self.size
            if seam:
                out += self._fill(run.stamps[:seam], run.rows[:, :seam])
            out += self._fill(run.stamps[seam:], run.rows[:, seam:])
        return out

    def _fill(self, stamps: Stamps, rows: Floats) -> list[Block]:
        """Judge the windows that more samples fill; the others wait."""
        if len(self._stamps):
            stamps = np.concatenate([self._stamps, stamps])
            rows = np.concatenate([self._rows, rows], axis=1)
        out: list[Block] = []
        at, have = 0, len(stamps) // self.size
        measured = Windows.of(rows[:, : have * self.size], self.size)
        while at < have:
            k = min(have - at, LEARN_WINDOWS - self._in_block)
            part = slice(at * self.size, (at + k) * self.size)
            run = Block(stamps[part], rows[:, part], self._stretch_cut)
            self._stretch_cut = ''
            out += self._judge(run, self.size, measured[at : at + k])
            self._in_block += k
            at += k
            if self._in_block == LEARN_WINDOWS:
                out += self._follow()
        self._stamps = stamps[have * self.size :].copy()
        self._rows = rows[:, have * self.size :].copy()
        return out

    def flush(self) -> list[Block]:
        """Return what still waits: no more samples come."""
        out = self._learn() if self._floor is None else []
        return out + self._end_stretch()

    def _learn(self) -> list[Block]:
        """Learn the floor from the first windows, then judge what waited."""
        waited, self._learning = self._learning, []
        if not waited:
            return []
        self._floor = NoiseFloor.learned(self._first_rows(waited), self.size, len(self._rows))
        return self.feed(waited)

    def _first_rows(self, waited: list[Block]) -> Iterator[Floats]:
        """Yield the samples that make the learning windows, whatever chunk they came in."""
        left = LEARN_WINDOWS * self.size
        for stretch in _stretches(waited):
            rows = np.concatenate([run.rows for run in stretch], axis=1)[:, :left]
            left -= rows.shape[1]
            yield rows

    def _end_stretch(self) -> list[Block]:
        """Judge the window that will not fill, and let go of the margin."""
        out: list[Block] = []
        if len(self._stamps) and self._floor is not None:
            last = Block(self._stamps, self._rows, self._stretch_cut)
            out += self._judge(last, len(last.stamps), Windows.of(last.rows, len(last.stamps)))
        self._stretch_cut = ''
        self._stamps = self._stamps[:0]
        self._rows = self._rows[:, :0]
        out += self._margin
        self._margin = []
        return out

    def _judge(self, run: Block, size: int, windows: Windows) -> list[Block]:
        """Judge the windows of a run; ``run.cut`` says why it does not follow on those before."""
        out: list[Block] = []
        if run.cut:
            out, self._margin = self._margin, []
            self._last_mean = None
            self._cut = self._cut or run.cut
        assert self._floor is not None
        verdict = classify_windows(
            windows, self._last_mean, size, self._floor, self._ratio, self._rate_limit
        )
        still = ~verdict.hot
        if self.moving or verdict.hot.any():
            for i in range(len(still)):
                part = slice(i * size, (i + 1) * size)
                window = Block(run.stamps[part], run.rows[:, part])
                out += self._step(window, *(bool(v[i]) for v in verdict[:3]))
                still[i] = not self.moving
        else:
            out += self._pass_on(Block(run.stamps, run.rows))
        self._last_mean = windows.mean[:, -1]
        if size == self.size:
            self._block.append(_Judged(run, windows, still, verdict))
        return out

    def _step(self, run: Block, hot: bool, calm: bool, stuck: bool) -> list[Block]:
        """Take one window through the state machine."""
        if not self.moving and not hot:
            return self._pass_on(run)
        if not self.moving:
            self.moving = True
            reason = 'stuck' if stuck else 'motion'
            self._counts.cuts[reason] += 1
            self._counts.moving += sum(len(r.stamps) for r in self._margin)
            self._margin = []
            self._cut = self._cut or reason
        if stuck:
            self._counts.stuck += len(run.stamps)
        else:
            self._counts.moving += len(run.stamps)
            self._counts.saturated += saturated(run.rows)
        self._calm = self._calm + 1 if calm else 0
        if self._calm >= MARGIN_AFTER:
            self.moving = False
            self._calm = 0
        return []

    def _pass_on(self, run: Block) -> list[Block]:
        """Let a still run go, but for the last window: a motion may begin in the next."""
        out = self._margin
        split = max(0, len(run.stamps) - MARGIN_BEFORE * self.size)
        cut, self._cut = self._cut, ''
        if split:
            out = [*out, Block(run.stamps[:split], run.rows[:, :split], cut)]
            cut = ''
        self._margin = [Block(run.stamps[split:], run.rows[:, split:], cut)]
        return out

    def _follow(self) -> list[Block]:
        """Follow the noise floor after a block of windows; start anew if it was none."""
        floor = self._floor
        assert floor is not None
        block, self._block, self._in_block = self._block, [], 0
        windows = Windows.joined(judged.windows for judged in block)
        anew = floor.if_learned_in_motion(windows)
        if anew is not None:
            self._floor = anew
            return self._judge_anew(block)
        still = np.concatenate([judged.still for judged in block])
        turning = all(judged.verdict.turning_only.all() for judged in block)
        self._floor = floor.following(windows, still, turning)
        return []

    def _judge_anew(self, block: list[_Judged]) -> list[Block]:
        """Judge a block again with the floor learned from it; all before it is void."""
        # what was passed on is counted as moving by whoever voids it
        self._counts.moving += sum(len(r.stamps) for r in self._margin)
        samples = sum(len(j.run.stamps) for j in block)
        stuck = self.size * sum(int(np.count_nonzero(j.verdict.stuck)) for j in block)
        self._counts.moving -= samples - stuck
        self._counts.stuck -= stuck
        self._margin = []
        self._last_mean = None
        self.moving, self._calm, self._cut = True, 0, 'motion'
        out = [Block(block[0].run.stamps[:0], block[0].run.rows[:, :0], RELEARNED)]
        for judged in block:
            out += self._judge(judged.run, self.size, judged.windows)
        self._block = []
        return out


def _stretches(runs: list[Block]) -> list[list[Block]]:
    """Return the runs in groups that follow on each other."""
    groups: list[list[Block]] = []
    for run in runs:
        if run.cut or not groups:
            groups.append([])
        groups[-1].append(run)
    return groups


LEAST_WINDOW = 16
"""Samples from which the variance of a window says something."""


LEAVE_SHARE = 0.8
"""Motion ends below this share of the standard deviation at which it begins."""


PEAK_SIGMAS = 20.0
"""A sample this many floor deviations from its window's mean is a knock. Real accelerometers at
rest show single samples at 10 deviations every few minutes: those are their noise."""


STEP_SIGMAS = 8.0
"""Means of neighbouring windows this many of their own deviations apart are a motion."""


class WindowClass(NamedTuple):
    """What k windows are, (k,) bool arrays.

    ``hot``: motion, or an axis ``stuck`` at one value. ``calm``: may end a motion.
    ``turning_only``: nothing stands out but the mean rate.
    """

    hot: Flags
    calm: Flags
    stuck: Flags
    turning_only: Flags


class _Limits(NamedTuple):
    """Where a window begins to stand out, (axes, 1) arrays; infinite where the floor is unknown."""

    variance: Floats
    peak: Floats
    step: Floats
    turn: Floats

    @classmethod
    def of(cls, floor: NoiseFloor, size: int, motion_ratio: float, rate_limit: Floats) -> _Limits:
        scale, lsb = floor.scale[:, None], floor.lsb[:, None]
        unknown = np.where(scale > 0.0, 0.0, np.inf)
        sigma = np.sqrt(scale)
        step_sigma = np.maximum(np.sqrt(2.0 / size) * sigma, floor.step[:, None])
        # few samples spread a variance: a short window is judged by its farthest sample alone
        unsure = unknown if size >= LEAST_WINDOW else np.full_like(unknown, np.inf)
        return cls(
            motion_ratio**2 * scale + unsure,
            np.maximum(PEAK_SIGMAS * sigma, 2.5 * lsb) + unknown,
            STEP_SIGMAS * step_sigma + lsb + unsure,
            np.maximum(rate_limit[:, None], STEP_SIGMAS * step_sigma),
        )


def classify_windows(
    windows: Windows,
    previous_mean: Floats | None,
    size: int,
    floor: NoiseFloor,
    motion_ratio: float,
    rate_limit: Floats,
) -> WindowClass:
    """Hold windows of ``size`` samples against the floor.

    Parameters
    ----------
    previous_mean : (axes,) array or None
        Of the window before the first; None when it does not follow on any.
    motion_ratio : float
        Standard deviation of a moving window over that of the floor.
    rate_limit : (axes,) array
        Least mean rate, away from the still one, that is a turn.
    """
    limits = _Limits.of(floor, size, motion_ratio, rate_limit)
    previous = windows.mean[:, :1] if previous_mean is None else previous_mean[:, None]
    means = np.concatenate([previous, windows.mean], axis=1)
    step = np.abs(means[:, 1:] - means[:, :-1])
    restless = windows.variance > LEAVE_SHARE**2 * limits.variance
    knocked = (windows.peak > limits.peak) | (step > limits.step)
    turning = np.abs(windows.mean - floor.mean[:, None]) > limits.turn
    quiet = np.zeros(windows.mean.shape[1], bool)
    if windows.variance.all() and not (restless | knocked | turning).any():
        return WindowClass(quiet, ~quiet, quiet, quiet)  # the common case: an IMU at rest
    noisy = (floor.variance > floor.lsb**2)[:, None] & (size >= LEAST_WINDOW)
    stuck = ((windows.variance == 0.0) & noisy).any(axis=0)
    wild = windows.variance > limits.variance
    hot = (wild | knocked | turning).any(axis=0) | stuck
    restless_any = (restless | knocked).any(axis=0) | stuck
    return WindowClass(hot, ~(hot | restless_any), stuck, turning.any(axis=0) & ~restless_any)


def saturated(rows: Floats) -> int:
    """Return how many samples of a moving window stand at their axis' extreme, three in a row."""
    size = np.abs(rows)
    top = size == size.max(axis=1, keepdims=True)
    three = top[:, 2:] & top[:, 1:-1] & top[:, :-2]
    inside = np.zeros(rows.shape[1], bool)
    for axis in np.flatnonzero(three.any(axis=1) & (rows.min(axis=1) < rows.max(axis=1))):
        for shift in range(3):
            inside[shift : shift + three.shape[1]] |= three[axis]
    return int(np.count_nonzero(inside))
