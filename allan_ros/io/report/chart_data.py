# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data of the charts as plain values in SI, with the factors of the selectable units."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from ...core.allan.spectrum import Spectrum
from ...core.fit import TERMS, Coefficient
from ...core.imu import AXES, SENSORS
from ...core.noise import NoiseTerms, term_avar
from ..datasheets import DatasheetComparison
from ..format import (
    READ_AT,
    SENSOR_NAMES,
    ShownUnit,
    interval_text,
    pretty_unit,
    shown_density_unit,
    shown_signal_unit,
    shown_unit,
    value_text,
)
from ..plot_style import BELOW_CURVE
from ..results import AxisResult, Results
from ..signal_summary import SignalSummary

TERM_NAMES = {
    'gyro': {
        'Q': 'quantization',
        'N': 'angle random walk',
        'B': 'bias instability',
        'K': 'rate random walk',
        'R': 'rate ramp',
    },
    'accel': {
        'Q': 'quantization',
        'N': 'velocity random walk',
        'B': 'bias instability',
        'K': 'acceleration random walk',
        'R': 'acceleration ramp',
    },
}
"""sensor -> term -> its name in IEEE Std 952 and 1293."""


def in_units(html_of: Callable[[str], str]) -> str:
    """Return the HTML of both systems of units, of which the page shows the chosen one."""
    return ''.join(f'<span data-units="{units}">{html_of(units)}</span>' for units in SYSTEMS)


def cell(text: str, what: str = '') -> str:
    """Return a table cell of escaped text."""
    return f'<td{f" class={what!r}" if what else ""}>{escape(text)}</td>'


Floats = NDArray[np.float64]


def model_density(axis: AxisResult, frequency: Floats) -> Floats:
    """Return the one-sided power spectral density of the selected model, SI unit^2/Hz.

    Twice the two-sided densities of IEEE Std 952-1997 C.1.1 to C.1.4 and 952-2020 annex C for
    samples of period tau0, w = 2 pi f: Q 4 Q^2/tau0 sin^2(w tau0/2), N^2, B^2/w,
    K^2 tau0^2/(4 sin^2(w tau0/2)), and 2 sigma^2 T/(1 + (w T)^2) of a Gauss-Markov process. The
    ramp has none (the mean of a block is subtracted), and a sinusoid is a line without width.

    Parameters
    ----------
    axis : AxisResult
    frequency : (frequencies,) array
        In Hz, above 0.

    Returns
    -------
    (frequencies,) array
    """
    terms = axis.fit.selected.terms
    omega = 2.0 * np.pi * frequency
    step = 2.0 * np.sin(omega * axis.tau0 / 2.0)
    density: Floats = (
        (terms.Q * step) ** 2 / axis.tau0
        + terms.N**2
        + terms.B**2 / omega
        + (terms.K * axis.tau0 / step) ** 2
    )
    for sigma, time in axis.fit.selected.gauss_markov:
        density = density + 2.0 * sigma**2 * time / (1.0 + (omega * time) ** 2)
    return 2.0 * density


COLUMNS = ('axis', 'term', 'value', 'low95', 'high95', 'upper95', 'unit')
"""Of the table for spreadsheets."""


CHART_DIGITS = 5
"""Significant digits of a point of a chart: a tenth of a pixel on any screen."""

DIGITS = 6
"""Significant digits of a copied number: more than any interval is known to."""


def copies(results: Results, axes: Sequence[str], units: str) -> dict[str, str]:
    """Return the coefficients of some axes as tab-separated values, Markdown and YAML.

    Units are in ASCII here, so that they survive wherever the text is pasted.
    """
    return {
        'TSV': _tsv(results, axes, units),
        'Markdown': _markdown(results, axes, units),
        'YAML': _yaml(results, axes, units),
    }


def _tsv(results: Results, axes: Sequence[str], units: str) -> str:
    lines = ['\t'.join(COLUMNS)]
    for axis in axes:
        for term in TERMS:
            unit = shown_unit(axis, term, units)
            numbers = _numbers(results.axes[axis].fit.noise[term], unit)
            shown = ('' if number is None else f'{number:g}' for number in numbers)
            lines.append('\t'.join([axis, term, *shown, unit.name]))
    return '\n'.join(lines) + '\n'


def _markdown(results: Results, axes: Sequence[str], units: str) -> str:
    rows = [['term', 'unit', *axes], ['---'] * (len(axes) + 2)]
    for term in TERMS:
        cells = []
        for axis in axes:
            coefficient, unit = results.axes[axis].fit.noise[term], shown_unit(axis, term, units)
            interval = interval_text(coefficient, unit)
            cells.append(value_text(coefficient, unit) + (f' ({interval})' if interval else ''))
        rows.append([term, shown_unit(axes[0], term, units).name, *cells])
    return '\n'.join(f'| {" | ".join(row)} |' for row in rows) + '\n'


