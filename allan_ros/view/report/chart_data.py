# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data of the charts in the report, as JSON values in SI with factors to datasheet units."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...core.allan.curve import Spectrum, noise_density
from ...core.fit.result import TERMS, TemperatureModel
from ...core.fit.statistics import expected_power
from ...core.imu import AXES, SENSORS, Floats, shown_unit
from ...core.noise import Model
from ...core.settings import UNIT_SYSTEMS
from ...core.stream.signal import SignalSummary
from ...results.axis_result import AxisResult
from ..format import SENSOR_NAMES, drawn_curve, pretty_unit, temperature_text

if TYPE_CHECKING:
    from ...results.results import Results


MEANS = 128
"""Largest number of points in a chart of the bias or the noise over time of a single recording.
A chart of several recordings may have a few more points, because each recording begins with a new
point."""

LEAST_TREND_POINTS = 4
"""Smallest number of points of a chart over time or over temperature."""


def sensor_charts(results: Results, sensor: str, summary: SignalSummary | None) -> dict[str, Any]:
    """Return the data of all charts of one sensor ('gyro' or 'accel') as a JSON object.

    Without Allan sums in ``results``, the chart of the noise density is omitted. Without the
    ``summary`` of the raw signal, the charts of the signal and of values over time are omitted.
    """
    axes = {name: results.axes[name] for name in AXES[SENSORS[sensor]] if name in results.axes}
    tau = sorted({float(t) for a in axes.values() if a.curve is not None for t in a.curve.tau})
    return {
        'sensor': sensor,
        'title': f'{SENSOR_NAMES[sensor]} of {results.identity.label or "IMU"}',
        'units': {units: _units(sensor, units) for units in UNIT_SYSTEMS},
        'tau': rounded(tau),
        'axes': [_axis(name, axis, tau) for name, axis in axes.items()],
        'references': [*_references(axes, results, tau)],
        'density': _density(axes, results),
        'signal': None if summary is None else _signal(axes, summary),
        'trends': trends(results, sensor, summary),
    }


def rounded(values: ArrayLike, digits: int = 5) -> list[float | None]:
    """Return values of any unit, (n,), rounded to ``digits`` significant digits.

    NaN and infinity become None. In a chart that is not enlarged, rounding to five digits moves a
    point by less than a tenth of a pixel.
    """
    numbers = np.asarray(values, float).tolist()
    return [float(f'{v:.{digits}g}') if math.isfinite(v) else None for v in numbers]


def to_script(data: object) -> str:
    """Return data as JSON text that is safe inside a ``<script>`` element.

    A ``<`` in a frame_id could end the element, and two Unicode separators end a line in older
    versions of JavaScript. These characters occur only in JSON strings, in which they are escaped.
    Raises ValueError if the data contain NaN or infinity.
    """
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(',', ':'))
    for character in '<>&\u2028\u2029':
        text = text.replace(character, f'\\u{ord(character):04x}')
    return text


def _units(sensor: str, units: str) -> dict[str, Any]:
    """Return quantity -> [name of its unit in the charts, factor from SI to this unit]."""
    shown_units = {
        'curve': shown_unit(sensor, 'B', units),
        'signal': shown_unit(sensor, 'signal', units),
        'density': shown_unit(sensor, 'density', units),
        **{term: shown_unit(sensor, term, units) for term in TERMS},
    }
    return {key: [pretty_unit(unit.name), unit.factor] for key, unit in shown_units.items()}


def _axis(name: str, axis: AxisResult, tau: Sequence[float]) -> dict[str, Any]:
    axis_data: dict[str, Any] = {'name': name, 'label': name[-1]}
    curve = drawn_curve(axis)
    if curve is None or axis.curve is None:
        return axis_data
    positions = np.searchsorted(tau, curve.tau)

    def with_all_tau(values: ArrayLike) -> list[float | None]:
        values_at_all_tau = np.full(len(tau), np.nan)
        values_at_all_tau[positions] = values
        return rounded(values_at_all_tau)

    columns = {
        'adev': curve.adev,
        'low': curve.low,
        'high': curve.high,
        'n': axis.curve.n,
        'fit': curve.model,
        'most': curve.upper,
    }
    return {
        **axis_data,
        **{key: with_all_tau(values) for key, values in columns.items()},
        'parts': {part: with_all_tau(adev) for part, adev in curve.parts.items()},
        'upper': {term: with_all_tau(adev) for term, adev in curve.limits.items()},
        'read': {term: rounded(point) for term, point in curve.marks.items()},
        'unresolved': [
            t for t, c in axis.fit.noise.items() if t in curve.parts and c.status != 'estimated'
        ],
    }


