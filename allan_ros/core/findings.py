# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings: what is reported to the user about a recording or a running node, as data.

A finding has an id of the catalog ``findings.txt`` and numbers. Its text is made at the output.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pkgutil import get_data
from typing import Any, Literal, NamedTuple

import numpy as np

from .errors import one_line
from .estimate import Ends, Estimate
from .imu import SI_UNITS, sensor_of

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

    >>> quantity(1e-4, 'gyro', 'N', (0.9e-4, 1.1e-4))
    0.0001000 (9.00e-05..0.000110) rad/s/sqrt(Hz)
    """
    unit = SI_UNITS[sensor][unit_term(name)]
    return Estimate(value, ci95, upper95, name=name, unit=unit, axis=sensor)


def unit_term(name: str) -> str:
    """Return the coefficient that has the same unit as one of the `QUANTITIES`."""
    return 'B' if name == 'signal' else name


@dataclass(frozen=True)
class Finding:
    """A message to the user, as data.

    Attributes
    ----------
    id : str
        Key of the catalog.
    severity : 'error', 'warning' or 'info'
    axes : tuple of str
        The affected axes; empty for all of them.
    values : mapping of str to int, float, str or Estimate
        The numbers of the text: quantities in SI, times in s, frequencies in Hz, shares of 1. In
        a merged finding, a tuple contains the different values of its axes.
    stated : (message, remedy) or None
        The text in the document of another version, which the present catalog cannot give.
    """

    id: str
    severity: Severity
    axes: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    stated: tuple[str, str] | None = None

    def __str__(self) -> str:
        where = f' ({", ".join(self.axes)})' if self.axes else ''
        known = (f'{name} {value}' for name, value in self.values.items() if value is not None)
        return one_line(f'{self.id}{where}: {", ".join(known)}')

    def document(self) -> dict[str, Any]:
        """Return the finding as a JSON object, with its values in SI."""
        words = dict(zip(('message', 'remedy'), self.stated)) if self.stated else {}
        return {
            'id': self.id,
            'severity': self.severity,
            **words,
            'axes': list(self.axes),
            'values': {name: _plain(value) for name, value in self.values.items()},
        }


class CatalogEntry(NamedTuple):
    """An entry of the catalog: the severity of a finding, and its values.

    ``values`` maps each name to one of `QUANTITIES`, or to '' for another value; ``optional`` are
    the names of values that may be missing.
    """

    severity: Severity
    values: Mapping[str, str]
    optional: frozenset[str]


def _catalog(text: str) -> Iterator[tuple[str, CatalogEntry]]:
    """Yield the id and the kind of each entry."""
    for entry in re.findall(r'(?m)^\w+:.*(?:\n .*)*', re.sub(r'(?m)^\[.*\n(?: .*\n)*', '', text)):
        head, *names = entry.replace(': ', ':', 1).split()
        id, _, severity = head.partition(':')
        pairs = (name.rstrip('?').partition(':')[::2] for name in names)
        optional = (name.rstrip('?').partition(':')[0] for name in names if name.endswith('?'))
        yield id, CatalogEntry(severity, dict(pairs), frozenset(optional))


_TEXT = (get_data(__package__, 'findings.txt') or b'').decode()

CATALOG = dict(_catalog(_TEXT))
"""Kind of finding by id."""

_FAULTS, _COUNTS, LIVE, UNUSABLE = (
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


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding ``id`` of the catalog.

    ``axes`` are the affected axes; empty for all. ``values`` must contain every value of the
    catalog that is not optional. Only ``when``, a text such as ' in the last 20 s', is '' by
    default. A quantity is an `Estimate` of `quantity`, or a number in SI for the sensor of the
    axes.
    """
    known, used = CATALOG[id], {}
    for name, term in known.values.items():
        value = values.get(name, '' if name == 'when' else None)
        if term and isinstance(value, (int, float)):
            value = quantity(value, str(values.get('sensor') or sensor_of(axes[0])), term)
        used[name] = _value(value)
    if missing := missing_values(known, used):
        raise KeyError(f'{id}: {", ".join(missing)}')
    severity = 'info' if id in MINOR and MINOR[id](used) else known.severity
    return Finding(id, severity, axes, used)


def missing_values(known: CatalogEntry, values: Mapping[str, Any]) -> list[str]:
    """Return the names of the values without which a text is incomplete."""
    return [
        name for name in known.values if name not in known.optional and values.get(name) is None
    ]


def _value(value: Any) -> Any:
    """Return a value as it is stored: a number, a quantity, quantities, or text."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple) and all(isinstance(each, Estimate) for each in value):
        return value
    known = isinstance(value, (int, float, Estimate)) or value is None
    return value if known else str(value)


class Several(tuple):  # type: ignore[type-arg]
    """The different values of several axes; the text contains their range."""


def grouped(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Merge the findings of several axes that differ only in numbers, and sort all findings.

    A merged finding has the different values of each number. The order is by `by_consequence`.
    """
    groups: dict[Hashable, list[Finding]] = {}
    for each in findings:
        values = each.values.items()
        alike = tuple((n, _kind(v)) for n, v in values) if each.axes else tuple(values)
        key = (each.id, each.severity, each.stated, alike)
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
    known = CATALOG.get(finding.id)
    if known is not None and finding.severity == known.severity:
        for group, ids in enumerate((_FAULTS, _COUNTS)):
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
