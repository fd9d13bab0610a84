# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export targets: options of the user, keys and rows of a file, and the formats of files."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from numbers import Real
from typing import Any, NamedTuple

import yaml

from ..core.errors import AllanError, one_line
from ..core.filters.noise_parameters import HORIZON_S, FilterLevel
from ..core.findings import Finding
from ..core.imu import SENSORS
from ..core.settings import CheckedSettings, check_range, parameter

INS_HORIZON_S = 100.0
"""Longest time in s that a state estimator integrates during an outage of GNSS."""

SIMULATOR_HORIZON_S = 1000.0
"""Time in s up to which a simulated sensor should drift like the measured sensor."""

ANY_NODE = ('/**', 'ros__parameters')
"""Top-level keys of a ROS 2 parameter file that apply to every node that loads the file."""

Value = Any
"""The value of a key in a file: a number, a string, a list or a mapping of these."""


@dataclass(frozen=True)
class ExportOptions(CheckedSettings):
    """Options of the user for an exported file.

    Raises
    ------
    AllanError
        When a value has a wrong type or lies outside its range, or when both ``inflate`` and
        ``motion`` are given.
    """

    inflate: str = parameter(
        '1',
        'Factor by which every noise level is multiplied, because vibration and model errors add '
        'to the noise at rest; or one factor for each sensor, such as gyro=2,accel=3. '
        '`allan inflate` measures these factors.',
    )
    motion: bool = parameter(
        False,
        'Multiply N and K of each sensor by their factors in motion, which `allan analyze` '
        'measures in a recording with drives between rests.',
    )
    filter_rate: float = parameter(
        0.0,
        'Rate at which the state estimator processes samples; 0: rate of the recording, or the '
        'fixed rate of the state estimator.',
        unit='Hz',
        low=0.0,
        high=1e6,
    )
    fidelity: str = parameter(
        'reduction',
        'Which N and K are written: with reduction, a reduced-order model, whose K is raised until '
        'the predicted errors are at least as large as with the complete model; with '
        'coefficients, N and K as measured.',
        choices=('reduction', 'coefficients'),
    )
    horizon: float = parameter(
        0.0,
        'Longest time that the state estimator integrates without a correction. The reduced-order '
        'model is chosen for the errors up to this time. 0: the default of the target, such as '
        '30 s for cameras and lidars, and 100 s for GNSS.',
        unit='s',
        low=0.0,
        high=1e6,
    )
    topic: str = parameter(
        '', 'The Imu topic to name in the file; empty: the topic of the recording.'
    )
    force: bool = parameter(
        False,
        'Write the file although the units of the samples are probably wrong, or the recording '
        'does not show the noise of the sensor.',
    )

    def __post_init__(self) -> None:
        text = self.inflate  # a Python user may also give a number, or a dict: sensor -> number
        if isinstance(text, Mapping):
            text = ','.join(f'{sensor}={factor}' for sensor, factor in text.items())
        elif isinstance(text, Real) and not isinstance(text, bool):
            text = str(text)
        object.__setattr__(self, 'inflate', text)
        super().__post_init__()
        if set(self.factors.values()) != {1.0} and self.motion:
            raise AllanError('inflate and motion both multiply the noise: give only one of them')

    @property
    def factors(self) -> dict[str, float]:
        """Sensor -> factor by which its noise levels are multiplied, according to ``inflate``."""
        assignments = [assignment.strip() for assignment in self.inflate.split(',')]
        if len(assignments) == 1 and '=' not in assignments[0]:
            return dict.fromkeys(SENSORS, _factor(assignments[0]))
        factors = dict.fromkeys(SENSORS, 1.0)
        for assignment in assignments:
            sensor, sign, number = assignment.partition('=')
            if not sign or sensor.strip() not in SENSORS:
                raise AllanError(
                    f'inflate is {one_line(self.inflate):.60}: write a factor such as 2, or one '
                    'for each sensor: gyro=2,accel=3'
                )
            factors[sensor.strip()] = _factor(number)
        return factors


def _factor(text: str) -> float:
    try:
        factor = float(text)
    except ValueError:
        raise AllanError(f'inflate is {one_line(text)!r:.60}: a number is expected') from None
    check_range(1.0, 1000.0, inflate=factor)
    return factor


