# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`report.html`: the verdict first, then curves, tables and findings, in one file of its own.

Nothing is fetched: the page forbids itself any request (Content-Security-Policy), and names each
of its scripts by its hash, so that none but ours can run, whatever a recording says.
"""

from __future__ import annotations

import base64
import datetime
import hashlib
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy
import scipy

from ... import __version__
from ...core.allan.spectrum import Spectrum
from ...core.compare import Comparison, Reference, compare, reference_of_run
from ...core.findings import Finding
from ...core.imu import AXES, SENSORS
from ..format import SENSOR_NAMES, duration_text, significant
from ..results import AxisResult, Results
from ..signal_summary import SignalSummary
from .chart_data import sensor_charts, temperature_chart, to_script
from .tables import coefficient_table, datasheet_table, former_table
from .verdict import Verdict, verdict_of

EARLIEST_S = 978_307_200
"""2001-01-01: a first stamp before it is no date, but the time since a machine was started."""


NS = 10**9


def recorded_on(results: Results) -> str:
    """Return when the evidence begins, in UTC, or '' where the stamps are no dates."""
    spans = results.provenance.spans
    start = min((span.start_ns for span in spans), default=0) // NS
    if start < EARLIEST_S:
        return ''
    when = datetime.datetime.fromtimestamp(start, datetime.timezone.utc)
    return f'{when:%Y-%m-%d %H:%M} UTC'


def background(results: Results, method: Mapping[str, str]) -> Iterator[str]:
    """Yield the section.

    Parameters
    ----------
    results : Results
    method : mapping of str to str
        What else one needs to do it again: the command, the fingerprint of the sums.
    """
    yield '<h3>Inputs</h3>' + _table(dict(_inputs(results)))
    yield '<h3>What became of the samples</h3>' + _table(dict(_fates(results)))
    yield '<h3>To repeat it</h3>' + _table({**method, **_versions()})
    settings = results.provenance.settings
    if settings:
        rows = {key: _value(value) for key, value in settings.items()}
        yield (f'<details><summary>Every setting ({len(rows)})</summary>{_table(rows)}</details>')


def _inputs(results: Results) -> Iterator[tuple[str, str]]:
    for source in results.provenance.sources:
        what = [part for part in (source.topic, source.type, source.storage) if part]
        yield source.path, ', '.join([*what, *_size(Path(source.path))])


def _size(path: Path) -> Iterator[str]:
    """Yield the size of an input, if it is still there."""
    try:
        files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
        stats = [file.stat() for file in files]
    except OSError:
        return
    if stats:
        yield f'{sum(stat.st_size for stat in stats):,} bytes'


def _fates(results: Results) -> Iterator[tuple[str, str]]:
    counts = results.provenance.counts
    yield (
        'evidence',
        f'{results.samples:,} samples at {significant(results.rate_hz, 5)} Hz, '
        f'{duration_text(results.duration_s)} in {results.segments} '
        f'segment{"" if results.segments == 1 else "s"}',
    )
    for name, number in vars(counts).items():
        if isinstance(number, int) and number:
            yield name.replace('_', ' '), f'{number:,}'
    yield 'cuts', ', '.join(f'{n} × {reason}' for reason, n in counts.cuts.items()) or 'none'


def _versions() -> dict[str, str]:
    return {
        'versions': f'allan_ros {__version__}, Python {platform.python_version()}, '
        f'numpy {numpy.__version__}, scipy {scipy.__version__}',
        'machine': f'{platform.system()} {platform.machine()}',
    }


def _value(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return ', '.join(str(v) for v in value) or '–'
    return f'{value:g}' if isinstance(value, float) else str(value) if value != '' else '–'


def _table(rows: Mapping[str, str]) -> str:
    cells = ''.join(
        f'<tr><th scope="row">{escape(key)}</th><td>{escape(value)}</td></tr>'
        for key, value in rows.items()
    )
    return f'<table class="facts"><tbody>{cells}</tbody></table>'


STYLES = ('uplot/uPlot.min.css', 'report.css', 'print.css')

SCRIPTS = (
    'uplot/uPlot.iife.min.js',
    'chart.js',
    'allan_chart.js',
    'other_charts.js',
    'page.js',
)
"""Files beside this one, in the order in which they stand in the page."""


ICONS = {
    'good': '<path d="M7 12.5l3.5 3.5L17 9"/>',
    'caution': '<path d="M12 6.5v7M12 17v.5"/>',
    'bad': '<path d="M8 8l8 8M16 8l-8 8"/>',
}
"""Light -> the sign in its disc: the light is told by sign and word as well as by colour."""


FOLDED = 3
"""More notes than this are folded away under their number."""


@dataclass(frozen=True)
class Beside:
    """What the page shows beside the results.

    Attributes
    ----------
    pictures : mapping of sensor to str
        ``<svg>`` elements: for print, and where there is no script.
    outline : SignalSummary or None
        The raw signal.
    spectra : sequence of Spectrum
    former : mapping of name to Results
        Earlier runs.
    margin : float
        Fraction by which an interval must lie above an earlier run to be beyond it.
    method : mapping of str to str
        What one needs to do it again.
    """

    pictures: Mapping[str, str] = field(default_factory=dict)
    outline: SignalSummary | None = None
    spectra: Sequence[Spectrum] = ()
    former: Mapping[str, Results] = field(default_factory=dict)
    margin: float = 0.0
    method: Mapping[str, str] = field(default_factory=dict)


def render_report(results: Results, beside: Beside, units: str) -> str:
    """Return the page.

    Parameters
    ----------
    results : Results
    beside : Beside
    units : 'datasheet' or 'si'
        Those shown first.
    """
    name = results.identity.label or 'IMU'
    comparisons = {run: _with_run(results, run, beside) for run in beside.former}
    held = [*_with_datasheet(results), *(c for of_run in comparisons.values() for c in of_run)]
    sensors = {
        sensor: axes
        for sensor, where in SENSORS.items()
        if (axes := {a: results.axes[a] for a in AXES[where] if a in results.axes})
    }
    body = [
        *_header(results, name, sensors, units),
        '<main>',
        *_verdict_section(verdict_of(results, held, units)),
        *_findings_section(results.findings),
    ]
    for sensor, axes in sensors.items():
        body += [
            *_sensor_section(sensor, axes, beside),
            *(datasheet_table(sensor, axes, results.datasheet) if results.datasheet else ()),
        ]
        for run, former in beside.former.items():
            body += former_table(sensor, axes, run, former, comparisons[run])
        body.append(f'<div class="charts rest" data-sensor="{sensor}" hidden></div></section>')
    body += [
        '<section id="background"><h2>Recording and method</h2>',
        *background(results, {**beside.method, 'fit': f'method {results.method}'}),
        '</section></main>',
        f'<footer>allan_ros {__version__}</footer>',
    ]
    return _page(f'Noise of {name}', '\n'.join(body), _data(results, beside, list(sensors), units))


def _page(title: str, body: str, data: str) -> str:
    here = files(__package__)
    scripts = [here.joinpath(name).read_text('utf-8') for name in SCRIPTS]
    styles = '\n'.join(here.joinpath(name).read_text('utf-8') for name in STYLES)
    hashes = ' '.join(f"'sha256-{_digest(script)}'" for script in scripts)
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; "
        f"style-src 'unsafe-inline'; script-src {hashes}"
    )
    run = ''.join(f'<script>{script}</script>\n' for script in scripts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f'<title>{escape(title)}</title>\n<style>\n{styles}</style>\n</head>\n<body>\n{body}\n'
        f'<script type="application/json" id="data">{data}</script>\n{run}</body>\n</html>\n'
    )


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _data(results: Results, beside: Beside, sensors: Sequence[str], units: str) -> str:
    references = [] if results.datasheet is None else [results.datasheet.datasheet.reference()]
    charts = [
        sensor_charts(results, sensor, references, beside.former, beside.spectra, beside.outline)
        for sensor in sensors
    ]
    return to_script(
        {'units': units, 'warmth': temperature_chart(beside.outline), 'sensors': charts}
    )


def _with_datasheet(results: Results) -> list[Comparison]:
    sheet = results.datasheet
    if sheet is None:
        return []
    name = sheet.datasheet.name
    return [Comparison(name, h.axis, h.term, h.limit.value, h.verdict) for h in sheet.held]


def _with_run(results: Results, run: str, beside: Beside) -> list[Comparison]:
    former = {name: axis.fit.noise for name, axis in beside.former[run].axes.items()}
    reference: Reference = reference_of_run(run, former)
    return [
        comparison
        for name, axis in results.axes.items()
        for comparison in compare(name, axis.fit.noise, reference, beside.margin)
    ]


def _header(
    results: Results, name: str, sensors: Mapping[str, object], units: str
) -> Iterator[str]:
    number = results.segments
    facts = [
        f'{results.samples:,} samples at {significant(results.rate_hz, 4)} Hz',
        f'{duration_text(results.duration_s)} at rest in {number} '
        f'segment{"" if number == 1 else "s"}',
        recorded_on(results),
    ]
    said = ''.join(f'<li>{escape(fact)}</li>' for fact in facts if fact)
    yield f'<header><h1>Noise of {escape(name)}</h1><ul class="plain">{said}</ul></header>'
    links = ''.join(f'<a href="#{s}">{s.capitalize()}</a>' for s in sensors)
    switch = ''.join(
        f'<label><input type="radio" name="units" id="units-{system}" value="{system}"'
        f'{" checked" if system == units else ""}>{label}</label>'
        for system, label in (('datasheet', 'datasheet'), ('si', 'SI'))
    )
    yield (
        f'<nav aria-label="Sections"><div><a href="#verdict">Verdict</a>{links}'
        '<a href="#background">Data</a></div><fieldset class="switch"><legend>Units</legend>'
        f'{switch}</fieldset></nav>'
    )


def _verdict_section(verdict: Verdict) -> Iterator[str]:
    steps = ''.join(f'<li>{escape(step)}</li>' for step in verdict.steps)
    yield (
        f'<section id="verdict" class="{verdict.light}">'
        f'<p class="light"><svg viewBox="0 0 24 24" aria-hidden="true">'
        f'<circle cx="12" cy="12" r="11"/>{ICONS[verdict.light]}</svg>'
        f'<strong>{verdict.word}</strong></p><div class="answers">'
        f'<div><h2>Is this IMU fine?</h2><p>{escape(verdict.fine)}</p></div>'
        f'<div><h2>Was the recording long enough?</h2><p>{escape(verdict.long_enough)}</p></div>'
        f'<div><h2>What to do next</h2><ol>{steps}</ol></div></div></section>'
    )


def _findings_section(findings: Sequence[Finding]) -> Iterator[str]:
    if not findings:
        return
    yield '<section id="findings"><h2>Findings</h2>'
    pressing = [finding for finding in findings if finding.severity != 'info']
    notes = [finding for finding in findings if finding.severity == 'info']
    yield from _finding_blocks(pressing)
    if len(notes) > FOLDED:
        yield f'<details><summary>{len(notes)} notes</summary>'
        yield from _finding_blocks(notes)
        yield '</details>'
    else:
        yield from _finding_blocks(notes)
    yield '</section>'


def _finding_blocks(findings: Sequence[Finding]) -> Iterator[str]:
    """Yield the findings, those that ask for the same together."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        alike.setdefault((finding.severity, finding.remedy), []).append(finding)
    for (severity, remedy), several in alike.items():
        said = ''.join(
            f'<p>{_where(finding.axes)}{escape(finding.message)}</p>' for finding in several
        )
        yield (
            f'<div class="finding {severity}"><span class="severity">{severity}</span><div>{said}'
            f'<p class="remedy">{escape(remedy)}</p></div></div>'
        )


def _where(axes: Sequence[str]) -> str:
    return f'<b>{escape(", ".join(axes))}</b> ' if axes else ''


def _sensor_section(sensor: str, axes: Mapping[str, AxisResult], beside: Beside) -> Iterator[str]:
    name = SENSOR_NAMES[sensor]
    yield f'<section id="{sensor}" class="sensor"><h2>{name}</h2>'
    yield f'<div class="charts curve" data-sensor="{sensor}" hidden></div>'
    if sensor in beside.pictures:
        yield (
            f'<figure class="static" role="img" aria-label="Allan deviation of the {sensor}">'
            f'{beside.pictures[sensor]}</figure>'
        )
    yield f'<h3>Coefficients</h3><div class="copy" data-sensor="{sensor}" hidden></div>'
    yield from coefficient_table(sensor, axes)
