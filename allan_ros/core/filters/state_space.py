# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""State-space models of the noise of one axis, with the exact discrete-time matrices.

The states are the integral of the samples (angle or velocity) and the components of the bias:

    angle' = walk + sum output_i x_i + white noise of density N
    walk'  = slope + white noise of density K        (slope: an optional constant)
    x_i'   = A_i x_i + white noise                   (`Process.states` of each other process)

Bias instability
----------------
Bias instability has no exact model with a finite number of states. It is approximated by four
Gauss-Markov processes with logarithmically spaced correlation times. Their Allan deviation agrees
with bias instability within 5 % from about 3 s to 3000 s.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import lru_cache
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ..errors import AllanError
from ..noise import FLICKER_FLOOR, Model, Process
from ..noise.derived import gauss_markov_approximation
from ..noise.model import BY_LETTER
from ..noise.process import States
from ..settings import expect

Floats = NDArray[np.float64]

BANK_SIZE = 4
"""Number of Gauss-Markov processes that approximate bias instability."""

LONGEST_TIME_S = 1500.0
"""Longest correlation time in s of the processes that approximate bias instability."""

SHORTEST_TIME_S = 1.5
"""Shortest correlation time in s of the processes that approximate bias instability, unless bias
instability exceeds white noise at short averaging times (see `flicker_processes`)."""


@dataclass(frozen=True)
class StateSpace:
    """State-space model of white noise, a random walk and other processes with states.

    The states are, in this order, the integral of the samples, the random walk, the states of the
    other processes, and optionally the slope of the random walk.

    Attributes
    ----------
    white : float
        Density N of the white noise, in the unit of the samples per sqrt(Hz).
    walk : float
        Density K of the random walk in SI. If it is 0 and there is no slope, the state of the
        random walk is a constant bias.
    processes : tuple of (coefficient, Process)
        Other processes, in SI; `Process.states` of each process must return states. The coefficient
        of most processes is the stationary standard deviation in the unit of the samples.
    slope : bool
        Whether the last state is a constant slope of the random walk.
    """

    white: float
    walk: float = 0.0
    processes: tuple[tuple[float, Process], ...] = ()
    slope: bool = False

    @property
    def _blocks(self) -> list[tuple[float, Process, slice]]:
        """Coefficient, process and slice of the states: for the random walk, then each process."""
        blocks, first = [], 1
        for value, process in ((self.walk, BY_LETTER['K']), *self.processes):
            size = len(_states(process).output)
            blocks.append((value, process, slice(first, first + size)))
            first += size
        return blocks

    @property
    def size(self) -> int:
        """Number of states."""
        return int(self._blocks[-1][2].stop) + self.slope

    def transition(self, dt: float) -> Floats:
        """Return the state transition matrix Phi, (size, size), for a step of ``dt`` s.

        Raises
        ------
        AllanError
            When the step is not a positive, finite number, or a process has no states.
        """
        phi = np.eye(self.size)
        for _, process, rows in self._blocks:
            process_phi, _ = _integrated(process, _checked(dt))
            phi[0, rows], phi[rows, rows] = process_phi[0, 1:], process_phi[1:, 1:]
        if self.slope:
            phi[1, -1], phi[0, -1] = dt, dt * dt / 2.0
        return phi

    def noise(self, dt: float) -> Floats:
        """Return the discrete process noise covariance Qd, (size, size), of a step of ``dt`` s.

        Raises
        ------
        AllanError
            When the step is not a positive, finite number, or a process has no states.
        """
        q = np.zeros((self.size, self.size))
        q[0, 0] = self.white**2 * _checked(dt)
        for value, process, rows in self._blocks:
            process_noise = value**2 * _integrated(process, dt)[1]
            indices = [0, *range(rows.start, rows.stop)]
            q[np.ix_(indices, indices)] += process_noise
        return q

    def initial_covariance(self, walk: float, slope: float = 0.0) -> Floats:
        """Return the initial covariance of the states, (size, size).

        ``walk`` and ``slope`` are the prior standard deviations of the random walk and of its
        slope. The other processes have their stationary covariance. The integral of the samples is
        known to be 0 at the start.
        """
        p = np.zeros((self.size, self.size))
        for value, process, rows in self._blocks:
            p[rows, rows] = value**2 * _states(process).initial
        p[1, 1] = walk**2
        if self.slope:
            p[-1, -1] = slope**2
        return p

    def sample_variance(self, rate: float) -> float:
        """Return the variance R = N^2 f of the white noise of one sample; ``rate`` is f in Hz."""
        return self.white**2 * rate


def _checked(dt: float) -> float:
    expect(Real, step=dt)
    if not 0.0 < dt <= sys.float_info.max:
        raise AllanError(f'the step is {dt!s:.40} s: give a rate above 0 Hz')
    return float(dt)


