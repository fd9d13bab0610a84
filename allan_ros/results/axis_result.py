# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of one axis (`AxisResult`), and functions for single curves (`adev` and `fit`)."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.allan.at_rest import AtRest, TurnOnBias
from ..core.allan.curve import AxisCurve, allan_curve
from ..core.allan.running import RunningSums
from ..core.errors import AllanError
from ..core.estimate import Estimate
from ..core.filters.growth import Growth, growth_table
from ..core.filters.noise_parameters import reduce_axis
from ..core.filters.state_space import StateSpace, state_space
from ..core.fit.least_squares import fit_curve
from ..core.fit.result import TERMS, AxisFit, ModelLine, Region, TemperatureModel, model_line
from ..core.imu import AXES, NANOSECONDS, SI_UNITS, real_numbers, sensor_of
from ..core.noise import Model
from ..core.settings import check_choice, expect


@dataclass(frozen=True)
class AxisResult:
    """The results of one axis: coefficients, Allan deviation and fitted noise model.

    The coefficients are the attributes ``Q``, ``N``, ``B``, ``K`` and ``R``, each an `Estimate` in
    SI. Its value is None if the coefficient is not resolved.

    Attributes
    ----------
    tau0 : float
        Sample period in s. If `fit` was called with lists tau and adev, the shortest averaging
        time.
    fit : AxisFit
        The fitted coefficients and noise processes, in SI.
    curve : AxisCurve or None
        The measured Allan deviation in SI; None if only the coefficients are known.
    regions : tuple of Region
        Ranges of averaging times, each with the noise that dominates in it; empty if they are
        unknown, as in the results of `fit`.
    name : str
        Name of the axis, such as 'gyro_z'.
    rounding : float or None
        Step to which the samples are rounded, in SI; None if no step is found, if N is unknown or
        0, or if the variance of the rounding error is at most 10 % or at least 105 % of the
        variance of the white noise.
    turn_on : TurnOnBias or None
        Scatter of the bias between recordings; None for fewer than two recordings.
    temperature : TemperatureModel or None
        Bias as a function of temperature; None if no temperature was recorded, if it varied too
        little or in one direction only, or if the data do not suffice for a model.
    at_rest : AtRest or None
        Mean (bias, plus gravity for an accelerometer), drift and bandwidth of the samples; None if
        the samples are unknown, for example if only a curve was fitted.

    Examples
    --------
    >>> import allan_ros as ar
    >>> axis = ar.analyze(ar.simulate(hours=0.1, rate=50))['accel_z']
    >>> axis.name, round(axis.N.to('ug/sqrt(Hz)').value, -1)
    ('accel_z', 20.0)
    >>> [prediction.horizon for prediction in axis.growth][:2]  # s
    [1.0, 10.0]
    >>> [q.unit for q in (axis.Q, axis.B, axis.K, axis.R)]
    ['m/s', 'm/s^2', 'm/s^3/sqrt(Hz)', 'm/s^3']
    """

    tau0: float
    fit: AxisFit
    curve: AxisCurve | None = None
    regions: tuple[Region, ...] = ()
    name: str = ''
    rounding: float | None = None
    turn_on: TurnOnBias | None = None
    temperature: TemperatureModel | None = None
    at_rest: AtRest | None = None

    @property
    def Q(self) -> Estimate:
        """Quantization noise in rad or m/s."""
        return self.quantity('Q')

    @property
    def N(self) -> Estimate:
        """Angle or velocity random walk in rad/s/sqrt(Hz) or m/s^2/sqrt(Hz).

        N is the square root of the two-sided power spectral density of the white noise.
        """
        return self.quantity('N')

    @property
    def B(self) -> Estimate:
        """Bias instability in rad/s or m/s^2: flat part of the Allan deviation divided by 0.664."""
        return self.quantity('B')

    @property
    def K(self) -> Estimate:
        """Rate or acceleration random walk in rad/s^2/sqrt(Hz) or m/s^3/sqrt(Hz)."""
        return self.quantity('K')

    @property
    def R(self) -> Estimate:
        """Rate or acceleration ramp in rad/s^2 or m/s^3."""
        return self.quantity('R')

    @property
    def processes(self) -> Model:
        """Noise processes that were fitted in addition to the five terms, or instead of a term.

        Each item of ``processes['gauss_markov']`` or ``processes['sinusoid']`` has a ``value`` in
        SI (a standard deviation or an amplitude) and the 95 % interval ``ci95`` of this value (None
        if it is unknown). The ``process`` of the item has shape parameters: ``correlation_time`` in
        s, or ``frequency`` in Hz. ``shape_ci95`` contains the 95 % intervals of these parameters;
        it is empty if they are unknown.

        Examples
        --------
        >>> import allan_ros as ar
        >>> samples = ar.simulate(hours=0.1, rate=50, vibration_gyro=3e-4, vibration_frequency=3.0)
        >>> axis = ar.analyze(samples, motion_gate=False)['gyro_x']
        >>> [round(item.process.frequency, 1) for item in axis.processes['sinusoid']]  # Hz
        [3.0]
        """
        return self.fit.model.shaped

    def state_space(self) -> StateSpace:
        """Return the noise as a state-space model for a Kalman filter.

        The model gives the transition matrix and the covariance of the process noise for any time
        step. The export target ``state_space`` writes such a model to a file.

        Raises
        ------
        AllanError
            When N has neither a value nor a finite upper limit, or when the model has no drift and
            K has neither a value nor a finite upper limit.

        Examples
        --------
        >>> import allan_ros as ar
        >>> space = ar.analyze(ar.simulate(hours=0.1, rate=50))['gyro_z'].state_space()
        >>> space.transition(0.02).shape == space.noise(0.02).shape == (space.size, space.size)
        True
        """
        return state_space(reduce_axis(self.name, self.fit, 'processes').model)

    @cached_property
    def growth(self) -> tuple[Growth, ...]:
        """Predicted standard deviation of the angle error (rad) or velocity error (m/s).

        There is one prediction, with its 95 % interval if it is known, for each of several times
        after the last correction by another sensor. Terms that are unknown count as 0.
        """
        return growth_table(self.fit)

    def quantity(self, term: str) -> Estimate:
        """Return the coefficient of a term ('Q', 'N', 'B', 'K' or 'R') in SI.

        The value of a coefficient that is not resolved is None; ``fit.noise`` contains its
        estimate. Raises AllanError for any other term.
        """
        check_choice(TERMS, term=term)
        unit = SI_UNITS[sensor_of(self.name)][term]
        return replace(self.fit.noise[term].shown, name=term, unit=unit, axis=self.name)

    def _tau(self, m: ArrayLike) -> NDArray[np.float64]:
        try:
            factors = real_numbers(m)
        except (TypeError, ValueError) as error:
            raise AllanError(
                f'm is {m!r:.60}: an array of averaging factors is expected'
            ) from error
        if not ((factors > 0.0) & np.isfinite(factors)).all():
            raise AllanError(f'm is {m!r:.60}: averaging factors above 0 are expected')
        return factors * self.tau0

    def part_adev(self, m: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Return the Allan deviation of each part of the fitted model in SI, in the shape of ``m``.

        The result maps names of parts to Allan deviations. A part is a term, such as 'N', or one of
        the `processes`, such as 'GM 300 s'. The effect of a low-pass filter on the Allan variance
        is no part if it is negative at any ``m``. ``m`` are averaging factors, which are averaging
        times in samples. Raises AllanError if ``m`` is not an array of finite numbers above 0.

        Examples
        --------
        >>> import allan_ros as ar
        >>> axis = ar.analyze(ar.simulate(hours=0.1, rate=50))['accel_z']
        >>> axis.quantity('N') == axis.N
        True
        >>> m = axis.curve.m
        >>> 'N' in axis.part_adev(m), 'N' in axis.limit_adev(m), axis.total_adev(m).shape == m.shape
        (True, False, True)
        >>> bool((axis.model_line().adev <= axis.model_line().upper).all())
        True
        """
        parts = self.fit.model.contributions(self._tau(m), self.tau0)
        # the Allan variance that represents a low-pass filter can be negative, so that it has no
        # square root
        return {name: np.sqrt(avar) for name, avar in parts.items() if np.all(avar >= 0.0)}

    def limit_adev(self, m: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Return the Allan deviation of terms that are 0 in the model, at their 95 % upper limits.

        Terms without a finite limit are absent. ``m`` are averaging factors, which are averaging
        times in samples. The result maps terms to Allan deviations in SI, in the shape of ``m``.
        Raises AllanError if ``m`` is not an array of finite numbers above 0.
        """
        model = self.fit.model
        limits = {
            term: c.upper95
            for term, c in self.fit.noise.items()
            if c.upper95 is not None and math.isfinite(c.upper95) and not model.value(term)
        }
        parts = Model.of(**limits).contributions(self._tau(m), self.tau0)
        return {name: np.sqrt(avar) for name, avar in parts.items()}

    def model_line(self) -> ModelLine:
        """Return the Allan deviation of the fitted model at the points of the curve, in SI.

        ``adev`` is the Allan deviation of the model, and ``upper`` is the Allan deviation of the
        model with unresolved terms at their 95 % upper limits (`AxisFit.model_at_limits`). Both
        arrays, (factors,), are NaN at short averaging times that the model does not describe, and
        where the Allan variance of the model is not above 0. They are empty if there is no curve.
        """
        curve = self.curve
        if curve is None:
            return ModelLine(np.zeros(0), np.zeros(0))
        return model_line(self.fit, self.tau0, curve)

    def total_adev(self, m: ArrayLike) -> NDArray[np.float64]:
        """Return the Allan deviation of the fitted model, in SI, in the shape of ``m``.

        ``m`` are averaging factors, which are averaging times in samples. If the samples are
        low-pass filtered, the result is NaN at short averaging times at which the variance of the
        model is negative. Raises AllanError if ``m`` is not an array of finite numbers above 0.
        """
        with np.errstate(invalid='ignore'):
            total: NDArray[np.float64] = np.sqrt(self.fit.model.avar(self._tau(m), self.tau0))
        return total


def adev(samples: ArrayLike, rate: float = 1.0) -> AxisCurve:
    """Compute the overlapping Allan deviation with its 68.3 % confidence limits.

    Parameters
    ----------
    samples : (n,) or (n, columns) array
        Evenly spaced samples of any quantity.
    rate : float
        Sample rate in Hz.

    Returns
    -------
    AxisCurve
        The Allan deviation in the unit of the samples, (times,) or (times, columns), at averaging
        times in s.

    Raises
    ------
    AllanError
        When there are fewer than two samples, some are not finite real numbers, their array has
        another shape, or the rate is not positive and finite.

    Examples
    --------
    >>> import numpy as np
    >>> import allan_ros as ar
    >>> curve = ar.adev(np.random.default_rng(0).normal(size=1000), rate=10.0)
    >>> [f'{tau:g} s: {value:.2f}' for tau, value in zip(curve.tau[:3], curve.adev)]
    ['0.1 s: 0.97', '0.2 s: 0.69', '0.3 s: 0.57']
    """
    try:
        values = real_numbers(samples)
    except (TypeError, ValueError) as error:
        raise AllanError(f'the samples are not numbers ({error}): give an array') from None
    expect(Real, rate=rate)
    table = values[:, None] if values.ndim == 1 else values
    if table.ndim != 2 or not table.shape[1] or not 0.0 < rate <= sys.float_info.max:
        raise AllanError(
            f'samples of shape {values.shape} at {rate!s:.40} Hz: give (n,) or (n, columns) and a '
            'positive rate'
        )
    if not np.isfinite(table).all():
        unusable_rows = int(np.count_nonzero(~np.isfinite(table).all(axis=1)))
        raise AllanError(
            f'{unusable_rows} of {len(table)} samples are NaN or infinite: remove them'
        )
    running_sums = RunningSums(axes=tuple(f'column {i}' for i in range(table.shape[1])))
    if len(table):
        # the sample period is 1 s here, because stamps in ns would round a very short period
        running_sums.update(table, 0, (len(table) - 1) * NANOSECONDS)
    running_sums.end_segment()
    curve = allan_curve(running_sums.sums)
    curve_arrays = (curve.adev, curve.ci_low, curve.ci_high)
    deviation, low, high = (c[:, 0] if values.ndim == 1 else c for c in curve_arrays)
    return AxisCurve(curve.m, curve.m / float(rate), curve.n, deviation, low, high)


def fit(
    curve: AxisCurve | tuple[ArrayLike, ArrayLike],
    axis: str = 'gyro_x',
    record: float | None = None,
) -> AxisResult:
    """Fit the noise coefficients to an Allan deviation curve, for example from another program.

    R is not fitted. `analyze` gives better intervals, because it computes the covariance of the
    points from the samples.

    Parameters
    ----------
    curve : AxisCurve or (tau, adev)
        Averaging times in s, in any order, and Allan deviations in SI; two lists or arrays,
        (points,). Points are ignored if the time is not between 1e-12 and 1e12, or if the deviation
        is not between 1e-30 and 1e30. At most five points per octave are used.
    axis : str
        The axis of the curve, such as 'gyro_z', which determines the units of the coefficients.
    record : float, optional
        Duration of the recording in s; by default nine times the longest averaging time used.

    Returns
    -------
    AxisResult
        The coefficients and the curve, without regions and without numbers that need the samples.

    Raises
    ------
    AllanError
        When the axis is unknown; when the curve has several columns, or is not a pair of equally
        long lists with positive, finite tau; when fewer than six points can be used; or when
        ``record`` is not finite, or is less than twice the longest averaging time used.

    Examples
    --------
    >>> import numpy as np
    >>> import allan_ros as ar
    >>> tau = np.geomspace(0.1, 1000.0, 60)
    >>> axis = ar.fit((tau, 1e-3 / np.sqrt(tau)), axis='accel_x')
    >>> round(axis.N.value, 6), axis.N.unit
    (0.001, 'm/s^2/sqrt(Hz)')
    """
    check_choice(AXES, axis=axis)
    if record is not None:
        expect(Real, record=record)
    if not isinstance(curve, AxisCurve):
        try:
            tau, deviation = map(real_numbers, curve)
        except (TypeError, ValueError) as error:
            raise AllanError(
                f'the curve is not a pair of lists tau and adev ({error}): give these, or an '
                'AxisCurve'
            ) from None
        is_list = tau.ndim == 1 and tau.shape == deviation.shape and len(tau)
        if not is_list or not ((tau > 0.0) & np.isfinite(tau)).all():
            raise AllanError(
                f'tau of shape {tau.shape} and adev of shape {deviation.shape}: give two lists of '
                'equal length, with positive, finite tau'
            )
        order = np.argsort(tau, kind='stable')
        tau, deviation = tau[order], deviation[order]
        unknown_limits = np.full(len(tau), np.nan)
        m = np.rint(tau / tau[0]).astype(np.int64)
        counts = np.zeros(len(tau), np.int64)
        curve = AxisCurve(m, tau, counts, deviation, unknown_limits, unknown_limits)
    elif curve.adev.ndim != 1:
        raise AllanError('the curve has several columns: fit each column separately')
    elif not len(curve.tau):
        raise AllanError('the curve has no points: record longer')
    tau0 = float(curve.tau[0] / curve.m[0])
    return AxisResult(tau0, fit_curve(curve.tau, curve.adev, record), curve, name=axis)
