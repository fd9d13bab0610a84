# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inflation of filter noise, measured on a robot at rest with its motors off and then on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..core.compare import Difference
from ..core.filters.inflation import AxisInflation, measure_inflation
from ..core.filters.reductions import Horizons
from ..core.imu import SI_UNITS, sensor_of
from .comparison import RunComparison, Subject, compare_runs
from .format import significant
from .results import Results

SCHEMA = 'allan_ros/inflation/1'

REST, RUNNING = 'at rest', 'at rest, motors on'
"""Labels of the two recordings."""

SHOWN_TAU_S = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Averaging times of the table."""


@dataclass(frozen=True)
class Inflation:
    """The noise of an IMU at rest with motors on, over that with motors off.

    Attributes
    ----------
    axes : mapping of axis name to AxisInflation
        N and K of the reductions, and their factors.
    comparison : RunComparison
        Ratio of the Allan deviations at each averaging time, with intervals.
    horizons : Horizons
        Range over which N and K bound the growth of the error.
    """

    axes: dict[str, AxisInflation]
    comparison: RunComparison
    horizons: Horizons

    def __repr__(self) -> str:
        return '\n'.join(inflation_lines(self))

    @property
    def factor(self) -> float:
        """The largest factor on N of any axis: a value for ``--inflate``."""
        return max(axis.white.factor for axis in self.axes.values())

    def ratios(self, axis: str) -> list[Difference]:
        """Return the ratio of the deviations of an axis at each common averaging time."""
        (pair,) = self.comparison.pairs
        return [d for d in pair.differences if d.axis == axis and d.tau is not None]


def inflate(rest: Results, running: Results, horizon: float = 30.0) -> Inflation:
    """Return what running motors add to the noise of a robot at rest.

    Parameters
    ----------
    rest, running : Results
        Of the robot at rest, motors off and motors on.
    horizon : float
        Longest time in s that the filter integrates without correction.

    Raises
    ------
    AllanError
        When the two have no axis in common, or N or K of an axis is not known.
    """
    horizons = Horizons.up_to(horizon)
    fits = [{axis: r.fit for axis, r in results.axes.items()} for results in (rest, running)]
    axes = measure_inflation(fits[0], fits[1], horizons)
    comparison = compare_runs([Subject(REST, rest), Subject(RUNNING, running)])
    return Inflation(axes, comparison, horizons)


def inflation_document(inflation: Inflation) -> dict[str, Any]:
    """Return the document ``allan_ros/inflation/1``, in SI."""
    return {
        'schema': SCHEMA,
        'horizon_s': list(inflation.horizons),
        'factor': inflation.factor,
        'axes': {
            name: {
                **{
                    term: {'rest': t.rest, 'running': t.running, 'factor': t.factor, 'use': t.use}
                    for term, t in (('N', axis.white), ('K', axis.walk))
                },
                'deviation': [
                    {'tau_s': d.tau, 'ratio': d.ratio, 'ci95': d.ci95 and list(d.ci95)}
                    for d in inflation.ratios(name)
                ],
            }
            for name, axis in inflation.axes.items()
        },
    }


def inflation_lines(inflation: Inflation) -> Iterator[str]:
    """Yield a table of N and K to use, then one of the ratio of the deviations over tau."""
    yield f'N and K for a filter, over {inflation.horizons}'
    yield f'{"":9}{"N to use":>34}  {"factor":>6}{"K to use":>36}  {"factor":>6}'
    for name, axis in inflation.axes.items():
        units = SI_UNITS[sensor_of(name)]
        cells = [
            f'{significant(term.use, 4)} {units[key]:16}'
            for key, term in (('N', axis.white), ('K', axis.walk))
        ]
        yield (
            f'{name:9}{cells[0]:>34}  {axis.white.factor:6.2f}'
            f'{cells[1]:>36}  {axis.walk.factor:6.2f}'
        ).rstrip()
    yield ''
    yield 'Allan deviation with motors on over motors off, 95 % interval'
    for name in inflation.axes:
        ratios = inflation.ratios(name)
        nearest = {d.tau: d for tau in SHOWN_TAU_S if (d := _nearest(ratios, tau)) is not None}
        cells = [f'{tau:g} s: {_ratio(d)}' for tau, d in nearest.items()]
        yield f'{name:9}{"  ".join(cells)}'


def _nearest(ratios: list[Difference], tau: float) -> Difference | None:
    """Return the ratio at the averaging time within a factor of 1.5 of ``tau``, if there is one."""
    close = [d for d in ratios if d.tau is not None and tau / 1.5 < d.tau < 1.5 * tau]
    return min(close, key=lambda d: abs((d.tau or 0.0) - tau), default=None)


def _ratio(d: Difference) -> str:
    if d.ratio is None or d.ci95 is None:
        return 'not known'
    return f'{d.ratio:.2f} ({d.ci95[0]:.2f} to {d.ci95[1]:.2f})'
