# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Examples of every finding of the catalog."""

from __future__ import annotations

from allan_ros.core.findings import CATALOG, Finding, finding
from allan_ros.view.finding_text import FIELD, OPTIONAL, words


def value_of(specs: list[str], quantity: str, number: float) -> object:
    """Return a value for a field that occurs with these formats."""
    if any('|' in spec for spec in specs):
        return 2
    is_number = quantity or specs[0] == 'duration' or specs[0].endswith(('g', 'f', '%'))
    return number if is_number else 'words'


def example(id: str, number: float = 2.0, axis: str = 'gyro_x', optional: bool = True) -> Finding:
    """Return a finding of the catalog whose numbers all have the same value in SI."""
    known = words()[id]
    text = f'{known.message} {known.remedy}'
    specs: dict[str, list[str]] = {}
    for name, spec in FIELD.findall(text if optional else OPTIONAL.sub('', text)):
        specs.setdefault(name, []).append(spec)
    kinds = CATALOG[id].values
    values = {name: value_of(found, kinds[name], number) for name, found in specs.items()}
    return finding(id, (axis,), **{**values, 'sensor': axis[:-2]})
