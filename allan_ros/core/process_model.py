# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`ProcessModel`: the noise of one axis as a sum of independent processes, in SI units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .terms import NoiseTerms, gauss_markov_avar, sinusoid_avar, term_avar


@dataclass(frozen=True)
class ProcessModel:
    """The selected model of one axis: what is drawn, predicted from and exported.

    Terms that are not resolved are 0. Where the five terms describe the curve, ``terms`` holds
    them and the tuples are empty; else ``terms`` holds N, K (and a signed R) beside processes.

    Attributes
    ----------
    terms : NoiseTerms
        Q, N, B, K, R in SI (see `NoiseTerms`).
    gauss_markov : tuple of (sigma, tau)
        First-order Gauss-Markov processes: stationary standard deviation in the unit of the
        samples, correlation time in s.
    sinusoids : tuple of (amplitude, frequency)
        Amplitude in the unit of the samples, frequency in Hz.
    """

    terms: NoiseTerms = field(default_factory=NoiseTerms)
    gauss_markov: tuple[tuple[float, float], ...] = ()
    sinusoids: tuple[tuple[float, float], ...] = ()

    def avar(self, tau: ArrayLike, tau0: float = 0.0) -> NDArray[np.float64]:
        """Return the Allan variance at the averaging times ``tau``.

        Parameters
        ----------
        tau : (times,) array
            Averaging times in s.
        tau0 : float
            Sample period in s. 0 gives the continuous-time curve; a positive period that of
            the samples (the discrete walk and aliased sinusoids).

        Returns
        -------
        (times,) float64 array
            Squared unit of the samples.

        Examples
        --------
        >>> ProcessModel(NoiseTerms(N=2.0)).avar([1.0, 4.0])
        array([4., 1.])
        """
        tau = np.asarray(tau, float)
        # an averaging factor counts samples; far below every tau, the period does not matter
        step = tau0 or 1e-6 * float(tau.min(initial=1.0))
        m = tau / step
        total = np.asarray(term_avar(m, step, self.terms).sum(axis=-1))
        for sigma, correlation_time in self.gauss_markov:
            total += sigma**2 * gauss_markov_avar(m, correlation_time / step)
        for amplitude, frequency in self.sinusoids:
            total += amplitude**2 * sinusoid_avar(m, frequency * step)
        return total
