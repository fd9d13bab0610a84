# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: samples in, running Allan sums out, in memory that does not grow with time.

`RunningAllan` feeds the cascade of the open segment and adds up the closed ones; `allan_table` is
the plain definition for one finite record.

Source of the statistic: IEEE Std 952-1997 annex C; NIST SP 1065 eq. 11 (overlapping Allan
variance). The phase is taken against the segment's first sample, block by block: with raw sums an
offset of 9.8 m/s^2 costs up to 1e-5 of the longest factors after 1e9 samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .batch import AXES
from .cascade import OpenSegment
from .errors import AllanError
from .grid import counts
from .sums import AllanSums, ImuIdentity

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AllanTable:
    """Allan sums of one finite record at chosen factors.

    Attributes
    ----------
    m, stride, n : (factors,) int64 arrays
        Averaging factor, samples between starts, and number of second differences.
    avar : (factors, ...) float64 array
        sum d^2 / (2 m^2 n).
    signed : (factors, ...) float64 array
        sum d.
    """

    m: NDArray[np.int64]
    stride: NDArray[np.int64]
    n: NDArray[np.int64]
    avar: Floats
    signed: Floats


def allan_table(y: ArrayLike, m: ArrayLike, stride: ArrayLike = 1) -> AllanTable:
    """Return the Allan variance of a record at any factors; stride 1 is full overlap.

    Parameters
    ----------
    y : (samples,) or (samples, axes) array
        Evenly spaced samples.
    m, stride : ints or (factors,) arrays
        Averaging factors, and samples between the starts of two second differences.

    Raises
    ------
    AllanError
        When a factor is not in 1 .. samples/2, or a stride is below 1.
    """
    values = np.asarray(y, float)
    ms, strides = (np.array(a) for a in np.broadcast_arrays(np.atleast_1d(m), stride))
    ms, strides = ms.astype(np.int64), strides.astype(np.int64)
    if len(ms) and (ms.min() < 1 or 2 * ms.max() > len(values) or strides.min() < 1):
        raise AllanError(
            f'factors {ms.min()} .. {ms.max()} need a record of at least {2 * ms.max()} samples '
            f'and strides of at least 1; this one has {len(values)} samples'
        )
    rows = values.reshape(len(values), -1).T
    theta = np.zeros((len(rows), len(values) + 1))
    np.cumsum(rows - rows[:, :1], axis=1, out=theta[:, 1:])
    sum_sq = np.empty((len(ms), len(rows)))
    signed = np.empty((len(ms), len(rows)))
    for i, (factor, step) in enumerate(zip(ms, strides)):
        d = _second_differences(theta, int(factor))[:, :: int(step)]
        sum_sq[i] = np.einsum('ij,ij->i', d, d)
        signed[i] = d.sum(axis=1)
    n = counts(len(values), ms, strides)
    avar = sum_sq / (2.0 * ms.astype(float)[:, None] ** 2 * n[:, None])
    shape = (len(ms), *values.shape[1:])
    return AllanTable(ms, strides, n, avar.reshape(shape), signed.reshape(shape))


def _second_differences(theta: Floats, lag: int) -> Floats:
    """Return theta(u + 2 lag) - 2 theta(u + lag) + theta(u) along the last axis, for every u."""
    g = theta[:, lag:] - theta[:, :-lag]
    return g[:, lag:] - g[:, :-lag]


class RunningAllan:
    """Running Allan sums of one stream of evenly spaced samples.

    Memory is O(log samples), time O(1) per sample. Any chunking of the same samples gives the same
    sums, bit for bit.

    Examples
    --------
    >>> import numpy as np
    >>> engine = RunningAllan()
    >>> engine.update(np.random.default_rng(0).normal(size=(1000, 6)), 0, 9_990_000_000)
    >>> engine.end_segment()
    >>> sums = engine.sums
    >>> sums.samples, sums.tau0
    (1000, 0.01)
    """

    def __init__(self, identity: ImuIdentity = ImuIdentity(), axes: tuple[str, ...] = AXES) -> None:
        self._closed = AllanSums.empty(identity, axes)
        self._open: OpenSegment | None = None

    def update(self, samples: ArrayLike, first_ns: int, last_ns: int) -> None:
        """Add samples that follow on the last ones without a cut.

        Parameters
        ----------
        samples : (n, axes) array
            Finite values.
        first_ns, last_ns : int
            Stamps of the first and the last of them.
        """
        values = np.asarray(samples, float)
        if not len(values):
            return
        if self._open is None:
            self._open = OpenSegment(len(self._closed.axes), values[0], first_ns)
        self._open.feed(values.T)
        self._open.last_ns = last_ns

    def end_segment(self) -> None:
        """Cut: the next sample starts a new segment, and no difference straddles the cut."""
        self._closed = self.sums
        self._open = None

    @property
    def open_samples(self) -> int:
        """Samples of the open segment."""
        return 0 if self._open is None else self._open.samples

    @property
    def sums(self) -> AllanSums:
        """The sums of all that came, as if the open segment ended here; nothing is disturbed."""
        if self._open is None:
            return self._closed
        now = self._open.sums(self._closed.identity, self._closed.axes)
        return self._closed.extended(now)
