# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Chart data of the bias and the noise over time, and of the bias against temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.allan.history import Recording
from ...core.allan.sums import AllanSums
from ...core.imu import AXES, SENSORS
from ..results import Results
from ..signal_summary import SignalSummary

Floats = NDArray[np.float64]

CHART_DIGITS = 5
"""Significant digits of a point of a chart: a tenth of a pixel on any screen."""

MEANS = 129
"""The means of a recording are fewer than this."""

LONGEST_NOISE_S = 1.0
"""The noise over time is shown at the longest averaging time below this."""

LEAST_COUNT, LEAST_POINTS = 16, 4
"""Fewest differences of a period, and fewest points of a chart."""

LEAST_RANGE_C = 0.5
"""A bias is shown against a temperature that changes by more."""


class Course(NamedTuple):
    """Times in s, values (times, axes), and the averaging time in s that the values have."""

    time: Floats
    values: Floats
    span: float


def rounded(values: ArrayLike) -> list[float | None]:
    """Return numbers to `CHART_DIGITS` digits, None for what is not finite."""
    return [
        float(f'{v:.{CHART_DIGITS}g}') if math.isfinite(v) else None
        for v in np.asarray(values, float).tolist()
    ]


def courses(results: Results, sensor: str, summary: SignalSummary | None) -> list[dict[str, Any]]:
    """Return the charts of bias and noise over time, and of the bias against temperature.

    Parameters
    ----------
    results : Results
    sensor : 'gyro' or 'accel'
    summary : SignalSummary or None
        Gives the time axis of the page; without it the recordings follow one another.
    """
    where = [name for name in AXES[SENSORS[sensor]] if name in results.axes]
    known_sums = () if results.recorded is None else results.recorded.sums
    sums = next((s for s in known_sums if set(where) & set(s.axes)), None)
    if sums is None or sums.tau0 is None:
        return []
    columns = [i for i, name in enumerate(sums.axes) if name in where]
    names = [sums.axes[i] for i in columns]
    placed = _placed(sums, summary)
    bias = _joined([_bias(recording, start, sums.tau0) for recording, start in placed], columns)
    levels = [_noise(recording, start, sums.tau0) for recording, start in placed]
    noise = _joined([level for level in levels if level.span == levels[0].span], columns)
    charts = []
    if np.isfinite(bias.values).any(axis=1).sum() >= LEAST_POINTS:
        bias = bias._replace(values=bias.values - np.nanmean(bias.values, axis=0))
        terms = [results.axes[name].fit.noise['N'] for name in names]
        known = [n.value if n.status == 'estimated' and n.value else math.nan for n in terms]
        white = rounded([1.96 * density / math.sqrt(bias.span) for density in known])
        charts.append({**_document('bias', bias, names), 'white': white})
        against = _against_temperature(bias, summary)
        if against is not None:
            slopes = rounded(np.polyfit(against.time, against.values, 1)[0])
            charts.append({**_document('temperature', against, names), 'slopes': slopes})
    if np.isfinite(noise.values).any(axis=1).sum() >= LEAST_POINTS:
        charts.append(_document('noise', noise, names))
    return charts


def _placed(sums: AllanSums, summary: SignalSummary | None) -> list[tuple[Recording, float]]:
    """Return each recording with its start on the time axis in s, the earliest first."""
    placed, end = [], 0.0
    for recording in sorted(sums.history.recordings, key=lambda r: r.start_ns):
        start = end
        for at, first_ns in zip(*((summary.starts, summary.first_ns) if summary else ((), ()))):
            if first_ns <= recording.start_ns:
                start = at + (recording.start_ns - first_ns) * 1e-9
        placed.append((recording, start))
        end += recording.length * (sums.tau0 or 0.0)
    return placed


def _bias(recording: Recording, start: float, tau0: float) -> Course:
    """Return the means of cells of which more than half the samples are used."""
    cells = recording.coarser(MEANS, recording.period_begin)
    span = cells.step * tau0
    known = cells.cell_samples[:, None] > cells.step / 2
    values = np.where(known, cells.cell_means + cells.reference, np.nan)
    middles = np.asarray((np.arange(len(values)) + 0.5) * span + start, float)
    return Course(middles, values, span)


def _noise(recording: Recording, start: float, tau0: float) -> Course:
    """Return the Allan deviation of every period at `LONGEST_NOISE_S` or less."""
    level = int(np.searchsorted(recording.level_m * tau0, LONGEST_NOISE_S, side='right')) - 1
    begins = recording.period_begin
    if level < 0 or not len(begins):
        return Course(np.zeros(0), np.zeros((0, len(recording.reference))), 0.0)
    m, count = recording.level_m[level], recording.level_count[:, level]
    square = recording.level_sum_sq[:, level] / (2.0 * np.maximum(count, 1)[:, None])
    adev = np.where(count[:, None] >= LEAST_COUNT, np.sqrt(square) / m, np.nan)
    middles = np.asarray((begins + np.append(begins[1:], recording.length)) / 2.0, float)
    return Course(middles * tau0 + start, adev, float(m * tau0))


def _joined(parts: Sequence[Course], columns: Sequence[int]) -> Course:
    """Return some columns of all recordings one after the other, with a NaN between two."""
    times, values = [np.zeros(0)], [np.zeros((0, len(columns)))]
    for part in parts:
        if len(part.time):
            times += [part.time, part.time[-1:] + 1e-3]
            values += [part.values[:, columns], np.full((1, len(columns)), np.nan)]
    span = max((part.span for part in parts), default=0.0)
    return Course(np.concatenate(times)[:-1], np.concatenate(values)[:-1], span)


def _against_temperature(bias: Course, summary: SignalSummary | None) -> Course | None:
    """Return the bias by temperature in degC; None where it was not recorded or hardly changes."""
    if summary is None or summary.temperature is None:
        return None
    trace = summary.temperature
    some = np.isfinite(trace.celsius)
    celsius = np.interp(bias.time, trace.time_s[some], trace.celsius[some], np.nan, np.nan)
    known = np.isfinite(celsius) & np.isfinite(bias.values).all(axis=1)
    if known.sum() < LEAST_POINTS or np.ptp(celsius[known]) <= LEAST_RANGE_C:
        return None
    order = np.argsort(celsius[known], kind='stable')
    return Course(celsius[known][order], bias.values[known][order], bias.span)


def _document(kind: str, course: Course, names: Sequence[str]) -> dict[str, Any]:
    lines = [{'name': n, 'values': rounded(v)} for n, v in zip(names, course.values.T)]
    return {'kind': kind, 'x': rounded(course.time), 'lines': lines, 'span': course.span}
