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
from ..core.settings import SLOWEST_HZ, check_range
from ..readers import SourceInfo
from ..readers.recording_sums import Provenance
from .axis_result import AxisResult
from .datasheets import Datasheet, load_sensor, sensor_names
from .measured import known_factors
from .results import Results

FROM_DATASHEET = 'datasheet'
"""Value of `Results.method` for results that are computed from a datasheet."""

DEFAULT_RATE_HZ = 200.0
"""Sample rate in Hz in files for an IMU that was not measured, unless the user states a rate."""

CROSSING_S = 10.0
"""Averaging time in s at which flicker noise and white noise are assumed to have equal Allan
deviations, if a datasheet states no B. This time is 8 to 190 s for the sensors whose measured N and
B are in their datasheet files. A shorter time gives a larger B."""


def results_of_datasheet(sheet: Datasheet, rate: float = DEFAULT_RATE_HZ) -> Results:
    """Return the noise model of a datasheet as the results of an IMU.

    ``rate`` is the sample rate of the IMU in Hz. The model has the stated N and B. If the datasheet
    states no B, B is computed from N and `CROSSING_S`. Axes of which the datasheet states nothing
    are absent. Raises AllanError if the datasheet states B but no N of an axis, or the rate is
    invalid.
    """
    check_range(SLOWEST_HZ, 1e6, 'Hz', rate=rate)
    axes, axes_without_bias = {}, []
    stated_axes = {axis: terms for axis, terms in sheet.values().items() if terms}
    for axis, terms in stated_axes.items():
        if 'N' not in terms:
            raise AllanError(
                f'{sheet.name} states no N of {axis}: record the sensor at rest and use '
                'allan analyze'
            )
        if 'B' not in terms:
            axes_without_bias.append(axis)
        flicker = terms['N'] / math.sqrt(FLICKER_FLOOR * CROSSING_S)
        estimates = {'N': Estimate(terms['N']), 'B': Estimate(terms.get('B', flicker))}
        noise = {term: estimates.get(term, UNKNOWN) for term in TERMS}
        fit = AxisFit(noise, model_of_terms(noise))
        axes[axis] = AxisResult(1.0 / rate, fit, name=axis)
    low, high = known_factors(map(load_sensor, sensor_names()))
    findings = [finding('from_datasheet', name=sheet.name, low=low, high=high)]
    if axes_without_bias:
        findings.append(finding('bias_not_stated', tuple(axes_without_bias), time=CROSSING_S))
    source_texts = [f'{source} {source.url}'.strip() for source in sheet.sources.values()]
    source_texts += [
        f'{sensor} {term} stated {limit.stated}{f" ({limit.note})" if limit.note else ""}'
        for sensor in SENSORS
        for term in 'NB'
        if (limit := sheet.limits.get(f'{sensor}_x', {}).get(term))
    ]
    sources = tuple(SourceInfo(text, '', '', '') for text in source_texts)
    identity, provenance = ImuIdentity(sheet.name), Provenance(sources)
    period = 1.0 / rate
    return Results(
        identity=identity,
        method=FROM_DATASHEET,
        tau0=period,
        samples=0,
        duration_s=0.0,
        segments=0,
        axes=axes,
        provenance=provenance,
        findings=tuple(findings),
    )
