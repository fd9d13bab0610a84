# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Estimate`: a measured number with a 95 % interval or limits. Conversion of numbers to text."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from .errors import AllanError
from .fields import Fields
from .imu import UNITS, ShownUnit, to_si
from .settings import MAX_FLOAT, expect

Ends = tuple[float, float]
"""Ends of an interval: (low, high)."""


def lies_beyond(ratio_ends: Ends, margin: float) -> bool:
    """Return whether an interval of a ratio lies above 1 + margin, or below 1 / (1 + margin)."""
    low, high = ratio_ends
    return low > 1.0 + margin or high < 1.0 / (1.0 + margin)


Status = Literal['estimated', 'likely', 'not_observable']
"""Whether a number is resolved ('estimated') or not ('likely', 'not_observable'). The estimated
square of a 'likely' number exceeds 0 by more than the standard error of this square. Numbers that
are not compared with 0, such as a bias, are 'estimated'."""

Z_95 = 1.96
"""Normal quantile of 97.5 %, for both ends of a 95 % interval and for a 95 % upper limit.

A one-sided limit alone would need only 1.645, the quantile of 95 %. But the same data decide
whether a term gets an interval or an upper limit. With one quantile for both, an upper limit is the
upper end of an interval that begins at 0, and the probability of missing the true value is the same
for both. Feldman & Cousins (Phys. Rev. D 57, 1998) unify intervals and limits in the same way."""

RESOLVED_HALF_WIDTHS = 2.58 / Z_95
"""A number that may be negative is resolved if its magnitude exceeds half the width of its 95 %
interval by more than this factor. The expected rate of false alarms is 1 % (two-sided). R was found
on 1.0 % of 900 axes without R."""

VALUE_DIGITS, LIMIT_DIGITS = 4, 3
"""Numbers of significant digits of a value, and of a limit or an end of an interval."""

NOTHING_KNOWN = '-'
"""Text for a number with neither a value nor a limit."""


