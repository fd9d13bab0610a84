# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How numbers, units of measurement and curves are shown in texts and figures."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..core.estimate import RESOLVED_HALF_WIDTHS, prefixed, significant, value_text
from ..core.fit.result import Deviation, TemperatureModel
from ..core.imu import Flags, Floats, ShownUnit, shown_unit

if TYPE_CHECKING:
    from ..results.axis_result import AxisResult

SENSOR_NAMES = {'gyro': 'Gyroscope', 'accel': 'Accelerometer'}
"""Sensor -> name of the sensor in headings."""

PRETTY = (
    ('sqrt(Hz)', '√Hz'),
    ('sqrt(h)', '√h'),
    ('^1.5', '¹·⁵'),
    ('^2', '²'),
    ('^3', '³'),
    ('deg', '°'),
    ('urad', 'µrad'),
    ('um/', 'µm/'),
    ('ug', 'µg'),
)
"""Parts of units in plain text, and their spellings in reports and plots."""

NO_BREAK = '\N{NO-BREAK SPACE}'
"""A space at which a line is not broken."""

READ_AT = {'Q': math.sqrt(3.0), 'N': 1.0, 'K': 3.0, 'R': math.sqrt(2.0)}
"""Term -> averaging time in s at which the Allan deviation of the term equals its coefficient in SI
(IEEE Std 952)."""


def pretty_unit(name: str) -> str:
    """Return a unit in typographic spelling.

    >>> pretty_unit('deg/sqrt(h)'), pretty_unit('ug'), pretty_unit('m/s^2/sqrt(Hz)')
    ('°/√h', 'µg', 'm/s²/√Hz')
    """
    for plain, typeset in PRETTY:
        name = name.replace(plain, typeset)
    return name


def part_text(part: str, likely: Collection[str]) -> str:
    """Return the name of a part of the model, with '?' after each term in ``likely``.

    ``part`` is a term, a process, or several of them joined by '+'. Likely terms are not resolved,
    but the model contains them.

    >>> part_text('B+GM 110 s', ['B'])
    'B?+GM 110 s'
    """
    return '+'.join(f'{name}?' if name in likely else name for name in part.split('+'))


def deviation_text(deviation: Deviation | None) -> str:
    """Return a deviation of a curve from its model, such as '+12 % at 3.4 s'; '' for None."""
    if deviation is None:
        return ''
    return f'{100.0 * deviation.relative:+.0f} % at {significant(deviation.tau, 2)} s'


def temperature_text(models: Mapping[str, TemperatureModel], units: str) -> str:
    """Return the bias over temperature of the axes of one sensor as text, with 95 % intervals.

    The text states the slope of each axis, and K before and after the bias over temperature is
    subtracted. If the effect of the temperature is resolved, the text also states which share of
    the drift the temperature explains. The hysteresis is stated if it is resolved.
    """
    names, fits = list(models), list(models.values())
    bias_unit, walk_unit = (
        prefixed(shown_unit(names[0], term, units), max(abs(size) for size in sizes))
        for term, sizes in (
            ('B', [m.b1 for m in fits]),
            ('K', [m.measured.K.value or 0.0 for m in fits]),
        )
    )
    slopes = (
        f'{name[-1]} {_plus_minus(m.b1, m.b1_ci95, bias_unit)}'
        + ('' if m.resolved else ' (not resolved)')
        for name, m in models.items()
    )
    text = f'{", ".join(slopes)} {bias_unit.name} per K at {fits[0].reference:g} degC'
    shares = [100.0 * m.explained for m in fits if m.resolved and m.explained is not None]
    if shares:
        low, high = f'{min(shares):.0f}', f'{max(shares):.0f}'
        text += f', {low if low == high else f"{low} to {high}"} % of the drift'
    hystereses = [
        f'{name[-1]} {_plus_minus(m.hysteresis, m.hysteresis_ci95, bias_unit)}'
        for name, m in models.items()
        if abs(m.hysteresis) > RESOLVED_HALF_WIDTHS * np.ptp(m.hysteresis_ci95) / 2.0
    ]
    if hystereses:
        text += f'; rising minus falling {", ".join(hystereses)} {bias_unit.name}'
    corrected_walks, measured_walks = (
        ', '.join(value_text(walk, walk_unit) for walk in walks)
        for walks in ([m.corrected.K for m in fits], [m.measured.K for m in fits])
    )
    return (
        f'{text}. K of the complete recording: {measured_walks} {walk_unit.name}, after the bias '
        f'over temperature is subtracted: {corrected_walks}. The coefficients above exclude '
        'warm-up and slow cycles.'
    )


