# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Findings: reports to the user about a recording or a running node, as data objects.

A finding has an id from the catalog ``findings.txt``, and values such as coefficients or times.
`view.finding_text` makes its text.
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
"""Quantities of a sensor: its coefficients, and 'signal' for its samples or Allan deviation."""


def quantity(
    value: float | None,
    sensor: str,
    name: str,
    ci95: Ends | None = None,
    upper95: float | None = None,
) -> Estimate:
    """Return a quantity of a sensor as an `Estimate` in SI, for a finding.

    Parameters
    ----------
    value : float or None
        The value in SI; None if only the upper limit is known.
    sensor : str
        'gyro' or 'accel'.
    name : str
        One of `QUANTITIES`.
    ci95 : (low, high) or None
        95 % interval in SI.
    upper95 : float or None
        95 % upper limit in SI, for a quantity without a value.

    Raises
    ------
    KeyError
        When the sensor or the name is unknown.

    >>> quantity(1e-4, 'gyro', 'N', (0.9e-4, 1.1e-4))
    0.0001000 (9.00e-05..0.000110) rad/s/sqrt(Hz)
    """
    unit = SI_UNITS[sensor][unit_term(name)]
    return Estimate(value, ci95, upper95, name=name, unit=unit, axis=sensor)


def unit_term(name: str) -> str:
    """Return the coefficient that has the same unit as the quantity ``name`` of `QUANTITIES`."""
    return 'B' if name == 'signal' else name


@dataclass(frozen=True)
class Finding:
    """A message to the user, as data.

    Attributes
    ----------
    id : str
        Id of the finding in the catalog, such as 'vibration'.
    severity : 'error', 'warning' or 'info'
    axes : tuple of str
        The affected axes; empty if all axes are affected, or if the finding is not about axes.
    values : mapping of str to int, float, str, Estimate, tuple or None
        The values in the text: quantities in SI, times in s, frequencies in Hz, angles in deg,
        shares from 0 to 1. An optional value is None if it is missing. In a merged finding, a value
        is a tuple if the axes have different values.
    stated : (message, remedy) or None
        Text of a finding that was read from a document of another version, if the present catalog
        does not contain its id or its values; else None.
    """

    id: str
    severity: Severity
    axes: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    stated: tuple[str, str] | None = None

    def __str__(self) -> str:
        axes = f' ({", ".join(self.axes)})' if self.axes else ''
        values = (f'{name} {value}' for name, value in self.values.items() if value is not None)
        return one_line(f'{self.id}{axes}: {", ".join(values)}')

    def document(self) -> dict[str, Any]:
        """Return the finding as a JSON object; its values keep their units."""
        texts = dict(zip(('message', 'remedy'), self.stated)) if self.stated else {}
        return {
            'id': self.id,
            'severity': self.severity,
            **texts,
            'axes': list(self.axes),
            'values': {name: _plain(value) for name, value in self.values.items()},
        }


class CatalogEntry(NamedTuple):
    """Severity of a finding, and the values that its text contains, according to the catalog.

    ``values`` maps the name of each value to one of `QUANTITIES`, or to '' if the value is not a
    quantity. ``optional`` contains the names of values that may be missing.
    """

    severity: Severity
    values: Mapping[str, str]
    optional: frozenset[str]


def _catalog(text: str) -> Iterator[tuple[str, CatalogEntry]]:
    """Yield the id and the entry of each finding in the text of the catalog."""
    for entry in re.findall(r'(?m)^\w+:.*(?:\n .*)*', re.sub(r'(?m)^\[.*\n(?: .*\n)*', '', text)):
        id_and_severity, *names = entry.replace(': ', ':', 1).split()
        id, _, severity = id_and_severity.partition(':')
        pairs = (name.rstrip('?').partition(':')[::2] for name in names)
        optional = (name.rstrip('?').partition(':')[0] for name in names if name.endswith('?'))
        yield id, CatalogEntry(severity, dict(pairs), frozenset(optional))


_TEXT = (get_data(__package__, 'findings.txt') or b'').decode()

CATALOG = dict(_catalog(_TEXT))
"""Id of a finding -> entry of the catalog."""

