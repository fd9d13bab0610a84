# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the noise processes, and the limits of a search for processes in a fit.

A process is defined by its autocovariance `Process.gamma`. The module `derived` computes all
statistics from this function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..settings import MAX_FLOAT

Floats = NDArray[np.float64]
Gamma = Callable[[ArrayLike, ArrayLike], Floats]
"""Type of a function gamma(M, j) such as `Process.gamma`, whose arguments broadcast."""

GAIN_PROCESS = 11.0
"""Least gain (decrease of -2 log L) for which one more process is added to a model. The least gain
is larger for a process with a frequency or with two shape parameters (`Process.threshold`). The
value is chosen for false alarms on 1 % of the axes. Measured false alarms
(`bench/bench_accuracy.py`): a Gauss-Markov process or a bounded random walk on 0.7 % of 2100 axes,
a sinusoid or a resonance on none."""

GAIN_RESOLVED = 5.41
"""Least decrease of -2 log L from a coefficient of 0 to its estimate for which a term is resolved.
The value is 2.326^2, for false alarms of 1 % (one-sided). Measured: 1.0 % for B and for K."""

LEAST_PERIODS = 3.0
"""Fewest periods, in the longest segment, of a sinusoid or resonance in a search. An oscillation
with fewer periods cannot be told from a slow drift. A daily cycle is not searched for, and may have
fewer periods (`sinusoid.daily_cycle`)."""


class Parameter(NamedTuple):
    """One shape parameter of a process, such as its correlation time."""

    name: str  # name of the field in the class of the process
    # unit of measurement in a `Model`; the function `Process.gamma` counts time in sample periods
    unit: Literal['s', 'Hz']
    largest_step: float  # largest change of the logarithm of the parameter in a step of a search
    derivative_step: float  # change of the logarithm of the parameter for a numerical derivative


CORRELATION_TIME = Parameter('correlation_time', 's', 0.7, 1e-3)
"""Time in which the autocovariance decays to 1/e: for a resonance its envelope, for rounding errors
the envelope of the first term of their series. A step of a search changes this time by at most a
factor of about two."""

FREQUENCY = Parameter('frequency', 'Hz', 0.06, 1e-4)
"""Frequency of an oscillation. A step of a search changes the frequency by at most about 6 %: half
a bin at the lower end of an octave of the spectra."""


class States(NamedTuple):
    """Linear system dx/dt = A x + v, with white noise v, whose output c^T x is a noise process.

    The coefficient of the noise process is 1.
    """

    dynamics: Floats  # matrix A, (states, states), per unit of time
    noise: Floats  # two-sided power spectral density of the white noise v, (states, states)
    output: Floats  # vector c, (states,)
    initial: Floats  # covariance of x at the start, (states, states); a random walk starts from 0


@dataclass(frozen=True, eq=False)
class Search:
    """Properties of the fitted data, which limit the shape parameters in a search for processes.

    The time unit is the sample period.

    Attributes
    ----------
    longest : int
        Number of samples of the longest segment.
    step : int
        Samples per block mean.
    crossover : float
        Frequency in cycles per sample below which the fit uses block means instead of spectra.
    f : (bins,) array
        Frequencies of the bins of the spectra in cycles per sample.
    block : (bins,) array
        Number of samples of a spectral block, for each bin.
    shortest : float
        Shortest correlation time in the search for a process without a frequency.
    """

    longest: int
    step: int
    crossover: float
    f: Floats
    block: Floats
    shortest: float

    def narrowest(self, frequency: float) -> float:
        """Return the shortest correlation time of a resonance that looks like a sinusoid in a fit.

        With this correlation time, the bandwidth of the resonance is a third of the width of the
        nearest bin. Without spectra, the result is 64 samples. ``frequency`` is in cycles per
        sample.
        """
        nearest = int(np.argmin(np.abs(self.f - frequency))) if len(self.f) else 0
        return float(self.block[nearest]) if len(self.f) else 64.0