def _yaml(results: Results, axes: Sequence[str], units: str) -> str:
    tree: dict[str, dict[str, dict[str, object]]] = {}
    for axis in axes:
        tree[axis] = {}
        for term in TERMS:
            unit = shown_unit(axis, term, units)
            value, low, high, upper = _numbers(results.axes[axis].fit.noise[term], unit)
            known: dict[str, object] = {'unit': unit.name}
            if value is not None:
                known['value'] = value
            if low is not None:
                known['ci95'] = [low, high]
            if upper is not None:
                known['upper95'] = upper
            tree[axis][term] = known
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    return text


def _numbers(c: Coefficient, unit: ShownUnit) -> tuple[float | None, ...]:
    """Return value, interval and limit in a unit; what is not known is None.

    Of a term that is not observable only the limit is given: its estimate means nothing.
    """
    seen = c.status == 'estimated'
    low, high = c.ci95 if seen and c.ci95 is not None else (None, None)
    sign = -1.0 if c.sign < 0 else 1.0
    value = c.value * sign if seen and c.value is not None else None
    numbers = (value, low, high, None if seen else c.upper95)
    return tuple(None if n is None else float(f'{n * unit.factor:.{DIGITS}g}') for n in numbers)


MEANS, PERIODS = 129, 65
"""Means and noise levels of a recording are fewer than this in a chart."""

LONGEST_NOISE_S = 1.0
"""The noise over time is shown at the longest averaging time below this."""

LEAST_COUNT, LEAST_POINTS = 4, 4
"""Fewest differences of a level, and fewest points of a chart."""

LEAST_RANGE_C = 0.5
"""A bias is shown against a temperature that changes by more."""

SYSTEMS = ('datasheet', 'si')
"""The systems of units that the page offers."""


def sensor_charts(
    results: Results,
    sensor: str,
    spectra: Sequence[Spectrum],
    summary: SignalSummary | None,
) -> dict[str, Any]:
    """Return the chart data of one sensor.

    Parameters
    ----------
    results : Results
    sensor : 'gyro' or 'accel'
    spectra : sequence of Spectrum
    summary : SignalSummary or None
    """
    axes = {name: results.axes[name] for name in AXES[SENSORS[sensor]] if name in results.axes}
    tau = sorted({float(t) for a in axes.values() if a.curve is not None for t in a.curve.tau})
    return {
        'sensor': sensor,
        'title': f'{SENSOR_NAMES[sensor]} of {results.identity.label or "IMU"}',
        'units': {units: _units(sensor, units) for units in SYSTEMS},
        'tau': _rounded(tau),
        'axes': [_axis(name, axis, tau) for name, axis in axes.items()],
        'references': [
            *_datasheet_curves(axes, results.datasheet, tau),
            *_former_curves(axes, results.baselines, tau),
        ],
        'spectrum': _spectrum(axes, spectra),
        'signal': None if summary is None else _signal(axes, summary),
        'courses': courses(results, sensor, summary),
        'copy': {units: copies(results, list(axes), units) for units in SYSTEMS},
    }


def to_script(data: object) -> str:
    """Return plain values as JSON that may stand inside a ``<script>`` element.

    ``<`` would let a frame_id end the element, and the two line separators end a line in older
    JavaScript; inside JSON strings, the only place where they can be, all have an escape.
    """
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(',', ':'))
    for character in '<>&\u2028\u2029':
        text = text.replace(character, f'\\u{ord(character):04x}')
    return text


def _units(sensor: str, units: str) -> dict[str, Any]:
    of = {
        'curve': shown_unit(sensor, 'B', units),
        'signal': shown_signal_unit(sensor, units),
        'density': shown_density_unit(sensor, units),
        **{term: shown_unit(sensor, term, units) for term in TERMS},
    }
    return {what: _unit(unit) for what, unit in of.items()}


def _unit(unit: ShownUnit) -> list[Any]:
    return [pretty_unit(unit.name), unit.factor]


