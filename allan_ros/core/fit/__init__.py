# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From sums to the five coefficients: `fit_noise`."""

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
    'gls': 'generalised least squares with the covariance of the curve: intervals and verdicts',
    'relative': 'nonnegative least squares on relative residuals: no intervals',
    'paper': 'plain least squares over groups that do not overlap, as Cong et al. 2019',
}
"""Method -> its description."""


def fit_noise(sums: AllanSums, method: str = 'gls', like: NoiseModel | None = None) -> NoiseModel:
    """Return the five terms of every axis of the sums.

    Parameters
    ----------
    sums : AllanSums
        Of one or many segments.
    method : str
        One of `METHODS`.
    like : NoiseModel, optional
        A fit of a part of the data by method gls: its processes and shortest averaging times are
        kept and not selected again.

    Raises
    ------
    AllanError
        When the method is unknown, or there are fewer than two samples.
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
    """Clear the tables that fits share; useful in a process that rarely fits."""
    for name in (f'{__name__}.table', f'{__package__.rpartition(".")[0]}.allan.likelihood'):
        if name in sys.modules:  # a module that is not imported has no cache
            sys.modules[name].clear_cache()
