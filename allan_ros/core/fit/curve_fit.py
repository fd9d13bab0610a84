# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of an Allan curve that was computed elsewhere: averaging times and deviations, no samples.

Without the samples the covariance of the curve is unknown. The points are decimated to four per
octave and treated as independent, each with the degrees of freedom of an overlapping estimate.
Intervals are therefore approximate, and the ramp, which needs signed sums, is not estimated.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import AllanError
from .intervals import Z_DETECT
from .model import (
    RANDOM_TERMS,
    TERMS,
    Z_95,
    AxisFit,
    Coefficient,
    Floats,
    GaussMarkov,
    Processes,
    Sinusoid,
    avar_terms,
    coefficient_to_si,
)
from .processes import Extra, GaussMarkovTerm
from .reading import largest_deviation, model_line
from .search import Found, ProcessSearch
from .solve import RIDGE, Whitening
from .table import Table

POINTS_PER_OCTAVE = 4
"""Points that are kept of a denser curve."""

DEFAULT_RECORD = 9.0
"""Length of an unknown record in the longest averaging time: where most tools end."""

OVERLAPPING = 0.75
"""Degrees of freedom of an average over tau, times tau over the record."""

LEAST_ERROR = 0.05
"""Least relative error of a variance, for errors that independent points do not show."""

FINE = 1000
"""Units of time in the shortest averaging time: there, samples and continuous time are the same."""

LEAST_POINTS = 6


def fit_curve(tau: ArrayLike, adev: ArrayLike, record: float | None = None) -> AxisFit:
    """Return the coefficients and, where these do not fit, the processes of one Allan curve.

    Parameters
    ----------
    tau : (points,) array
        Averaging times in s.
    adev : (points,) array
        Allan deviations in SI.
    record : float, optional
        Length of the recording in s; nine times the longest averaging time by default.

    Raises
    ------
    AllanError
        When there are too few points.

    Examples
    --------
    >>> import numpy as np
    >>> tau = np.geomspace(0.1, 1000.0, 60)
    >>> fit = fit_curve(tau, np.sqrt(1e-6 / tau + 1e-12 * tau / 3.0))
    >>> round(fit.noise['N'].value, 6), round(fit.noise['K'].value, 8)
    (0.001, 1e-06)
    """
    tau, avar = _decimated(np.asarray(tau, float), np.asarray(adev, float) ** 2)
    unit = float(tau[0]) / FINE
    m = np.round(tau / unit).astype(np.int64)
    seconds = record or DEFAULT_RECORD * float(tau[-1])
    freedom = np.maximum(OVERLAPPING * (seconds / tau - 1.0), 1.0)
    relative = np.sqrt(2.0 / freedom + LEAST_ERROR**2)
    pairs = np.zeros((10, len(m) * (len(m) + 1) // 2))
    table = Table(m, np.round(freedom).astype(np.int64), avar, avar_terms(m), pairs)
    model = avar
    found = Found((), np.zeros(len(RANDOM_TERMS)), math.inf)
    z = 0.0
    for _ in range(3):  # errors of the measured curve, then of the model
        whitening = Whitening.of(np.diag((relative * model) ** 2))
        search = ProcessSearch(
            table, whitening, float(len(m)), round(seconds / unit), signed=False, walk=True
        )
        five = search.fitted(())
        z = search.z(five)
        found = five if z < Z_DETECT else search.search(found.extras)
        model = table.terms @ found.power[: len(RANDOM_TERMS)]
        if found.extras:
            model = model + table.columns(found.extras) @ found.power[len(RANDOM_TERMS) :]
        model = np.maximum(model, np.finfo(float).tiny)
    return _axis_fit(table, found, whitening, z, relative, unit)


def _decimated(tau: Floats, avar: Floats) -> tuple[Floats, Floats]:
    """Return the valid points, `POINTS_PER_OCTAVE` at most, shortest first."""
    good = np.isfinite(tau) & np.isfinite(avar) & (tau > 0.0) & (avar > 0.0)
    order = np.argsort(tau[good])
    tau, avar = tau[good][order], avar[good][order]
    if len(tau):
        bins = np.round(np.log2(tau / tau[0]) * POINTS_PER_OCTAVE)
        first = np.unique(bins, return_index=True)[1]
        tau, avar = tau[first], avar[first]
    if len(tau) < LEAST_POINTS:
        raise AllanError(f'the curve has {len(tau)} usable points: give at least {LEAST_POINTS}')
    return tau, avar


def _axis_fit(
    table: Table,
    found: Found,
    whitening: Whitening,
    z: float,
    relative: Floats,
    unit: float,
) -> AxisFit:
    """Return the fit in SI units, with intervals from the linear fit."""
    extras: tuple[Extra, ...] = found.extras
    columns = [table.terms]
    if extras:
        columns += [table.columns(extras), table.tangents(extras)]
    design = whitening.apply(np.column_stack(columns))
    size = np.linalg.norm(design, axis=0)
    size[size == 0.0] = 1.0
    scaled = design / size
    inverse = np.linalg.inv(scaled.T @ scaled + RIDGE * np.eye(len(size)))
    deviation = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
    noise = {
        term: _coefficient(term, float(found.power[t]), float(deviation[t]), unit)
        for t, term in enumerate(RANDOM_TERMS)
    }
    noise['R'] = Coefficient(None, status='not_observable')
    gauss_markov, sinusoid = [], []
    four, number = len(RANDOM_TERMS), len(extras)
    for k, extra in enumerate(extras):
        power = float(found.power[four + k])
        if power <= 0.0:
            continue
        errors = deviation[[four + k, four + number + k]] / power
        of_size, of_shape = np.exp(np.minimum(Z_95 * errors, math.log(100.0)))
        amplitude, half = math.sqrt(power), math.sqrt(float(of_size))
        ends = (amplitude / half, amplitude * half)
        low, high = extra.shape / float(of_shape), extra.shape * float(of_shape)
        if isinstance(extra, GaussMarkovTerm):
            times = (low * unit, high * unit)
            gauss_markov.append(GaussMarkov(amplitude, ends, extra.shape * unit, times))
        else:
            hertz = (low / unit, high / unit)
            sinusoid.append(Sinusoid(amplitude, ends, extra.shape / unit, hertz))
    processes = Processes(tuple(gauss_markov), tuple(sinusoid))
    fit = AxisFit({t: noise[t] for t in TERMS}, gof_z=z, processes=processes)
    adev, bar = np.sqrt(table.avar), np.exp(relative / 2.0)
    line = model_line(fit, unit, table.m, adev, adev * bar)
    tau = np.asarray(table.m * unit, float)
    off = largest_deviation(line, tau, adev, adev / bar, adev * bar)
    return replace(fit, deviation=off)


def _coefficient(term: str, power: float, deviation: float, unit: float) -> Coefficient:
    """Return a term in SI units: a value with its interval, or an upper limit."""
    upper = coefficient_to_si(term, max(power, 0.0) + Z_95 * deviation, unit)
    if power < Z_DETECT * deviation or power <= 0.0:
        value = coefficient_to_si(term, power, unit) or None
        return Coefficient(value, None, upper, 'not_observable')
    low, high = power - Z_95 * deviation, power + Z_95 * deviation
    ends = (coefficient_to_si(term, low, unit), coefficient_to_si(term, high, unit))
    return Coefficient(coefficient_to_si(term, power, unit), ends)
