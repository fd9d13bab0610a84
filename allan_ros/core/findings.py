# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings: messages to the user about a recording or a running node.

A finding holds numbers. Its text is made at the output, in the units of the output, from the
templates of the catalog ``findings.txt``: the message states the cause with its numbers, the remedy
the next step.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pkgutil import get_data
from typing import Any, Literal, NamedTuple

import numpy as np

from .errors import one_line
from .estimate import Ends, Estimate
from .imu import SI_UNITS, sensor_of, shown_unit
from .number_text import duration_text, prefixed, significant

Severity = Literal['info', 'warning', 'error']

SEVERITIES: tuple[Severity, ...] = ('error', 'warning', 'info')
"""Severities, the most severe first."""

QUANTITIES = ('Q', 'N', 'B', 'K', 'R', 'signal')
"""Quantities of a sensor: the coefficients, and its samples (also the Allan deviation)."""


def quantity(
    value: float | None,
    sensor: str,
    name: str,
    ci95: Ends | None = None,
    upper95: float | None = None,
) -> Estimate:
    """Return a coefficient or a signal of a sensor in SI, for a finding.

    ``name`` is one of `QUANTITIES`; ``upper95`` is the limit of a quantity without a value.

    >>> quantity_text(quantity(1e-4, 'gyro', 'N', (0.9e-4, 1.1e-4)))
    '0.344 deg/sqrt(h) (0.309 to 0.378)'
    """
    unit = SI_UNITS[sensor][_coefficient(name)]
    return Estimate(value, ci95, upper95, name=name, unit=unit, axis=sensor)


def quantity_text(known: Estimate, units: str = 'deg/h', digits: int = 3) -> str:
    """Return a quantity with its unit and its interval, or ``< limit``."""
    return _quantities_text([known], digits, units, str)


class Texts(NamedTuple):
    """Message and remedy of a finding, with its numbers filled in."""

    message: str
    remedy: str


@dataclass(frozen=True)
class Finding:
    """A message to the user, with its numbers.

    Attributes
    ----------
    id : str
        Key of the catalog.
    severity : 'error', 'warning' or 'info'
    axes : tuple of str
        The affected axes; empty for all of them.
    values : mapping of str to int, float, str or Estimate
        The numbers of the texts: quantities in SI, times in s, frequencies in Hz, shares of 1. In
        a merged finding, a tuple contains the different values of its axes.
    """

    id: str
    severity: Severity
    message_template: str = field(repr=False)
    remedy_template: str = field(repr=False)
    axes: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def texts(self, units: str = 'deg/h', spelled: Callable[[str], str] = str) -> Texts:
        """Return the texts in the given units; ``spelled`` returns the spelling of a unit."""
        fill = partial(_filled, values=self.values, units=units, spelled=spelled)
        return Texts(fill(self.message_template), fill(self.remedy_template))

    @property
    def message(self) -> str:
        """The cause with its numbers, in the units of datasheets."""
        return self.texts().message

    @property
    def remedy(self) -> str:
        """The next step."""
        return self.texts().remedy

    def __str__(self) -> str:
        where = f'{", ".join(self.axes)}: ' if self.axes else ''
        return where + ' '.join(self.texts())

    def document(self, units: str = 'deg/h') -> dict[str, Any]:
        """Return the finding as a JSON object: its texts, and its values in SI."""
        return {
            'id': self.id,
            'severity': self.severity,
            **self.texts(units)._asdict(),
            'axes': list(self.axes),
            'values': {name: _plain(value) for name, value in self.values.items()},
        }


def _catalog(text: str) -> Iterator[Finding]:
    """Yield each kind of finding without values."""
    for entry in re.split(r'\n(?=\w)', re.sub(r'(?m)^(#.*)?\n|^\[.*\n( .*\n)*', '', text)):
        head, _, words = entry.partition('\n')
        id, _, severity = head.partition(': ')
        message, _, remedy = (' '.join(part.split()) for part in words.partition('  > '))
        yield Finding(id, severity, message, remedy)  # type: ignore[arg-type]


_TEXT = (get_data(__package__, 'findings.txt') or b'').decode()

CATALOG = {one.id: one for one in _catalog(_TEXT)}
"""Finding by id, without values."""

