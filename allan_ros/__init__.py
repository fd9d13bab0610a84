# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise coefficients of IMUs by the Allan variance, with confidence intervals.

>>> import allan_ros as ar
>>> recording = ar.simulate(hours=0.2, rate=50, preset='paper')
>>> results = ar.analyze(recording)
>>> round(results['gyro_z'].N.to('deg/sqrt(h)').value, 2)
0.25
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:
    from .api.analysis import analyze, load
    from .api.classes import Results, sensor
    from .api.comparison import common, compare, inflate
    from .core.allan.curve import AxisCurve
    from .core.errors import AllanError
    from .core.estimate import Estimate
    from .results.axis_result import AxisResult, adev, fit
    from .results.simulation import simulate


__all__ = [
    'AllanError',
    'AxisCurve',
    'AxisResult',
    'Estimate',
    'Results',
    'adev',
    'analyze',
    'common',
    'compare',
    'fit',
    'inflate',
    'load',
    'sensor',
    'simulate',
]

_HOME = {
    **dict.fromkeys(('analyze', 'load'), 'api.analysis'),
    **dict.fromkeys(('common', 'compare', 'inflate'), 'api.comparison'),
    **dict.fromkeys(('Results', 'sensor'), 'api.classes'),
    'AllanError': 'core.errors',
    'AxisCurve': 'core.allan.curve',
    'Estimate': 'core.estimate',
    **dict.fromkeys(('AxisResult', 'adev', 'fit'), 'results.axis_result'),
    'simulate': 'results.simulation',
}


def keep_to_one_thread() -> None:
    """Limit the linear algebra of numpy to one thread.

    This function must be called before numpy is imported. The matrices of a fit have about a
    hundred rows: more threads do not make the fit faster, and their busy waiting triples the CPU
    time. The limits are environment variables; those that are already set are not changed.
    """
    for library in ('OPENBLAS', 'OMP', 'MKL'):
        os.environ.setdefault(f'{library}_NUM_THREADS', '1')


def __getattr__(name: str) -> Any:
    # A name is loaded when it is first used, so that importing the package is fast.
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'.{_HOME[name]}', __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