@dataclass(frozen=True)
class Process:
    """A noise process with the coefficient 1.

    The noise processes of a model are frozen dataclasses in `allan_ros.core.noise.processes`. Their
    fields are the shape parameters, for example a correlation time. The values of these parameters
    are the shape of the process. Each of these classes has `gamma`, and either `states` or
    `no_states`.
    """

    name: ClassVar[str]
    """Unique name of the process in documents."""

    label: ClassVar[str]
    """Name in charts and tables, with fields for shape parameters: 'GM {correlation_time} s'."""

    meaning: ClassVar[str]
    """Sentence that describes the process in the documentation."""

    letter: ClassVar[str] = ''
    """Letter of the coefficient if IEEE Std 952-1997 defines this coefficient; else ''."""

    coefficient: ClassVar[str] = 'sigma'
    """Name of the coefficient of a process whose `letter` is ''."""

    time_power: ClassVar[float] = 0.0
    """The SI unit of the coefficient is the unit of the samples times s to this power.

    The coefficient of a low-pass filter has the squared unit of the samples instead.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = ()
    """The shape parameters, in the order of the fields."""

    finding: ClassVar[str] = ''
    """Id of the finding that reports the process; '' if none does.

    A sinusoid below 0.5 Hz is reported by another finding (`fit_findings.line_finding`).
    """

    no_states: ClassVar[str] = ''
    """Why a Kalman filter has no exact states for the process; '' if `states` returns states."""

    is_white: ClassVar[bool] = False
    """Whether the process is white noise."""

    is_regressor: ClassVar[bool] = False
    """Whether the process is not random: a ramp, or the effect of a low-pass filter."""

    is_line: ClassVar[bool] = False
    """Whether all power is at one frequency, as for a sinusoid."""

    low_band: ClassVar[Literal['dense', 'rank two', 'none']] = 'dense'
    """Form of the covariance of the block means in the search for the process: a dense matrix, a
    matrix of rank two (cosine and sine), or none if all candidates are too fast to change the block
    means."""

    replaces: ClassVar[type[Process] | None] = None
    """Class of the term that this process replaces if the data show the shape of the process."""

    def gamma(self, M: ArrayLike, j: ArrayLike) -> Floats:
        """Return the autocovariance of means over M samples at a lag of j means.

        The coefficient is 1, and the time unit is the sample period.

        Parameters
        ----------
        M : array
            Samples per mean, above 0; need not be whole.
        j : array
            Lag as a whole number of means, at least 0; broadcasts with ``M``.

        Returns
        -------
        float64 array
            Autocovariance in the squared unit of the samples, up to a constant that is the same for
            all M and j. It has the shape to which ``M`` and ``j`` broadcast.
        """
        raise NotImplementedError

    @property
    def is_drift(self) -> bool:
        """Whether the integral of the process grows with time, or the process is a slow sinusoid.

        A resonance is not drift, although its integral grows: `density_at_zero` describes this. The
        shape must be in s and Hz, because sinusoids of up to `SLOW_SINUSOID_HZ` are slow.
        """
        return True

    @property
    def density_at_zero(self) -> float:
        """Two-sided power spectral density at 0 Hz of a resonance with the coefficient 1.

        The integral of a resonance grows like the integral of white noise with this density. The
        density has the unit of the correlation time. The result is 0 for all other processes.
        """
        return 0.0

    @property
    def slowest_time(self) -> float:
        """Correlation time of a process, or half of the period of a sinusoid.

        The result is infinite for a process without shape parameters. It is 0 for a resonance, and
        for the rounding errors of a counter.
        """
        return math.inf

    def states(self) -> States | None:
        """Return the exact state-space model in continuous time, or None if there is none."""
        return None

    @classmethod
    def grid(cls, search: Search) -> Iterator[Process]:
        """Yield the candidates of a search; none if a fit does not search for the process."""
        return iter(())

    @classmethod
    def threshold(cls, bins: int) -> float:
        """Return the least decrease of -2 log L for which the process is added to a model.

        For a process with a frequency, the result is larger by 2 log(bins), because the frequencies
        of ``bins`` bins are tried. For a process with two shape parameters, the result is larger by
        `GAIN_RESOLVED`, because a simpler process with one parameter is a limit of this process.
        """
        search_gain = 2.0 * math.log(bins) * (FREQUENCY in cls.parameters)
        return GAIN_PROCESS + search_gain + GAIN_RESOLVED * max(len(cls.parameters) - 1, 0)

    def bounds(self, parameter: Parameter, search: Search) -> tuple[float, float]:
        """Return the lowest and the highest value of a shape parameter in a search.

        Correlation times are in samples, and frequencies in cycles per sample.
        """
        if parameter.unit == 's':
            return search.shortest, 4.0 * search.longest
        return LEAST_PERIODS / search.longest, 0.499

    @property
    def bends_spectrum(self) -> bool:
        """Whether the spectrum looks like low-pass filtered noise at the highest frequencies."""
        return False

    def is_broad_near(self, highest: float) -> bool:
        """Return whether the process is a broad resonance that can imitate a low-pass filter.

        ``highest`` is the highest frequency of the fit in cycles per sample, near which a filter
        bends the spectrum.
        """
        return False

    def limit(self, search: Search) -> Process:
        """Return the process that replaces this process if its shape is at a limit of a search.

        A resonance that is too narrow is replaced by a sinusoid. Other processes are not replaced.
        """
        return self

    def alias_variance(self, step: int) -> float:
        """Return the largest variance that an alias adds to means over ``step`` samples.

        The coefficient is 1, and the shape is in samples. The result is 0 for a process that is not
        a sinusoid, and for a sinusoid of at most 1/step cycles per sample.
        """
        return 0.0

    def facts(self, value: float) -> dict[str, float]:
        """Return the numbers in the finding that reports the process, by name.

        ``value`` is the coefficient in SI.
        """
        return {self.coefficient: value, **self.numbers}

    def sample(self, n: int, rng: np.random.Generator) -> Floats | None:
        """Return n samples, (n,), or None if `derived.simulate` draws them from gamma."""
        return None

    # --- units ------------------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[float, ...]:
        """Values of the shape parameters, in the order of `parameters`."""
        return tuple(getattr(self, parameter.name) for parameter in self.parameters)

    @property
    def numbers(self) -> dict[str, float]:
        """Values of the shape parameters by name."""
        return {p.name: getattr(self, p.name) for p in self.parameters}

    def with_shape(self, numbers: Mapping[str, float]) -> Process:
        """Return the process with new values of some shape parameters."""
        return replace(self, **numbers)

    def scaled(self, parameter: Parameter, factor: float) -> Process:
        """Return the process with one shape parameter multiplied by a factor."""
        return self.with_shape({parameter.name: self.numbers[parameter.name] * factor})

    def in_unit(self, unit: float) -> Process:
        """Return the process with its shape in another unit of time.

        ``unit`` is the new unit of time as a multiple of the present unit: ``in_unit(tau0)``
        converts a shape from s to samples, and ``in_unit(1.0 / tau0)`` from samples to s.
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
        """Convert a coefficient from SI to units in which the sample period is the unit of time."""
        return coefficient * math.pow(tau0, -self.time_power)

    def variance_of(self, coefficient: float, tau0: float) -> float:
        """Return the factor by which gamma is multiplied: the squared result of `in_samples`.

        ``coefficient`` is in SI, and ``tau0`` is the sample period in s. The factor is at most
        `MAX_FLOAT`^2. For a low-pass filter, it is the result of `in_samples` itself.
        """
        return min(abs(self.in_samples(coefficient, tau0)), MAX_FLOAT) ** 2

    def coefficient_of(self, variance: float, tau0: float) -> float:
        """Return the coefficient in SI for which `variance_of` is ``variance``.

        The result is 0 for a negative variance, except for a low-pass filter, whose coefficient may
        be negative.
        """
        return math.sqrt(max(variance, 0.0)) * math.pow(tau0, self.time_power)

    @property
    def title(self) -> str:
        """The label with the values of the shape parameters, rounded to two significant digits."""
        numbers = {p.name: _two_digits(v) for p, v in zip(self.parameters, self.shape)}
        return self.label.format(**numbers)


def _two_digits(value: float) -> str:
    return f'{float(f"{value:.2g}"):g}'