class Key(NamedTuple):
    """One key of a file and the quantity that is written there."""

    name: str
    # 'gyro' or 'accel'; '-' for both sensors, whose larger N or K is written
    sensor: str
    # 'N' or 'K'; 'sigma', 'tau' or 'driving' (density sigma sqrt(2/tau)) of the Gauss-Markov bias;
    # 'common_tau': correlation time of all axes, in h; 'rate'; 'topic'
    what: str
    unit: str = ''  # a name in `filter_noise.NOTATIONS`, or a unit of measurement
    limits: tuple[float, float] | None = None  # range of numbers that the state estimator accepts


@dataclass(frozen=True)
class Row:
    """One key of a file with its value and the origin of the value."""

    path: tuple[str, ...]  # the key, preceded by the keys of the mappings that contain it
    value: Value
    words: str = ''  # formula, axis and interval of the number as text; '' for none
    unit: str = ''  # unit of the number in the file; '' if it is not stated
    # 95 % interval of the number, in the unit of the file: (0, number) if the number is an upper
    # limit, (0, inf) if the interval is unknown. If the row has numbers for x, y and z, this is the
    # widest of their three intervals
    interval: tuple[float, float] = (0.0, math.inf)
    levels: tuple[FilterLevel, ...] = ()  # measured noise levels from which the number is computed
    findings: tuple[Finding, ...] = ()  # information for the user of the file

    @property
    def key(self) -> str:
        """The last key of the path."""
        return self.path[-1]

    @property
    def name(self) -> str:
        """The keys of the path, without the keys `ANY_NODE` at its start, joined by dots."""
        path = self.path[2:] if self.path[:2] == ANY_NODE else self.path
        return '.'.join(path)

    @property
    def values(self) -> tuple[float, ...]:
        """The value as a tuple: the items of a list, such as three numbers, or the only value."""
        return tuple(self.value) if isinstance(self.value, list) else (self.value,)

    @property
    def ratio(self) -> float:
        """Ratio of the upper to the lower end of the interval.

        The ratio is infinite if the lower end is not above 0.
        """
        low, high = self.interval
        return high / low if low > 0.0 else math.inf

    @property
    def is_limit(self) -> bool:
        """Whether any number of the row comes from a 95 % upper limit."""
        return any(level.is_limit for level in self.levels)

    @property
    def no_interval(self) -> bool:
        """Whether any number of the row comes from a value without a 95 % interval."""
        return any(level.no_interval for level in self.levels)


def keys_of(table: str) -> tuple[Key, ...]:
    """Return the keys that a table lists, one for each line.

    A line is ``name sensor what [unit [low..high]]``: the fields of a `Key`, with ``low..high`` for
    ``limits``. The default unit is 'density'.
    """
    keys = []
    for line in table.strip().splitlines():
        name, sensor, what, *optional_fields = line.split()
        unit = optional_fields[0] if optional_fields else 'density'
        low, high = (
            map(float, optional_fields[1].split('..')) if len(optional_fields) > 1 else (0.0, 0.0)
        )
        keys.append(Key(name, sensor, what, unit, (low, high) if high else None))
    return tuple(keys)


def noise_keys(names: str, unit: str = 'density') -> tuple[Key, ...]:
    """Return the keys for gyro N, accelerometer N, gyro K and accelerometer K.

    ``names`` are the names of these four keys, separated by spaces. ``unit`` is `Key.unit`.
    """
    quantities = ('gyro N', 'accel N', 'gyro K', 'accel K')
    return keys_of(
        '\n'.join(f'{name} {quantity} {unit}' for name, quantity in zip(names.split(), quantities))
    )


RAISED = 'Raised numbers cover B and correlated noise, for which the filter has no states.'
"""Explanation of numbers that are larger than the coefficients as measured."""


def origin_text(level: FilterLevel) -> str:
    """Return a text on how a number for a state estimator differs from the measured coefficient."""
    name = f'{level.estimate.name} of {level.estimate.axis.replace("_", " ")}'
    if level.raised_from == 0.0:
        return f'{name} is not resolved: set to cover the error growth'
    words = f'{name} is not resolved: its 95 % upper limit' if level.is_limit else name
    if level.raised_from is None:
        return words if level.is_limit else f'{name} as measured'
    factor, measured = level.value / level.raised_from, level.raised_from
    return f'{words}, raised {factor:.3g} times from {measured:.4g} as measured'