def _states(process: Process) -> States:
    states = process.states()
    if states is None:
        raise AllanError(f'{process.title} has no states: {process.no_states}')
    return states


@lru_cache(maxsize=256)
def _integrated(process: Process, dt: float) -> tuple[Floats, Floats]:
    """Return Phi and Qd, for a step of ``dt`` s, of a process with the coefficient 1.

    The first state is the integral of the process, the other states are the states of the process.
    The matrices of a short step follow from a matrix exponential (C. F. van Loan, IEEE Trans.
    Automatic Control 23, 1978). Then the step is doubled repeatedly. Each doubling adds positive
    semidefinite matrices, so that no digits are lost. During the computation, the unit of time is
    ``dt``.
    """
    from scipy.linalg import expm  # slow to import

    states = _states(process)
    n = len(states.output) + 1
    dynamics, density = np.zeros((n, n)), np.zeros((n, n))
    dynamics[0, 1:], dynamics[1:, 1:] = states.output, states.dynamics * dt
    density[1:, 1:] = states.noise * dt
    doublings = max(0, math.ceil(math.log2(2.0 * np.abs(dynamics).sum(axis=1).max())))
    step = 2.0**-doublings
    scale = density.max() or 1.0
    block = np.block([[-dynamics, density / scale], [np.zeros((n, n)), dynamics.T]])
    exponential = expm(step * block)
    phi = exponential[n:, n:].T
    q = scale * phi @ exponential[:n, n:]
    for _ in range(doublings):
        q = q + phi @ q @ phi.T
        phi = phi @ phi
    unit_change = np.diag([dt, *np.ones(n - 1)])
    phi = unit_change @ phi @ np.linalg.inv(unit_change)
    q = unit_change @ (q + q.T) @ unit_change / 2.0
    phi.flags.writeable = q.flags.writeable = False
    return phi, q


def state_space(model: Model) -> StateSpace:
    """Return the state-space model of noise processes.

    Bias instability becomes the Gauss-Markov processes of `flicker_processes`. These processes lack
    the components of bias instability that are slower than the longest correlation time T.
    Therefore, K^2 of the random walk is increased by B^2/(3 pi T). Except for white noise,
    processes without states of their own, such as quantization, a ramp or a sinusoid, are excluded
    (see `has_states`).
    """
    n, b, k = (model.value(letter) for letter in 'NBK')
    slow_walk = b / math.sqrt(3.0 * math.pi * LONGEST_TIME_S)
    with_states = model.where(lambda process: has_states(process) and process != BY_LETTER['K'])
    other_parts = tuple((part.value, part.process) for part in with_states.parts)
    flicker_parts = flicker_processes(b, n) if b else ()
    return StateSpace(n, math.hypot(k, slow_walk), (*flicker_parts, *other_parts))


def has_states(process: Process) -> bool:
    """Return whether a process has states of its own in a `StateSpace`.

    A ramp has none: the slope of the random walk represents the ramp.
    """
    return process.states() is not None and not process.is_regressor


def flicker_processes(
    bias_instability: float, white: float = 0.0
) -> tuple[tuple[float, Process], ...]:
    """Return Gauss-Markov processes whose sum approximates the Allan variance of flicker noise.

    White noise dominates at averaging times below N^2 / (0.441 B^2). The shortest correlation time
    is a fifth of this averaging time, limited to the range from 0.15 s to `SHORTEST_TIME_S`.

    Parameters
    ----------
    bias_instability : float
        Coefficient B of the flicker noise in SI, above 0.
    white : float
        Density N of the white noise in SI.

    Returns
    -------
    tuple of (float, Process)
        Standard deviation in the unit of the samples, and Gauss-Markov process with a correlation
        time in s.
    """
    crossing_s = white**2 / (FLICKER_FLOOR * bias_instability**2)
    shortest = min(max(crossing_s / 5.0, 0.15), SHORTEST_TIME_S)
    times = np.geomspace(shortest, LONGEST_TIME_S, BANK_SIZE)
    tau = np.geomspace(1.3 * times[0], 2.0 * times[-1], 40)
    step = 1e-6 * shortest  # so short that the result holds for continuous time
    processes = gauss_markov_approximation(BY_LETTER['B'], (times / step).tolist(), tau / step)
    return tuple(
        (bias_instability * math.sqrt(variance), process.in_unit(1.0 / step))
        for variance, process in processes
    )


def white_density(process: Process) -> float:
    """Return the density N of the white noise that a process with the coefficient 1 resembles.

    The process must have a correlation time. At times that are long compared with this correlation
    time, the process resembles white noise. Raises AllanError if the process has no states.
    """
    states = _states(process)
    gain = np.linalg.solve(-states.dynamics.T, states.output)
    return math.sqrt(float(gain @ states.noise @ gain))
