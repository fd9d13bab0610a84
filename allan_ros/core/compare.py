# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hold a fit against what the IMU should be: it is blamed only when the interval excludes that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from .fit.values import TERMS, Coefficient

MARGIN = 0.2
"""A unit is blamed from 20 % above a limit: typical figures are those of the middle unit, not
of the worst, and noise rises some percent with temperature."""

Verdict = Literal['within', 'beyond', 'open']
"""Surely not above the limit; surely above it; the interval holds the limit, so wait."""


@dataclass(frozen=True)
class Reference:
    """What an IMU should be.

    Attributes
    ----------
    name : str
        Of the datasheet or the former run.
    limits : mapping of axis name to term to float
        Upper limits in SI, for the terms that are known.
    """

    name: str
    limits: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Comparison:
    """One coefficient against one limit, in SI."""

    reference: str
    axis: str
    term: str
    limit: float
    verdict: Verdict


def compare(
    axis: str, noise: Mapping[str, Coefficient], reference: Reference, margin: float
) -> tuple[Comparison, ...]:
    """Return a comparison for each term of an axis that the reference knows.

    Parameters
    ----------
    axis : str
    noise : mapping of term to Coefficient
    reference : Reference
    margin : float
        Fraction by which the whole 95 % interval must lie above the limit to be beyond it.
    """
    limits = reference.limits.get(axis, {})
    return tuple(
        Comparison(
            reference.name, axis, term, limits[term], verdict(noise[term], limits[term], margin)
        )
        for term in TERMS
        if term in limits
    )


def verdict(coefficient: Coefficient, limit: float, margin: float) -> Verdict:
    """Return how a coefficient stands to an upper limit."""
    highest = limit * (1.0 + margin)
    low, high = coefficient.ci95 or (None, coefficient.upper95)
    if coefficient.status == 'estimated' and low is not None and low > highest:
        return 'beyond'
    if high is not None and high <= highest:
        return 'within'
    return 'open'


def reference_of_run(name: str, noise: Mapping[str, Mapping[str, Coefficient]]) -> Reference:
    """Return a former run as a reference: no term may lie above what it could have been then.

    Parameters
    ----------
    name : str
    noise : mapping of axis name to term to Coefficient
    """
    limits: dict[str, dict[str, float]] = {}
    for axis, terms in noise.items():
        limits[axis] = {
            term: high for term, c in terms.items() if (high := _highest(c)) is not None
        }
    return Reference(name, limits)


def _highest(coefficient: Coefficient) -> float | None:
    """Return the upper end of what is known of a coefficient."""
    if coefficient.ci95 is not None:
        return coefficient.ci95[1]
    return coefficient.value if coefficient.upper95 is None else coefficient.upper95
