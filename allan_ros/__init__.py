# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of IMUs by Allan variance: coefficients with confidence intervals.

>>> import allan_ros as ar
>>> recording = ar.simulate(hours=0.2, rate=50, preset='paper')
>>> results = ar.analyze(recording)
>>> round(results['gyro_z'].N.to('deg/sqrt(h)').value, 2)
0.25
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import adev, analyze, compare, fit, inflate, merge, simulate
    from .core.errors import AllanError
    from .io.axis_result import AxisCurve, AxisResult, Quantity
    from .io.documents import load
    from .io.results import Results

__version__ = '1.0.0'

__all__ = [
    'AllanError',
    'AxisCurve',
    'AxisResult',
    'Quantity',
    'Results',
    'adev',
    'analyze',
    'compare',
    'fit',
    'inflate',
    'load',
    'merge',
    'simulate',
]

_HOME = {
    'AllanError': 'core.errors',
    'load': 'io.documents',
    **dict.fromkeys(('AxisCurve', 'AxisResult', 'Quantity'), 'io.axis_result'),
    'Results': 'io.results',
}


def __getattr__(name: str) -> Any:
    # Loaded on first use, so that importing the package takes no time.
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'.{_HOME.get(name, "api")}', __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
