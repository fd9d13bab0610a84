# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The text of a file: its header comment, its format, and the numbers of the user's own file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from ..core.errors import AllanError, one_line
from ..core.filters.growth import growth_table, predicted_growth
from ..core.filters.reductions import horizon_text
from ..core.findings import Finding
from ..core.imu import AXES, DEGREE, HOUR, SENSORS, UNITS, sensor_of
from ..core.noise import GaussMarkov, Model
from ..core.number_text import duration_text, significant
from ..results.from_datasheet import FROM_DATASHEET
from ..version import __version__
from . import ExportOptions, Form, Key, Row, Target, Value, target_of
from .model import REFUSED, FilterNoise, notation_of

if TYPE_CHECKING:
    from ..results.results import Results

# --- header ---------------------------------------------------------------------------------------

NAMED_SOURCES = 3
"""Largest number of recordings that the header comment names; others are counted."""


def header_lines(
    name: str, noise: FilterNoise, rows: Sequence[Row], words: Callable[[Finding], str]
) -> list[str]:
    """Return the lines of the header comment, without comment marks.

    They state source, date, convention, units, rate, axes, intervals and warnings. ``name`` is the
    target, ``rows`` are the keys of the file; ``words`` returns the text of a finding.
    """
    results, target, inflate = noise.results, noise.target, noise.options.inflate
    limits = dict.fromkeys(row.key for row in rows if row.is_limit)
    unsure = dict.fromkeys(row.key for row in rows if row.no_interval)
    first = (*REFUSED, 'from_datasheet')
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
    rule = 'each (x, y, z)' if target.three else 'worst (the largest of x, y, z)'
    inflation = f'x{inflate:g} on every N, K and bias; the levels below are without it'
    lines = [
        *(f'warning: {words(note)}' for note in results.findings if note.id in first),
        *title,
        f'convention: {target.convention}',
        f'rate: f = {noise.rate:g} Hz, {noise.rate_words}',
        f'axis rule: {rule}; inflation: {inflation if inflate > 1 else "none"}',
    ]
    if noise.options.fidelity == 'coefficients':
        lines.append('fidelity: N and K as measured; they underestimate flicker and drift')
    elif noise.used:
        lows, highs = zip(*(one.ratio for one in noise.used.values()))
        lines.append(
            'reduction: N and K bound the error growth of the complete model over '
            f'{horizon_text(noise.horizon)}; predicted over model growth {min(lows):.2f} to '
            f'{max(highs):.2f}'
        )
    lines += [
        *(f'{row.key} {row.words}' for row in rows if row.words),
        f'upper limits instead of measurements: {", ".join(limits) or "none"}',
        *([f'values without a 95 % interval: {", ".join(unsure)}'] if unsure else []),
        *(f'note: {note}' for note in target.notes),
        *dict.fromkeys(f'note: {words(note)}' for row in rows for note in row.findings),
        *(f'warning: {words(note)}' for note in noise.findings()),
        *(
            f'warning: {words(note)}'
            for note in results.findings
            if note.severity != 'info' and note.id not in first
        ),
    ]
    return [one_line(line) for line in lines]


def _sources(results: Results) -> str:
    sources = [f'{s.path} {s.topic}'.strip() for s in results.provenance.sources]
    more = len(sources) - NAMED_SOURCES
    named = ', '.join(sources[:NAMED_SOURCES]) + (f' and {more} more' if more > 0 else '')
    return named or 'sums without a recording'


# --- formats --------------------------------------------------------------------------------------

INDENT = 2

INNERMOST_LIST = re.compile(r'\[\s+([^][{}"]*?)\s+\]')
"""A list of numbers on several lines."""


def nested(rows: Sequence[Row]) -> dict[str, Value]:
    """Return the values of rows as nested mappings."""
    tree: dict[str, Value] = {}
    for row in rows:
        here: Any = tree
        for key in row.path[:-1]:
            here = here.setdefault(key, {})
        here[row.key] = row.value
    return tree


