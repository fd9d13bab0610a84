# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scatter of the noise between parts: sixths of a recording, or several recordings.

The level of white noise is compared by Bartlett's test (Proceedings of the Royal Society A 160,
1937), the size of the drift by its likelihood, with a normal distribution of its logarithm between
the parts. Intervals of the coefficients include the scatter: if the noise varies, a recording
determines only the average, not the coefficient at another time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..deferred import linalg, special
from .curve import WHITE, edf
from .history import Recording
from .likelihood import CellMeans, null_model, variance_model
from .sums import LEVEL_FACTORS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PARTS = 6
"""Number of parts of a single recording."""

LEVEL_PROBABILITY = 1e-4
"""Probability below which the levels of an axis are significantly different."""

LEVEL_RATIO = 1.02
"""Smallest ratio of two levels that is reported."""

WHITE_SLOPE = 0.25
"""Tolerance of the exponent within which the variance falls as 1/m, as for white noise."""

LEAST_DIFFERENCES = 200
"""Smallest number of differences of a part that is used."""

SCATTER_PROBABILITY = 1e-3
"""Probability above which the scatter between parts or periods is explained by normal noise."""


@dataclass(frozen=True)
class Scatter:
    """Scatter of the white noise of one axis between parts."""

    parts: int  # number of parts
    # smallest and largest deviation of a part, relative to the deviation of all parts
    low: float
    high: float
    scatter: float  # standard deviation of the logarithm of the true deviations of the parts
    probability: float  # the same if the true deviations do not differ


def level_changes(recordings: Sequence[Recording], age: int = 0) -> dict[int, Scatter]:
    """Return the axes whose white noise differs between sixths of a recording or recordings.

    The first ``age`` samples of each are left out.
    """
    scatters = _white_scatters(_white_levels(recordings, age, _parts_of_each(recordings)))
    return {
        axis: one
        for axis, one in scatters.items()
        if one.probability < LEVEL_PROBABILITY and one.high >= LEVEL_RATIO * one.low
    }


def _parts_of_each(recordings: Sequence[Recording]) -> int:
    return PARTS if len(recordings) == 1 else 1


def level_scatter(recordings: Sequence[Recording], axes: int, age: int = 0) -> Floats:
    """Return the standard deviation of ln N, (axes,), in excess of normal noise.

    It is computed from the parts that `level_changes` compares, even if their differences are not
    relevant. With heavy tails or bursts, the variances of single periods scatter more than
    chi-squared. This increases the variance of the mean by the excess scatter over the number of
    periods. Scatter that is not significant counts as 0.
    """
    variance = np.zeros(axes)
    for parts in (_parts_of_each(recordings), 0):
        for axis, found in _white_scatters(_white_levels(recordings, age, parts)).items():
            if found.probability < SCATTER_PROBABILITY:
                variance[axis] += found.scatter**2 / (1 if parts else found.parts)
    return np.sqrt(variance)


WhiteLevel = tuple[int, Floats, Ints]
"""Averaging factor, variance of each part, and number of its second differences."""


def _white_levels(recordings: Sequence[Recording], age: int, parts: int) -> dict[int, WhiteLevel]:
    """Return the white noise in each part of the recordings, by axis.

    ``parts`` is the number of equal parts of a recording; if it is 0, each period is a part. Axes
    without white noise are left out.
    """
    split = [_level_parts(recording, age, parts) for recording in recordings]
    levels = min((count.shape[1] for count, _ in split), default=0)
    if not levels:
        return {}
    count = np.concatenate([c[:, :levels] for c, _ in split])
    sum_sq = np.concatenate([s[:, :levels] for _, s in split])
    m = recordings[0].level_m[:levels]
    scale = 2.0 * m.astype(float) ** 2
    found = {}
    for axis in range(sum_sq.shape[2]):
        with np.errstate(divide='ignore', invalid='ignore'):
            pooled = sum_sq[:, :, axis].sum(axis=0) / (scale * count.sum(axis=0))
        i = _white_level(pooled, np.median(count, axis=0))
        if i is not None:
            variance = sum_sq[:, i, axis] / (scale[i] * np.maximum(count[:, i], 1))
            found[axis] = int(m[i]), variance, count[:, i]
    return found