def _axis(name: str, axis: AxisResult, tau: Sequence[float]) -> dict[str, Any]:
    """Return the curve, the fit and its parts of one axis at the averaging times of its sensor."""
    shown: dict[str, Any] = {'name': name, 'label': name.rsplit('_', 1)[1]}
    curve = axis.curve
    if curve is None:
        return shown
    at = np.searchsorted(tau, curve.tau)

    def column(values: ArrayLike) -> list[float | None]:
        spread = np.full(len(tau), np.nan)
        spread[at] = values
        return _rounded(spread)

    positive = curve.adev[curve.adev > 0.0]
    floor = BELOW_CURVE * float(positive.min()) if len(positive) else math.inf
    fitted = curve.m >= axis.fit.m_min

    def above_floor(adev: Floats) -> list[float | None]:
        return column(np.where(adev > floor, adev, np.nan))

    parts = axis.part_adev(curve.m)
    model = axis.fit.selected
    return {
        **shown,
        'adev': column(np.where(curve.adev > 0.0, curve.adev, np.nan)),
        'low': column(np.where(curve.ci_low > 0.0, curve.ci_low, np.nan)),
        'high': column(np.where(curve.ci_high > 0.0, curve.ci_high, np.nan)),
        'n': column(curve.n),
        'fit': column(np.where(fitted & bool(parts), axis.total_adev(curve.m), np.nan)),
        'parts': {name: above_floor(adev) for name, adev in parts.items()},
        'upper': {name: above_floor(adev) for name, adev in axis.limit_adev(curve.m).items()},
        'read': {
            term: _rounded([tau, float(np.sqrt(model.parts([tau])[term][0]))])
            for term, tau in READ_AT.items()
            if term in parts
        },
        'regions': [[*_rounded([r.tau_low, r.tau_high]), r.term, r.slope] for r in axis.regions],
    }


def _datasheet_curves(
    axes: Mapping[str, AxisResult], comparison: DatasheetComparison | None, tau: Sequence[float]
) -> Iterable[dict[str, Any]]:
    """Yield the curve that the stated terms of a datasheet make."""
    stated = comparison.datasheet.values() if comparison else {}
    for name, axis in axes.items():
        limits = stated.get(name, {})
        if comparison and limits and tau:
            factors = np.asarray(tau) / axis.tau0
            adev = np.sqrt(term_avar(factors, axis.tau0, NoiseTerms(**limits)).sum(axis=1))
            yield {'name': comparison.datasheet.name, 'axis': name, 'adev': _rounded(adev)}


def _former_curves(
    axes: Mapping[str, AxisResult], former: Mapping[str, Results], tau: Sequence[float]
) -> Iterable[dict[str, Any]]:
    """Yield the curve of each earlier run, read off at the averaging times of this one."""
    for run, results in former.items():
        for name in axes:
            curve = results.axes[name].curve if name in results.axes else None
            if curve is None or not np.any(curve.adev > 0.0):
                continue
            some = curve.adev > 0.0
            logs = np.interp(
                np.log(tau), np.log(curve.tau[some]), np.log(curve.adev[some]), np.nan, np.nan
            )
            yield {'name': run, 'axis': name, 'adev': _rounded(np.exp(logs))}


def _spectrum(axes: Mapping[str, AxisResult], spectra: Sequence[Spectrum]) -> dict[str, Any] | None:
    """Return the root of the density of each axis, and that of its fit."""
    for spectrum in spectra:
        columns = [name for name in axes if name in spectrum.axes]
        if not columns:
            continue
        shown = []
        for name in columns:
            i = spectrum.axes.index(name)
            roots = (np.sqrt(a[:, i]) for a in (spectrum.psd, spectrum.low, spectrum.high))
            model = np.sqrt(model_density(axes[name], spectrum.frequency))
            density, low, high, fit = (
                _rounded(np.where(a > 0, a, np.nan)) for a in (*roots, model)
            )
            shown.append({'name': name, 'density': density, 'low': low, 'high': high, 'fit': fit})
        return {'frequency': _rounded(spectrum.frequency), 'axes': shown}
    return None


def _signal(axes: Mapping[str, AxisResult], summary: SignalSummary) -> dict[str, Any]:
    """Return the raw signal of each axis about its middle."""
    shown = []
    for name in axes:
        i = AXES.index(name)
        middle = float(summary.middle[i])
        low, high = summary.low[:, i] - middle, summary.high[:, i] - middle
        shown.append(
            {
                'name': name,
                'middle': _rounded([middle])[0],
                'reach': _rounded([summary.reach[i]])[0],
                'low': _short(low),
                'high': _short(high),
            }
        )
    return {
        'time': _rounded(summary.time_s),
        'axes': shown,
        'leftOut': [[*_rounded([out.start, out.end]), out.why] for out in summary.left_out],
        'gaps': [_rounded(span) for span in summary.gaps],
        'starts': _rounded(summary.starts),
    }


