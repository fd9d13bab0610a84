# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration files of state estimators, calibration tools and simulators.

A `Target` describes one file: its keys (`Key`), the convention of its numbers and the source of
this convention, and its format. The module `filter_noise` computes the `Row` of each key from the
noise model. The module `computed` computes rows without a `Key`. The module `targets` contains all
targets.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import AllanError, one_line
from ..core.estimate import LIMIT_DIGITS, duration_text, significant
from ..core.filters.noise_parameters import horizon_text
from ..core.findings import Finding, finding
from ..core.settings import expect
from ..readers.files import MAX_BYTES, open_regular, write_atomic
from ..readers.recording import listed
from ..results.from_datasheet import FROM_DATASHEET
from ..results.results import MOTION_MEASURED
from ..version import __version__
from .filter_noise import REFUSED, FilterNoise
from .target import RAISED, Export, ExportOptions, Row, Target, origin_text
from .targets import TARGETS

if TYPE_CHECKING:
    from ..core.estimate import Estimate
    from ..core.filters.motion_factors import SensorInMotion
    from ..results.results import Results

__all__ = [
    'RAISED',
    'TARGETS',
    'Export',
    'ExportOptions',
    'Row',
    'check_own_output',
    'make_export',
    'origin_text',
    'target_of',
    'target_rows',
    'write_export',
]

WITHOUT_PARAMETERS = ('robot_localization', 'fuse')
"""State estimators without noise parameters: they read the covariances in each Imu message."""


def target_of(name: str) -> Target:
    """Return the export target with this name; raise AllanError if there is no such target."""
    expect(str, target=name)
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
    """Return the rows of an export target that contain a measured number with a unit (`Row.unit`).

    The rows are used to set parameters of a running state estimator. ``results``, ``name`` and
    ``options`` are the same as in `make_export`. ``bias`` is axis -> bias at rest in SI. The gain
    of a state estimator without a bias state is raised to cover this bias. Leave ``bias`` empty if
    the bias is subtracted from the samples.

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
    AllanError when the target is unknown, or the results lack the sample rate, a number or the
    factors in motion that the file needs. Unless ``options.force`` is set, also raises AllanError
    when the samples are probably not in SI units, or the recording does not show the noise of the
    sensor.
    """
    target = target_of(name)
    noise = FilterNoise(results, options, target)
    rows = noise.rows()
    text = target.form(rows, _header_lines(name, noise, rows, words))
    findings = [note for row in rows for note in row.findings] + noise.findings()
    for id, keys in (
        ('export_limits', [row.key for row in rows if row.is_limit]),
        ('export_no_interval', [row.key for row in rows if row.no_interval]),
    ):
        if keys and results.method != FROM_DATASHEET:
            findings.append(finding(id, keys=', '.join(dict.fromkeys(keys))))
    return Export(text, tuple(dict.fromkeys(findings)))


OWN_OUTPUT = re.compile(rb'\ballan_ros \d')
"""Pattern of the name and version of this package in the header of every exported file."""


def write_export(
    path: str | os.PathLike[str], name: str, text: str, overwrite: bool = False
) -> Path:
    """Write the text of an export target to a file, and return the path of the file.

    Parameters
    ----------
    path : path
        The file, or an existing folder for the file.
    name : str
        The export target, one of `TARGETS`.
    text : str
        The text of the file, from `make_export`.
    overwrite : bool
        Whether a file that was not written by this package is replaced.

    Raises
    ------
    AllanError
        When the file cannot be written, or may not be replaced.
    """
    file = Path(path) / target_of(name).file_name if os.path.isdir(path) else Path(path)
    if not overwrite:
        check_own_output(file)
    write_atomic(file, text)
    return file


def check_own_output(path: Path) -> None:
    """Raise AllanError if there is a file that is neither empty nor contains `OWN_OUTPUT`.

    Also raises AllanError if the path is a folder or a device.
    """
    try:
        with open_regular(path) as file:
            content = file.read(MAX_BYTES)
    except OSError:  # the file is missing, or the error is reported when the file is written
        return
    if content and not OWN_OUTPUT.search(content):
        raise AllanError(
            f'{path}: was not written by allan_ros: choose another name, or use --overwrite '
            '(in Python overwrite=True)'
        )


# --- header ---------------------------------------------------------------------------------------

NAMED_SOURCES = 3
"""Largest number of recordings that the header comment names; further recordings are counted."""