@dataclass(frozen=True)
class Estimate:
    """A measured number: a noise coefficient, a parameter of a process, a bias, a predicted error.

    Attributes
    ----------
    value : float or None
        The estimate with its sign, also if the number is not resolved; None if it is unknown, or
        if a number that is not resolved is estimated as 0.
    recording_ci95 : (low, high) or None
        95 % interval of the value for this recording; None if it is unknown, as for a coefficient
        that is not resolved, or of method 'paper'.
    upper95 : float or None
        95 % upper limit of a number that is not resolved; None if there is no limit. For a number
        that can be negative, ``upper95`` limits the magnitude.
    status : 'estimated', 'likely' or 'not_observable'
        'estimated' if the data show that the number is not 0, or if the number is not compared
        with 0, such as a bias or a coefficient of method 'paper'. A 'likely' number is not
        resolved, but its estimated square exceeds 0 by more than the standard error of this square.
    predictive_ci95 : (low, high) or None
        95 % interval of the value in another hour of the same sensor; None if the noise does not
        vary significantly within the recording, or if the interval is unknown.
    name : str
        Name of the number, such as 'N' or 'frequency'; '' if unknown.
    unit : str
        Unit of the value, the intervals and the limits; '' for a ratio, or if unknown.
    axis : str
        Axis of the IMU, such as 'gyro_z', or sensor; '' if the number belongs to no axis or sensor,
        or if unknown.

    Examples
    --------
    >>> from allan_ros import Estimate
    >>> from allan_ros.core.fields import Fields
    >>> Estimate(1e-4, (9e-5, 1.1e-4), unit='rad/s/sqrt(Hz)').to('deg/sqrt(h)')
    0.3438 (0.309..0.378) deg/sqrt(h)
    >>> Estimate(None, upper95=2e-5, status='not_observable', unit='rad/s').to('deg/h')
    < 4.13 deg/h
    >>> ramp = Estimate(-2.0, (-2.5, -1.5))
    >>> ramp.resolved, ramp.ci95, ramp.magnitude.ci95
    (True, (-2.5, -1.5), (1.5, 2.5))
    >>> bias = Estimate.normal(-2.0, 0.1)
    >>> round(bias.std, 9), round(bias.largest, 3)
    (0.1, 2.196)
    >>> likely = Estimate(0.5, upper95=2.0, status='likely')
    >>> likely.shown.value is None
    True
    >>> likely.document()
    {'value': 0.5, 'ci95': None, 'upper95': 2.0, 'status': 'likely'}
    >>> Estimate.from_document(Fields(likely.document(), 'file')) == likely
    True
    """

    value: float | None
    recording_ci95: Ends | None = None
    upper95: float | None = None
    status: Status = 'estimated'
    predictive_ci95: Ends | None = None
    name: str = ''
    unit: str = ''
    axis: str = ''

    @classmethod
    def normal(cls, value: float, std: float) -> Estimate:
        """Return an estimate with a normally distributed error; ``std`` is the standard error."""
        return cls(value, (value - Z_95 * std, value + Z_95 * std))

    @property
    def std(self) -> float:
        """Standard error: half the width of the 95 % interval, divided by 1.96.

        NaN if the interval is unknown.
        """
        low, high = self.ci95 or (math.nan, math.nan)
        return (high - low) / (2.0 * Z_95)

    @property
    def largest(self) -> float:
        """Largest magnitude in the interval; without an interval, the magnitude of the value.

        NaN if the interval and the value are unknown.
        """
        return max(map(abs, self.ci95 or (math.nan if self.value is None else self.value,)))

    @property
    def ci95(self) -> Ends | None:
        """The 95 % interval that is shown and exported.

        This is the predictive interval if it is known, else the interval for the recording.
        """
        return self.predictive_ci95 or self.recording_ci95

    @property
    def resolved(self) -> bool:
        """Whether the value is known and has the status 'estimated'."""
        return self.status == 'estimated' and self.value is not None

    @property
    def shown(self) -> Estimate:
        """The estimate as it is shown to users: without its value if it is not resolved."""
        return self if self.resolved else replace(self, value=None)

    @property
    def magnitude(self) -> Estimate:
        """The estimate of the magnitude: a negative estimate is multiplied by -1."""
        return self.times(-1.0) if (self.value or 0.0) < 0.0 else self

    def times(self, factor: float) -> Estimate:
        """Return the estimate times a factor; limits are multiplied by the magnitude of the factor.

        >>> Estimate(2.0, (1.5, 2.5)).times(-2.0).ci95
        (-5.0, -3.0)
        """

        def ends(interval: Ends | None) -> Ends | None:
            if interval is None:
                return None
            low, high = sorted(factor * end for end in interval)
            return low, high

        return replace(
            self,
            value=None if self.value is None else factor * self.value,
            recording_ci95=ends(self.recording_ci95),
            predictive_ci95=ends(self.predictive_ci95),
            upper95=None if self.upper95 is None else abs(factor) * self.upper95,
        )

    def to(self, unit: str) -> Estimate:
        """Return the estimate converted to another unit.

        Parameters
        ----------
        unit : str
            A unit of the same kind, such as 'deg/sqrt(h)' for N of a gyro.

        Raises
        ------
        AllanError
            When ``unit`` is unknown or of another kind; the message lists the possible units. Also
            when ``unit`` is no text, or the estimate has no unit, such as a ratio or a coefficient
            in `Results.noise`, or a unit for which no other unit is known, such as Hz.
        """
        expect(str, unit=unit)
        present_unit = UNITS.get(self.unit)
        if present_unit is None:
            raise AllanError(
                f'a number with the unit {self.unit!r} cannot be converted to {unit!r:.40}: take '
                "coefficients from an axis, such as results['gyro_z'].N"
            )
        return replace(
            self.times(present_unit.factor / to_si(1.0, unit, present_unit.si)), unit=unit
        )

    def document(self) -> dict[str, Any]:
        """Return the estimate as a JSON object, without name, unit and axis.

        Unknown numbers are None. ``ci95`` is the interval that is shown. If this is the predictive
        interval, the object also contains ``recording_ci95``, the interval for this recording.
        """
        numbers: dict[str, Any] = {'value': self.value, 'ci95': self.ci95}
        if self.predictive_ci95 is not None:
            numbers['recording_ci95'] = self.recording_ci95
        return {**numbers, 'upper95': self.upper95, 'status': self.status}

    @classmethod
    def from_document(cls, fields: Fields, signed: bool = False) -> Estimate:
        """Return the estimate that `document` wrote as a JSON object.

        Name, unit and axis are not stored; missing numbers are None. With ``signed``, the value may
        be negative. Raises AllanError if a number or an end of an interval is no number or out of
        range, if the status is missing or unknown, or if there is ``recording_ci95`` without
        ``ci95``.
        """
        least = -MAX_FLOAT if signed else 0.0

        def number(key: str, least: float = 0.0) -> float | None:
            has_number = key in fields and fields.value(key) is not None
            return fields.number(key, least) if has_number else None

        has_predictive = 'recording_ci95' in fields
        return cls(
            number('value', least),
            fields.typed('recording_ci95' if has_predictive else 'ci95', Ends | None),
            number('upper95'),
            fields.typed('status', Status),
            fields.typed('ci95', Ends) if has_predictive else None,
        )

    def __repr__(self) -> str:
        own_unit = ShownUnit(self.unit, 1.0)
        interval = interval_text(self, own_unit)
        value = f'{value_text(self, own_unit)}{f" ({interval})" if interval else ""}'
        return f'{value} {self.unit}'.rstrip()


