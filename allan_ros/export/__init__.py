# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that filters, calibration tools and simulators read.

A `Target` describes one file: its keys (`Key`), their convention and its source, and the text
format. `model` computes the `Row` of each key from the noise model. Targets are in `targets` and,
if their rows are not in a table, in `computed`; a new one also needs a line in `TARGETS`.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..core.settings import CheckedSettings, parameter
from ..results.from_datasheet import FROM_DATASHEET

if TYPE_CHECKING:
    from ..core.filters.reductions import Level
    from ..results.results import Results
    from .model import FilterNoise

__all__ = ['TARGETS', 'Export', 'ExportOptions', 'make_export', 'target_of', 'target_rows']

TARGETS = {
    'kalibr': 'Kalibr imu.yaml: continuous densities N and K',
    'openvins': 'OpenVINS kalibr_imu_chain.yaml: continuous densities N and K',
    'vins_fusion': 'VINS-Mono and VINS-Fusion: std per sample, N sqrt(f) and K sqrt(f)',
    'orb_slam3': 'ORB-SLAM3 settings: continuous densities N and K, and the rate',
    'lio_sam': 'LIO-SAM ROS 2 parameters: continuous densities N and K',
    'fast_lio': 'FAST-LIO and FAST-LIO2 ROS 2 parameters: variances N^2 f and K^2 f',
    'fast_livo2': 'FAST-LIVO2 parameters: variance N^2 f',
    'point_lio': 'Point-LIO parameters: variances N^2 f and K^2 f',
    'glim': 'GLIM config_sensors.json: continuous density N, and K for the time between two scans',
    'lvi_sam': 'LVI-SAM params_lidar.yaml: continuous densities N and K',
    'gtsam': 'GTSAM PreintegrationCombinedParams in Python: continuous covariances N^2 and K^2',
    'basalt': 'Basalt calibration JSON: continuous densities N and K of each axis',
    'msckf_vio': 'MSCKF_VIO parameters: continuous densities N and K',
    'px4': 'PX4 EKF2 parameters: std per EKF step, within their ranges',
    'ardupilot': 'ArduPilot EK3 parameters: std per EKF step, within their ranges',
    'kf_gins': 'KF-GINS imunoise: deg/sqrt(hr), m/s/sqrt(hr) and a Gauss-Markov bias, of each axis',
    'pyins': 'pyins EstimationModel in Python: continuous densities N and K of each axis',
    'imu_filter_madgwick': 'imu_filter_madgwick ROS 2 parameters: gain and zeta at a horizon',
    'temperature': 'YAML: bias of each axis over temperature (b0, b1, b2) in SI and K',
    'state_space': 'JSON allan_ros/state_space/2: all processes, and Phi, Qd, R of each axis',
    'gazebo': 'Gazebo SDF <imu>: std per sample and a Gauss-Markov bias, of each axis',
}
"""Target -> description of its file."""

WITHOUT_PARAMETERS = ('robot_localization', 'fuse')
"""Filters that read the covariances of each message."""

VIO_HORIZON_S = 30.0
"""Longest integration in s between corrections by a camera or lidar."""

INS_HORIZON_S = 100.0
"""Longest integration in s between corrections by GNSS, including outages."""

SIMULATOR_HORIZON_S = 1000.0
"""Time in s up to which a simulated sensor should drift like the real one."""

ANY_NODE = ('/**', 'ros__parameters')
"""Top-level keys of ROS 2 parameters for any node that loads the file by --params-file."""

Value = Any
"""The value of a key in a file: a number, a string, a list or a mapping of these."""


