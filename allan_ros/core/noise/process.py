# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the noise processes, and the range in which the fit searches for them.

The only mathematics of a process is `Process.gamma`. `derived` computes all statistics from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Gamma = Callable[[ArrayLike, ArrayLike], Floats]
"""gamma(M, j), whose arguments broadcast."""

GAIN_PROCESS = 11.0
"""Least gain in -2 log L of one more process, plus 2 log(bins) if it has a frequency: 1 % of axes
(0.7 % with the threshold of a bounded walk; sinusoids and resonances: none)."""

GAIN_RESOLVED = 5.41
"""Least gain in -2 log L from 0 for a term to be resolved: one-sided 1 % (B 1.0, K 1.0 %)."""


LARGEST_NUMBER = 1e150
"""Largest coefficient whose square is a float; a document may state any number."""


LEAST_PERIODS = 3.0
"""Fewest periods of a sinusoid or resonance in the longest segment. A slow drift imitates fewer."""


class Parameter(NamedTuple):
    """One number of the shape of a process. Its name is the name of a field of the class."""

    name: str
    unit: Literal['s', 'Hz']  # the time unit is the sample period in gamma, and 1 s in a `Model`
    largest_step: float  # of a search, in the logarithm of the number
    derivative_step: float  # for the derivative of an expectation, in the logarithm of the number


CORRELATION_TIME = Parameter('correlation_time', 's', 0.7, 1e-3)
"""Time in which the autocovariance decays to 1/e. A search moves by at most a factor of two."""

FREQUENCY = Parameter('frequency', 'Hz', 0.06, 1e-4)
"""A search moves the frequency by at most half a bin of the spectra."""


class States(NamedTuple):
    """Linear system x' = A x + white noise whose output is the process with the coefficient 1."""

    dynamics: Floats  # A, (states, states), per unit of time
    noise: Floats  # two-sided density of the white noise, (states, states)
    output: Floats  # (states,)
    initial: Floats  # covariance of the states at the start; the level of a walk starts from 0


@dataclass(frozen=True, eq=False)
class Search:
    """Range of shapes that the data of a fit can tell apart; the time unit is the sample period.

    Attributes
    ----------
    longest : int
        Number of samples of the longest segment.
    step : int
        Samples per block mean.
    crossover : float
        Frequency in cycles per sample below which the fit uses block means instead of spectra.
    f : (bins,) array
        Frequencies of the spectra.
    block : (bins,) array
        Samples per block of each bin.
    shortest : float
        Shortest correlation time of a process without a frequency.
    """

    longest: int
    step: int
    crossover: float
    f: Floats
    block: Floats
    shortest: float

    def narrowest(self, frequency: float) -> float:
        """Return the correlation time from which a process looks like a sinusoid in the spectra.

        Its bandwidth is then a third of the width of a bin.
        """
        at = int(np.argmin(np.abs(self.f - frequency))) if len(self.f) else 0
        return float(self.block[at]) if len(self.f) else 64.0


