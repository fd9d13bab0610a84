# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts of exported files: the comment at the top, and the numbers in the format of the file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import yaml

from ..core.errors import one_line
from ..core.filters.reductions import horizon_text
from ..core.findings import Finding
from ..core.number_text import LIMIT_DIGITS, duration_text, significant
from ..results.from_datasheet import FROM_DATASHEET
from ..results.results import MOTION_MEASURED
from ..version import __version__
from .filter_noise import REFUSED, FilterNoise
from .target import Form, Row, Value

if TYPE_CHECKING:
    from ..core.estimate import Estimate
    from ..core.filters.motion_factors import SensorInMotion
    from ..results.results import Results

# --- header ---------------------------------------------------------------------------------------

NAMED_SOURCES = 3
"""Largest number of recordings that the header comment names; further recordings are counted."""


def header_lines(
    name: str, noise: FilterNoise, rows: Sequence[Row], words: Callable[[Finding], str]
) -> list[str]:
    """Return the lines of the header comment, without comment marks.

    The lines state source, date, convention, units, rate, axes, intervals and warnings. ``name`` is
    the name of the target, and ``words`` returns the text of a finding.
    """
    results, target = noise.results, noise.target
    limit_keys = dict.fromkeys(row.key for row in rows if row.is_limit)
    keys_without_interval = dict.fromkeys(row.key for row in rows if row.no_interval)
    first_ids = (*REFUSED, 'from_datasheet')
    subject = 'Bias of an IMU over' if name == 'temperature' else 'IMU noise for'
    start = results.provenance.start
    title = [
        f'{subject} {name}, measured by allan_ros {__version__} (method {results.method})',
        f'source: {_sources(results)}; {duration_text(results.duration_s, 3)} at rest, '
        f'{significant(results.rate_hz, 5)} Hz',
        f'date: recorded from {start:%Y-%m-%d %H:%M:%S} UTC on' if start else 'date: not known',
    ]
    if results.method == FROM_DATASHEET:
        title = [
            f'IMU noise for {name}, from the datasheet of {results.identity.frame_id} and not '
            f'measured (allan_ros {__version__})',
            *(f'source: {source.path}' for source in results.provenance.sources),
        ]
    axes = 'one number for each of x, y, z' if target.three else 'the largest number of x, y, z'
    lines = [
        *(f'warning: {words(note)}' for note in results.findings if note.id in first_ids),
        *title,
        f'convention: {target.convention}',
        f'rate: f = {noise.rate:g} Hz, {noise.rate_words}',
        f'axes: {axes}; inflation: {_inflation(noise)}',
    ]
    if noise.options.fidelity == 'coefficients':
        lines.append('fidelity: N and K as measured; they underestimate flicker and drift')
    elif noise.used:
        smallest_ratios, largest_ratios = zip(*(reduced.ratio for reduced in noise.used.values()))
        lines.append(
            'reduction: N and K bound the error growth of the complete model over '
            f'{horizon_text(noise.horizon)}: they predict {min(smallest_ratios):.2f} to '
            f'{max(largest_ratios):.2f} times this growth'
        )
    lines += [
        *(f'{row.key} {row.words}' for row in rows if row.words),
        f'upper limits instead of measurements: {", ".join(limit_keys) or "none"}',
        *(
            [f'values without a 95 % interval: {", ".join(keys_without_interval)}']
            if keys_without_interval
            else []
        ),
        *(f'note: {note}' for note in target.notes),
        *(
            f'note: {words(note)}'
            for note in results.findings
            if noise.options.motion and note.id in MOTION_MEASURED
        ),
        *dict.fromkeys(f'note: {words(note)}' for row in rows for note in row.findings),
        *(f'warning: {words(note)}' for note in noise.findings()),
        *(
            f'warning: {words(note)}'
            for note in results.findings
            if note.severity != 'info' and note.id not in first_ids
        ),
    ]
    return [one_line(line) for line in lines]


def _inflation(noise: FilterNoise) -> str:
    """Return a text for the header: the factors by which the noise is multiplied."""
    note, motion = 'the levels below are without these factors', noise.results.motion
    if noise.options.motion and motion is not None:
        factors_in_motion = ', '.join(
            f'{name} {_raised(sensor_in_motion)}'
            for name, sensor_in_motion in motion.sensors.items()
        )
        return f'in motion, {factors_in_motion}, from {len(motion.drives)} drives; {note}'
    factors = noise.options.factors
    distinct_factors = set(factors.values())
    if distinct_factors == {1.0}:
        return 'none'
    factor_of_each = ', '.join(f'{sensor} x{factor:g}' for sensor, factor in factors.items())
    factor_text = factor_of_each if len(distinct_factors) > 1 else f'x{distinct_factors.pop():g}'
    return f'{factor_text} on every N, K and bias; {note}'