def _plus_minus(value: float, ends: tuple[float, float], unit: ShownUnit) -> str:
    half_width = (ends[1] - ends[0]) / 2.0
    return f'{significant(value * unit.factor, 3)} ± {significant(half_width * unit.factor, 2)}'


# --- figures --------------------------------------------------------------------------------------

TERM_STYLES: dict[str, tuple[str, Any]] = {
    'Q': ('#CC79A7', (0, (1, 1.2))),
    'N': ('#0072B2', (0, (5, 1.5))),
    'B': ('#009E73', (0, (6, 1.5, 1, 1.5))),
    'K': ('#D55E00', (0, (9, 2))),
    'R': ('#E69F00', (0, (3, 1.2, 1, 1.2, 1, 1.2))),
}
"""Term -> color and dashes of the line of this term.

Color-blind readers can distinguish the colors (Okabe and Ito, "Color universal design", 2008). The
dashes distinguish the lines in print without colors."""


class DrawnCurve(NamedTuple):
    """The Allan curve and the model of one axis as they are drawn.

    Each array, (factors,), has one element for each averaging time. The Allan deviations are NaN
    where nothing is drawn. They are in the unit of the drawing, which the argument ``factor`` of
    `drawn_curve` determines.
    """

    tau: Floats  # averaging times in s
    adev: Floats
    low: Floats  # 68.3 % confidence limits
    high: Floats
    uncertain: Flags  # whether a point is too uncertain to be compared with the model
    model: Floats
    upper: Floats  # model with unresolved terms at their upper limits
    parts: dict[str, Floats]  # name of a part of the model -> deviation of this part
    limits: dict[str, Floats]  # term that is not resolved -> upper limit of its deviation
    # term -> point (tau, adev) at which the deviation of the term equals its coefficient
    marks: dict[str, tuple[float, float]]

    @property
    def any(self) -> bool:
        """Whether any deviation is positive, so that a logarithmic scale can show the curve."""
        return bool(np.isfinite(self.adev).any())


def drawn_curve(axis: AxisResult, factor: float = 1.0) -> DrawnCurve | None:
    """Return the Allan curve and the model of an axis as they are drawn; None without a curve.

    ``factor`` converts SI to the unit of the drawing.
    """
    curve = axis.curve
    if curve is None:
        return None
    positive_adev = curve.adev[curve.adev > 0.0]
    # parts of the model are drawn only where they exceed a fifth of the lowest point of the curve
    floor = 0.2 * positive_adev.min() if len(positive_adev) else np.inf

    def above(values: Floats, least: float = 0.0) -> Floats:
        return np.where(values > least, factor * values, np.nan)

    parts = {name: above(adev, floor) for name, adev in axis.part_adev(curve.m).items()}
    limits = {name: above(adev, floor) for name, adev in axis.limit_adev(curve.m).items()}
    adev, low, high = (above(values) for values in (curve.adev, curve.ci_low, curve.ci_high))
    model, upper = (factor * line for line in axis.model_line())
    marks = {
        term: (tau, factor * float(np.sqrt(axis.fit.model.contributions([tau])[term][0])))
        for term, tau in READ_AT.items()
        if term in parts
    }
    return DrawnCurve(
        curve.tau, adev, low, high, curve.is_uncertain, model, upper, parts, limits, marks
    )
