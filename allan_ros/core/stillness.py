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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .clock import Run
from .health import Counts

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

WINDOW_S = 0.5
"""Length of a window in s: long enough for a variance, short against a motion."""

LEAST_WINDOW, MOST_WINDOW = 16, 1024
"""Bounds of a window in samples."""

LEARN_WINDOWS = 32
"""Windows the floor is learned from, and after which it is updated."""

QUIET = 0.25
"""The floor is this quantile of the windows' variances: three quarters of them may be motion."""

LEAVE_SHARE = 0.8
"""Motion ends below this share of the standard deviation at which it begins."""

PEAK_SIGMAS = 20.0
"""A sample this many floor deviations from its window's mean is a knock. Real accelerometers at
rest show single samples at 10 deviations every few minutes: those are their noise."""

STEP_SIGMAS = 8.0
"""Means of neighbouring windows this many of their own deviations apart are a motion."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal variable over its median absolute value."""

MARGIN_BEFORE, MARGIN_AFTER = 1, 4
"""Windows left out before a motion and after it: 0.5 s and 2 s."""

FLOOR_GAIN = 0.25
"""Share by which the floor follows a block of still windows."""

RELEARN_RATIO = 5.0
"""When a block is quieter than the floor by this factor (standard deviation), the floor had been
learned in motion: what was taken for evidence is none."""

ROUNDING = 1e-13
"""A deviation below this share of the mean is rounding: no sensor resolves 43 bits."""

RELEARNED = 'relearned'
"""The cut of a run before which no evidence of this stream counts."""


@dataclass
class _Floor:
    """The noise of a still sensor, per axis, in the unit of the samples (squared)."""

    variance: Floats
    step: Floats
    mean: Floats
    lsb: Floats

    def scale(self, variance: Floats) -> Floats:
        """Return the variance that thresholds are multiples of: never below that of rounding.

        Where noise is below the last bit, single flips of it are honest (LSB^2/4 at most).
        """
        return np.maximum(variance, 0.25 * self.lsb**2)


@dataclass(frozen=True)
class _Windows:
    """Statistics of k windows; (axes, k) arrays of the samples' unit."""

    mean: Floats
    variance: Floats
    peak: Floats

    @classmethod
    def of(cls, rows: Floats, size: int) -> _Windows:
        """Measure windows of ``size`` samples; rows is (axes, k * size)."""
        cube = rows.reshape(len(rows), -1, size)
        mean = np.add.reduce(cube, axis=2) / size
        from_mean = cube - mean[:, :, None]
        variance = np.einsum('ijk,ijk->ij', from_mean, from_mean) / max(size - 1, 1)
        # one value throughout has no variance, whatever the rounding of its mean leaves
        variance[variance <= (ROUNDING * mean) ** 2] = 0.0
        peak = np.maximum(from_mean.max(axis=2), -from_mean.min(axis=2))
        return cls(mean, variance, peak)


class _Verdict(NamedTuple):
    """What k windows are, (k,) bool arrays.

    ``hot``: motion, or an axis ``stuck`` at one value. ``calm``: may end a motion.
    ``turning_only``: nothing stands out but the mean rate.
    """

    hot: Flags
    calm: Flags
    stuck: Flags
    turning_only: Flags