_FAULTS, _NUMBERS, LIVE, UNUSABLE = (
    re.findall(rf'(?m)^\[{name}\]\n((?: .*\n)*)', _TEXT)[0].split()
    for name in ('faults', 'numbers', 'live', 'unusable')
)
"""Lists of ids, described in the catalog."""

MINOR: dict[str, Callable[[Mapping[str, Any]], bool]] = {
    'level_changes': lambda of: of['high'].value < 1.1 * of['low'].value,
    'lack_of_fit': lambda of: abs(of['deviation']) < 0.05,
    'tilted': lambda of: of['angle'] < 1.0,
}
"""Id -> whether values are so small that a filter is not affected: the severity is then info. The
limit of a tilt is in deg."""

FIELD = re.compile(r'\{(\w+)(?::([^{}]*))?\}')
"""A template field ``{name}`` or ``{name:format}``. The format is one of Python, ``duration`` for a
time in s, one of `QUANTITIES` with the number of digits (3 by default), or ``singular|plural``: the
first text if the value is 1."""

OPTIONAL = re.compile(r'\[\[(.*?)\]\]')
"""A part of a template that is omitted if one of its values is missing."""


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding ``id`` of the catalog.

    ``axes`` are the affected axes; empty for all. ``values`` must contain every field of the
    templates that is not in an optional part. Only ``when``, a text such as ' in the last minute',
    is '' by default. A quantity is an `Estimate` of `quantity`, or a number in SI for the sensor of
    the axes.
    """
    values = {'when': '', **values}
    known, used = CATALOG[id], {}
    for name, spec in _fields(known):
        value = values.get(name)
        if spec.rstrip('0123456789') in QUANTITIES and isinstance(value, (int, float)):
            sensor = str(values['sensor'] if 'sensor' in values else sensor_of(axes[0]))
            value = quantity(value, sensor, spec.rstrip('0123456789'))
        used[name] = _value(value)
    if missing := [name for name in required(known) if used[name] is None]:
        raise KeyError(f'{id}: {", ".join(missing)}')
    severity = 'info' if id in MINOR and MINOR[id](used) else known.severity
    return replace(known, severity=severity, axes=axes, values=used)


def _value(value: Any) -> Any:
    """Return a value as it is stored: a number, a quantity, quantities, or text."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple) and all(isinstance(each, Estimate) for each in value):
        return value
    known = isinstance(value, (int, float, Estimate)) or value is None
    return value if known else str(value)


def _fields(known: Finding, optional: bool = True) -> list[tuple[str, str]]:
    """Return the names and formats of the fields of both templates."""
    both = f'{known.message_template} {known.remedy_template}'
    return FIELD.findall(both if optional else OPTIONAL.sub('', both))


def required(known: Finding) -> list[str]:
    """Return the names of the values without which the texts are incomplete."""
    return [name for name, _ in _fields(known, optional=False)]


class Several(tuple):  # type: ignore[type-arg]
    """The different values of several axes; the text contains their range."""


def _filled(
    template: str, values: Mapping[str, Any], units: str, spelled: Callable[[str], str]
) -> str:
    """Return a template with its values inserted."""

    def optional(part: re.Match[str]) -> str:
        names = [name for name, _ in FIELD.findall(part[1])]
        return '' if any(values.get(name) is None for name in names) else part[1]

    def inserted(place: re.Match[str]) -> str:
        name, spec = place[1], place[2] or ''
        if name not in values:
            return str(place[0])
        value = values[name]
        if '|' in spec:
            one, many = spec.split('|')
            return one if value == 1 else many
        return _text_of(value if isinstance(value, Several) else [value], spec, units, spelled)

    return FIELD.sub(inserted, OPTIONAL.sub(optional, template))


def _text_of(values: Sequence[Any], spec: str, units: str, spelled: Callable[[str], str]) -> str:
    """Return a value as text, or the range of several values."""
    if all(isinstance(value, Estimate) for value in values):
        return _quantities_text(values, int(spec.lstrip('QNBKRsignal') or 3), units, spelled)
    if isinstance(values[0], tuple):
        return ', '.join(f'{q.name} {_text_of([q], spec, units, spelled)}' for q in values[0])
    texts = [_plain_text(value, spec) for value in (min(values), max(values))]
    low, high = texts if len(values) > 1 else (texts[0], texts[0])
    number, _, unit = low.partition(' ')
    if low == high:
        return low
    return f'{number if high.endswith(f" {unit}") else low} to {high}'


