# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data of the charts as plain values in SI, with the factors of the selectable units."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from ...core.allan.spectrum import Spectrum
from ...core.fit import TERMS, Coefficient
from ...core.imu import AXES, SENSORS
from ...core.noise import NoiseTerms, term_avar
from ..axis_result import AxisResult
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
from ..results import Results
from ..signal_summary import SignalSummary
from .courses import courses, rounded

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
        'tau': rounded(tau),
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
        return rounded(spread)

    positive = curve.adev[curve.adev > 0.0]
    floor = BELOW_CURVE * float(positive.min()) if len(positive) else math.inf
    line, upper = axis.model_line()

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
        'fit': column(line),
        'most': column(upper),
        'parts': {name: above_floor(adev) for name, adev in parts.items()},
        'upper': {name: above_floor(adev) for name, adev in axis.limit_adev(curve.m).items()},
        'read': {
            term: rounded([tau, float(np.sqrt(model.parts([tau])[term][0]))])
            for term, tau in READ_AT.items()
            if term in parts
        },
        'regions': [[*rounded([r.tau_low, r.tau_high]), r.term, r.slope] for r in axis.regions],
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
            yield {'name': comparison.datasheet.name, 'axis': name, 'adev': rounded(adev)}


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
            yield {'name': run, 'axis': name, 'adev': rounded(np.exp(logs))}


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
            density, low, high, fit = (rounded(np.where(a > 0, a, np.nan)) for a in (*roots, model))
            shown.append({'name': name, 'density': density, 'low': low, 'high': high, 'fit': fit})
        return {'frequency': rounded(spectrum.frequency), 'axes': shown}
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
                'middle': rounded([middle])[0],
                'reach': rounded([summary.reach[i]])[0],
                'low': _short(low),
                'high': _short(high),
            }
        )
    return {
        'time': rounded(summary.time_s),
        'axes': shown,
        'leftOut': [[*rounded([out.start, out.end]), out.why] for out in summary.left_out],
        'gaps': [rounded(span) for span in summary.gaps],
        'starts': rounded(summary.starts),
    }


def temperature_chart(summary: SignalSummary | None) -> dict[str, Any] | None:
    """Return the temperature over the time of the signals, or None where none was recorded."""
    if summary is None or summary.temperature is None:
        return None
    temperature = summary.temperature
    time, celsius = (rounded(values) for values in (temperature.time_s, temperature.celsius))
    return {'source': temperature.source, 'time': time, 'celsius': celsius}


def _short(values: ArrayLike) -> list[float | None]:
    """Return numbers to three digits, None for what is not finite."""
    return [
        float(f'{v:.3g}') if math.isfinite(v) else None for v in np.asarray(values, float).tolist()
    ]
