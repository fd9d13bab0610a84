# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The HTML report of an analysis in one file: verdict, findings, interactive charts and tables.

The Content-Security-Policy of the page forbids network requests. It permits only scripts with the
listed hashes, so that a text in a recording cannot run as a script. It also permits images that the
page itself contains, with which a chart is saved as PNG.
"""

from __future__ import annotations

import base64
import hashlib
import platform
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy
import scipy

from ...core.estimate import duration_text, significant
from ...core.findings import Finding
from ...core.imu import AXES, SENSORS
from ...core.settings import UNIT_SYSTEMS
from ...core.stream.signal import SignalSummary
from ...results.axis_result import AxisResult
from ...version import __version__
from ..finding_text import texts_of
from ..format import SENSOR_NAMES, pretty_unit
from ..table import in_units
from ..verdict_text import (
    VERDICT_WORDS,
    Verdict,
    datasheet_title,
    findings_and_notes,
    further_steps,
    used_samples,
    verdict_of,
    where,
)
from .chart_data import motion_chart, sensor_charts, temperature_chart, times, to_script
from .sensor_tables import (
    baseline_html,
    datasheet_html,
    facts_html,
    filter_html,
    growth_html,
    headline_html,
    model_html,
)

if TYPE_CHECKING:
    from ...results.results import Results

SCRIPTS = ('chart.js', 'charts.js', 'page.js')
"""Names of the JavaScript files in the page, in the order in which they run."""

ICONS = {
    'healthy': '<path d="M7 12.5l3.5 3.5L17 9"/>',
    'attention': '<path d="M12 6.5v7M12 17v.5"/>',
    'measured': '<path d="M7 12.5l3.5 3.5L17 9"/>',
    'unknown': '<path d="M9 9.5a3 3 0 1 1 4.2 2.8c-.8.4-1.2.9-1.2 1.7v.4M12 17.3v.4"/>',
    'failed': '<path d="M8 8l8 8M16 8l-8 8"/>',
}
"""Level of the verdict -> SVG path of the symbol that is shown with it."""


def render_report(
    results: Results,
    units: str,
    signal: SignalSummary | None = None,
    method: Mapping[str, str] = {},
    files: Sequence[str] = (),
) -> str:
    """Return the HTML of the report.

    Parameters
    ----------
    results : Results
        The results of the analysis.
    units : 'deg/h' or 'SI'
        Units that are shown at first; a switch in the page changes the units.
    signal : SignalSummary or None
        Without this summary, the charts of the raw signal and of values over time are omitted.
    method : mapping of str to str
        Further rows for the table "How to repeat the analysis".
    files : sequence of str
        Names of files in the same folder, which are linked.
    """
    name = results.identity.label or 'IMU'
    sensors = {
        sensor: axes
        for sensor, rows in SENSORS.items()
        if (axes := {a: results.axes[a] for a in AXES[rows] if a in results.axes})
    }
    charts = [sensor_charts(results, s, signal) for s in sensors]
    data = {
        'units': units,
        'times': times(signal),
        'temperature': temperature_chart(signal),
        'motion': motion_chart(results),
        'sensors': charts,
    }
    verdict = verdict_of(results, units)
    body = [
        *_header(results, name, units),
        '<main>',
        _verdict_section(results, verdict),
        '<div class="pair">',
        *(_sensor_section(sensor, axes) for sensor, axes in sensors.items()),
        '</div>',
        '<noscript><p class="note">The charts of this page need JavaScript.</p></noscript>',
        '<div class="pair">',
        f'<section id="filter"><h2>Numbers for a filter: imu.yaml</h2>{filter_html(results)}'
        '</section>',
        *_next_steps(results, verdict),
        '</div>',
        '<div class="pair">',
        *(_curve_section(sensor) for sensor in sensors),
        '</div>',
        *_comparisons(results, sensors),
        *_findings_section(results),
    ]
    body += _fold('motion', 'Error in motion', [*_motion(results)], shown=True)
    temperature_element = (
        '<div class="charts" data-kind="temperature"></div>' if data['temperature'] else ''
    )
    body += _fold(
        'trends',
        'Bias and noise over time',
        [*_chart_elements(charts, 'trends'), temperature_element],
    )
    body += _fold('density', 'Noise density', _chart_elements(charts, 'density'))
    body += _fold('signal', 'Raw signal', _chart_elements(charts, 'signal'))
    for id, title, content in (
        ('model', 'Other terms and parts of the model', model_html),
        ('growth', 'Predicted error without correction', growth_html),
    ):
        parts = [[*content(axes)] for axes in sensors.values()]
        if id != 'model' or not results.is_too_short:
            body += _fold(id, title, _pair(sensors, parts))
    links = ' '.join(f'<a href="{escape(f)}">{escape(f)}</a>' for f in files)
    files_line = f'<p class="files">Files in the same folder: {links}</p>' if links else ''
    method = {**method, 'fit': f'method {results.method}'}
    body += _fold('recording', 'Recording and method', [files_line, *_method(results, method)])
    body.append(f'</main><footer>allan_ros {__version__}</footer>')
    return _page(f'Noise of {name}', '\n'.join(body), to_script(data))


def _fold(id: str, title: str, content: Sequence[str], shown: bool = False) -> Iterator[str]:
    """Yield the HTML of a section that can be opened and closed; nothing if it would be empty."""
    if any(content):
        yield f'<details id="{id}"{" open" if shown else ""}><summary><h2>{title}</h2></summary>'
        yield from content
        yield '</details>'


def _chart_elements(charts: Sequence[Mapping[str, Any]], kind: str) -> list[str]:
    """Return the empty HTML elements into which a script draws the charts of one kind."""
    html = '<div class="charts" data-kind="{}" data-sensor="{}"></div>'
    names = [chart['sensor'] for chart in charts if chart[kind]]
    return _pair(names, [[html.format(kind, name)] for name in names])


def _pair(sensors: Iterable[str], parts: Iterable[Sequence[str]]) -> list[str]:
    """Return HTML with a column for each sensor; sensors without any HTML are omitted.

    ``parts`` contains, for each sensor, the pieces of its HTML. If all are empty, the result is an
    empty list.
    """
    content = [
        f'<div><h3>{SENSOR_NAMES[sensor]}</h3>{"".join(part)}</div>'
        for sensor, part in zip(sensors, parts)
        if part
    ]
    return ['<div class="pair">', *content, '</div>'] if content else []


def _page(title: str, body: str, data: str) -> str:
    package_files = resources.files(__package__)
    scripts = [package_files.joinpath(name).read_text('utf-8') for name in SCRIPTS]
    style = package_files.joinpath('report.css').read_text('utf-8')
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    hashes = ' '.join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; "
        f"style-src 'unsafe-inline'; img-src data:; script-src {hashes}"
    )
    script_elements = ''.join(f'<script>{script}</script>\n' for script in scripts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f'<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}\n'
        f'<script type="application/json" id="data">{data}</script>\n{script_elements}'
        '</body>\n</html>\n'
    )


def _header(results: Results, name: str, units: str) -> Iterator[str]:
    start = results.provenance.start
    inputs = [*dict.fromkeys(Path(source.path).name for source in results.provenance.sources)]
    more_inputs = f' and {len(inputs) - 1} more' if len(inputs) > 1 else ''
    facts = [
        inputs[0] + more_inputs if inputs else '',
        f'{used_samples(results)} at {significant(results.rate_hz, 4)} Hz',
        f'{duration_text(results.duration_s, 3)} at rest in {_segments(results)}',
        f'{start:%Y-%m-%d %H:%M} UTC' if start else '',
    ]
    unit_switch = ''.join(
        f'<label><input type="radio" name="units" value="{system}"'
        f'{" checked" if system == units else ""}>{system}</label>'
        for system in UNIT_SYSTEMS
    )
    yield (
        f'<header><h1>Noise of {escape(name)}</h1>'
        f'<ul class="plain">{_items(filter(None, facts))}</ul>'
        f'<fieldset class="switch"><legend>Units</legend>{unit_switch}</fieldset></header>'
    )


def _items(texts: Iterable[str]) -> str:
    # options such as --to are not broken at the end of a line
    unbroken_options = partial(
        re.compile(r'--[a-z][a-z-]*').sub, r'<span class="nowrap">\g<0></span>'
    )
    return ''.join(f'<li>{unbroken_options(escape(text))}</li>' for text in texts)


def _verdict_section(results: Results, verdict: Verdict) -> str:
    summary = in_units(lambda system: escape(verdict_of(results, system).summary))
    findings = findings_and_notes(results)
    counts = [
        f'{n} {word}{"" if n == 1 else "s"}'
        for n, word in zip(map(len, findings), ('finding', 'note'))
        if n
    ]
    link = f'<a href="#findings">{" and ".join(counts)}</a>' if counts else ''
    return (
        f'<section id="verdict" class="{verdict.level}">'
        f'<svg viewBox="0 0 24 24" aria-hidden="true">'
        f'<circle cx="12" cy="12" r="11"/>{ICONS[verdict.level]}</svg>'
        f'<strong>{VERDICT_WORDS[verdict.level]}</strong><span>{summary}</span>{link}'
        '</section>'
    )


def _next_steps(results: Results, verdict: Verdict) -> Iterator[str]:
    if steps := further_steps(results, verdict):
        yield f'<section id="next"><h2>What to do next</h2><ol>{_items(steps)}</ol></section>'


def _comparisons(
    results: Results, sensors: Mapping[str, Mapping[str, AxisResult]]
) -> Iterator[str]:
    if results.datasheet:
        checks = results.datasheet_checks
        parts = [[*datasheet_html(axes, results.datasheet, checks)] for axes in sensors.values()]
        title = f'Compared with {escape(datasheet_title(results))}'
        yield from _fold('datasheet', title, _pair(sensors, parts), shown=True)
    for i, (reference, baseline) in enumerate(results.baselines.items()):
        baseline_checks = [c for c in results.comparisons if c.reference == reference]
        parts = [[*baseline_html(axes, baseline, baseline_checks)] for axes in sensors.values()]
        yield from _fold(
            f'baseline-{i}', f'Compared with {escape(reference)}', _pair(sensors, parts), True
        )


def _method(results: Results, method: Mapping[str, str]) -> Iterator[str]:
    provenance, counts = results.provenance, results.provenance.counts
    inputs: dict[str, str] = {}
    for s in provenance.sources:
        text = ', '.join(filter(None, (s.topic, s.type, s.storage)))
        inputs[s.path] = '; '.join(filter(None, (inputs.get(s.path), text)))
    samples = {
        'used': f'{results.samples:,} samples at {significant(results.rate_hz, 5)} Hz, '
        f'{duration_text(results.duration_s, 3)} in {_segments(results)}',
        **{
            name.replace('_', ' '): f'{number:,}'
            for name, number in vars(counts).items()
            if isinstance(number, int) and number and name != 'used'
        },
        'gaps': ', '.join(f'{n} × {reason}' for reason, n in counts.splits.items()) or 'none',
    }
    versions = {
        'versions': f'allan_ros {__version__}, Python {platform.python_version()}, '
        f'numpy {numpy.__version__}, scipy {scipy.__version__}',
        'machine': f'{platform.system()} {platform.machine()}',
    }
    yield f'<h3>Inputs</h3>{facts_html(inputs)}<h3>Samples</h3>{facts_html(samples)}'
    yield f'<h3>How to repeat the analysis</h3>{facts_html({**method, **versions})}'
    if provenance.settings:
        rows = {key: _setting_text(value) for key, value in provenance.settings.items()}
        yield f'<details><summary>All settings ({len(rows)})</summary>{facts_html(rows)}</details>'


def _segments(results: Results) -> str:
    return f'{results.segments} segment{"" if results.segments == 1 else "s"}'


def _setting_text(value: object) -> str:
    if isinstance(value, (list, tuple)):
        value = ', '.join(map(str, value))
    return f'{value:g}' if isinstance(value, float) else str(value) if value != '' else '–'


def _motion(results: Results) -> Iterator[str]:
    if results.motion is not None:
        yield '<div class="charts pair" data-kind="motion"></div>'
        yield (
            '<p class="note">Each point is one drive between two rests. The dashed line at 1 is '
            'the error predicted from the noise at rest and from the rotation of the Earth, whose '
            'direction is unknown. If the noise itself is larger in motion, all drives have large '
            'ratios. Scale factors and misalignments enlarge the ratios of drives with much '
            'rotation.</p>'
        )


def _findings_section(results: Results) -> Iterator[str]:
    findings, notes = findings_and_notes(results)
    if findings or notes:
        yield '<section id="findings"><h2>Findings</h2>'
        yield from (_block(finding, results) for finding in findings)
        if notes:
            yield f'<details><summary>{len(notes)} note{"" if len(notes) == 1 else "s"}</summary>'
            yield from (_block(note, results) for note in notes)
            yield '</details>'
        yield '</section>'


def _block(finding: Finding, results: Results) -> str:
    message = in_units(lambda units: escape(texts_of(finding, units, pretty_unit).message))
    remedy = in_units(lambda units: escape(texts_of(finding, units, pretty_unit).remedy))
    return (
        f'<div class="finding {finding.severity}">'
        f'<span class="severity">{finding.severity}</span>'
        f'<div><p><b>{escape(where(finding, results))}</b>{message}</p>'
        f'<p class="remedy">{remedy}</p></div></div>'
    )


def _sensor_section(sensor: str, axes: Mapping[str, AxisResult]) -> str:
    return (
        f'<section id="{sensor}" class="sensor"><h2>{SENSOR_NAMES[sensor]}</h2>'
        f'{headline_html(axes)}</section>'
    )


def _curve_section(sensor: str) -> str:
    return (
        f'<section id="{sensor}-curve" class="sensor"><h3>{SENSOR_NAMES[sensor]}</h3>'
        f'<div class="charts" data-kind="allan" data-sensor="{sensor}"></div></section>'
    )
