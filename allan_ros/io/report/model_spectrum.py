# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The spectrum that the fitted terms make: what the measured one is laid against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..results import AxisResult

Floats = NDArray[np.float64]


def model_density(axis: AxisResult, frequency: Floats) -> Floats:
    """Return the one-sided power spectral density of the fit, (frequencies,), SI unit^2/Hz.

    Twice the two-sided densities of IEEE Std 952-1997 C.1.1 to C.1.4 and 952-2020 annex C for
    samples of period tau0, w = 2 pi f: Q 4 Q^2/tau0 sin^2(w tau0/2), N^2, B^2/w,
    K^2 tau0^2/(4 sin^2(w tau0/2)), and 2 sigma^2 T/(1 + (w T)^2) of a Gauss-Markov process. The
    ramp has none: a block's mean is taken off, and what is left of it is far below. Only terms
    that are observable count.
    """
    value = {
        term: c.value if c.status == 'estimated' and c.value is not None else 0.0
        for term, c in axis.fit.noise.items()
    }
    omega = 2.0 * np.pi * frequency
    step = 2.0 * np.sin(omega * axis.tau0 / 2.0)
    density: Floats = (
        (value['Q'] * step) ** 2 / axis.tau0
        + value['N'] ** 2
        + value['B'] ** 2 / omega
        + (value['K'] * axis.tau0 / step) ** 2
    )
    drift = axis.fit.gauss_markov
    if drift is not None:
        time = drift.correlation_time
        density = density + 2.0 * drift.sigma**2 * time / (1.0 + (omega * time) ** 2)
    return 2.0 * density
