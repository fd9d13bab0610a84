# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood of the statistics of one axis, its maximum by Fisher scoring, and 95 % intervals.

Likelihood
----------
The power of each bin of the octave spectra has a Gamma distribution with known degrees of freedom.
The contrasts of the block means are Gaussian. The contrast that measures a linear change with time
is not used. The likelihood is therefore the restricted likelihood (REML) of the block means with an
unknown mean and an unknown ramp in each segment.

The expected power and the covariance of the contrasts are linear in the coefficients. One step of
Fisher scoring is therefore a linear least-squares problem with nonnegative unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..noise import Parameter, Process
from ..nonnegative import nonnegative_least_squares
from .statistics import Floats, Statistics, contrasts, without_lines

Flags = NDArray[np.bool_]

LEVEL_95 = 3.841
"""Increase of -2 log L at the ends of a 95 % interval: 95 % quantile of chi-squared with one degree
of freedom."""

RIDGE = 1e-9
"""Number that is added to the diagonal of the scaled information matrix, so that the matrix can be
inverted even if the data cannot distinguish two coefficients."""


class Shape(NamedTuple):
    """One shape parameter of a component, such as its correlation time."""

    component: int  # index of the component
    parameter: Parameter


class Columns(NamedTuple):
    """Expected statistics for each component of a model, with the coefficient 1."""

    power: Floats  # (bins, components) expected power

    # covariance of the contrasts of each group, (components, contrasts, contrasts)
    low: list[Floats]


@dataclass(frozen=True, eq=False)
class Fit:
    """Maximum of the likelihood for one list of components.

    Attributes
    ----------
    components : tuple of Process
        Processes with their shapes in samples.
    p : (components,) array
        Coefficients, in units of `AxisData.scale`.
    value : float
        -2 log likelihood, up to a constant; infinite if the expected power or covariance of the
        model is not positive.
    information : (components, components) array
        Fisher information of the coefficients; empty if ``value`` is infinite.
    moment : (components,) array
        ``moment`` - ``information`` @ ``p`` is the score (gradient of the log likelihood), to first
        order in the last step of the search. Empty if ``value`` is infinite.
    columns : Columns
        Expected statistics of the components.
    signed : tuple of int
        Indices of the coefficients that may be negative.
    """

    components: tuple[Process, ...]
    p: Floats
    value: float
    columns: Columns
    signed: tuple[int, ...] = ()
    information: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    moment: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def free(self) -> NDArray[np.int64]:
        """Indices of the k coefficients that are above 0 or may be negative, (k,)."""
        return np.flatnonzero((self.p > 0.0) | flags(len(self.p), self.signed))

    def covariance(self) -> Floats:
        """Return the covariance of all coefficients, (components, components).

        The covariance is 0 for coefficients that are not in `free`.
        """
        free = self.free
        full_covariance = np.zeros_like(self.information)
        full_covariance[np.ix_(free, free)] = inverse(self.information[np.ix_(free, free)])
        return full_covariance

    def spectrum(self) -> Floats:
        """Return the expected power of the bins that are used, (bins,)."""
        return np.asarray(self.columns.power @ self.p)


def flags(size: int, chosen: Iterable[int]) -> Flags:
    """Return a boolean array, (size,), that is True at the chosen indices."""
    is_chosen = np.zeros(size, bool)
    is_chosen[list(chosen)] = True
    return is_chosen


def inverse(information: Floats) -> Floats:
    """Return the inverse of an information matrix, (n, n).

    `RIDGE` is added to the diagonal of the matrix when the diagonal is scaled to 1.
    """
    d = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(d, d) + RIDGE * np.eye(len(d))
    return np.asarray(np.linalg.inv(scaled) / np.outer(d, d))


class LowBand(NamedTuple):
    """Contrasts (weighted sums of block means) of one group of segments, for one axis.

    The contrast that measures a linear change with time is not included.
    """

    segments: int  # number of segments
    # (contrasts, contrasts) sum over the segments of z z^T, where z are the contrasts of a segment
    gram: Floats
    points: int = 0  # number of block means of each segment; 0 if there is only one group