@dataclass(frozen=True)
class Process:
    """A noise process with a shape.

    A subclass is a frozen dataclass in a module of `allan_ros.core.noise.processes`, whose fields
    are the numbers of the shape. It must define `gamma`, and `states` or `no_states`.
    """

    name: ClassVar[str]
    """Name in documents, unique."""

    label: ClassVar[str]
    """Name in charts and tables; a template with the shape, such as 'GM {correlation_time} s'."""

    meaning: ClassVar[str]
    """One sentence for the documentation."""

    letter: ClassVar[str] = ''
    """Letter of the coefficient in IEEE Std 952-1997, if the process is one of its terms."""

    coefficient: ClassVar[str] = 'sigma'
    """Name of the coefficient of a process without a letter."""

    time_power: ClassVar[float] = 0.0
    """The SI unit of the coefficient is the unit of the samples times s to this power."""

    parameters: ClassVar[tuple[Parameter, ...]] = ()
    """The numbers of the shape, in the order of the fields."""

    finding: ClassVar[str] = ''
    """Id of the finding that reports the process; '' if none does."""

    no_states: ClassVar[str] = ''
    """Why a Kalman filter has no exact states for the process; '' if `states` gives them."""

    is_white: ClassVar[bool] = False
    """Whether the process has no memory."""

    is_regressor: ClassVar[bool] = False
    """Whether it is a known function with an unknown factor and no random process."""

    is_line: ClassVar[bool] = False
    """Whether all power is at one frequency."""

    low_band: ClassVar[Literal['dense', 'rank two', 'none']] = 'dense'
    """Covariance of slow contrasts of block means in the search for the process: a dense matrix,
    the squares of a cosine and a sine, or none because all candidates are faster."""

    replaces: ClassVar[type[Process] | None] = None
    """The term that this process replaces if the data show its shape."""

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        """Return the autocovariance of means over M samples at a lag of j means.

        The coefficient is 1, the time unit is the sample period, and the arguments broadcast. M
        need not be whole. A constant, the same for all M and j, may be omitted.
        """
        raise NotImplementedError

    @property
    def is_drift(self) -> bool:
        """Whether the integral of the process grows; the shape is in s and Hz."""
        return True

    @property
    def density_at_zero(self) -> float:
        """Two-sided density at 0 Hz of vibration with the coefficient 1, in s; 0 for a line.

        The integral of vibration grows like that of white noise of this density.
        """
        return 0.0

    @property
    def slowest_time(self) -> float:
        """Time within which the process changes, for a comparison with slow disturbances."""
        return math.inf

    def states(self) -> States | None:
        """Return exact states in continuous time, or None."""
        return None

    @classmethod
    def grid(cls, search: Search) -> Iterator[Process]:
        """Yield the candidates of a search; none by default."""
        return iter(())

    @classmethod
    def threshold(cls, bins: int) -> float:
        """Return the least gain in -2 log L of one more process.

        The search over the frequencies of ``bins`` bins increases it by 2 log(bins). A process with
        two numbers contains a simpler one with one, so it must be better by `GAIN_RESOLVED`.
        """
        search = 2.0 * math.log(bins) * (FREQUENCY in cls.parameters)
        return GAIN_PROCESS + search + GAIN_RESOLVED * max(len(cls.parameters) - 1, 0)

    def bounds(self, parameter: Parameter, search: Search) -> tuple[float, float]:
        """Return the lowest and the highest value of a number of the shape in a search."""
        if parameter.unit == 's':
            return search.shortest, 4.0 * search.longest
        return LEAST_PERIODS / search.longest, 0.499

    @property
    def bends_spectrum(self) -> bool:
        """Whether the highest frequencies have a spectrum like that of a low-pass filter."""
        return False

    def is_broad_near(self, highest: float) -> bool:
        """Return whether it can have the shape of a low-pass filter that bends the spectrum.

        ``highest`` is the highest frequency of the fit, near which such a filter bends it.
        """
        return False

    def limit(self, search: Search) -> Process:
        """Return the process that this one becomes at the end of its range, or itself."""
        return self

    def alias_variance(self, step: int) -> float:
        """Return the variance of means over ``step`` samples if only aliases of it remain, or 0."""
        return 0.0

    def facts(self, value: float) -> dict[str, float]:
        """Return the numbers of the finding about a process with an SI coefficient."""
        return {self.coefficient: value, **self.numbers}

    def sample(self, n: int, rng: np.random.Generator) -> Floats | None:
        """Return n samples, or None if `derived.simulate` draws them from gamma."""
        return None

    # --- units ------------------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[float, ...]:
        """The numbers of the shape."""
        return tuple(getattr(self, parameter.name) for parameter in self.parameters)

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of the shape by name."""
        return {p.name: getattr(self, p.name) for p in self.parameters}

    def with_shape(self, numbers: Mapping[str, float]) -> Process:
        """Return the process with some numbers of its shape changed."""
        return replace(self, **numbers)

    def scaled(self, parameter: Parameter, factor: float) -> Process:
        """Return the process with one number of its shape multiplied by a factor."""
        return self.with_shape({parameter.name: self.numbers[parameter.name] * factor})

    def in_unit(self, unit: float) -> Process:
        """Return the process with another time unit, which is ``unit`` old ones long.

        ``in_unit(tau0)`` is the shape in samples of a shape in s, and ``in_unit(1.0 / tau0)`` the
        reverse.
        """
        if not self.parameters:
            return self
        return replace(
            self,
            **{
                p.name: value / unit if p.unit == 's' else value * unit
                for p, value in zip(self.parameters, self.shape)
            },
        )

    def in_samples(self, coefficient: float, tau0: float) -> float:
        """Return an SI coefficient with the sample period as the time unit."""
        return coefficient * math.pow(tau0, -self.time_power)

    def variance_of(self, coefficient: float, tau0: float) -> float:
        """Return the factor of gamma for an SI coefficient: its square in sample units."""
        return min(abs(self.in_samples(coefficient, tau0)), LARGEST_NUMBER) ** 2

    def coefficient_of(self, variance: float, tau0: float) -> float:
        """Return the SI coefficient of a factor of gamma; 0 for a negative one."""
        return math.sqrt(max(variance, 0.0)) * math.pow(tau0, self.time_power)

    @property
    def title(self) -> str:
        """The label with the shape in s and Hz, rounded to two digits."""
        numbers = {p.name: _two_digits(v) for p, v in zip(self.parameters, self.shape)}
        return self.label.format(**numbers)


def _two_digits(value: float) -> str:
    return f'{float(f"{value:.2g}"):g}'
