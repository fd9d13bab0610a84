# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interpolates samples that a driver repeats at random, because the sensor had no new data."""

from __future__ import annotations

import numpy as np

from .timing import Block, Floats

LONGEST_REPEAT = 16
"""Largest number of consecutive repeated samples that are interpolated; a sensor that repeats more
may be stuck."""


class RepeatFilter:
    """Interpolates samples that repeat the previous one, in evenly spaced blocks.

    ``groups`` are the positions of the axes of each group: a sample is repeated if it equals the
    previous one on all axes of a group. At most `LONGEST_REPEAT` + 1 samples are buffered.
    """

    def __init__(self, groups: list[list[int]], axes: int) -> None:
        self._groups = groups
        self._empty = Block(np.empty(0, np.int64), np.empty((axes, 0)))
        self._restart()

    def _restart(self) -> None:
        # the last new sample, and the repeats after it, which need the next new sample
        self._held = self._empty
        self._repeated = np.zeros((len(self._groups), 0), bool)  # held, to be interpolated
        self._last: Floats = np.full(len(self._empty.rows), np.nan)  # the last values received
        self._skipping = np.zeros(len(self._groups), bool)  # whether a run is too long

    def feed(self, blocks: list[Block]) -> list[Block]:
        """Add blocks, and return the samples whose interpolation is complete."""
        out: list[Block] = []
        for block in blocks:
            if block.cut:
                out += self.flush()
            if len(block):
                out += self._add(block)
        return out

    def flush(self) -> list[Block]:
        """Return the buffered samples at the end of a segment; the last repeats are kept."""
        held = self._held
        self._restart()
        return [held] if len(held) else []

    def _add(self, block: Block) -> list[Block]:
        have = Block.joined([self._held, block]) if len(self._held) else block
        old, n = len(self._held), len(have)
        rows = have.rows.copy()
        filled = np.zeros(rows.shape, bool) if have.filled is None else have.filled.copy()
        before = np.concatenate([self._last[:, None], block.rows[:, :-1]], axis=1)
        equal = block.rows == before
        self._last = block.rows[:, -1].copy()
        repeated = np.zeros((len(self._groups), n), bool)
        repeated[:, :old] = self._repeated
        index, keep = np.arange(n), n - 1
        for flags, group, i in zip(repeated, self._groups, range(n)):
            flags[old:] = equal[group].all(axis=0)
            new = np.flatnonzero(~flags[old:])
            if self._skipping[i]:
                flags[old : old + int(new[0]) if len(new) else n] = False
                self._skipping[i] = not len(new)
            if not flags.any():
                continue
            left = np.maximum.accumulate(np.where(flags, -1, index))
            right = np.minimum.accumulate(np.where(flags, n, index)[::-1])[::-1]
            length = right - left - 1
            at = np.flatnonzero(flags & (right < n) & (length <= LONGEST_REPEAT))
            low, high = left[at], right[at]
            fraction = (at - low) / (high - low)
            for axis in group:
                first = have.rows[axis, low]
                rows[axis, at] = first + fraction * (have.rows[axis, high] - first)
                filled[axis, at] = True
            flags[right < n] = False
            if flags[-1] and length[-1] > LONGEST_REPEAT:
                flags[:] = False
                self._skipping[i] = True
            elif flags[-1]:
                keep = min(keep, int(left[-1]))
        done = Block(have.stamps, rows, have.cut, filled if filled.any() else None)
        self._held = done.part(slice(keep, None), done.cut if keep == 0 else '').copy()
        self._repeated = repeated[:, keep:].copy()
        return [done.part(slice(keep), done.cut)] if keep else []