class _Judged(NamedTuple):
    """Windows of the present block, with what was measured and said of them."""

    run: Run
    windows: _Windows
    still: Flags
    verdict: _Verdict


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
        self._floor: _Floor | None = None
        self._learning: list[Run] = []  # stretches that wait for the floor
        self._stamps = np.empty(0, np.int64)  # samples that wait to fill a window
        self._rows = np.empty((len(axes), 0))
        self._last_mean: Floats | None = None
        self._calm = 0  # calm windows since the motion
        self._cut = ''  # why the next still run does not follow on the last one
        self._margin: list[Run] = []  # still windows that a motion may yet take back
        self._stretch_cut = ''  # why the samples that wait do not follow on those before
        self._block: list[_Judged] = []
        self._in_block = 0

    @property
    def learning(self) -> bool:
        """The noise floor is not known yet."""
        return self._floor is None

    def feed(self, run: Run) -> list[Run]:
        """Take a run, return the still runs that are certain by now."""
        if self._floor is None:
            self._learning.append(run)
            if sum(len(r.stamps) for r in self._learning) < LEARN_WINDOWS * self.size:
                return []
            return self._learn()
        out: list[Run] = []
        cut = run.cut
        if cut:
            out += self._end_stretch()
        self._stamps = np.concatenate([self._stamps, run.stamps])
        self._rows = np.concatenate([self._rows, run.rows], axis=1)
        self._stretch_cut = self._stretch_cut or cut
        at, have = 0, len(self._stamps) // self.size
        while at < have:
            k = min(have - at, LEARN_WINDOWS - self._in_block)
            part = slice(at * self.size, (at + k) * self.size)
            windows = Run(self._stamps[part], self._rows[:, part], self._stretch_cut)
            self._stretch_cut = ''
            out += self._judge(windows, self.size)
            self._in_block += k
            at += k
            if self._in_block == LEARN_WINDOWS:
                out += self._follow()
        self._stamps = self._stamps[have * self.size :]
        self._rows = self._rows[:, have * self.size :]
        return out

    def flush(self) -> list[Run]:
        """Return what still waits: no more samples come."""
        out = self._learn() if self._floor is None else []
        return out + self._end_stretch()

    def _learn(self) -> list[Run]:
        """Learn the floor from the first windows, then judge what waited."""
        waited, self._learning = self._learning, []
        if not waited:
            return []
        # the samples that make the learning windows, whatever chunk they came in
        wanted, taken = LEARN_WINDOWS * self.size, 0
        windows: list[_Windows] = []
        steps: list[Floats] = []
        lsb = np.full(len(self._rows), np.inf)
        for stretch in _stretches(waited):
            rows = stretch[:, : wanted - taken]
            taken += rows.shape[1]
            size = min(self.size, rows.shape[1])
            if size < 2:
                continue
            measured = _Windows.of(rows[:, : rows.shape[1] // size * size], size)
            windows.append(measured)
            steps.append(np.abs(np.diff(measured.mean, axis=1)))
            change = np.abs(np.diff(rows, axis=1))
            lsb = np.minimum(lsb, np.where(change > 0.0, change, np.inf).min(axis=1))
        lsb[~np.isfinite(lsb)] = 0.0
        zero = np.zeros(len(lsb))
        if windows:
            variance = np.concatenate([w.variance for w in windows], axis=1)
            mean = np.concatenate([w.mean for w in windows], axis=1)
            step = np.concatenate(steps, axis=1)
            self._floor = _Floor(
                _quantile(variance, QUIET),
                MAD_TO_SIGMA * _quantile(step, 0.5) if step.size else zero,
                _quantile(mean, 0.5),
                lsb,
            )
        else:
            self._floor = _Floor(zero, zero, zero, lsb)
        out: list[Run] = []
        for run in waited:
            out += self.feed(run)
        return out

    def _end_stretch(self) -> list[Run]:
        """Judge the window that will not fill, and let go of the margin."""
        out: list[Run] = []
        if len(self._stamps) and self._floor is not None:
            last = Run(self._stamps, self._rows, self._stretch_cut)
            out += self._judge(last, len(self._stamps))
        self._stretch_cut = ''
        self._stamps = self._stamps[:0]
        self._rows = self._rows[:, :0]
        out += self._margin
        self._margin = []
        return out

    def _judge(self, run: Run, size: int) -> list[Run]:
        """Judge windows that follow on each other; ``run.cut`` says why not on those before."""
        out: list[Run] = []
        if run.cut:
            out, self._margin = self._margin, []
            self._last_mean = None
            self._cut = self._cut or run.cut
        windows = _Windows.of(run.rows, size)
        verdict = self._verdict(windows, size)
        still = ~verdict.hot
        if self.moving or verdict.hot.any():
            for i in range(len(still)):
                part = slice(i * size, (i + 1) * size)
                window = Run(run.stamps[part], run.rows[:, part])
                out += self._step(window, *(bool(v[i]) for v in verdict[:3]))
                still[i] = not self.moving
        else:
            out += self._pass_on(Run(run.stamps, run.rows))
        self._last_mean = windows.mean[:, -1]
        if size == self.size:
            self._block.append(_Judged(run, windows, still, verdict))
        return out

    def _verdict(self, windows: _Windows, size: int) -> _Verdict:
        """Hold windows against the floor."""
        floor = self._floor
        assert floor is not None
        # few samples spread a variance: a short window is judged by its farthest sample alone
        enough = size >= LEAST_WINDOW
        scale = floor.scale(floor.variance)[:, None]
        known = scale > 0.0
        sigma = np.sqrt(scale)
        wild = known & (windows.variance > self._ratio**2 * scale) & enough
        restless = known & (windows.variance > (LEAVE_SHARE * self._ratio) ** 2 * scale) & enough
        lsb = floor.lsb[:, None]
        knocked = known & (windows.peak > np.maximum(PEAK_SIGMAS * sigma, 2.5 * lsb))
        previous = windows.mean[:, :1] if self._last_mean is None else self._last_mean[:, None]
        step = np.abs(np.diff(np.concatenate([previous, windows.mean], axis=1), axis=1))
        step_sigma = np.maximum(np.sqrt(2.0 / size) * sigma, floor.step[:, None])
        stepped = known & (step > STEP_SIGMAS * step_sigma + lsb) & enough
        least_turn = np.maximum(self._rate_limit[:, None], STEP_SIGMAS * step_sigma)
        turning = np.abs(windows.mean - floor.mean[:, None]) > least_turn
        noisy = (floor.variance > floor.lsb**2)[:, None]
        stuck = ((windows.variance == 0.0) & noisy & enough).any(axis=0)
        restless_any = (wild | restless | knocked | stepped).any(axis=0) | stuck
        hot = (wild | knocked | stepped | turning).any(axis=0) | stuck
        turning_only = turning.any(axis=0) & ~restless_any
        return _Verdict(hot, ~(hot | restless_any), stuck, turning_only)

    def _step(self, run: Run, hot: bool, calm: bool, stuck: bool) -> list[Run]:
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
            self._counts.saturated += _saturated(run.rows)
        self._calm = self._calm + 1 if calm else 0
        if self._calm >= MARGIN_AFTER:
            self.moving = False
            self._calm = 0
        return []

    def _pass_on(self, run: Run) -> list[Run]:
        """Let a still run go, but for the last window: a motion may begin in the next."""
        out = self._margin
        split = max(0, len(run.stamps) - MARGIN_BEFORE * self.size)
        cut, self._cut = self._cut, ''
        if split:
            out = [*out, Run(run.stamps[:split], run.rows[:, :split], cut)]
            cut = ''
        self._margin = [Run(run.stamps[split:], run.rows[:, split:], cut)]
        return out

    def _follow(self) -> list[Run]:
        """Follow the noise floor after a block of windows; start anew if it was none."""
        floor = self._floor
        assert floor is not None
        block, self._block, self._in_block = self._block, [], 0
        variance = np.concatenate([j.windows.variance for j in block], axis=1)
        mean = np.concatenate([j.windows.mean for j in block], axis=1)
        still = np.concatenate([j.still for j in block])
        # an axis that is stuck says nothing of its noise
        quiet = _quantile(variance, QUIET)
        quiet = np.where(quiet > 0.0, quiet, floor.variance)
        if (RELEARN_RATIO**2 * floor.scale(quiet) < floor.scale(floor.variance)).any():
            at_rest = (variance <= 2.0 * quiet[:, None]).all(axis=0)
            floor.variance = quiet
            steps = np.abs(np.diff(mean, axis=1))
            floor.step = MAD_TO_SIGMA * _quantile(steps, QUIET)
            floor.mean = _quantile(mean[:, at_rest] if at_rest.any() else mean, 0.5)
            return self._judge_anew(block)
        if np.count_nonzero(still) >= LEARN_WINDOWS // 2:
            recent = _quantile(variance[:, still], QUIET)
            floor.variance = floor.variance + FLOOR_GAIN * (recent - floor.variance)
            floor.mean = _quantile(mean[:, still], 0.5)
        elif np.concatenate([j.verdict.turning_only for j in block]).all():
            # a steady rate for a whole block is a bias that jumped, or was learned in a turn
            floor.mean = _quantile(mean, 0.5)
        return []

    def _judge_anew(self, block: list[_Judged]) -> list[Run]:
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
        out = [Run(block[0].run.stamps[:0], block[0].run.rows[:, :0], RELEARNED)]
        for judged in block:
            out += self._judge(judged.run, self.size)
        self._block = []
        return out


def _quantile(values: Floats, share: float) -> Floats:
    """Return the lower quantile of each row: a value that is there, found without interpolation."""
    k = int(share * (values.shape[1] - 1))
    found: Floats = np.partition(values, k, axis=1)[:, k]
    return found


def _stretches(runs: list[Run]) -> list[Floats]:
    """Return the rows of runs, joined where they follow on each other."""
    joined: list[list[Floats]] = []
    for run in runs:
        if run.cut or not joined:
            joined.append([])
        joined[-1].append(run.rows)
    return [np.concatenate(rows, axis=1) for rows in joined]


def _saturated(rows: Floats) -> int:
    """Return how many samples of a moving window stand at their axis' extreme, three in a row."""
    size = np.abs(rows)
    top = size == size.max(axis=1, keepdims=True)
    three = top[:, 2:] & top[:, 1:-1] & top[:, :-2]
    inside = np.zeros(rows.shape[1], bool)
    for axis in np.flatnonzero(three.any(axis=1) & (rows.min(axis=1) < rows.max(axis=1))):
        for shift in range(3):
            inside[shift : shift + three.shape[1]] |= three[axis]
    return int(np.count_nonzero(inside))
