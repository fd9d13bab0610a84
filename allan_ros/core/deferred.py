# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Modules of scipy that are imported at their first use.

A node that only accumulates sums or relays samples needs none of them. It then starts half a second
earlier and uses 20 MB less memory.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Any

import numpy

UNUSED = ('f2py', 'testing')
"""Submodules of numpy that scipy 1.17 imports only because it copies all names of numpy (7 MB)."""


class DeferredModule:
    """A module that is imported when one of its functions is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        value = getattr(_import(self._name), name)
        setattr(self, name, value)
        return value


def _import(name: str) -> ModuleType:
    """Import a module of scipy, but not the submodules of numpy that are listed in `UNUSED`."""
    known = vars(numpy)
    deferred = {each: DeferredModule(f'numpy.{each}') for each in UNUSED if each not in known}
    known.update(deferred)
    try:
        return import_module(name)
    finally:
        for each, module in deferred.items():
            if known.get(each) is module:  # otherwise numpy has imported it meanwhile
                del known[each]


lapack = DeferredModule('scipy.linalg.lapack')
linalg = DeferredModule('scipy.linalg')
special = DeferredModule('scipy.special')
