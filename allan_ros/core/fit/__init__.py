# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimate the noise coefficients of an IMU from Allan sums: `fit_noise`.

Terms used in this package:

- *phase* theta: cumulative sum of the samples of one axis.
- *averaging factor* m: averaging time tau divided by the sample period tau0.
- *difference* d: second difference theta(u + 2m) - 2 theta(u + m) + theta(u) of the phase. The
  Allan variance at m is the mean of d^2/(2 m^2) over the start positions u.
- *variance coefficients* q, w, b, k: the squares of Q, N, B, K with tau0 as the unit of time. The
  expected Allan variance is linear in them.
- *ramp*: constant rate of change of the samples of one segment (term R), per sample.
- *kept segment*: one of the longest segments, which are stored separately. Shorter segments are
  *pooled* by length.
- *process*: a Gauss-Markov process or a sinusoid that is added to the model if the five terms do
  not describe the measured curve. Its *shape* is its correlation time or its frequency.
- *table*: Allan variances of one axis with the ramps removed, their expectation per unit
  coefficient (one column each), and their covariance.
- *model error* (misfit): standard deviation of the relative difference between the true Allan
  variance and the model. It is added to the covariance if no model passes the test of fit.
"""

from __future__ import annotations

import sys

from ..allan.sums import AllanSums
from ..errors import AllanError
from .model import (
    TERMS,
    AxisFit,
    Coefficient,
    Deviation,
    GaussMarkov,
    NoiseModel,
    Processes,
    Sinusoid,
)

__all__ = [
    'METHODS',
    'TERMS',
    'AxisFit',
    'Coefficient',
    'Deviation',
    'GaussMarkov',
    'NoiseModel',
    'Processes',
    'Sinusoid',
    'clear_cache',
    'fit_noise',
]

METHODS = {
    'gls': 'generalized least squares with the covariance of the curve: intervals and verdicts',
    'relative': 'nonnegative least squares on relative residuals: no intervals',
    'paper': 'plain least squares over groups that do not overlap, as Cong et al. 2019',
}
"""Fit method -> its description for users."""


def fit_noise(sums: AllanSums, method: str = 'gls', like: NoiseModel | None = None) -> NoiseModel:
    """Estimate the noise coefficients of every axis.

    Parameters
    ----------
    sums : AllanSums
        Sums of one or many segments.
    method : str
        One of `METHODS`.
    like : NoiseModel, optional
        Earlier fit of part of these data by method 'gls'. Its processes and its shortest averaging
        time are used instead of a new model selection, which saves most of the time.

    Returns
    -------
    NoiseModel
        Coefficients with intervals for each axis, and findings.

    Raises
    ------
    AllanError
        If the method is unknown, or the sums contain fewer than two samples.
    """
    if method not in METHODS:
        raise AllanError(f'fit method {method!r} is unknown: choose one of {", ".join(METHODS)}')
    # A method is imported when it is used: imports are slow, and most runs use one method.
    if method == 'gls':
        from .gls import fit_gls

        return fit_gls(sums, like)
    from .simple_methods import fit_paper, fit_relative

    return (fit_paper if method == 'paper' else fit_relative)(sums)


def clear_cache() -> None:
    """Free the precomputed covariance tables, which later fits would reuse."""
    for name in (f'{__name__}.table', f'{__package__.rpartition(".")[0]}.allan.likelihood'):
        if name in sys.modules:  # a module that is not imported has no cache
            sys.modules[name].clear_cache()
