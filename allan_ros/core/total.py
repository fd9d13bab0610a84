# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Add what several runs of one IMU know, sensor by sensor."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from .errors import AllanError
from .sums import AllanSums


def add_sums(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> tuple[AllanSums, ...]:
    """Return the sums of both runs: those of the same axes added, neither argument changed.

    A run has one `AllanSums` with all axes, or one a sensor where their rates differ. A run that
    has none yet adds nothing.

    Raises
    ------
    AllanError
        When the two are of different IMUs, rates, or axes.
    """
    if not a or not b:
        return tuple(a or b)
    if [s.axes for s in a] != [s.axes for s in b]:
        shown = (' and '.join(', '.join(s.axes) for s in run) for run in (a, b))
        raise AllanError(
            f'sums of {next(shown)} and of {next(shown)} do not add: the sensors of the two runs '
            'differ, analyse them apart'
        )
    return tuple(x + y for x, y in zip(a, b))


def refuse_strangers(a: Sequence[AllanSums], b: Sequence[AllanSums]) -> None:
    """Do nothing if both may be of one stream, one of them later on with more axes.

    Raises
    ------
    AllanError
        When an axis that both have is of different IMUs or rates.
    """
    for x, y in product(a, b):
        if not set(x.axes).isdisjoint(y.axes):
            x.refuse_stranger(y)
