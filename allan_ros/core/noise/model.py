# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise model of one axis: a sum of processes in SI."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..errors import AllanError
from ..estimate import Ends
from .derived import avar, growth_variance
from .process import Floats, Process
from .registry import LETTERS, PROCESSES

CONTINUOUS = 1e-6
"""Sample period with which continuous time is approximated, as a fraction of the shortest given
time, or of 1 s if all given times are longer."""

LARGEST_VARIANCE = 1e300
"""Largest variance of an error due to one part of a model. Larger variances are set to this value,
because documents contain finite numbers only."""

BY_LETTER: Mapping[str, Process] = {
    one.letter: one() for one in PROCESSES.values() if one.letter and not one.parameters
}
"""Letter of each of the five terms Q, N, B, K and R -> process of this term."""


class Part(NamedTuple):
    """A process of a model with its coefficient.

    Attributes
    ----------
    process : Process
        Process with its shape in s and Hz.
    value : float
        Coefficient in SI, as in `Model.parts`.
    ci95 : (low, high) or None
        95 % interval of the coefficient; None if it is unknown. The intervals of the five terms are
        not in a model but in `AxisFit.noise`.
    shape_ci95 : tuple of (low, high)
        95 % interval of each shape parameter; empty if the intervals are unknown. The interval of a
        shape that is known instead of fitted, such as the period of a daily cycle, has the width 0.
    """

    process: Process
    value: float
    ci95: Ends | None = None
    shape_ci95: tuple[Ends, ...] = ()


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of the fitted coefficients of one axis.

    Attributes
    ----------
    names : tuple of str
        Names of the coefficients: 'Q', 'N', 'B' and 'K', then the other processes in the order of
        `Model.parts` as name and number, such as 'gauss_markov 0'. The letter of a term also
        stands for a process that replaces this term. R and a low-pass filter are not included.
    matrix : (names, names) array
        Covariance of the squared coefficients (N^2, sigma^2, amplitude^2 ...) in SI. It includes
        the uncertainty of the fitted correlation times and frequencies.
    """

    names: tuple[str, ...]
    matrix: Floats


@dataclass(frozen=True)
class Model:
    """Noise of one axis: a sum of independent processes.

    Attributes
    ----------
    parts : tuple of Part
        Processes with their coefficients in SI, the terms Q, N, B, K and R first. The coefficient
        of a Gauss-Markov process or a resonance is its standard deviation (sigma), and the
        coefficient of a sinusoid its amplitude. A process that replaces Q or K has the coefficient
        of this term. The coefficient of a low-pass filter is in the squared unit of the samples
        times s^2, and may be negative.
    covariance : Covariance or None
        Covariance of the fitted coefficients; None if it is unknown.

    Examples
    --------
    >>> from allan_ros.core.noise import GaussMarkov, Model
    >>> model = Model.of((0.1, GaussMarkov(300.0)), N=2.0, K=1e-3)
    >>> model.value('N'), list(model.contributions([1.0]))
    (2.0, ['N', 'K', 'GM 300 s'])
    """

    parts: tuple[Part, ...] = ()
    covariance: Covariance | None = field(default=None, compare=False)

    @classmethod
    def of(cls, *processes: tuple[float, Process], **terms: float) -> Model:
        """Return the model of terms (``N=1e-3``) and of pairs (coefficient, process) in SI.

        Terms and processes with the coefficient 0 are not in the model.

        Raises
        ------
        AllanError
            If a term is unknown or not finite, or a term other than R is negative.
        """
        for name, value in terms.items():
            if name not in [*LETTERS]:
                raise AllanError(f'there is no term {name!r}: give {", ".join(LETTERS)}')
            # an integer above the largest float counts as infinite
            if not abs(value) <= sys.float_info.max or (value < 0.0 and name != 'R'):
                allowed_range = '' if name == 'R' else ' of 0 or above'
                raise AllanError(f'{name} is {value!s:.40}: give a finite number{allowed_range}')
        parts = [Part(BY_LETTER[name], terms[name]) for name in LETTERS if terms.get(name)]
        parts += [Part(process, value) for value, process in processes if value]
        return cls(tuple(parts))

    def value(self, letter: str) -> float:
        """Return the coefficient of one of the terms Q, N, B, K and R in SI.

        The result is 0 if the model does not contain the term, or another process replaces it.
        Raises KeyError for another letter.
        """
        term = BY_LETTER[letter]
        return sum((part.value for part in self.parts if part.process == term), 0.0)

    def changed(self, **terms: float) -> Model:
        """Return the model with other coefficients of some terms (``N=1e-3``), in SI.

        The covariance, and the processes other than the five terms, are unchanged.

        Raises
        ------
        AllanError
            As for `of`.
        """
        present_terms = {letter: self.value(letter) for letter in BY_LETTER}
        new_parts = Model.of(**{**present_terms, **terms}).parts
        other_parts = (part for part in self.parts if part.process not in BY_LETTER.values())
        return replace(self, parts=(*new_parts, *other_parts))

    def __getitem__(self, name: str) -> tuple[Part, ...]:
        """Return all parts whose process has this name, such as 'sinusoid'."""
        return tuple(part for part in self.parts if part.process.name == name)

    @property
    def shaped(self) -> Model:
        """Model of the processes with shape parameters, which the five terms do not have."""
        return self.where(lambda process: bool(process.parameters))

    def at_end(self, end: int, scatter: float = 0.0) -> Model:
        """Return the model with each coefficient at an end of its 95 % interval.

        A lower end below 0 becomes 0. Coefficients without an interval, sinusoids and shapes are
        unchanged.

        Parameters
        ----------
        end : int
            0 for the lower ends of the intervals, 1 for the upper ends.
        scatter : float
            Half-width of the 95 % interval for the logarithm of the drift amplitude in another hour
            (`AxisFit.drift_scatter`). It widens the intervals of the drift (`Process.is_drift`).
        """

        def value(part: Part) -> float:
            if part.ci95 is None or part.process.is_line:
                return part.value
            limit = max(part.ci95[end], 0.0)
            if not (scatter and limit and part.value and part.process.is_drift):
                return limit
            distance = math.hypot(math.log(limit / part.value), scatter)
            return part.value * math.exp(distance if end else -distance)

        return replace(self, parts=tuple(p._replace(value=value(p)) for p in self.parts))

    def where(self, chosen: Callable[[Process], bool]) -> Model:
        """Return the model of the processes for which ``chosen`` is true, without covariance."""
        return Model(tuple(part for part in self.parts if chosen(part.process)))

    @property
    def drift(self) -> Model:
        """The model of all processes whose integral grows with time, and of slow sinusoids.

        Sinusoids above 0.1 Hz and other processes whose integral is bounded, such as quantization
        noise, are excluded. A resonance is replaced by white noise with the same density at 0 Hz.
        """
        drift = self.where(lambda process: process.is_drift)
        density = sum(part.value**2 * part.process.density_at_zero for part in self.parts)
        return drift.changed(N=math.sqrt(self.value('N') ** 2 + density)) if density else drift

    @property
    def has_drift(self) -> bool:
        """Whether a process of the model, other than white noise, is drift (`Process.is_drift`)."""
        return any(p.process.is_drift and not p.process.is_white for p in self.parts)

    def avar(self, tau: ArrayLike, tau0: float = 0.0) -> Floats:
        """Return the Allan variance at the averaging times ``tau``.

        Parameters
        ----------
        tau : (times,) array
            Averaging times in s.
        tau0 : float
            Sample period in s. The result is for sampled noise (random walk in discrete steps,
            aliased sinusoids). With 0, the result approximates continuous time.

        Returns
        -------
        (times,) float64 array
            Allan variance in the squared unit of the samples.

        Examples
        --------
        >>> Model.of(N=2.0).avar([1.0, 4.0])
        array([4., 1.])
        """
        tau = np.asarray(tau, float)
        return np.asarray(sum(self.contributions(tau, tau0).values(), np.zeros_like(tau)))

    def contributions(self, tau: ArrayLike, tau0: float = 0.0) -> dict[str, Floats]:
        """Return the Allan variance of each process; the sum over all processes is `avar`.

        Processes with equal titles are added.

        Parameters
        ----------
        tau, tau0
            As for `avar`.

        Returns
        -------
        dict of name to (times,) float64 array
            Keys are the titles of the processes, such as 'N' and 'GM 300 s'. Values are in the
            squared unit of the samples. The value of a low-pass filter may be negative.
        """
        tau = np.asarray(tau, float)
        step = tau0 or CONTINUOUS * float(tau.min(initial=1.0))
        variances: dict[str, Floats] = {}
        for part in self.parts:
            variance, in_samples = (
                part.process.variance_of(part.value, step),
                part.process.in_unit(step),
            )
            title = part.process.title
            variances[title] = variances.get(title, 0.0) + variance * avar(in_samples, tau / step)
        return variances

    def growth(self, horizon: ArrayLike, window: ArrayLike) -> Floats:
        """Return the predicted standard deviation of the error of the integrated samples.

        Parameters
        ----------
        horizon : array
            Prediction horizons h in s, above 0.
        window : array
            Times W in s, above 0, over which the bias was averaged before time 0; broadcasts with
            ``horizon``.

        Returns
        -------
        float64 array
            Standard deviation in the unit of the samples times s, with the broadcast shape of
            ``horizon`` and ``window``.

        Notes
        -----
        The integral theta of the samples is the angle of a gyro, or the velocity of an
        accelerometer. The bias is averaged over the W seconds before time 0 and subtracted. At the
        prediction horizon h, theta has the error

            e(h) = theta(h) - theta(0) - (h/W) (theta(0) - theta(-W)).

        A constant bias does not change e. The variance of e therefore follows from gamma of each
        process (`allan_ros.core.noise.derived.growth_variance`).

        Examples
        --------
        White noise with N = 1. The bias is averaged over 8 s, and the samples are integrated over
        the next 8 s:

        >>> float(Model.of(N=1.0).growth(8.0, 8.0))
        4.0
        """
        variances = self.growth_variances(horizon, window).values()
        zeros = np.zeros(np.broadcast_shapes(np.shape(horizon), np.shape(window)))
        return np.asarray(np.sqrt(np.maximum(sum(variances, zeros), 0.0)))

    def growth_variances(self, horizon: ArrayLike, window: ArrayLike) -> dict[Process, Floats]:
        """Return a dict that maps each process to the variance of the error due to this process.

        The parameters are the same as in `growth`. The variances have the squared unit of the
        samples times s^2, and the broadcast shape of ``horizon`` and ``window``.
        """
        h, w = np.broadcast_arrays(np.asarray(horizon, float), np.asarray(window, float))
        step = CONTINUOUS * float(min(h.min(initial=1.0), w.min(initial=1.0)))
        variances: dict[Process, Floats] = {}
        for process, value, *_ in self.parts:
            unit_variance = step**2 * growth_variance(process.in_unit(step), h / step, w / step)
            with np.errstate(over='ignore'):
                variance = process.variance_of(value, step) * unit_variance
                variance = np.minimum(variance, LARGEST_VARIANCE)
            variances[process] = variances.get(process, np.zeros(np.shape(h))) + variance
        return variances