def _references(
    axes: Mapping[str, AxisResult], results: Results, tau: Sequence[float]
) -> Iterator[dict[str, Any]]:
    sheet_values = results.datasheet.values() if results.datasheet else {}
    for name, axis in axes.items():
        if results.datasheet and sheet_values.get(name) and tau:
            avar = Model.of(**sheet_values[name]).avar(tau, axis.tau0)
            yield {'name': results.datasheet.name, 'axis': name, 'adev': rounded(np.sqrt(avar))}
    for run, former in results.baselines.items():
        for name in axes:
            curve = former.axes[name].curve if name in former.axes else None
            if curve is None or not np.any(curve.adev > 0.0):
                continue
            has_value = curve.adev > 0.0
            log_curve = np.log(curve.tau[has_value]), np.log(curve.adev[has_value])
            adev = np.exp(np.interp(np.log(tau), *log_curve, np.nan, np.nan))
            yield {'name': run, 'axis': name, 'adev': rounded(adev)}


def _density(axes: Mapping[str, AxisResult], results: Results) -> dict[str, Any] | None:
    """Return the measured and modeled noise densities of the axes in SI/sqrt(Hz), for the chart.

    Returns None if the results have no Allan sums with a spectrum of these axes.
    """
    all_sums = () if results.recorded is None else results.recorded.sums
    spectra = (noise_density(sums) for sums in all_sums if set(axes) & set(sums.axes))
    spectrum = next((found for found in spectra if found is not None), None)
    if spectrum is None:
        return None
    axis_charts = []
    for i, name in enumerate(spectrum.axes):
        if name in axes:
            columns = {
                'density': spectrum.psd[:, i],
                'low': spectrum.low[:, i],
                'high': spectrum.high[:, i],
                'fit': model_density(axes[name], spectrum),
            }
            roots = {k: rounded(np.sqrt(np.where(v > 0, v, np.nan))) for k, v in columns.items()}
            axis_charts.append({'name': name, **roots})
    return {'x': rounded(spectrum.frequency), 'axes': axis_charts, 'lines': _lines(axes)}


def _lines(axes: Mapping[str, AxisResult]) -> list[tuple[float, str]]:
    # rounded frequency -> (frequency in Hz, axis) of each sinusoid and resonance
    groups: dict[str, list[tuple[float, str]]] = {}
    for name, axis in axes.items():
        shapes = (part.process.numbers for part in axis.processes.parts)
        for frequency in (shape['frequency'] for shape in shapes if 'frequency' in shape):
            groups.setdefault(f'{frequency:.2g}', []).append((frequency, name[-1]))
    return sorted(
        (float(f'{np.mean([f for f, _ in group]):.3g}'), ' '.join(sorted({a for _, a in group})))
        for group in groups.values()
    )


def _signal(axes: Mapping[str, AxisResult], summary: SignalSummary) -> list[dict[str, Any]]:
    axis_charts = []
    for name in axes:
        i = AXES.index(name)
        middle, reach = rounded([summary.middle[i], summary.reach[i]])
        low, high = (rounded(v[:, i] - summary.middle[i], 3) for v in (summary.low, summary.high))
        axis_charts.append(
            {'name': name, 'middle': middle, 'reach': reach, 'low': low, 'high': high}
        )
    return axis_charts


