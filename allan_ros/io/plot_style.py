# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options and colors of figures, and the drawn curves. Does not import matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError
from ..core.settings import choose
from .axis_result import AxisResult
from .format import READ_AT

Floats = NDArray[np.float64]

FORMATS = ('png', 'svg', 'pdf')
"""File formats of figures."""

TERM_STYLES: dict[str, tuple[str, Any]] = {
    'Q': ('#CC79A7', (0, (1, 1.2))),
    'N': ('#0072B2', (0, (5, 1.5))),
    'B': ('#009E73', (0, (6, 1.5, 1, 1.5))),
    'K': ('#D55E00', (0, (9, 2))),
    'R': ('#E69F00', (0, (3, 1.2, 1, 1.2, 1, 1.2))),
}
"""Term -> color and dashes of its line.

The colors of Okabe and Ito ("Color universal design", 2008) can be distinguished by color-blind
readers, the dashes without colors."""

BELOW_CURVE = 0.2
"""A part of the model is drawn above this fraction of the lowest point of the curve."""


class DrawnCurve(NamedTuple):
    """The curve and the model of one axis as they are drawn.

    Each array has a value for each averaging time, NaN where nothing is drawn.
    """

    tau: Floats  # averaging times in s
    adev: Floats
    low: Floats  # 68.3 % limits
    high: Floats
    model: Floats
    upper: Floats  # model with unresolved terms at their upper limits
    parts: dict[str, Floats]  # parts of the model
    limits: dict[str, Floats]  # limits of terms that are not resolved
    read: dict[str, tuple[float, float]]  # term -> (tau, adev) at which its coefficient can be read

    @property
    def any(self) -> bool:
        """Whether any point is positive, so that it can be drawn on a logarithmic axis."""
        return bool(np.isfinite(self.adev).any())


def drawn_curve(axis: AxisResult, factor: float = 1.0) -> DrawnCurve | None:
    """Return the curve and the model of an axis, times ``factor``; None if it has no curve."""
    curve = axis.curve
    if curve is None:
        return None
    positive = curve.adev[curve.adev > 0.0]
    floor = BELOW_CURVE * positive.min() if len(positive) else np.inf

    def above(values: Floats, least: float = 0.0) -> Floats:
        return np.where(values > least, factor * values, np.nan)

    parts = {name: above(adev, floor) for name, adev in axis.part_adev(curve.m).items()}
    limits = {name: above(adev, floor) for name, adev in axis.limit_adev(curve.m).items()}
    adev, low, high = (above(values) for values in (curve.adev, curve.ci_low, curve.ci_high))
    model, upper = (factor * line for line in axis.model_line())
    read = {
        term: (tau, factor * float(np.sqrt(axis.fit.model.parts([tau])[term][0])))
        for term, tau in READ_AT.items()
        if term in parts
    }
    return DrawnCurve(curve.tau, adev, low, high, model, upper, parts, limits, read)


def check_plots(formats: Sequence[str]) -> None:
    """Raise AllanError if a format is unknown, or figures are requested without matplotlib."""
    for form in formats:
        choose(FORMATS, plots=form)
    if formats and find_spec('matplotlib') is None:
        raise AllanError(
            '--plots needs matplotlib, which is not installed: install it with pip or apt, or use '
            'the charts of report.html'
        )