def _plain_text(value: Any, spec: str) -> str:
    if value is None or isinstance(value, str):
        return one_line(value or '')
    if spec == 'duration':
        return duration_text(value)
    if spec.rstrip('0123456789') in QUANTITIES:
        spec = '.3g'
    return format(value, spec).replace('%', ' %')


def _quantities_text(
    quantities: Sequence[Estimate], digits: int, units: str, spelled: Callable[[str], str]
) -> str:
    """Return quantities of one kind as one text, such as '2 to 3 deg/h (1.5 to 4.1)'."""
    known = [q.value for q in quantities if q.value is not None]
    ends = [q.ci95 for q in quantities if q.ci95 is not None]
    limits = [q.upper95 for q in quantities if q.upper95 is not None]
    first, size = quantities[0], max(map(abs, known or limits), default=0.0)
    unit = prefixed(shown_unit(first.axis, _coefficient(first.name), units), size)
    if first.name == 'signal' and unit.name == 'deg/h' and size * unit.factor >= FAST_DEG_H:
        unit = shown_unit(first.axis, 'signal', units)

    def text(value: float) -> str:
        return significant(value * unit.factor, digits)

    if not known:
        return f'< {text(size)} {spelled(unit.name)}'
    values = dict.fromkeys(text(value) for value in (min(known), max(known)))
    interval = ''
    if ends:
        lowest, highest = min(low for low, _ in ends), max(high for _, high in ends)
        interval = f' ({text(lowest)} to {text(highest)})'
    return f'{" to ".join(values)} {spelled(unit.name)}{interval}'


def _coefficient(term: str) -> str:
    """Return the coefficient that has the same unit as a quantity."""
    return 'B' if term == 'signal' else term


def grouped(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Merge the findings of several axes that differ only in numbers, and sort all findings.

    The text of a merged finding contains the ranges of the numbers: "Vibration at 0.573 to 0.579
    Hz". The order is by `by_consequence`.
    """
    groups: dict[Hashable, list[Finding]] = {}
    for each in findings:
        values = each.values.items()
        alike = tuple((n, _kind(v)) for n, v in values) if each.axes else tuple(values)
        key = (each.id, each.severity, each.message_template, each.remedy_template, alike)
        groups.setdefault(key, []).append(each)
    return by_consequence(_merged(group) for group in groups.values())


def _kind(value: Any) -> Hashable:
    """Return what must be equal in the values of findings that are merged."""
    if isinstance(value, Estimate):
        return value.axis, value.name, value.value is None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return int if is_number else value


def _merged(alike: Sequence[Finding]) -> Finding:
    values = {}
    for name in alike[0].values:
        several = Several(dict.fromkeys(each.values[name] for each in alike))
        values[name] = several if len(several) > 1 else several[0]
    axes = tuple(dict.fromkeys(axis for each in alike for axis in each.axes))
    return replace(alike[0], axes=axes, values=values)


def by_consequence(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings in the order of their effect on the user, the largest first.

    Faults come first, then what changes the numbers for a filter, other warnings, and notes. The
    groups are in the order of the catalog.
    """
    return tuple(sorted(findings, key=_rank))


def is_note(finding: Finding) -> bool:
    """Return whether a finding affects neither the data nor the numbers."""
    return _rank(finding)[0] == len(SEVERITIES)


def _rank(finding: Finding) -> tuple[int, int]:
    """Return the group of a finding and its place in this group."""
    known = CATALOG.get(finding.id, finding)
    if finding.severity == known.severity:
        for group, ids in enumerate((_FAULTS, _NUMBERS)):
            if finding.id in ids:
                return group, ids.index(finding.id)
    group = {'error': 0, 'warning': 1, 'info': len(SEVERITIES)}[finding.severity]
    return group, len(_TEXT)


def _plain(value: Any) -> Any:
    if isinstance(value, Estimate):
        low, high = value.ci95 or (None, value.upper95)
        known = {'value': value.value, 'sensor': value.axis, 'term': value.name}
        return {**known, 'low': low, 'high': high, 'unit': value.unit}
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return value if not isinstance(value, float) or math.isfinite(value) else None


FAST_DEG_H = 36.0
"""Angular rate in deg/h from which a signal is printed in deg/s."""