def times(summary: SignalSummary | None) -> dict[str, Any] | None:
    """Return the times of the raw signal and the times to be marked; None without a signal.

    The keys of the result are ``time`` (times of the signal in s), ``starts`` (start of each
    recording after the first, in s) and ``bands``. A band is a marked time: (start in s, end in s,
    kind). The kind is 'gap', the text in `Excluded.why`, or 'other' if this text is empty.
    """
    if summary is None:
        return None
    bands = [[*rounded([each.start, each.end]), each.why or 'other'] for each in summary.excluded]
    bands += [[*rounded(gap), 'gap'] for gap in summary.gaps]
    return {'time': rounded(summary.time_s), 'bands': bands, 'starts': rounded(summary.starts[1:])}


def temperature_chart(summary: SignalSummary | None) -> dict[str, Any] | None:
    """Return the source, the times in s and the temperatures in degC of the recorded temperature.

    Returns None if no temperature was recorded.
    """
    if summary is None or summary.temperature is None:
        return None
    temperature = summary.temperature
    time, celsius = (rounded(values) for values in (temperature.time_s, temperature.celsius))
    return {'source': temperature.source, 'time': time, 'celsius': celsius}


def motion_chart(results: Results) -> dict[str, Any] | None:
    """Return error / predicted error for each drive; None if the error in motion was not measured.

    The durations of the drives are in s, and the angles by which the robot turned are in deg.
    """
    if results.motion is None:
        return None
    drives = results.motion.drives
    columns = {
        'duration': [drive.duration for drive in drives],
        'turned': [math.degrees(drive.turned) for drive in drives],
        'rotation': [drive.rotation for drive in drives],
        'velocity': [drive.velocity for drive in drives],
    }
    return {'drives': {name: rounded(values, 4) for name, values in columns.items()}}


def model_density(axis: AxisResult, spectrum: Spectrum) -> Floats:
    """Return the one-sided power spectral density of the model, (frequencies,), in SI unit^2/Hz.

    The density is the expectation of the measured ``spectrum`` if the model is right. It therefore
    has peaks of the same height at sinusoids, and the same leakage of slow processes, as the
    spectrum. A ramp has no effect, because the tapers remove it. If the samples are low-pass
    filtered, the density is NaN above the pass band.
    """
    tau0, power = axis.tau0, np.zeros(len(spectrum.frequency))
    for process, value, *_ in axis.fit.model.parts:
        if not process.is_regressor:
            unit = expected_power(process.in_unit(tau0), spectrum.octaves)[spectrum.bin]
            power += process.variance_of(value, tau0) * unit
    density = 2.0 * tau0 * spectrum.step * power
    # the pass band: frequencies up to 4 / (shortest averaging time of the model)
    highest_frequency = 4.0 / (axis.fit.m_min * tau0) if axis.fit.m_min > 1 else math.inf
    return np.where(spectrum.frequency <= highest_frequency, density, np.nan)


class Trend(NamedTuple):
    """Values of all axes, in SI, over time (s) or over temperature (degC)."""

    x: Floats  # time in s, or temperature in degC, (points,)
    values: Floats  # SI, (points, axes)
    tau: float  # averaging time of the values in s


def trends(results: Results, sensor: str, summary: SignalSummary | None) -> list[dict[str, Any]]:
    """Return the charts of bias and noise over time, and of the bias over temperature.

    The charts are computed from the ``summary`` of the raw signal. The list is empty without a
    summary or an axis of the sensor, and if the bias is known at fewer than `LEAST_TREND_POINTS`
    times. The chart of the bias over temperature is missing if the temperature is unknown or nearly
    constant, or is known at too few of these times. Times are in s, temperatures in degC, and other
    values in SI.
    """
    names = [name for name in AXES[SENSORS[sensor]] if name in results.axes]
    if summary is None or not names:
        return []
    columns = [AXES.index(name) for name in names]
    bias = _over_time(summary, summary.mean[:, columns])
    noise = _over_time(summary, summary.noise[:, columns] ** 2)
    if np.isfinite(bias.values).any(axis=1).sum() < LEAST_TREND_POINTS:
        return []
    bias = bias._replace(values=bias.values - np.nanmean(bias.values, axis=0))
    terms = [results.axes[name].fit.noise['N'] for name in names]
    densities = [n.value if n.status == 'estimated' and n.value else math.nan for n in terms]
    white_limits = rounded([1.96 * density / math.sqrt(bias.tau) for density in densities])
    charts = [{**_document('bias', bias, names), 'white': white_limits}]
    over_temperature = _against_temperature(bias, summary)
    if over_temperature is not None:
        charts.append(
            {
                **_document('temperature', over_temperature, names),
                **_fitted(over_temperature, results.temperature_models.get(sensor, {}), names),
            }
        )
    return [*charts, _document('noise', noise._replace(values=np.sqrt(noise.values)), names)]