@dataclass(frozen=True, eq=False)
class AxisData:
    """Statistics of one axis, divided by their scale, and the bins that are used.

    Attributes
    ----------
    statistics : Statistics
        Statistics of all axes.
    axis : int
        Index of the axis.
    scale : float
        Variance by which the statistics are divided.
    power : (bins,) array
        Mean power of each bin, without the power of a settling.
    low : list of LowBand
        Contrasts of each group of segments.
    dof : (bins,) array
        Degrees of freedom of the power; reduced where the model is less accurate than the data.
    used : (bins,) array of bool
        Bins that are used in a fit, for example those below its highest frequency.
    """

    statistics: Statistics
    axis: int
    scale: float
    power: Floats
    low: list[LowBand]
    dof: Floats
    used: Flags

    @classmethod
    def of(cls, statistics: Statistics, axis: int) -> AxisData:
        """Return the statistics of one axis; all bins are used."""
        power = statistics.power[:, axis] * (1.0 - statistics.settling[:, axis])
        dof = statistics.dof_of(axis)
        if len(power):
            scale = float(np.average(power, weights=dof))
        else:
            traces = [
                (float(np.trace(g.gram[axis])), g.segments * g.size.high) for g in statistics.groups
            ]
            scale = sum(t for t, _ in traces) / max(sum(n for _, n in traces), 1)
        scale = scale if scale > 0.0 else 1.0
        grams = without_lines([g.gram[axis] for g in statistics.groups], statistics.sizes)
        low_bands = [
            LowBand(g.segments, gram / scale, g.size.points)
            for g, gram in zip(statistics.groups, grams)
        ]
        used_bins = np.ones(len(power), bool)
        return cls(statistics, axis, scale, power / scale, low_bands, dof, used_bins)

    def columns(self, components: Sequence[Process], tangents: Sequence[Shape] = ()) -> Columns:
        """Return the expected statistics of components, and then their derivatives.

        There is one derivative for each shape parameter in ``tangents``, with respect to the
        logarithm of this parameter. The result contains the power of the used bins only.
        """
        columns = [self.statistics.column(component, self.axis) for component in components]
        power = [column.power for column in columns]
        covariances = [without_lines(column.low, self.statistics.sizes) for column in columns]
        for i, parameter in tangents:
            h = parameter.derivative_step
            shifted = self.statistics.column(
                components[i].scaled(parameter, math.exp(h)), self.axis
            )
            power.append((shifted.power - power[i]) / h)
            shifted_covariances = without_lines(shifted.low, self.statistics.sizes)
            covariances.append([(b - a) / h for a, b in zip(covariances[i], shifted_covariances)])
        covariances_of_groups = [np.array(group) for group in zip(*covariances)]
        return Columns(np.array(power).T[self.used], covariances_of_groups)

    def moments(
        self, columns: Columns, coefficients: Floats
    ) -> tuple[float, Floats, Floats] | None:
        """Return -2 log L, the Fisher information I and the moment m at some coefficients.

        The next step of Fisher scoring leads to the x that minimizes x^T I x - 2 m^T x. I is
        (components, components). m and ``coefficients``, in units of `scale`, are (components,).
        The result is None if the expected power or covariance is not positive.
        """
        from scipy.linalg import lapack  # slow to import

        s = columns.power @ coefficients
        if np.any(s <= 0.0):
            return None
        half_dof = self.dof[self.used] / 2.0
        ratio = self.power[self.used] / s
        value = 2.0 * float(half_dof @ (np.log(s) + ratio))
        a = columns.power * (np.sqrt(half_dof) / s)[:, None]
        information, moment = a.T @ a, a.T @ (ratio * np.sqrt(half_dof))
        for (count, gram, _), d in zip(self.low, columns.low):
            flat_covariances = d.reshape(len(coefficients), -1)
            expected = (coefficients @ flat_covariances).reshape(d.shape[1:])
            root, failure = lapack.dpotrf(expected, lower=1)
            if failure:
                return None
            inverse_root = lapack.dtrtri(root, lower=1)[0]
            precision = inverse_root.T @ inverse_root
            weighted, weighted_gram = d @ precision, precision @ gram @ precision
            log_determinant = 2.0 * float(np.log(np.diag(root)).sum())
            value += count * log_determinant + float(np.sum(gram * precision))
            transposed = weighted.transpose(0, 2, 1).reshape(len(coefficients), -1)
            information += 0.5 * count * weighted.reshape(len(coefficients), -1) @ transposed.T
            moment += 0.5 * flat_covariances @ weighted_gram.ravel()
        return value, information, moment

    def _is_positive(self, columns: Columns, p: Floats) -> bool:
        """Return whether the expected power and covariances at the coefficients are positive."""
        from scipy.linalg import lapack  # slow to import

        if np.any(columns.power @ p <= 0.0):
            return False
        if np.all(p >= 0.0):
            return True
        return not any(lapack.dpotrf(np.tensordot(p, d, 1), lower=1)[1] for d in columns.low)

    def start(self, columns: Columns) -> Floats:
        """Return coefficients to start from, (components,), in units of `scale`.

        With these coefficients, no component alone exceeds the measured power of any used bin, or
        the mean square of all contrasts of any segment length, unless its coefficient has the
        smallest allowed value.
        """
        upper_bounds = np.full(len(columns.power.T), np.inf)
        if len(columns.power):
            ratios = self.power[self.used][:, None] / np.maximum(columns.power, 1e-300)
            upper_bounds = ratios.min(axis=0)
        for _, parts in groupby(zip(self.low, columns.low), lambda part: part[0].points):
            bands_of_length = list(parts)
            measured = sum(float(np.trace(low.gram)) / low.segments for low, _ in bands_of_length)
            expected = sum(np.trace(d, axis1=1, axis2=2) for _, d in bands_of_length)
            upper_bounds = np.minimum(upper_bounds, measured / np.maximum(expected, 1e-300))
        return np.asarray(np.maximum(upper_bounds, 1e-12) / len(upper_bounds))

    def solve(
        self,
        components: Sequence[Process],
        columns: Columns | None = None,
        p: Floats | None = None,
        held: Mapping[int, float] | None = None,
        signed: tuple[int, ...] = (),
        rounds: int = 40,
        tolerance: float = 1e-4,
    ) -> Fit:
        """Return the maximum of the likelihood over the coefficients of some components.

        If the search has not converged after ``rounds`` steps, or if no further step decreases
        -2 log L, the result of the last step is returned. The value of the result is infinite if
        the expected power or covariance at the coefficients to start from is not positive.

        Parameters
        ----------
        components : sequence of Process
            Processes with their shapes in samples.
        columns : Columns, optional
            Expected statistics of the components, if already computed.
        p : (components,) array, optional
            Coefficients to start from.
        held : mapping of index to value, optional
            Coefficients that are not fitted, and their values.
        signed : tuple of int
            Indices of the coefficients that may be negative.
        rounds : int
            Largest number of steps.
        tolerance : float
            Expected change of -2 log L below which a step is the last step.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the information matrix is not positive definite in spite of `RIDGE`, for example if
            the matrix contains NaN.
        """
        columns = self.columns(components) if columns is None else columns
        p = self.start(columns) if p is None else p.copy()
        held = held or {}
        for i, value in held.items():
            p[i] = value
        state = self.moments(columns, p)
        if state is None:
            return Fit(tuple(components), p, math.inf, columns, signed)
        is_held = flags(len(p), held)
        free = np.flatnonzero(~is_held)
        may_be_negative = flags(len(p), signed)[free]
        for _ in range(rounds):
            value, information, moment = state
            proposed = p.copy()
            proposed[free] = _step(
                information[np.ix_(free, free)],
                (moment - information[:, is_held] @ p[is_held])[free],
                may_be_negative,
            )
            d = proposed - p
            expected = float(d @ (2.0 * (moment - information @ p) - information @ d))
            if expected < tolerance and self._is_positive(columns, proposed):
                p, state = proposed, (value - expected, information, moment)
                break
            size, trial = 1.0, self.moments(columns, proposed)
            while size > 0.01 and (trial is None or trial[0] > value + 1e-6):
                size /= 2.0
                trial = self.moments(columns, p + size * d)
            if size <= 0.01 or trial is None:
                break
            p, state = p + size * d, trial
        return Fit(tuple(components), p, state[0], columns, signed, state[1], state[2])