def json_form(rows: Sequence[Row], header: Sequence[str]) -> str:
    """Return a JSON file; it has no comments, so the header is the value of a key."""
    # last, because a reader may expect one of its keys first
    document = {**nested(rows), 'allan_ros': list(header)}
    text = json.dumps(document, indent=INDENT, ensure_ascii=False, allow_nan=False)
    return INNERMOST_LIST.sub(lambda found: f'[{" ".join(found[1].split())}]', text) + '\n'


def line_form(line: str, before: str = '', after: str = '') -> Form:
    """Return the format of a file with one line per key.

    ``line`` is a `str.format` template of key and value. ``before`` is text between header and
    lines, ``after`` text after the lines.
    """

    def form(rows: Sequence[Row], header: Sequence[str]) -> str:
        comments = ''.join(f'# {text}\n' for text in header)
        lines = (line.format(key=row.key, value=row.value) + '\n' for row in rows)
        return f'{comments}{before}{"".join(lines)}{after}'

    return form


def xml_form(rows: Sequence[Row], header: Sequence[str]) -> str:
    """Return a fragment of XML; a key that starts with '@' is an attribute of its element."""
    # a comment must not contain two hyphens in a row
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
    """Writes lists of numbers on one line, and indents sequences as OpenCV requires."""

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
    """Return a YAML file that begins with the line ``first``."""
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
"""YAML for cv::FileStorage."""


# --- the user's own file --------------------------------------------------------------------------

AFTER_S = (1.0, 10.0, 60.0)
"""Times in s after the last correction at which the drift is compared."""

SHOWN = {'gyro': (DEGREE, 'deg'), 'accel': (1.0, 'm/s')}
"""Sensor -> SI value and name of the unit of its drift."""

DIGITS = 2
"""Significant digits of a drift."""

ROUNDING = 0.01
"""Relative difference that is due to the rounding of the numbers in a file."""

SMALLEST, LARGEST = 1e-30, 1e15
"""Range of plausible numbers in a file, in any unit; their squares are finite."""

COMMENT = re.compile(r'(?m)^\s*(?:#|//).*|(?s:/\*.*?\*/)|"[^"\n]* [^"\n]*"')
"""Comments of YAML, Python and JSON, and strings with a space."""

NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'

EXAMPLE = 'kalibr, openvins or px4'


class Drift(NamedTuple):
    """Standard deviation of the angle (rad) or velocity (m/s) of one axis without correction."""

    axis: str
    after: float  # s
    file: float  # with the numbers of the user's file
    measured: float
    ci95: tuple[float, float] | None  # of ``measured``; None if unknown

    @property
    def ratio(self) -> float:
        """Measured drift / drift in the file; above 1, the filter is overconfident."""
        return self.measured / self.file if self.file else math.inf

    @property
    def overconfident(self) -> bool:
        """Whether the file expects less than the interval of the measured drift."""
        return self.file < (self.ci95[0] if self.ci95 else self.measured)

    def __str__(self) -> str:
        factor, unit = SHOWN[sensor_of(self.axis)]
        file, measured, *ends = (
            f'{significant(x / factor, DIGITS)}'
            for x in (self.file, self.measured, *(self.ci95 or ()))
        )
        interval = f' ({"..".join(ends)})' if ends else ''
        text = f'{self.axis} after {self.after:g} s: your file {file} {unit}, measured {measured}'
        return f'{text}{interval} {unit}, {significant(self.ratio, DIGITS)} times'


