# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All targets by name; the module of a target is imported when it runs."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial

from .harness import Target

NAMES: tuple[str, ...] = ('mcap', 'sqlite3', 'ros1', 'folder', 'tables', 'losses', 'hostile', 'imu')
NAMES += ('documents', 'absurd', 'nodes')


def _load(name: str) -> Target:
    target: Target = importlib.import_module(f'.{name}_target', __package__).TARGET
    return target


TARGETS: dict[str, Callable[[], Target]] = {name: partial(_load, name) for name in NAMES}
"""Name -> function that returns the target."""