def _step(information: Floats, moment: Floats, may_be_negative: Flags) -> Floats:
    """Return the p that minimizes p'Ip - 2m'p, with p >= 0 where ``may_be_negative`` is False.

    I is ``information``, and m is ``moment``.
    """
    from scipy.linalg import lapack  # slow to import

    d = np.sqrt(np.maximum(np.diag(information), 1e-300))
    root = np.linalg.cholesky(information / np.outer(d, d) + RIDGE * np.eye(len(d)))
    unconstrained = lapack.dpotrs(root, moment / d, lower=1)[0]
    if np.all((unconstrained >= 0.0) | may_be_negative):
        return np.asarray(unconstrained / d)
    return nonnegative_least_squares(root.T, np.linalg.solve(root, moment / d), may_be_negative) / d


class Interval(NamedTuple):
    """95 % interval of a coefficient."""

    low: float
    high: float

    # decrease of -2 log L from the coefficient 0 to the estimate; 400 instead if the estimate is at
    # least 20 standard errors, and 0 for a coefficient that may be negative. With unknown shapes,
    # the decrease is divided by the square of the factor by which the interval is wider
    gain: float

    def times(self, factor: float) -> Interval:
        """Return the interval of the coefficient times a positive factor."""
        return self._replace(low=factor * self.low, high=factor * self.high)


