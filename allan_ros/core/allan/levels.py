# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the noise level between parts: sixths of a recording, or several recordings.

The white noise of the parts is compared by Bartlett's test (Proceedings of the Royal Society A 160,
1937). The drift of the parts is compared by a likelihood-ratio test, in which the logarithm of its
level is normally distributed between the parts. If the noise varies, a recording determines only
its average, not the coefficient at another time, so the intervals of the coefficients are widened
by the scatter between the parts.
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
"""Largest p-value at which a change of the white noise of an axis is reported."""

LEVEL_RATIO = 1.02
"""Smallest ratio of the largest to the smallest deviation of the parts that is reported."""

WHITE_SLOPE = 0.25
"""Largest difference between the slope of log variance over log m and -1, the slope of white
noise."""

MIN_DIFFERENCES = 200
"""Smallest number of second differences in a part that is used."""

SCATTER_PROBABILITY = 1e-3
"""Largest p-value at which scatter between parts or periods widens the intervals."""


@dataclass(frozen=True)
class Scatter:
    """Scatter of the white noise of one axis between parts of a recording, or recordings."""

    parts: int  # number of parts
    low: float  # smallest Allan deviation of a part, relative to that of all data
    high: float  # largest Allan deviation of a part, relative to that of all data
    # standard deviation of ln(Allan deviation) of the parts, without that due to estimation errors
    scatter: float
    probability: float  # p-value of Bartlett's test for equal variances


def level_changes(recordings: Sequence[Recording], age: int = 0) -> dict[int, Scatter]:
    """Return the scatter of each axis whose white noise changed significantly, by axis position.

    A single recording is divided into sixths; several recordings are compared with each other. The
    first ``age`` samples of each recording are left out.
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
    """Return the standard deviation of ln N due to changes of the white noise, (axes,).

    It is the root sum of squares of two contributions, each 0 if it is not significant. The first
    is the scatter between the sixths of a single recording, or between several recordings. The
    second is the scatter between short time intervals, divided by the root of their number; heavy
    tails or bursts make it significant. The first ``age`` samples of each recording are left out.
    """
    variance = np.zeros(axes)
    for parts in (_parts_of_each(recordings), 0):
        for axis, found in _white_scatters(_white_levels(recordings, age, parts)).items():
            if found.probability < SCATTER_PROBABILITY:
                variance[axis] += found.scatter**2 / (1 if parts else found.parts)
    return np.sqrt(variance)


WhiteLevel = tuple[int, Floats, Ints]
"""Averaging factor, Allan variance of each part, and number of second differences of each part."""


def _white_levels(recordings: Sequence[Recording], age: int, parts: int) -> dict[int, WhiteLevel]:
    """Return the white noise in each part of the recordings, for the axes that have white noise.

    The keys are positions of axes. The first ``age`` samples of each recording are left out.
    ``parts`` is the number of equal parts of each recording; if it is 0, each period is a part.
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
        i = _white_factor(pooled, np.median(count, axis=0))
        if i is not None:
            variance = sum_sq[:, i, axis] / (scale[i] * np.maximum(count[:, i], 1))
            found[axis] = int(m[i]), variance, count[:, i]
    return found


def _level_parts(recording: Recording, age: int, parts: int) -> tuple[Ints, Floats]:
    """Return counts (parts, levels) and sums of squares (parts, levels, axes) of differences."""
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


def _white_factor(variance: Floats, count: Floats) -> int | None:
    """Return the index of the first factor with the slope of white noise, or None."""
    with np.errstate(divide='ignore', invalid='ignore'):
        slopes = np.diff(np.log(variance)) / math.log(4.0)
    for i, slope in enumerate(slopes):
        if abs(slope + 1.0) < WHITE_SLOPE and count[i] >= MIN_DIFFERENCES:
            return i
    return None


def _white_scatters(levels: dict[int, WhiteLevel]) -> dict[int, Scatter]:
    scatters = {axis: _scatter(*level) for axis, level in levels.items()}
    return {axis: one for axis, one in scatters.items() if one is not None}


def _scatter(m: int, variance: Floats, count: Ints) -> Scatter | None:
    """Return the scatter of the variances, or None if fewer than two parts are long enough."""
    some = (count >= MIN_DIFFERENCES) & (variance > 0.0)
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


# --- drift ----------------------------------------------------------------------------------------

LOG_FACTORS = np.arange(-8.0, 8.01, 0.2)
"""Tried values of the logarithm of the drift variance of a part, relative to all data."""