def _raised(sensor: SensorInMotion) -> str:
    """Return the factors of a sensor in motion as text, such as 'N x2.7 (2.2 to 3.3)'."""
    terms: dict[Estimate, list[str]] = {}
    for term, factor in sensor.raised.items():
        terms.setdefault(factor, []).append(term)
    texts = []
    for factor, names in terms.items():
        value, low, high = (
            significant(x, LIMIT_DIGITS)
            for x in (factor.value or 1.0, *(factor.ci95 or (0.0, math.inf)))
        )
        remark = '' if (factor.value or 0.0) > 1.0 else 'not raised, '
        texts.append(f'{" and ".join(names)} {remark}x{value} ({low} to {high})')
    return ' and '.join(texts)


def _sources(results: Results) -> str:
    sources = [f'{s.path} {s.topic}'.strip() for s in results.provenance.sources]
    unnamed_count = len(sources) - NAMED_SOURCES
    source_names = ', '.join(sources[:NAMED_SOURCES]) + (
        f' and {unnamed_count} more' if unnamed_count > 0 else ''
    )
    return source_names or 'sums without a recording'


# --- formats --------------------------------------------------------------------------------------

INDENT = 2

INNERMOST_LIST = re.compile(r'\[\s+([^][{}"]*?)\s+\]')
"""Pattern of a list of numbers that is written on several lines."""


def nested(rows: Sequence[Row]) -> dict[str, Value]:
    """Return the values of the rows as nested dicts, whose keys are the paths of the rows."""
    tree: dict[str, Value] = {}
    for row in rows:
        mapping: Any = tree
        for key in row.path[:-1]:
            mapping = mapping.setdefault(key, {})
        mapping[row.key] = row.value
    return tree


def json_form(rows: Sequence[Row], header: Sequence[str]) -> str:
    """Return a JSON file. JSON has no comments, so the header is the value of the key allan_ros."""
    # the header is last, because the program that reads the file may expect another key first
    document = {**nested(rows), 'allan_ros': list(header)}
    text = json.dumps(document, indent=INDENT, ensure_ascii=False, allow_nan=False)
    return INNERMOST_LIST.sub(lambda found: f'[{" ".join(found[1].split())}]', text) + '\n'


def line_form(line: str, before: str = '', after: str = '') -> Form:
    """Return a function that writes a file with one line per key.

    ``line`` is a `str.format` template with ``key`` and ``value``. ``before`` is text between
    header and lines, ``after`` is text after the lines.
    """

    def form(rows: Sequence[Row], header: Sequence[str]) -> str:
        comments = ''.join(f'# {text}\n' for text in header)
        lines = (line.format(key=row.key, value=row.value) + '\n' for row in rows)
        return f'{comments}{before}{"".join(lines)}{after}'

    return form


def xml_form(rows: Sequence[Row], header: Sequence[str]) -> str:
    """Return a fragment of XML; a key that starts with '@' is an attribute of its element."""
    # an XML comment must not contain two hyphens in a row
    lines = ''.join(f'  {line.replace("--", "- -")}\n' for line in header)
    return f'<!--\n{lines}-->\n' + '\n'.join(_elements(nested(rows))) + '\n'


def _elements(tree: dict[str, Value], depth: int = 0) -> list[str]:
    lines, margin = [], ' ' * INDENT * depth
    for key, value in tree.items():
        if key.startswith('@'):
            continue
        if not isinstance(value, dict):
            lines.append(f'{margin}<{key}>{value}</{key}>')
            continue
        attributes = ''.join(f' {k[1:]}="{v}"' for k, v in value.items() if k.startswith('@'))
        lines += [f'{margin}<{key}{attributes}>', *_elements(value, depth + 1), f'{margin}</{key}>']
    return lines


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes YAML with lists of numbers on one line, and indents lists as OpenCV requires."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(
    list,
    lambda dumper, row: dumper.represent_sequence(
        'tag:yaml.org,2002:seq', row, not any(isinstance(item, list) for item in row)
    ),
)


def yaml_form(rows: Sequence[Row], header: Sequence[str], first: str = '') -> str:
    """Return a YAML file that begins with the text ``first``, followed by the header."""
    tree: str = yaml.dump(
        nested(rows),
        Dumper=_Dumper,
        width=10**6,
        allow_unicode=True,
        sort_keys=False,
        indent=INDENT,
    )
    return first + ''.join(f'# {line}\n' for line in header) + tree


opencv_form = partial(yaml_form, first='%YAML:1.0\n')
"""Function like `yaml_form`, for YAML files that OpenCV reads (cv::FileStorage)."""
