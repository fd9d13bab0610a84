# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that filters and calibration tools read, each written by the module of its name.

A new target is a module beside this file, with ``FILE_NAME`` and
``render(results, options) -> str``, and a line in `TARGETS`. What all share (which axis, interval,
limits) is in `levels`.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path

from ...core.errors import AllanError
from ..atomic import write_atomic
from ..results import Results
from .levels import ExportOptions

__all__ = ['TARGETS', 'ExportOptions', 'export']

TARGETS = {
    'kalibr': 'Kalibr imu.yaml: continuous-time N and K',
}
"""Target -> what its file is."""


def export(
    results: Results,
    target: str,
    folder: str | os.PathLike[str],
    options: ExportOptions = ExportOptions(),
) -> Path:
    """Write the target's file into the folder and return its path.

    Raises
    ------
    AllanError
        When the target is unknown, or the results lack what its file must hold.
    """
    if target not in TARGETS:
        raise AllanError(f'target {target!r} is unknown: choose one of {", ".join(TARGETS)}')
    module = importlib.import_module(f'.{target}', __package__)
    path = Path(folder) / str(module.FILE_NAME)
    write_atomic(path, module.render(results, options))
    return path
