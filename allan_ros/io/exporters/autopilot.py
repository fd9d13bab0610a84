# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What PX4's EKF2 and ArduPilot's EK3 have in common: std per EKF step, within ranges.

Both add (dt noise)^2 to the variance of angle and velocity and (dt bias_noise)^2 to that of the
bias, with dt the step of the filter, to which the samples are averaged before: so f is its rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import NamedTuple

from ...core.filters.noise_parameters import walk_rate_std, white_std
from ...core.imu import SI_UNITS
from .model import FilterNoise, clamped
from .target import Entry

FLOOR_NOTE = (
    'this is the noise at rest, a floor: propellers, vibration and clipping come on top, and the '
    'values the autopilot ships allow for them; go below those only with proof in the logs'
)


class Parameter(NamedTuple):
    """Sensor and term of a parameter, and the range the autopilot accepts."""

    sensor: str
    term: str
    low: float
    high: float


def step_entries(model: FilterNoise, parameters: Mapping[str, Parameter]) -> Iterator[Entry]:
    """Yield the parameters, each within its range."""
    for key, (sensor, term, low, high) in parameters.items():
        convert = white_std if term == 'N' else walk_rate_std
        unit = SI_UNITS[sensor]['B' if term == 'N' else 'R']
        entry = model.number(
            (key,), sensor, term, f'{term} sqrt(f)', unit, partial(convert, rate=model.rate)
        )
        yield clamped(entry, low, high)