Form = Callable[[Sequence[Row], Sequence[str]], str]
"""Function (rows, lines of the header) -> text of a file in one format."""


@dataclass(frozen=True)
class Target:
    """An export target: a file of a state estimator, simulator or calibration tool."""

    title: str  # the file and the meaning of its numbers, for a list of all targets
    file_name: str  # name of the file in a results folder
    convention: str  # meaning of the numbers, and the source code that shows this meaning
    form: Form
    keys: tuple[Key, ...] = ()  # the keys of the file
    parent: tuple[str, ...] = ()  # keys of the nested mappings that contain the keys of the file
    fixed: Mapping[str, Value] = field(default_factory=dict)  # required keys that are not measured
    notes: tuple[str, ...] = ()  # further information for the user of this file
    # yields the rows of a file that is too complex for a table, given a `FilterNoise`
    rows: Callable[[Any], Iterable[Row]] | None = None
    # whether the file has numbers for x, y and z; if False, it has the largest of the three numbers
    three: bool = False
    rate_hz: float | None = None  # fixed rate of the estimator in Hz; None if it is the sample rate
    horizon_s: float = HORIZON_S  # default of `ExportOptions.horizon` in s
    # whether the target models the bias as a random walk, so that N and K are adjusted together
    walk: bool = True
    # whether the numbers bound the error growth from above, as a state estimator needs; if False,
    # they approximate the error growth, as a simulator needs
    bound: bool = True


class Export(NamedTuple):
    """The text of an exported file, and findings about its numbers."""

    text: str
    findings: tuple[Finding, ...]


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
    """Return the text of a JSON file, in which the header is the value of the key allan_ros.

    JSON has no comments.
    """
    # the header is last, because the program that reads the file may expect another key first
    document = {**nested(rows), 'allan_ros': list(header)}
    text = json.dumps(document, indent=INDENT, ensure_ascii=False, allow_nan=False)
    return INNERMOST_LIST.sub(lambda found: f'[{" ".join(found[1].split())}]', text) + '\n'


def line_form(line: str, before: str = '', after: str = '') -> Form:
    """Return a function that returns the text of a file with one line per key.

    The header comes first, as comments that begin with ``#``. ``line`` is a `str.format` template
    with ``key`` and ``value``. ``before`` is text between header and lines, ``after`` is text after
    the lines.
    """

    def form(rows: Sequence[Row], header: Sequence[str]) -> str:
        comments = ''.join(f'# {text}\n' for text in header)
        lines = (line.format(key=row.key, value=row.value) + '\n' for row in rows)
        return f'{comments}{before}{"".join(lines)}{after}'

    return form


def xml_form(rows: Sequence[Row], header: Sequence[str]) -> str:
    """Return a fragment of XML; a key that starts with '@' is an attribute of its element."""
    # an XML comment must not contain two hyphens in a row
    lines = ''.join(f'  {re.sub("-(?=-)", "- ", line)}\n' for line in header)
    return f'<!--\n{lines}-->\n' + '\n'.join(_elements(nested(rows))) + '\n'


def _elements(tree: dict[str, Value], depth: int = 0) -> list[str]:
    lines, indentation = [], ' ' * INDENT * depth
    for key, value in tree.items():
        if key.startswith('@'):
            continue
        if not isinstance(value, dict):
            lines.append(f'{indentation}<{key}>{value}</{key}>')
            continue
        attributes = ''.join(f' {k[1:]}="{v}"' for k, v in value.items() if k.startswith('@'))
        lines.append(f'{indentation}<{key}{attributes}>')
        lines += [*_elements(value, depth + 1), f'{indentation}</{key}>']
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
    """Return the text of a YAML file, which begins with ``first``, followed by the header."""
    yaml_text: str = yaml.dump(
        nested(rows),
        Dumper=_Dumper,
        width=10**6,
        allow_unicode=True,
        sort_keys=False,
        indent=INDENT,
    )
    return first + ''.join(f'# {line}\n' for line in header) + yaml_text


opencv_form = partial(yaml_form, first='%YAML:1.0\n')
"""Function like `yaml_form`, for YAML files that OpenCV reads (cv::FileStorage)."""