def information_with_shapes(data: AxisData, fit: Fit, shapes: Sequence[Shape]) -> Floats:
    """Return the Fisher information of the coefficients of a fit and of shape parameters.

    The result is (components + shapes, components + shapes). The rows are the coefficients, then
    the shape parameters ``shapes``. The unknown of a shape parameter is its logarithm times the
    coefficient of its component.
    """
    columns = data.columns(fit.components, shapes)
    moments = data.moments(columns, np.append(fit.p, np.zeros(len(shapes))))
    assert moments is not None  # a fitted model has positive variances
    return moments[1]


def profile_interval(
    data: AxisData, fit: Fit, i: int, with_shapes: Floats | None = None
) -> Interval:
    """Return the interval of the coefficient ``i`` of a fit, by its profile likelihood.

    The interval is in units of `AxisData.scale`. It contains all values for which -2 log L exceeds
    the minimum by at most 3.84, with all other coefficients fitted again for each value. The
    interval of a coefficient that may be negative is symmetric: 1.96 standard errors to each side.
    ``with_shapes``, (components + shapes, components + shapes), is the result of
    `information_with_shapes`. If it is given, the interval is wider by the ratio of two standard
    errors: with unknown and with known shapes.
    """
    estimate = float(fit.p[i])
    free = np.union1d(fit.free, [i])
    covariance = inverse(fit.information[np.ix_(free, free)])[:, int(np.searchsorted(free, i))]
    error = math.sqrt(covariance[np.searchsorted(free, i)])
    widening = 1.0
    if with_shapes is not None:
        all_free = np.append(free, np.arange(len(fit.p), len(with_shapes)))
        variances = np.diag(inverse(with_shapes[np.ix_(all_free, all_free)]))
        widening = max(math.sqrt(variances[np.searchsorted(free, i)]) / error, 1.0)

    def distance(value: float) -> float:
        start = fit.p.copy()
        start[free] += covariance / error**2 * (value - estimate)
        start = np.where(flags(len(start), fit.signed), start, np.maximum(start, 0.0))
        new_fit = data.solve(
            fit.components, fit.columns, start, {i: value}, fit.signed, rounds=10, tolerance=1e-2
        )
        if not math.isfinite(
            new_fit.value
        ):  # without this component, the model that the fit starts from has no power
            new_fit = data.solve(
                fit.components, fit.columns, None, {i: value}, fit.signed, tolerance=1e-2
            )
        if not math.isfinite(new_fit.value):
            return 1e3
        return math.sqrt(max(new_fit.value - fit.value, 0.0))

    z = math.sqrt(LEVEL_95)
    if i in fit.signed:
        return Interval(estimate - z * widening * error, estimate + z * widening * error, 0.0)
    distance_at_zero = distance(0.0) if estimate < 20.0 * error else 20.0
    low = 0.0
    if distance_at_zero > z:
        lowest = max(estimate - 4.0 * error, 0.0)
        low = _crossing(distance, z, estimate, lowest, distance_at_zero if lowest == 0.0 else 4.0)
    high = estimate + 2.0 * error
    distance_at_high = distance(high)
    while distance_at_high < z and high < 1e12:
        high = estimate + 2.0 * (high - estimate)
        distance_at_high = distance(high)
    high = _crossing(distance, z, estimate, high, distance_at_high)
    return Interval(
        max(estimate - widening * (estimate - low), 0.0),
        estimate + widening * (high - estimate),
        (distance_at_zero / widening) ** 2,
    )


