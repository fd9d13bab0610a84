# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All noise processes, found in the modules of `allan_ros.core.noise.processes`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules

from . import processes
from .process import Process

LETTERS = 'QNBKR'
"""Letters of the five terms of IEEE Std 952-1997, in the order of all tables."""


def _classes() -> Iterator[type[Process]]:
    for module in iter_modules(processes.__path__):
        loaded = import_module(f'{processes.__name__}.{module.name}')
        for member in vars(loaded).values():
            if isinstance(member, type) and member.__module__ == loaded.__name__:
                yield member


def _sort_key(kind: type[Process]) -> tuple[int, int, str]:
    """Return the key by which the classes of processes are sorted: the five terms come first."""
    letter = LETTERS.find(kind.letter) if kind.letter else len(LETTERS)
    return len(kind.parameters) and len(LETTERS), letter, kind.name


PROCESSES: Mapping[str, type[Process]] = {
    one.name: one for one in sorted(_classes(), key=_sort_key)
}
"""Name of each process in documents -> class of the process. The terms Q, N, B, K, R come first."""

RANDOM_TERMS: tuple[Process, ...] = tuple(
    one()
    for one in PROCESSES.values()
    if one.letter and not one.parameters and not one.is_regressor
)
"""The random terms of IEEE Std 952-1997: Q, N, B and K."""

SEARCHED: tuple[type[Process], ...] = tuple(
    one
    for one in PROCESSES.values()
    if one.parameters and one.replaces is None and not one.is_regressor
)
"""Classes of the processes that a fit may add to the random terms."""

REPLACEMENTS: Mapping[type[Process], type[Process]] = {
    one.replaces: one for one in PROCESSES.values() if one.replaces is not None
}
"""Class of a term -> class of the process that replaces the term if the data show the shape of the
process."""