LOG_SCATTERS = np.arange(0.2, 4.01, 0.2)
"""Tried values of the standard deviation of this logarithm between the parts."""

DRIFT_THRESHOLD = 12.0
"""Smallest significant value of twice the log likelihood ratio of a scatter, summed over the axes
of one sensor."""

PART_INTERVALS = 128
"""Largest number of intervals into which a part is divided."""


def drift_scatter(
    recordings: Sequence[Recording], sensors: Sequence[Sequence[int]], age: int = 0
) -> Floats:
    """Return the standard deviation of ln B and ln K between the parts of the recordings, (axes,).

    The parts are the sixths of a single recording, or the recordings. In the model, the drift
    variances of a part are those of all data times an unknown factor. The result is 0 for the axes
    of a sensor whose drift does not change significantly.

    The first of the ``recordings`` must be the longest. ``sensors`` contains the positions of the
    axes of each sensor. The first ``age`` samples of each recording are left out.
    """
    axes = sum(len(s) for s in sensors)
    scatter = np.zeros(axes)
    of_each = _parts_of_each(recordings)
    parts = [part for one in recordings for part in _part_means(one, age, of_each)]
    if len(parts) < 2:
        return scatter
    step = recordings[0].step
    means = CellMeans.growing(recordings[0].cells(math.ceil(age / step)))
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
        likelihoods = np.array(
            [
                _factor_likelihoods(part.means[:, axis], part, null.variances, ratio, width / step)
                for (part, width), ratio in zip(parts, ratios)
            ]
        )
        gains[axis] = _scatter_ratios(likelihoods)
    for sensor in sensors:
        rows = list(sensor)
        if gains[rows].sum(axis=0).max() > DRIFT_THRESHOLD:
            best = gains[rows].argmax(axis=1)
            scatter[rows] = np.where(gains[rows].max(axis=1) > 0.0, LOG_SCATTERS[best], 0.0) / 2.0
    return scatter


def _part_means(recording: Recording, age: int, parts: int) -> list[tuple[CellMeans, int]]:
    """Return (means, length of a cell in samples) of the parts that are long enough."""
    first = math.ceil(age / recording.step)
    edges = np.linspace(first, max(len(recording.cell_samples), first), parts + 1)
    edges = edges.round().astype(int)
    found = [
        (CellMeans.even(recording.cells(int(a), int(b)), PART_INTERVALS), recording.step)
        for a, b in pairwise(edges)
    ]
    return [(means, step) for means, step in found if len(means.begin) > PARTS]


def _factor_likelihoods(
    means: Floats, part: CellMeans, variances: Floats, white_ratio: float, width: float
) -> Floats:
    """Return twice the log likelihood of each factor in `LOG_FACTORS` for one axis of a part.

    ``means`` are the means of the axis over the intervals of ``part``. ``variances`` are those of
    white noise, bias instability and random walk in all data. ``white_ratio`` and ``width`` are the
    white noise variance and the cell length of the part, relative to all data.
    """
    model = variance_model(part)
    values = model.contrasts @ means
    white = variances[0] / width * white_ratio * model.units[0]
    drift = variances[1] * model.units[1] + variances[2] * width * model.units[2]
    white[np.diag_indices_from(white)] += 1e-9 * np.trace(white + drift) / len(values)
    eigenvalues, vectors = linalg.eigh(drift, white)
    power = (vectors.T @ values) ** 2
    total = 1.0 + np.exp(LOG_FACTORS)[:, None] * np.maximum(eigenvalues, 0.0)
    return -np.asarray((np.log(total) + power / total).sum(axis=1))


def _scatter_ratios(log_likelihoods: Floats) -> Floats:
    """Return twice the log likelihood ratio of each scatter in `LOG_SCATTERS` to no scatter.

    ``log_likelihoods`` is twice the log likelihood of each factor of each part, (parts, factors).
    """
    best = log_likelihoods.max(axis=1, keepdims=True)
    likelihoods = np.exp((log_likelihoods - best) / 2.0)
    distances = (LOG_FACTORS[:, None] - LOG_FACTORS) ** 2
    out = []
    for scatter in LOG_SCATTERS:
        weights = np.exp(-distances / (2.0 * scatter**2))
        weights /= weights.sum(axis=1, keepdims=True)
        mean = np.maximum(likelihoods @ weights.T, 1e-300)
        out.append(2.0 * np.log(mean).sum(axis=0).max())
    return np.array(out) - float((log_likelihoods - best).sum(axis=0).max())
