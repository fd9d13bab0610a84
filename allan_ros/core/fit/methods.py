# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`fit_noise`: the noise coefficients of all axes by one of two methods."""

from __future__ import annotations

from ..allan.sums import AllanSums
from ..errors import AllanError
from .result import NoiseModel

METHODS = ('likelihood', 'paper')
"""Fit methods: maximum likelihood for octave spectra and block means, and least squares on Allan
variances as in Cong et al. 2019."""


def fit_noise(sums: AllanSums, method: str = 'likelihood') -> NoiseModel:
    """Estimate the noise coefficients of every axis.

    Parameters
    ----------
    sums : AllanSums
        Allan sums of one IMU.
    method : str
        One of `METHODS`.

    Returns
    -------
    NoiseModel
        Coefficients with intervals for each axis, and findings.

    Raises
    ------
    AllanError
        If the method is unknown, or if the method is 'paper' and there are fewer than two samples.
        With 'likelihood', a finding reports too few samples.
    """
    if method not in METHODS:
        raise AllanError(f'fit method {method!r} is unknown: choose one of {", ".join(METHODS)}')
    # A method is imported when it is used: imports are slow, and most runs use one method.
    if method == 'likelihood':
        from .maximum_likelihood import fit_likelihood

        return fit_likelihood(sums)
    from .least_squares import fit_paper

    return fit_paper(sums)