def against(
    results: Results, name: str, text: str, options: ExportOptions = ExportOptions()
) -> tuple[Drift, ...]:
    """Return the drift of each axis according to the user's file and to the measured model.

    Parameters
    ----------
    results : Results
        The measured IMU.
    name : str
        The target whose file it is, one of `TARGETS`.
    text : str
        Text of the user's file, in the format and with the keys that `make_export` writes; other
        keys are ignored.
    options : ExportOptions
        The rate of the filter and the horizon, which is also the time over which the bias is
        averaged before.

    Raises
    ------
    AllanError
        If the text lacks a number of the target, or the target has no noise model in its file.
    """
    target = target_of(name)
    noise = FilterNoise(results, options, target)
    window = noise.horizon
    found = []
    for axis, model in file_models(target, text, noise.rate).items():
        if axis not in results.axes:
            continue
        grown = predicted_growth(model, AFTER_S, window)
        for believed, growth in zip(
            grown, growth_table(results.axes[axis].fit, horizons=AFTER_S, window=window)
        ):
            size, ends = growth.std.value or 0.0, growth.std.ci95
            found.append(Drift(axis, growth.horizon, float(believed), size, ends))
    return tuple(found)


def verdicts(drifts: tuple[Drift, ...]) -> list[str]:
    """Return a sentence for each sensor on its worst axis and time."""
    lines = []
    for sensor in dict.fromkeys(sensor_of(one.axis) for one in drifts):
        worst = max((d for d in drifts if sensor_of(d.axis) == sensor), key=lambda d: d.ratio)
        factor = significant(max(worst.ratio, 1.0 / worst.ratio), DIGITS)
        said = f'your file covers the measured drift, by {factor} or more'
        if worst.ratio > 1.0 + ROUNDING:
            said = f'a filter with your file is overconfident by {factor}'
            if not worst.overconfident:
                said += ', within the interval of the measured drift'
        lines.append(f'{sensor}: {said} ({worst.axis} after {worst.after:g} s)')
    return lines


def file_models(target: Target, text: str, rate: float) -> Mapping[str, Model]:
    """Return axis -> noise that a filter assumes with the numbers in the text of its file."""
    whats = {key.what for key in target.keys}
    if not whats & {'K', 'sigma'}:
        raise AllanError(
            f'{target.file_name} has no noise model to compare: give --to for a filter with N and '
            f'the drift of the bias in its file, such as {EXAMPLE}'
        )
    plain = COMMENT.sub('', text)
    values: dict[tuple[str, str], list[float]] = {}
    for key in target.keys:
        if key.what in ('rate', 'topic'):
            continue
        numbers = _si(key, _numbers(plain, key), rate)
        for sensor in SENSORS if key.sensor == '-' else (key.sensor,):
            values.setdefault((sensor, key.what), numbers)
    models = {}
    for sensor, place in SENSORS.items():
        for i, axis in enumerate(AXES[place]):
            one = {w: v[i % len(v)] for (s, w), v in values.items() if s == sensor}
            bias = [(one['sigma'], GaussMarkov(one['common_tau']))] if 'sigma' in one else []
            models[axis] = Model.of(*bias, N=one['N'], K=one.get('K', 0.0))
    return models


def _numbers(plain: str, key: Key) -> list[float]:
    """Return the one or three numbers of a key in a text without comments."""
    name = key.name
    known = re.escape(name)
    values = re.findall(rf'(?<![\w.]){known}["\']?\s*[:=,\s]\s*(\[[^\]]*\]|{NUMBER})', plain)
    numbers = [[float(n) for n in re.findall(NUMBER, value)] for value in dict.fromkeys(values)]
    if len(numbers) != 1 or len(numbers[0]) not in (1, 3):
        what = 'contains no number' if not numbers else 'contains several values'
        raise AllanError(
            f'your file {what} of {name}: give the file of the filter that --to names, with one IMU'
        )
    least = 0.0 if key.what == 'K' else SMALLEST
    if not all(least <= value <= LARGEST for value in numbers[0]):
        raise AllanError(
            f'{name} of your file is {values[0]}: give a number from {least:g} to {LARGEST:g}'
        )
    return numbers[0]


def _si(key: Key, numbers: list[float], rate: float) -> list[float]:
    if key.what in ('N', 'K'):
        notation = notation_of(key)
        return [notation.level(value, rate) for value in numbers]
    factor = HOUR if key.what == 'common_tau' else UNITS[key.unit].factor
    return [value * factor for value in numbers]
