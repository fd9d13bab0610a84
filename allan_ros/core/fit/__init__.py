# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimate the noise coefficients of an IMU from its sums: `fit_noise`.

Terms used in this package:

- *variance coefficients* q, w, b, k: the squares of Q, N, B, K with the sample period tau0 as the
  unit of time. All expectations are linear in them.
- *ramp*: constant rate of change of the samples (term R), per sample.
- *process*: a Gauss-Markov process, a sinusoid or a resonance that is added to the model if the
  five terms do not describe the data. Its *shape* is its correlation time, its frequency, or both.
- *component*: a term or a process of a model.
- *gain*: decrease of -2 log likelihood.
- *lack of fit*: octave of frequencies in which the data differ from the model.
"""

from __future__ import annotations

from ..allan.sums import AllanSums
from ..errors import AllanError
from .model import (
    TERMS,
    AxisFit,
    Deviation,
    LackOfFit,
    NoiseModel,
)

__all__ = [
    'METHODS',
    'TERMS',
    'AxisFit',
    'Deviation',
    'LackOfFit',
    'NoiseModel',
    'fit_noise',
]

METHODS = ('likelihood', 'paper')
"""Maximum likelihood of octave spectra and block means, or least squares as Cong et al. 2019."""


def fit_noise(sums: AllanSums, method: str = 'likelihood') -> NoiseModel:
    """Estimate the noise coefficients of every axis.

    Parameters
    ----------
    sums : AllanSums
        Sums of one or many segments.
    method : str
        One of `METHODS`.

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
    if method == 'likelihood':
        from .method import fit_likelihood

        return fit_likelihood(sums)
    from .least_squares import fit_paper

    return fit_paper(sums)
