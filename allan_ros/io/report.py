# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`report.html`: the verdict first, then tables, pictures and findings, in one file of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib.resources import files

from .. import __version__
from ..core.batch import AXES, SENSORS
from ..core.findings import Finding
from ..core.fit import TERMS
from .results import Results
from .shown import (
    duration_text,
    interval_text,
    region_text,
    shown_unit,
    significant,
    value_text,
)

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

SENSOR_NAMES = {'gyro': 'Gyroscope', 'accel': 'Accelerometer'}


def render_report(results: Results, pictures: Mapping[str, str], units: str) -> str:
    """Return the page.

    Parameters
    ----------
    results : Results
    pictures : mapping of sensor to str
        ``<svg>`` elements.
    units : 'datasheet' or 'si'
    """
    name = results.identity.hardware_id or results.identity.frame_id or 'IMU'
    body = [
        f'<h1>Noise of {escape(name)}</h1>',
        f'<p class="verdict">{escape(verdict(results, units))}</p>',
        *_finding_blocks(results.findings),
    ]
    for sensor, where in SENSORS.items():
        axes = [axis for axis in AXES[where] if axis in results.axes]
        if axes:
            body += [f'<h2>{SENSOR_NAMES[sensor]}</h2>', *_table(results, sensor, axes, units)]
            if sensor in pictures:
                body.append(f'<figure>{pictures[sensor]}</figure>')
    body += ['<h2>Recording</h2>', *_recording(results)]
    style = files(__package__).joinpath('report.css').read_text('utf-8')
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>Noise of {escape(name)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n'
        + '\n'.join(body)
        + f'\n<footer>allan_ros {__version__}, method {escape(results.method)}</footer>\n'
        '</body>\n</html>\n'
    )


def verdict(results: Results, units: str) -> str:
    """Return one sentence: the largest N and B of each sensor, and what is not observable."""
    said = []
    for sensor, where in SENSORS.items():
        axes = [axis for axis in AXES[where] if axis in results.axes]
        for term in ('N', 'B'):
            known = [
                (c.value, axis)
                for axis in axes
                if (c := results.axes[axis].fit.noise[term]).status == 'estimated' and c.value
            ]
            if known:
                value, axis = max(known)
                unit = shown_unit(axis, term, units)
                said.append(f'{sensor} {term} {significant(value * unit.factor, 3)} {unit.name}')
    hidden = [
        f'{term} ({len(unseen)} of {len(results.axes)} axes)'
        for term in TERMS
        if (
            unseen := [
                a for a in results.axes.values() if a.fit.noise[term].status == 'not_observable'
            ]
        )
    ]
    worst = f'Worst axis: {", ".join(said)}. ' if said else ''
    return worst + (f'Not observable in this much data: {", ".join(hidden)}.' if hidden else '')


def _table(results: Results, sensor: str, axes: Sequence[str], units: str) -> Iterator[str]:
    yield '<table><thead><tr><th>term</th><th>unit</th>'
    yield ''.join(f'<th>{axis.rsplit("_", 1)[1]}</th>' for axis in axes) + '</tr></thead><tbody>'
    for term in TERMS:
        unit = shown_unit(axes[0], term, units)
        cells = ''
        for axis in axes:
            coefficient = results.axes[axis].fit.noise[term]
            cells += (
                f'<td class="{coefficient.status}">{escape(value_text(coefficient, unit))}'
                f'<small>{escape(interval_text(coefficient, unit))}</small></td>'
            )
        name = f'{term} <small>{TERM_NAMES[sensor][term]}</small>'
        yield f'<tr><th>{name}</th><td>{unit.name}</td>{cells}</tr>'
    fits = [results.axes[axis].fit for axis in axes]
    if any(fit.misfit > 0.0 for fit in fits):
        misfits = ''.join(f'<td>{fit.misfit:.1%}</td>' for fit in fits)
        yield f'<tr><th>misfit <small>of the five terms</small></th><td></td>{misfits}</tr>'
    regions = ''.join(
        f'<td>{"<br>".join(region_text(r) for r in results.axes[axis].regions)}</td>'
        for axis in axes
    )
    yield f'<tr><th>what rules where</th><td></td>{regions}</tr></tbody></table>'
    yield (
        '<p class="note">Below each value its 95 % interval. "&lt;": not observable in this much '
        'data; the 95 % upper limit is given.</p>'
    )


def _finding_blocks(findings: Sequence[Finding]) -> Iterator[str]:
    for finding in findings:
        where = f'<b>{", ".join(finding.axes)}</b>: ' if finding.axes else ''
        yield (
            f'<div class="finding {finding.severity}"><p>{where}{escape(finding.message)}</p>'
            f'<p class="remedy">{escape(finding.remedy)}</p></div>'
        )


def _recording(results: Results) -> Iterator[str]:
    counts = results.provenance.counts
    fates = {name: n for name, n in vars(counts).items() if isinstance(n, int) and n}
    cuts = ', '.join(f'{n} {reason}' for reason, n in counts.cuts.items())
    rows = {
        'evidence': f'{results.samples:,} samples at {significant(results.rate_hz, 5)} Hz, '
        f'{duration_text(results.duration_s)} in {results.segments} segment(s)',
        'samples': ', '.join(f'{n:,} {name.replace("_", " ")}' for name, n in fates.items()),
        'cuts': cuts or 'none',
    }
    for source in results.provenance.sources:
        what = ', '.join(part for part in (source.topic, source.type, source.storage) if part)
        rows[source.path] = what
    cells = (
        f'<tr><th>{escape(key)}</th><td>{escape(value)}</td></tr>' for key, value in rows.items()
    )
    yield f'<table class="recording"><tbody>{"".join(cells)}</tbody></table>'
