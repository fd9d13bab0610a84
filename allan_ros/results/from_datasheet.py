# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise model of a datasheet as `Results`, to export files for an IMU that was not measured."""

from __future__ import annotations

import math

from ..core.errors import AllanError
from ..core.estimate import UNKNOWN, Estimate
from ..core.findings import finding
from ..core.fit.result import TERMS, AxisFit, model_of_terms
from ..core.imu import SENSORS, ImuIdentity
from ..core.noise import FLICKER_FLOOR
from ..readers import SourceInfo
from ..readers.recorded import Provenance
from .axis_result import AxisResult
from .datasheets import Datasheet, load_sensor, sensor_names
from .measured import known_factors
from .results import Results

FROM_DATASHEET = 'datasheet'
"""`Results.method` of results that come from a datasheet."""

DEFAULT_RATE_HZ = 200.0
"""Sample rate in Hz that files from a datasheet state, unless the user states another rate."""

CROSSING_S = 10.0
"""Averaging time in s at which flicker noise is assumed to equal white noise, if a datasheet states
no B. This time is 7 to 200 s for the sensors that were measured. A shorter time gives a larger B.
"""


def results_of_datasheet(sheet: Datasheet, rate: float = DEFAULT_RATE_HZ) -> Results:
    """Return the noise model of a datasheet as results of an IMU with a sample rate in Hz.

    The model has the stated N and B. If the datasheet states no B, B follows from `CROSSING_S`.
    Raises AllanError if the datasheet states no N of an axis.
    """
    axes, assumed = {}, []
    for axis, terms in sheet.values().items():
        if 'N' not in terms:
            raise AllanError(
                f'{sheet.name} states no N of {axis}: record the sensor at rest and use '
                'allan analyze'
            )
        if 'B' not in terms:
            assumed.append(axis)
        flicker = terms['N'] / math.sqrt(FLICKER_FLOOR * CROSSING_S)
        known = {'N': Estimate(terms['N']), 'B': Estimate(terms.get('B', flicker))}
        noise = {term: known.get(term, UNKNOWN) for term in TERMS}
        fit = AxisFit(noise, model_of_terms(noise))
        axes[axis] = AxisResult(1.0 / rate, fit, name=axis)
    low, high = known_factors(map(load_sensor, sensor_names()))
    found = [finding('from_datasheet', name=sheet.name, low=low, high=high)]
    if assumed:
        found.append(finding('bias_not_stated', tuple(assumed), time=CROSSING_S))
    stated = [f'{one} {one.url}'.strip() for one in sheet.sources.values()]
    stated += [
        f'{kind} {term} stated {limit.stated}{f" ({limit.note})" if limit.note else ""}'
        for kind in SENSORS
        for term in 'NB'
        if (limit := sheet.limits.get(f'{kind}_x', {}).get(term))
    ]
    sources = tuple(SourceInfo(text, '', '', '') for text in stated)
    identity, provenance = ImuIdentity(sheet.name), Provenance(sources)
    period = 1.0 / rate
    return Results(identity, FROM_DATASHEET, period, 0, 0.0, 0, axes, provenance, tuple(found))
