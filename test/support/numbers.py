# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a number in a document may be."""

from __future__ import annotations

import math
from typing import Any

SIGNED = {'sign', 'slope', 'gof_z', 'start_ns', 'signed', 'phase', 'ramp_correction'}
"""Fields whose numbers may be below zero."""


def check_numbers(value: Any, key: str = '') -> None:
    """Raise unless every number of a document is finite, and none negative where it cannot be."""
    if isinstance(value, dict):
        for name, inner in value.items():
            check_numbers(inner, name)
    elif isinstance(value, (list, tuple)):
        for inner in value:
            check_numbers(inner, key)
    elif isinstance(value, (int, float)):
        assert type(value) in (bool, int, float), f'{key} is a {type(value).__name__}'
        assert math.isfinite(value), f'{key} is {value}'
        assert value >= 0 or key in SIGNED, f'{key} is {value}'