def _level_parts(recording: Recording, age: int, parts: int) -> tuple[Ints, Floats]:
    """Return counts (parts, levels) and sums of squares (parts, levels, axes)."""
    late = recording.period_begin >= age
    begins = recording.period_begin[late]
    count, sum_sq = recording.level_count[late], recording.level_sum_sq[late]
    if not parts:
        return count, sum_sq
    edges = np.linspace(age, recording.length, parts + 1)[:-1]
    rows = np.unique(np.searchsorted(edges, begins, 'right'), return_index=True)[1]
    if not len(rows):
        return count.sum(axis=0)[None], sum_sq.sum(axis=0)[None]
    return np.add.reduceat(count, rows), np.add.reduceat(sum_sq, rows)


def _white_level(variance: Floats, count: Floats) -> int | None:
    """Return the first level at which the variance falls as for white noise."""
    with np.errstate(divide='ignore', invalid='ignore'):
        slopes = np.diff(np.log(variance)) / math.log(4.0)
    for i, slope in enumerate(slopes):
        if abs(slope + 1.0) < WHITE_SLOPE and count[i] >= LEAST_DIFFERENCES:
            return i
    return None


def _white_scatters(levels: dict[int, WhiteLevel]) -> dict[int, Scatter]:
    scatters = {axis: _scatter(*level) for axis, level in levels.items()}
    return {axis: one for axis, one in scatters.items() if one is not None}