_FAULTS, _NUMBERS, LIVE, UNUSABLE = (
    re.findall(rf'(?m)^\[{name}\]\n((?: .*\n)*)', _TEXT)[0].split()
    for name in ('faults', 'numbers', 'live', 'unusable')
)
"""Ids of the findings in the lists ``faults``, ``numbers``, ``live`` and ``unusable`` of
``findings.txt``. Comments in this file describe the lists."""

MINOR: dict[str, Callable[[Mapping[str, Any]], bool]] = {
    'level_changes': lambda values: values['high'].value < 1.1 * values['low'].value,
    'lack_of_fit': lambda values: abs(values['deviation']) < 0.05,
    'tilted': lambda values: values['angle'] < 1.0,
}
"""Id of a finding -> function that returns whether the values of the finding are too small to
affect a state estimator. Such a finding has the severity info. The angle of a tilt is in deg."""


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding ``id`` of the catalog.

    Parameters
    ----------
    id : str
        Id of the finding in the catalog.
    axes : tuple of str
        The affected axes; empty for all axes, or if the finding is not about axes.
    values : int, float, str, Estimate or tuple of Estimate
        The values that the catalog lists for this id; other values are ignored. Only optional
        values and ``when``, a text such as ' in the last 20 s', may be missing. A quantity is given
        as the result of `quantity`, or as a number in SI. The sensor of such a number is the value
        ``sensor`` or, if this value is missing, the sensor of the first axis.

    Raises
    ------
    KeyError
        When the id is unknown, or a value is missing.
    IndexError
        When a quantity is a number, and neither ``sensor`` nor an axis is given.
    """
    entry, stored = CATALOG[id], {}
    for name, term in entry.values.items():
        value = values.get(name, '' if name == 'when' else None)
        if term and isinstance(value, (int, float)):
            value = quantity(value, str(values.get('sensor') or sensor_of(axes[0])), term)
        stored[name] = _value(value)
    if missing := missing_values(entry, stored):
        raise KeyError(f'{id}: {", ".join(missing)}')
    severity = 'info' if id in MINOR and MINOR[id](stored) else entry.severity
    return Finding(id, severity, axes, stored)


def missing_values(known: CatalogEntry, values: Mapping[str, Any]) -> list[str]:
    """Return the names of the values that the entry ``known`` requires and ``values`` lacks."""
    return [
        name for name in known.values if name not in known.optional and values.get(name) is None
    ]


def _value(value: Any) -> Any:
    """Convert a value to a type that a finding stores: a number, Estimate, text, tuple or None."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple) and all(isinstance(each, Estimate) for each in value):
        return value
    is_storable = isinstance(value, (int, float, Estimate)) or value is None
    return value if is_storable else str(value)


class Several(tuple):  # type: ignore[type-arg]
    """The different values of a number on several axes; a message states their range."""


def grouped(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Merge the findings of several axes that differ only in numbers, and sort all findings.

    A merged finding contains the different values of each number. `by_consequence` defines the
    order.
    """
    groups: dict[Hashable, list[Finding]] = {}
    for each in findings:
        values = each.values.items()
        equal_parts = tuple((n, _kind(v)) for n, v in values) if each.axes else tuple(values)
        key = (each.id, each.severity, each.stated, equal_parts)
        groups.setdefault(key, []).append(each)
    return by_consequence(_merged(group) for group in groups.values())


def _kind(value: Any) -> Hashable:
    """Return the part of a value that must be equal for two findings to be merged."""
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
    """Return findings sorted by their consequence for the user, the most serious finding first.

    The order is: faults, other errors, findings that change the numbers for a state estimator,
    other warnings, notes. Within the faults, and within the findings that change the numbers, the
    lists in the catalog define the order.
    """
    return tuple(sorted(findings, key=_rank))


def is_note(finding: Finding) -> bool:
    """Return whether a finding affects neither the data nor the numbers for a state estimator."""
    return _rank(finding)[0] == len(SEVERITIES)


def _rank(finding: Finding) -> tuple[int, int]:
    """Return the group of a finding and its place in this group, as a key for sorting."""
    entry = CATALOG.get(finding.id)
    if entry is not None and finding.severity == entry.severity:
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
