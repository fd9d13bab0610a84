# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measured inflation: what running motors add to the noise of a robot at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import AllanError
from ..fit.model import AxisFit
from .noise_parameters import reduce_axis
from .reductions import Horizons


@dataclass(frozen=True)
class TermInflation:
    """N or K of a reduction, at rest and at rest with motors on, in SI.

    Attributes
    ----------
    rest, running : float
    """

    rest: float
    running: float

    @property
    def use(self) -> float:
        """The value for a filter: the larger of the two."""
        return max(self.rest, self.running)

    @property
    def factor(self) -> float:
        """The value for a filter over the one at rest, at least 1."""
        return self.use / self.rest


@dataclass(frozen=True)
class AxisInflation:
    """Inflation of N and K of one axis."""

    white: TermInflation
    walk: TermInflation


def measure_inflation(
    rest: Mapping[str, AxisFit],
    running: Mapping[str, AxisFit],
    horizons: Horizons = Horizons(1.0, 30.0),
) -> dict[str, AxisInflation]:
    """Return the inflation of N and K of each common axis.

    Parameters
    ----------
    rest : mapping of axis name to AxisFit
        Of the robot at rest with its motors off.
    running : mapping of axis name to AxisFit
        Of the robot at rest with its motors on.
    horizons : Horizons
        Range over which the reductions bound the growth of the error.

    Raises
    ------
    AllanError
        When there is no common axis, or an axis has neither a value nor a limit of N or K.
    """
    common = [axis for axis in rest if axis in running]
    if not common:
        raise AllanError('the two results have no axis in common: give two recordings of one IMU')
    inflation = {}
    for axis in common:
        quiet, loud = (reduce_axis(axis, fits[axis], 'walk', horizons) for fits in (rest, running))
        assert quiet.walk is not None and loud.walk is not None
        inflation[axis] = AxisInflation(
            TermInflation(quiet.white.value, loud.white.value),
            TermInflation(quiet.walk.value, loud.walk.value),
        )
    return inflation