def courses(results: Results, sensor: str, summary: SignalSummary | None) -> list[dict[str, Any]]:
    """Return the charts of mean and noise over time, and of the mean against the temperature.

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
    tau0, offset = sums.tau0, 0.0
    means, levels = [], []
    recordings = sorted(sums.history.recordings, key=lambda r: r.start_ns)
    for recording in (r.coarser(MEANS, PERIODS) for r in recordings):
        starts = [] if summary is None else [
            at + (recording.start_ns - first) * 1e-9
            for at, first in zip(summary.starts, summary.first_ns)
            if first <= recording.start_ns
        ]  # fmt: skip
        start = starts[-1] if starts else offset
        offset += recording.length * tau0
        known = recording.cell_samples > recording.step / 2
        values = recording.cell_means[:, columns] + recording.reference[columns]
        middles = (np.arange(len(values)) + 0.5) * recording.step * tau0 + start
        means.append((middles, np.where(known[:, None], values, np.nan), recording.step * tau0))
        level = np.flatnonzero(recording.level_m * tau0 <= LONGEST_NOISE_S)[-1:]
        for m in recording.level_m[level]:
            count = recording.level_count[:, level]
            square = recording.level_sum_sq[:, level[0], columns]
            with np.errstate(divide='ignore', invalid='ignore'):
                adev = np.sqrt(square / (2.0 * count)) / m
            middles = (np.arange(len(adev)) + 0.5) * recording.period * tau0 + start
            levels.append((middles, np.where(count >= LEAST_COUNT, adev, np.nan), m * tau0))
    charts = []
    if sum(len(mean[0]) for mean in means) >= LEAST_POINTS:
        time, values = _with_breaks(means)
        values = values - np.nanmean(values, axis=0)
        span = max(span for *_, span in means)
        noise = [results.axes[name].fit.noise['N'] for name in names]
        white = [n.value if n.status == 'estimated' and n.value else math.nan for n in noise]
        white = [1.96 * density / math.sqrt(span) for density in white]
        charts.append({**_course('bias', time, values, names, span), 'white': _rounded(white)})
        if summary is not None and summary.temperature is not None:
            warm = summary.temperature
            some = np.isfinite(warm.celsius)
            celsius = np.interp(time, warm.time_s[some], warm.celsius[some], np.nan, np.nan)
            both = np.isfinite(celsius) & np.isfinite(values).all(axis=1)
            if both.sum() >= LEAST_POINTS and np.ptp(celsius[both]) > LEAST_RANGE_C:
                order = np.argsort(celsius[both], kind='stable')
                x, y = celsius[both][order], values[both][order]
                chart = _course('temperature', x, y, names, span)
                charts.append({**chart, 'slopes': _rounded(np.polyfit(x, y, 1)[0])})
    levels = [level for level in levels if level[2] == levels[0][2]]
    if sum(len(level[0]) for level in levels) >= LEAST_POINTS:
        charts.append(_course('noise', *_with_breaks(levels), names, levels[0][2]))
    return charts


def _with_breaks(parts: Sequence[tuple[Floats, Floats, float]]) -> tuple[Floats, Floats]:
    """Return times and values of all recordings, with a NaN between two."""
    times, values = [], []
    for time, value, _ in parts:
        times += [time, time[-1:] + 1e-3]
        values += [value, np.full_like(value[:1], np.nan)]
    return np.concatenate(times[:-1]), np.concatenate(values[:-1])


def _course(
    kind: str, x: Floats, values: Floats, names: Sequence[str], span: float
) -> dict[str, Any]:
    lines = [{'name': name, 'values': _rounded(v)} for name, v in zip(names, values.T)]
    return {'kind': kind, 'x': _rounded(x), 'lines': lines, 'span': _rounded([span])[0]}


def temperature_chart(summary: SignalSummary | None) -> dict[str, Any] | None:
    """Return the temperature over the time of the signals, or None where none was recorded."""
    if summary is None or summary.temperature is None:
        return None
    temperature = summary.temperature
    time, celsius = (_rounded(values) for values in (temperature.time_s, temperature.celsius))
    return {'source': temperature.source, 'time': time, 'celsius': celsius}


def _rounded(values: ArrayLike) -> list[float | None]:
    """Return numbers to `CHART_DIGITS` digits, None for what is not finite."""
    return [
        float(f'{v:.{CHART_DIGITS}g}') if math.isfinite(v) else None
        for v in np.asarray(values, float).tolist()
    ]


def _short(values: ArrayLike) -> list[float | None]:
    """Return numbers to three digits, None for what is not finite."""
    return [
        float(f'{v:.3g}') if math.isfinite(v) else None for v in np.asarray(values, float).tolist()
    ]
