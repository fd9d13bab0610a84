# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One home per default: settings are frozen dataclasses whose fields say unit, range and meaning.

The command line builds its options from them and the nodes declare their parameters from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from .errors import AllanError


@dataclass(frozen=True)
class ParameterInfo:
    """What a person needs to know of one setting."""

    doc: str
    unit: str = ''
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False


def parameter(default: Any, doc: str, **info: Any) -> Any:
    """Return a dataclass field that carries its default and its `ParameterInfo`."""
    return field(default=default, metadata={'info': ParameterInfo(doc, **info)})


def describe(settings: Any) -> dict[str, ParameterInfo]:
    """Return name -> info of every field of a settings class or instance, in order."""
    return {f.name: f.metadata['info'] for f in fields(settings) if 'info' in f.metadata}


def check(settings: Any) -> None:
    """Refuse a setting outside its range; call it from ``__post_init__``.

    Raises
    ------
    AllanError
        Naming the setting, its value, its range and unit.
    """
    for name, info in describe(settings).items():
        value = getattr(settings, name)
        if info.choices and value not in info.choices:
            raise AllanError(f'{name} is {value!r}: choose one of {", ".join(info.choices)}')
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        low = -math.inf if info.low is None else info.low
        high = math.inf if info.high is None else info.high
        if not low <= value <= high:
            unit = f' {info.unit}' if info.unit else ''
            raise AllanError(f'{name} is {value}: it must lie between {low:g} and {high:g}{unit}')
