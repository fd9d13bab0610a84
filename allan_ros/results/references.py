# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare results with the references that a user names: a datasheet, an earlier run, or both."""

from __future__ import annotations

import os
from dataclasses import replace
from numbers import Real
from typing import TypeVar

from ..core.errors import AllanError
from ..core.settings import expect
from ..readers.files import PATH
from .datasheets import Datasheet, load_sensor
from .documents import labels_of, load
from .results import Results

R = TypeVar('R', bound=Results)


def compared(
    results: R,
    sensor: Datasheet | str = '',
    baseline: Results | str | os.PathLike[str] = '',
    margin: float | None = None,
) -> R:
    """Return a copy of the results that is compared with a datasheet, an earlier run, or both.

    ``sensor`` is a datasheet, its name or its path, and ``baseline`` results or their path; '' for
    none. ``margin`` is the fraction by which a limit may be exceeded, by default that of the
    results. A comparison with a datasheet that the results contain is made again. Raises AllanError
    when a reference cannot be read, or the margin is negative.
    """
    expect((Results, *PATH), 'results or a path', baseline=baseline)
    expect((Datasheet, *PATH), 'a datasheet or its name', sensor=sensor)
    stated = results.margin if margin is None else margin
    expect(Real, margin=stated)
    if not stated >= 0.0:
        raise AllanError(f'margin is {stated:g}: give 0 or more')
    results = replace(results, margin=stated)
    if isinstance(baseline, Results):
        results = replace(results, baselines={'the earlier run': baseline})
    elif str(baseline):
        (label,) = labels_of([str(baseline)])
        results = replace(results, baselines={label: load(baseline)})
    sheet = results.datasheet
    if sensor:
        sheet = sensor if isinstance(sensor, Datasheet) else load_sensor(str(sensor))
    return results if sheet is None else results.against_datasheet(sheet, stated)
