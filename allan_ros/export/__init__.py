# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration files of state estimators, calibration tools and simulators.

A `Target` describes one file: its keys (`Key`), the convention of its numbers and the source of
this convention, and its format (module `text`). The module `filter_noise` computes the `Row` of
each key from the noise model. The module `computed` computes rows without a `Key`. The module
`targets` contains all targets.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..results.from_datasheet import FROM_DATASHEET
from .filter_noise import FilterNoise
from .target import RAISED, Export, ExportOptions, Row, Target, origin_text
from .targets import TARGETS
from .text import header_lines

if TYPE_CHECKING:
    from ..results.results import Results

__all__ = [
    'RAISED',
    'TARGETS',
    'Export',
    'ExportOptions',
    'Row',
    'make_export',
    'origin_text',
    'target_of',
    'target_rows',
]

WITHOUT_PARAMETERS = ('robot_localization', 'fuse')
"""State estimators without noise parameters: they read the covariances in each Imu message."""


def target_of(name: str) -> Target:
    """Return the export target with this name; raise AllanError if the name is unknown."""
    if name in WITHOUT_PARAMETERS:
        raise AllanError(
            f'{name} has no parameters for the noise of an IMU: it reads the covariances of the '
            'messages, which the node allan_imu_relay fills in; for the parameters of a driver, '
            'use the target covariance'
        )
    if name not in TARGETS:
        similar_names = difflib.get_close_matches(name.lower().replace('-', '_'), TARGETS, 1)
        advice = (
            f'did you mean {similar_names[0]}? The targets are'
            if similar_names
            else 'choose one of'
        )
        raise AllanError(f'target {name!r} is unknown: {advice} {", ".join(TARGETS)}')
    return TARGETS[name]


def target_rows(
    results: Results,
    name: str,
    options: ExportOptions = ExportOptions(),
    bias: Mapping[str, float] = {},
) -> tuple[Row, ...]:
    """Return the measured numbers of an export target, for parameters of a running state estimator.

    ``results``, ``name`` and ``options`` are the same as in `make_export`. ``bias`` is axis -> bias
    at rest in SI. The gain of a state estimator without a bias state is raised to cover this bias.
    Leave ``bias`` empty if the bias is subtracted from the samples.

    Raises
    ------
    AllanError
        Under the same conditions as in `make_export`.
    """
    rows = FilterNoise(results, options, target_of(name), bias).rows()
    return tuple(row for row in rows if row.unit)


def make_export(
    results: Results,
    name: str,
    options: ExportOptions = ExportOptions(),
    words: Callable[[Finding], str] = str,
) -> Export:
    """Return the configuration file of a state estimator or simulator with the measured noise.

    ``name`` is one of `TARGETS`, and ``words`` returns the text of a finding for the header. Raises
    AllanError when the target is unknown, or the results lack a number or the factors in motion
    that the file needs. Unless ``options.force`` is set, also raises AllanError when the samples
    are probably not in SI units, or the recording does not show the noise of the sensor.
    """
    target = target_of(name)
    noise = FilterNoise(results, options, target)
    rows = noise.rows()
    text = target.form(rows, header_lines(name, noise, rows, words))
    findings = [note for row in rows for note in row.findings] + noise.findings()
    for id, keys in (
        ('export_limits', [row.key for row in rows if row.is_limit]),
        ('export_no_interval', [row.key for row in rows if row.no_interval]),
    ):
        if keys and results.method != FROM_DATASHEET:
            findings.append(finding(id, keys=', '.join(dict.fromkeys(keys))))
    return Export(text, tuple(dict.fromkeys(findings)))