@dataclass(frozen=True)
class ExportOptions(CheckedSettings):
    """Options of a file for a filter."""

    inflate: float = parameter(
        1.0,
        'Factor on every noise level, for vibration and model errors that add to the noise at '
        'rest; measure it with `allan inflate`.',
        low=1.0,
        high=1000.0,
    )
    filter_rate: float = parameter(
        0.0,
        'Rate at which the filter processes samples; 0: rate of the recording, or the fixed rate '
        'of the filter.',
        unit='Hz',
        low=0.0,
        high=1e6,
    )
    fidelity: str = parameter(
        'reduction',
        'N and K of the file: a reduction, in which K is raised until the predicted error growth '
        'covers the complete model, or the coefficients as measured.',
        choices=('reduction', 'coefficients'),
    )
    horizon: float = parameter(
        0.0,
        'Longest time that the filter integrates without correction, over which the reduction '
        'holds; 0: the default of the target (30 s for cameras and lidars, 100 s for GNSS).',
        unit='s',
        low=0.0,
        high=1e6,
    )
    topic: str = parameter(
        '', 'The Imu topic to name in the file; empty: the topic of the recording.'
    )
    force: bool = parameter(
        False, 'Write the file although the units of the samples are probably wrong.'
    )


class Key(NamedTuple):
    """One key of a file and the quantity that is written there."""

    name: str
    sensor: str  # 'gyro' or 'accel'; '-' for both, where N or K is the larger of the two
    # 'N' or 'K'; 'sigma', 'tau' or 'driving' (density sigma sqrt(2/tau)) of the Gauss-Markov bias;
    # 'common_tau': correlation time of all axes, in h; 'rate'; 'topic'
    what: str
    unit: str = ''  # one of `model.NOTATIONS`, or a unit
    limits: tuple[float, float] | None = None  # range that the filter accepts