def _header_lines(
    name: str, noise: FilterNoise, rows: Sequence[Row], words: Callable[[Finding], str]
) -> list[str]:
    """Return the lines of the header comment, without comment marks.

    The lines state, for example, the source, the convention, the rate and warnings. ``name`` is the
    name of the target, and ``words`` returns the text of a finding.
    """
    results, target = noise.results, noise.target
    limit_keys = dict.fromkeys(row.key for row in rows if row.is_limit)
    keys_without_interval = dict.fromkeys(row.key for row in rows if row.no_interval)
    first_ids = (*REFUSED, 'from_datasheet')
    subject = 'Bias of an IMU over' if name == 'temperature' else 'IMU noise for'
    start = results.provenance.start
    title = [
        f'{subject} {name}, measured by allan_ros {__version__} (method {results.method})',
        f'source: {_sources(results)}; {duration_text(results.duration_s, 3)} at rest, '
        f'{significant(results.rate_hz, 5)} Hz',
        f'date: recorded from {start:%Y-%m-%d %H:%M:%S} UTC on' if start else 'date: not known',
    ]
    if results.method == FROM_DATASHEET:
        title = [
            f'IMU noise for {name}, from the datasheet of {results.identity.frame_id} and not '
            f'measured (allan_ros {__version__})',
            *(f'source: {source.path}' for source in results.provenance.sources),
        ]
    axes = 'one number for each of x, y, z' if target.three else 'the largest number of x, y, z'
    lines = [
        *(f'warning: {words(note)}' for note in results.findings if note.id in first_ids),
        *title,
        f'convention: {target.convention}',
        f'rate: f = {noise.rate:g} Hz, {noise.rate_words}',
        f'axes: {axes}; inflation: {_inflation(noise)}',
    ]
    if noise.options.fidelity == 'coefficients':
        lines.append('fidelity: N and K as measured; they underestimate flicker and drift')
    elif noise.used:
        smallest_ratios, largest_ratios = zip(*(reduced.ratio for reduced in noise.used.values()))
        lines.append(
            'reduction: N and K bound the error growth of the complete model over '
            f'{horizon_text(noise.horizon)}: they predict {min(smallest_ratios):.2f} to '
            f'{max(largest_ratios):.2f} times this growth'
        )
    lines += [
        *(f'{row.key} {row.words}' for row in rows if row.words),
        f'upper limits instead of measurements: {", ".join(limit_keys) or "none"}',
        *(
            [f'values without a 95 % interval: {", ".join(keys_without_interval)}']
            if keys_without_interval
            else []
        ),
        *(f'note: {note}' for note in target.notes),
        *(
            f'note: {words(note)}'
            for note in results.findings
            if noise.options.motion and note.id in MOTION_MEASURED
        ),
        *dict.fromkeys(f'note: {words(note)}' for row in rows for note in row.findings),
        *(f'warning: {words(note)}' for note in noise.findings()),
        *(
            f'warning: {words(note)}'
            for note in results.findings
            if note.severity != 'info' and note.id not in first_ids
        ),
    ]
    return [one_line(line) for line in lines]


def _inflation(noise: FilterNoise) -> str:
    """Return a text for the header: the factors by which the noise is multiplied."""
    note, motion = 'the levels below are without these factors', noise.results.motion
    if noise.options.motion and motion is not None:
        factors_in_motion = ', '.join(
            f'{name} {_factors_text(sensor_in_motion)}'
            for name, sensor_in_motion in motion.sensors.items()
        )
        return f'in motion, {factors_in_motion}, from {len(motion.drives)} drives; {note}'
    factors = noise.options.factors
    distinct_factors = set(factors.values())
    if distinct_factors == {1.0}:
        return 'none'
    factor_of_each = ', '.join(f'{sensor} x{factor:g}' for sensor, factor in factors.items())
    factor_text = factor_of_each if len(distinct_factors) > 1 else f'x{distinct_factors.pop():g}'
    return f'{factor_text} on every N, K and bias; {note}'


def _factors_text(sensor: SensorInMotion) -> str:
    """Return the factors of a sensor in motion as text, such as 'N x2.70 (2.20 to 3.30)'."""
    terms: dict[Estimate, list[str]] = {}
    for term, factor in sensor.term_factors.items():
        terms.setdefault(factor, []).append(term)
    texts = []
    for factor, names in terms.items():
        value, low, high = (
            significant(x, LIMIT_DIGITS)
            for x in (factor.value or 1.0, *(factor.ci95 or (0.0, math.inf)))
        )
        remark = '' if (factor.value or 0.0) > 1.0 else 'not raised, '
        texts.append(f'{" and ".join(names)} {remark}x{value} ({low} to {high})')
    return ' and '.join(texts)


def _sources(results: Results) -> str:
    sources = [f'{s.path} {s.topic}'.strip() for s in results.provenance.sources]
    return listed(sources, NAMED_SOURCES) or 'sums without a recording'