def _crossing(distance, z: float, inner: float, outer: float, outer_distance: float) -> float:  # type: ignore[no-untyped-def]
    """Return the value between ``inner`` and ``outer`` at which ``distance`` is approximately z.

    ``distance`` is 0 at ``inner``, and approximately ``outer_distance`` at ``outer``.
    """
    inner_distance, value = 0.0, outer
    for _ in range(10):
        share = (z - inner_distance) / max(outer_distance - inner_distance, 1e-9)
        value = inner + (outer - inner) * min(max(share, 0.05), 0.95)
        reached = distance(value)
        if abs(reached - z) < 0.02:
            break
        if reached < z:
            inner, inner_distance = value, reached
        else:
            outer, outer_distance = value, reached
    return value


class RampEstimate(NamedTuple):
    """Estimate of a ramp, a constant rate of change of the samples."""

    value: float  # change per unit of time
    error: float  # standard error of the value
    dof: float  # degrees of freedom of the standard error

    def times(self, factor: float) -> RampEstimate:
        """Return the ramp in another unit: value and error are multiplied by ``factor``."""
        return self._replace(value=factor * self.value, error=factor * self.error)

    @property
    def half_width(self) -> float:
        """Half of the width of the 95 % interval."""
        from scipy.special import stdtrit

        return float(stdtrit(self.dof, 0.975)) * self.error


def ramp_estimate(data: AxisData, fit: Fit) -> RampEstimate | None:
    """Return the ramp that all segments have in common, or None if there are too few block means.

    The ramp is the change per sample of the scaled data. It is estimated from the block means by
    generalized least squares with the fitted covariance. The degrees of freedom of its standard
    error follow from the errors of the coefficients (Satterthwaite).
    """
    information, moment = 0.0, 0.0
    slope = np.zeros(len(fit.p))
    statistics = data.statistics
    columns = [statistics.column(c, data.axis).low for c in fit.components]
    for g, group in enumerate(statistics.groups):
        if not group.size.lines:
            continue  # a ramp has no effect on symmetric contrasts
        d = np.array([column[g] for column in columns])
        line_weights = contrasts(group.size)[:, 0]
        # value of the first contrast, which measures a linear change, for a ramp of 1 per sample
        unit_line = statistics.step * float(np.arange(group.size.points) @ line_weights)
        e = np.zeros(d.shape[1])
        e[0] = unit_line
        w = np.linalg.solve(np.tensordot(fit.p, d, 1), e)
        information += group.segments * float(w[0]) * unit_line
        moment += float(w @ group.sums[data.axis]) / math.sqrt(data.scale)
        slope += group.segments * np.einsum('i,kij,j->k', w, d, w)
    if not information > 0.0:
        return None
    slope = slope / information
    relative_variance = float(slope @ fit.covariance() @ slope)
    return RampEstimate(
        moment / information, information**-0.5, max(2.0 / max(relative_variance, 1e-9), 1.0)
    )
