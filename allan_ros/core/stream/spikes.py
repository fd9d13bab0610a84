# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Isolated spikes: errors of transmission or conversion that are no noise and no motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .noise_floor import LEAST_WINDOW, MAD_TO_SIGMA, NoiseFloor, Windows
from .timing import Block

Floats = NDArray[np.float64]

SPIKE_SIGMAS = 7.0
"""A sample this many floor deviations from the mean of its window is a spike if it is isolated:
1e-10 of the samples of white noise, whose variance changes by less than 1e-8."""

SPIKE_NEIGHBORS, NEIGHBOR_RATIO = 4, 0.6
"""The samples next to a spike, and all but one of so many before and after it, must be closer to
the mean than this fraction of its least height: a knock rings, a spike does not."""


def without_spikes(
    block: Block, size: int, before: Floats, after: Floats, floor: NoiseFloor
) -> tuple[Block, Windows, int]:
    """Replace isolated spikes by the mean of their neighbors.

    Spikes of axes whose noise has heavy tails stay in the block, but not in the windows.

    Parameters
    ----------
    block : Block
        Complete windows of ``size`` samples.
    size : int
    before, after : (axes, up to `SPIKE_NEIGHBORS`) arrays
        The samples before and after the block.
    floor : NoiseFloor

    Returns
    -------
    block : Block
    windows : Windows
        Its statistics.
    spikes : int
        How many values were replaced.
    """
    rows = block.rows
    windows = Windows.of(rows, size)
    least = SPIKE_SIGMAS * np.sqrt(floor.scale)
    flagged = (windows.peak > least[:, None]) & (least > 0.0)[:, None]
    if not flagged.any() or size < LEAST_WINDOW:
        return block, windows, 0
    axes, at = np.nonzero(flagged)
    cube = rows.reshape(len(rows), -1, size)[axes, at]
    level = np.median(cube, axis=1)
    sigma = MAD_TO_SIGMA * np.median(np.abs(cube - level[:, None]), axis=1)
    # where the noise itself became louder, by more than the estimate scatters
    louder = SPIKE_SIGMAS * sigma > (1.0 + 5.0 / np.sqrt(size)) * least[axes]
    height = np.where(louder, SPIKE_SIGMAS * sigma, least[axes])
    far = np.abs(cube - level[:, None]) > height[:, None]
    few = np.count_nonzero(far, axis=1) <= 1 + size // LEAST_WINDOW  # more are a motion
    around = np.concatenate([before, rows, after], axis=1)
    judged = rows.copy()
    found = np.zeros(rows.shape, bool)
    for n, k in zip(*np.nonzero(far & few[:, None])):
        axis, i = axes[n], at[n] * size + k
        x, j = around[axis], i + before.shape[1]
        first = max(0, j - SPIKE_NEIGHBORS)
        near = np.abs(x[first : j + SPIKE_NEIGHBORS + 1] - level[n])
        if _is_isolated(near > NEIGHBOR_RATIO * height[n], j - first):
            judged[axis, i] = 0.5 * (x[j - 1] + x[j + 1])
            found[axis, i] = True
    changed = found.any(axis=0).reshape(-1, size).any(axis=1)
    if not changed.any():
        return block, windows, 0
    some = judged.reshape(len(rows), -1, size)[:, changed].reshape(len(rows), -1)
    again = Windows.of(some, size)
    for old, new in zip(
        (windows.mean, windows.variance, windows.peak), (again.mean, again.variance, again.peak)
    ):
        old[:, changed] = new
    found[floor.heavy] = False
    filled = found if block.filled is None else block.filled | found
    replaced = np.where(found, judged, rows)
    return Block(block.stamps, replaced, block.cut, filled), windows, int(np.count_nonzero(found))


def _is_isolated(far: NDArray[np.bool_], at: int) -> bool:
    """Return whether at most one other sample is far from the level, and none next to an index."""
    inside = 0 < at < len(far) - 1
    return inside and not far[at - 1] and not far[at + 1] and int(np.count_nonzero(far)) <= 2