@dataclass(frozen=True)
class Row:
    """One key of a file with its value and the origin of the value."""

    path: tuple[str, ...]  # the key, preceded by the keys of the mappings that contain it
    value: Value
    words: str = ''  # formula, axis and interval of the number as text; '' if it is not measured
    unit: str = ''  # '' if it is not measured
    # 95 % interval of the number in the unit of the file: (0, number) for an upper limit, (0, inf)
    # if it is unknown; of three numbers the widest
    interval: tuple[float, float] = (0.0, math.inf)
    levels: tuple[Level, ...] = ()  # the measured noise levels from which it is computed
    findings: tuple[Finding, ...] = ()  # information for the user of the file

    @property
    def key(self) -> str:
        """The last key of the path."""
        return self.path[-1]

    @property
    def name(self) -> str:
        """Name of the ROS parameter: the keys below ``ros__parameters``, joined by dots."""
        path = self.path[2:] if self.path[:2] == ANY_NODE else self.path
        return '.'.join(path)

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers: one, or three for x, y and z."""
        return tuple(self.value) if isinstance(self.value, list) else (self.value,)

    @property
    def ratio(self) -> float:
        """Ratio of the upper to the lower end of the interval; infinite if the lower end is 0."""
        low, high = self.interval
        return high / low if low > 0.0 else math.inf

    @property
    def is_limit(self) -> bool:
        """Whether the number comes from a 95 % upper limit."""
        return any(level.is_limit for level in self.levels)

    @property
    def no_interval(self) -> bool:
        """Whether the number comes from a value without a 95 % interval."""
        return any(level.no_interval for level in self.levels)


def keys_of(table: str) -> tuple[Key, ...]:
    """Return the keys of a table with a line ``name sensor what [unit [low..high]]`` for each.

    These are the attributes of `Key`; the default unit is 'density'.
    """
    found = []
    for line in table.strip().splitlines():
        name, sensor, what, *rest = line.split()
        unit = rest[0] if rest else 'density'
        low, high = map(float, rest[1].split('..')) if len(rest) > 1 else (0.0, 0.0)
        found.append(Key(name, sensor, what, unit, (low, high) if high else None))
    return tuple(found)


def noise_keys(names: str, unit: str = 'density') -> tuple[Key, ...]:
    """Return four keys, with ``names`` separated by spaces: gyro N, accel N, gyro K, accel K."""
    whats = ('gyro N', 'accel N', 'gyro K', 'accel K')
    return keys_of('\n'.join(f'{name} {what} {unit}' for name, what in zip(names.split(), whats)))


RAISED = 'Raised numbers cover B and correlated noise, for which such a filter has no states.'
"""Explanation of numbers that are larger than the coefficients as measured."""


def origin_text(level: Level) -> str:
    """Return how a number for a filter differs from the coefficient as measured."""
    name = f'{level.term} of {level.axis.replace("_", " ")}'
    if level.raised_from == 0.0:
        return f'{name} is not resolved: set to cover the error growth'
    words = f'{name} is not resolved: its 95 % upper limit' if level.is_limit else name
    if level.raised_from is None:
        return words if level.is_limit else f'{name} as measured'
    factor, measured = level.value / level.raised_from, level.raised_from
    return f'{words}, raised {factor:.3g} times from {measured:.4g} as measured'


Form = Callable[[Sequence[Row], Sequence[str]], str]
"""Text format: (rows, lines of the header) -> text of a file."""


@dataclass(frozen=True)
class Target:
    """A filter, simulator or calibration tool."""

    file_name: str  # name of its file in a results folder
    convention: str  # meaning of the numbers, and the source file of the target that shows it
    form: Form
    keys: tuple[Key, ...] = ()  # the keys of the file
    parent: tuple[str, ...] = ()  # the mappings that contain the keys
    fixed: Mapping[str, Value] = field(default_factory=dict)  # required, but not measured
    notes: tuple[str, ...] = ()  # further information for the user of this file
    # yields the rows of a file that is too complex for a table
    rows: Callable[[FilterNoise], Iterable[Row]] | None = None
    three: bool = False  # whether the file takes x, y and z of a sensor; else the largest
    rate_hz: float | None = None  # the filter's own rate; None if it steps with the samples
    horizon_s: float = VIO_HORIZON_S  # default of `ExportOptions.horizon` in s
    # whether the target models the bias as a random walk; then N and K are adjusted together
    walk: bool = True
    # whether the numbers bound the error growth, as a filter needs; else they approximate it
    bound: bool = True


class Export(NamedTuple):
    """The text of a file for a filter, and findings about its numbers."""

    text: str
    findings: tuple[Finding, ...]


def target_of(name: str) -> Target:
    """Return the target with this name, or raise AllanError with the known names."""
    if name in WITHOUT_PARAMETERS:
        raise AllanError(
            f'{name} has no parameters for the noise of an IMU: it reads the covariances of the '
            'messages, which the node allan_imu_relay fills in'
        )
    if name not in TARGETS:
        near = difflib.get_close_matches(name.lower().replace('-', '_'), TARGETS, 1)
        meant = f'did you mean {near[0]}? Known are' if near else 'choose one of'
        raise AllanError(f'target {name!r} is unknown: {meant} {", ".join(TARGETS)}')
    from . import computed, targets

    return {**targets.FILTERS, **computed.COMPUTED}[name]


def target_rows(
    results: Results,
    name: str,
    options: ExportOptions = ExportOptions(),
    bias: Mapping[str, float] = {},
) -> tuple[Row, ...]:
    """Return the measured numbers of a target, to set them as parameters of a running filter.

    The parameters are the same as in `make_export`. ``bias`` maps axes to their bias at rest in SI.
    If the filter has no state for the bias, its gain is raised to cover this bias. Leave it empty
    if the bias is subtracted from the samples.

    Raises
    ------
    AllanError
        Under the conditions of `make_export`.
    """
    from .model import FilterNoise

    rows = FilterNoise(results, options, target_of(name), bias).rows()
    return tuple(row for row in rows if row.unit)


def make_export(
    results: Results,
    name: str,
    options: ExportOptions = ExportOptions(),
    words: Callable[[Finding], str] = str,
) -> Export:
    """Return the text of a file with the measured noise for a filter or simulator.

    ``name`` is one of `TARGETS`, and ``words`` returns the text of a finding for the header. Raises
    AllanError when the target is unknown, an option does not
    apply to it, the results lack a required number, or their units are wrong.
    """
    from .model import FilterNoise
    from .text import header_lines

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