def _scatter(m: int, variance: Floats, count: Ints) -> Scatter | None:
    """Return the scatter of the levels of parts in excess of normal noise; None if there are too
    few."""
    some = (count >= LEAST_DIFFERENCES) & (variance > 0.0)
    variance, count = variance[some], count[some]
    if len(count) < 2:
        return None
    stride = max(1, m // LEVEL_FACTORS[0])
    of_count = {n: edf(WHITE, m, stride, n) for n in set(count.tolist())}
    degrees = np.array([of_count[n] for n in count.tolist()])
    pooled = float(degrees @ variance / degrees.sum())
    ratio = np.log(variance / pooled)
    size = 1.0 + (np.sum(1.0 / degrees) - 1.0 / degrees.sum()) / (3.0 * (len(count) - 1))
    statistic = -float(degrees @ ratio) / size
    probability = float(special.chdtrc(len(count) - 1, max(statistic, 0.0)))
    low, high = (math.exp(r / 2.0) for r in (ratio.min(), ratio.max()))
    # DerSimonian & Laird, Controlled Clinical Trials 7, 1986; Var ln s^2 is 2/degrees
    weights = degrees / 2.0
    excess = float(weights @ (ratio - weights @ ratio / weights.sum()) ** 2) - (len(count) - 1)
    spread = max(excess, 0.0) / float(weights.sum() - weights @ weights / weights.sum())
    return Scatter(len(count), low, high, math.sqrt(spread) / 2.0, probability)


# --- the size of the drift ------------------------------------------------------------------------

LOG_SIZES = np.arange(-8.0, 8.01, 0.2)
"""Logarithms of the drift variance of a part, relative to all parts, that are tried."""

LOG_SCATTERS = np.arange(0.2, 4.01, 0.2)
"""Standard deviations of these logarithms that are tried."""

DRIFT_RATIO = 12.0
"""Smallest significant value of twice the log likelihood ratio of a scatter, summed over the axes
of one sensor."""

PART_CELLS = 128
"""Largest number of cells of a part."""


def drift_scatter(
    recordings: Sequence[Recording], sensors: Sequence[Sequence[int]], age: int = 0
) -> Floats:
    """Return the standard deviation of ln B and ln K between the parts, (axes,).

    The drift of each part is the drift of all parts times a factor. The likelihood of the factor is
    computed from the means of the cells of the part, with the white noise of the part. The result
    is 0 for the axes of a sensor whose drift does not differ significantly.

    Parameters
    ----------
    recordings : sequence of Recording
        The longest first.
    sensors : sequence of sequences of int
        Positions of the axes of each sensor.
    age : int
        Samples left out at the start of each.
    """
    axes = sum(len(s) for s in sensors)
    scatter = np.zeros(axes)
    of_each = _parts_of_each(recordings)
    parts = [part for one in recordings for part in _parts(one, age, of_each)]
    if len(parts) < 2:
        return scatter
    step = recordings[0].step
    means = CellMeans.of(recordings[0].cells(math.ceil(age / step)))
    if len(means.begin) < PARTS + 2:
        return scatter
    model = variance_model(means)
    white = _white_levels(recordings, age, of_each)
    gains = np.zeros((axes, len(LOG_SCATTERS)))
    contrasts = model.contrasts @ means.means
    for axis in range(axes):
        null = null_model(contrasts[:, axis], model)
        if null is None or not null.variances[1:].any():
            continue
        level = white[axis][1] if axis in white else np.ones(1)
        ratios = level / level.mean() if len(level) == len(parts) else np.ones(len(parts))
        sizes = np.array(
            [
                _size_likelihood(part.means[:, axis], part, null.variances, ratio, width / step)
                for (part, width), ratio in zip(parts, ratios)
            ]
        )
        gains[axis] = _gains(sizes)
    for sensor in sensors:
        rows = list(sensor)
        if gains[rows].sum(axis=0).max() > DRIFT_RATIO:
            best = gains[rows].argmax(axis=1)
            scatter[rows] = np.where(gains[rows].max(axis=1) > 0.0, LOG_SCATTERS[best], 0.0) / 2.0
    return scatter


def _parts(recording: Recording, age: int, parts: int) -> list[tuple[CellMeans, int]]:
    """Return the means of each part, and the length of their cells in samples."""
    first = math.ceil(age / recording.step)
    edges = np.linspace(first, max(len(recording.cell_samples), first), parts + 1)
    edges = edges.round().astype(int)
    found = [
        (CellMeans.even(recording.cells(int(a), int(b)), PART_CELLS), recording.step)
        for a, b in pairwise(edges)
    ]
    return [(means, step) for means, step in found if len(means.begin) > PARTS]


def _size_likelihood(
    means: Floats, part: CellMeans, variances: Floats, white_ratio: float, width: float
) -> Floats:
    """Return twice the log likelihood of each size of the drift of a part from its means, (cells,).

    ``variances`` are the variances of all parts for cells of unit length, ``white_ratio`` is the
    white noise of the part relative to all, and ``width`` is the length of its cells.
    """
    model = variance_model(part)
    values = model.contrasts @ means
    white = variances[0] / width * white_ratio * model.units[0]
    drift = variances[1] * model.units[1] + variances[2] * width * model.units[2]
    white[np.diag_indices_from(white)] += 1e-9 * np.trace(white + drift) / len(values)
    eigenvalues, vectors = linalg.eigh(drift, white)
    power = (vectors.T @ values) ** 2
    total = 1.0 + np.exp(LOG_SIZES)[:, None] * np.maximum(eigenvalues, 0.0)
    return -np.asarray((np.log(total) + power / total).sum(axis=1))


def _gains(sizes: Floats) -> Floats:
    """Return twice the log likelihood ratio of each scatter to no scatter.

    ``sizes`` is twice the log likelihood of each size of each part, (parts, sizes).
    """
    best = sizes.max(axis=1, keepdims=True)
    likelihoods = np.exp((sizes - best) / 2.0)
    distances = (LOG_SIZES[:, None] - LOG_SIZES) ** 2
    out = []
    for scatter in LOG_SCATTERS:
        weights = np.exp(-distances / (2.0 * scatter**2))
        weights /= weights.sum(axis=1, keepdims=True)
        mean = np.maximum(likelihoods @ weights.T, 1e-300)
        out.append(2.0 * np.log(mean).sum(axis=0).max())
    return np.array(out) - float((sizes - best).sum(axis=0).max())