def _over_time(summary: SignalSummary, values: Floats) -> Trend:
    """Return the means of ``values``, (bins, axes), over intervals of equal length.

    The last interval of a recording may be shorter. A mean is NaN if its interval has too few used
    bins with a value: at most half of the number of bins in a full interval. A NaN separates two
    recordings.
    """
    step = -(-len(summary.time_s) // MEANS)
    time_steps = np.diff(summary.time_s)
    bin_s = float(np.median(time_steps[time_steps > 0.0])) if (time_steps > 0.0).any() else math.nan
    first_bins = np.searchsorted(summary.time_s, summary.starts).tolist()
    x, rows = [], []
    for begin, end in zip(first_bins, [*first_bins[1:], len(values)]):
        for first_bin in range(begin, end, step):
            part = slice(first_bin, min(first_bin + step, end))
            used_values = values[part][summary.used[part]]
            is_known = np.isfinite(used_values)
            counts = np.where(2 * is_known.sum(axis=0) > step, is_known.sum(axis=0), np.nan)
            x.append(float(summary.time_s[part].mean()) + 0.5 * bin_s)
            rows.append(np.where(is_known, used_values, 0.0).sum(axis=0) / counts)
        x.append(x[-1])
        rows.append(np.full(values.shape[1], np.nan))
    return Trend(np.array(x[:-1]), np.array(rows[:-1]), step * bin_s)


def _against_temperature(bias: Trend, summary: SignalSummary | None) -> Trend | None:
    """Return the bias over temperature, sorted by temperature.

    Returns None if the temperature is unknown or varies by at most 0.5 K, or if there are fewer
    than `LEAST_TREND_POINTS` points.
    """
    if summary is None or summary.temperature is None:
        return None
    trace = summary.temperature
    has_reading = np.isfinite(trace.celsius)
    times_s, readings = trace.time_s[has_reading], trace.celsius[has_reading]
    celsius = np.interp(bias.x, times_s, readings, np.nan, np.nan)
    is_known = np.isfinite(celsius) & np.isfinite(bias.values).all(axis=1)
    if is_known.sum() < LEAST_TREND_POINTS or np.ptp(celsius[is_known]) <= 0.5:  # range in K
        return None
    order = np.argsort(celsius[is_known], kind='stable')
    return Trend(celsius[is_known][order], bias.values[is_known][order], bias.tau)


def _fitted(
    trend: Trend, models: Mapping[str, TemperatureModel], names: Sequence[str]
) -> dict[str, Any]:
    """Return the models of the bias over temperature as curves and as text.

    Each curve is shifted to the mean of the points of its axis. Unless each of the axes ``names``
    has a model, there are no curves, and the text is ''.
    """
    if set(models) != set(names):
        return {'fits': [], 'text': dict.fromkeys(UNIT_SYSTEMS, '')}
    curves = [models[name].bias(trend.x) for name in names]
    means = trend.values.mean(axis=0)
    return {
        'fits': [rounded(curve - curve.mean() + mean) for curve, mean in zip(curves, means)],
        'text': {u: pretty_unit(temperature_text(models, u)) for u in UNIT_SYSTEMS},
    }


def _document(kind: str, trend: Trend, names: Sequence[str]) -> dict[str, Any]:
    lines = [{'name': n, 'values': rounded(v)} for n, v in zip(names, trend.values.T)]
    return {'kind': kind, 'x': rounded(trend.x), 'lines': lines, 'span': trend.tau}
