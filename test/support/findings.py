# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Examples of every finding of the catalog."""

from __future__ import annotations

from allan_ros.core.findings import CATALOG, FIELD, OPTIONAL, QUANTITIES, Finding, finding


def templates(known: Finding) -> str:
    return f'{known.message_template} {known.remedy_template}'


def value_of(specs: list[str], number: float) -> object:
    """Return a value for a field that occurs with these formats."""
    if any('|' in spec for spec in specs):
        return 2
    first = specs[0].rstrip('0123456789')
    is_number = first in (*QUANTITIES, 'duration') or first.endswith(('g', 'f', '%'))
    return number if is_number else 'words'


def example(id: str, number: float = 2.0, axis: str = 'gyro_x', optional: bool = True) -> Finding:
    """Return a finding of the catalog whose numbers all have the same value in SI."""
    text = templates(CATALOG[id])
    specs: dict[str, list[str]] = {}
    for name, spec in FIELD.findall(text if optional else OPTIONAL.sub('', text)):
        specs.setdefault(name, []).append(spec)
    values = {name: value_of(found, number) for name, found in specs.items()}
    return finding(id, (axis,), **{**values, 'sensor': axis[:-2]})
