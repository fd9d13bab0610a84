# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gauss-Markov processes and sinusoids as columns of an Allan table.

Both are linear in their variance and have one more parameter, their shape: a correlation time or a
frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..noise import gauss_markov_sums, sinusoid_avar
from .model import RANDOM_TERMS, Floats, Ints

LINE_PEAK = 0.371
"""f m where sin^4(pi f m)/(pi f m)^2 is largest."""


@dataclass(frozen=True)
class GaussMarkovTerm:
    """First-order Gauss-Markov process; its shape is the correlation time in samples."""

    shape: float

    @property
    def scale(self) -> float:
        """Averaging factor at which it is largest relative to white noise."""
        return 1.89 * self.shape

    def white(self) -> float:
        """Return the variance per sample of white noise of the same long-term level."""
        return float(gauss_markov_sums(self.shape)[0][0])


@dataclass(frozen=True)
class SinusoidTerm:
    """A sinusoid of random phase; its shape is the frequency in cycles per sample."""

    shape: float

    @property
    def scale(self) -> float:
        """Averaging factor at which it is largest."""
        return LINE_PEAK / self.shape


Extra = GaussMarkovTerm | SinusoidTerm


def correlation_times(extras: Sequence[Extra]) -> tuple[float, ...]:
    """Return the correlation times of the Gauss-Markov processes among some processes."""
    return tuple(e.shape for e in extras if isinstance(e, GaussMarkovTerm))


def line_scatter(samples: int, times: Sequence[float], lines: Sequence[Extra]) -> Floats:
    """Return the variances of squared amplitudes for `Table.line_scatter`.

    Noise of the two-sided density S adds 8 A^2 S / n to the variance of the squared amplitude of a
    sinusoid of n samples.
    """
    rows = []
    for line in lines:
        omega = 2.0 * np.pi * line.shape
        step = (2.0 * np.sin(omega / 2.0)) ** 2
        density = [step, 1.0, 1.0 / omega, 1.0 / step]
        for time in times:
            keep = np.exp(-1.0 / time)
            lost = -np.expm1(-1.0 / time)
            # (1 - keep^2) / (1 - 2 keep cos(omega) + keep^2) without the loss of digits
            density.append(lost * (1.0 + keep) / (lost**2 + keep * step))
        rows.append(8.0 / samples * np.array(density))
    return np.array(rows).reshape(len(lines), len(RANDOM_TERMS) + len(times))


def line_rest(
    m: Ints, stride: Ints, count: Ints, samples: int, segments: int, lines: Sequence[Extra]
) -> Floats:
    """Return `Table.line_rest` of some segments with that many samples in all.

    Differences at every s-th start also hold the noise at the aliases of the sinusoid. With C
    differences l_j of the sinusoid and d_j of white noise, the variance of mean(l d) is
    E[l^2]/C sum_k (1 - |k|/C) cos(omega s k) R_d(s k). The mean of l^2 itself depends on the phase
    by 1/(C sin(omega s)), or entirely where each start meets the same phase.
    """
    out = np.zeros((2, len(lines), len(m)))
    if not lines:
        return out
    shapes = np.array([line.shape for line in lines])
    column = sinusoid_avar(m, shapes[:, None])
    omega = 2.0 * np.pi * shapes
    for n, (factor, s, number) in enumerate(zip(m, stride, count)):
        lag = np.arange(min((2 * factor - 1) // s + 1, number))
        h = (lag * s)[:, None] + np.array([0, -factor, factor])
        overlap = np.maximum(factor - np.abs(h), 0) @ np.array([2.0, -1.0, -1.0])
        weight = np.where(lag > 0, 2.0, 1.0) * (1.0 - lag / number) * overlap / float(factor) ** 2
        level = 2.0 / number * (np.cos(np.outer(omega, lag * s)) @ weight)
        level -= 8.0 / samples * column[:, n]
        out[0, :, n] = column[:, n] * np.maximum(level, 0.0)
        swing = number * np.abs(np.sin(omega * s))
        share = np.minimum(1.0, segments / np.maximum(swing, 1e-9) ** 2 / 2.0)
        out[1, :, n] = column[:, n] ** 2 / 2.0 * share
    return out