SignedEstimate = Annotated[Estimate, 'may be negative']
"""Type of a field whose estimate may be negative (`Fields.typed`)."""

UNKNOWN = Estimate(None, status='not_observable')
"""A number of which nothing is known."""


def value_text(estimate: Estimate, unit: ShownUnit) -> str:
    """Return an estimate as text in ``unit``: its value, ``< limit`` if it is not resolved, or '-'.

    The text is '-' if the estimate is not resolved and has no finite limit.

    >>> value_text(Estimate(None, upper95=0.5), ShownUnit('', 1.0))
    '< 0.500'
    """
    if estimate.resolved and estimate.value is not None:
        return significant(estimate.value * unit.factor, VALUE_DIGITS)
    if estimate.upper95 is not None and math.isfinite(estimate.upper95):
        return f'< {significant(estimate.upper95 * unit.factor, LIMIT_DIGITS)}'
    return NOTHING_KNOWN


def interval_text(estimate: Estimate, unit: ShownUnit) -> str:
    """Return the 95 % interval of an estimate as text in ``unit``: ``low..high``.

    The text is '' if the status is not 'estimated', or if the number has no interval or is known
    exactly.

    >>> interval_text(Estimate(-2.0, (-2.5, -1.5)), ShownUnit('', 1.0))
    '-2.50..-1.50'
    """
    if estimate.status != 'estimated' or estimate.ci95 is None:
        return ''
    low, high = estimate.ci95
    if low == high:
        return ''
    is_narrow = high - low < 0.02 * max(abs(low), abs(high))
    digits = VALUE_DIGITS if is_narrow else LIMIT_DIGITS
    return '..'.join(significant(end * unit.factor, digits) for end in (low, high))


def known_numbers(estimate: Estimate, unit: ShownUnit) -> tuple[float | None, ...]:
    """Return the value, the ends of the interval and the upper limit of an estimate, in ``unit``.

    A resolved number has no upper limit, and a number that is not resolved has only an upper limit.
    Missing numbers are None.
    """
    converted = estimate.shown.times(unit.factor)
    low, high = (
        converted.ci95 if converted.resolved and converted.ci95 is not None else (None, None)
    )
    return converted.value, low, high, None if converted.resolved else converted.upper95


# --- numbers as text ------------------------------------------------------------------------------


def significant(value: float, digits: int) -> str:
    """Return a number rounded to ``digits`` significant digits, with trailing zeros.

    Rounded magnitudes below 1e-4, or of 1e6 or more, are in exponential notation. Zero, NaN and
    infinity have no digits: '0', 'nan', 'inf' and '-inf'.

    >>> significant(0.24199, 4), significant(31.8, 4), significant(12345.6, 3)
    ('0.2420', '31.80', '12300')
    """
    if not math.isfinite(value) or value == 0.0:
        return f'{value + 0.0:g}'  # -0.0 + 0.0 is 0.0
    exponent = math.floor(math.log10(abs(float(f'{value:.{digits - 1}e}'))))
    if not -4 <= exponent <= 5:
        return f'{value:.{digits - 1}e}'
    decimals = digits - 1 - exponent
    return f'{round(value, decimals):.{max(decimals, 0)}f}'


def duration_text(seconds: float, digits: int = 2) -> str:
    """Return a duration as text in s, min, h or days, rounded to ``digits`` significant digits.

    ``digits`` is at most 6.

    >>> duration_text(90.0), duration_text(1234.0, digits=3), duration_text(86400.0 * 3.456)
    ('90 s', '20.6 min', '3.5 days')
    """
    for unit, size in (('days', 86400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2.0 * size:
            return f'{float(f"{seconds / size:.{digits}g}"):g} {unit}'
    return f'{float(f"{seconds:.{digits}g}"):g} s'


def prefixed(unit: ShownUnit, size: float) -> ShownUnit:
    """Return ``unit``, or this unit with a larger prefix if ``size`` would be 1000 or more in it.

    ``size`` is a value in SI. Only the prefixes u and m are replaced, and only if g, rad or m/
    follows the prefix; any other unit is returned unchanged.

    >>> prefixed(ShownUnit('ug', 1e6 / 9.80665), 0.0274).name
    'mg'
    """
    name, factor = unit
    for prefix, larger_prefix in (('u', 'm'), ('m', '')):
        rest = name[1:] if name.startswith(prefix) else ''
        if rest.startswith(('g', 'rad', 'm/')) and size * factor >= 1000.0:
            name, factor = larger_prefix + rest, 1e-3 * factor
    return ShownUnit(name, factor)
