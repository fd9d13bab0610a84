# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Examples of every finding of the catalog."""

from __future__ import annotations

from allan_ros.core.findings import CATALOG, FIELD, OPTIONAL, QUANTITIES, Finding, finding


def templates(known: Finding) -> str:
    return f'{known.message_template} {known.remedy_template}'


def value_of(spec: str, number: float) -> object:
    """Return a value for a field with this format."""
    if spec.rstrip('0123456789') in QUANTITIES or '.' in spec or spec == 'duration':
        return number
    return int(number) if spec == 'd' or '|' in spec else 'words'


def example(id: str, number: float = 2.0, axis: str = 'gyro_x', optional: bool = True) -> Finding:
    """Return a finding of the catalog whose numbers all have the same value in SI."""
    text = templates(CATALOG[id])
    specs = dict(reversed(FIELD.findall(text if optional else OPTIONAL.sub('', text))))
    values = {name: value_of(spec, number) for name, spec in specs.items()}
    return finding(id, (axis,), **{**values, 'sensor': axis[:-2]})
