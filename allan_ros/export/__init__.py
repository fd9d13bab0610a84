# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that filters, calibration tools and simulators read.

A `Target` describes one file: its keys (`Key`), their convention and its source, and the text
format (`text`). `model` computes the `Row` of each key from the noise model. Targets are in
`targets` and, if their rows are not in a table, in `computed`; a new one also needs a line in
`TARGETS`.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..results.from_datasheet import FROM_DATASHEET
from .target import RAISED, Export, ExportOptions, Row, Target, origin_text

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
    'covariance': 'driver parameters: covariance matrices of sensor_msgs/Imu, 9 elements each',
    'temperature': 'YAML: bias of each axis over temperature (b0, b1, b2) in SI and K',
    'state_space': 'JSON allan_ros/state_space/3: all processes, and Phi, Qd, R of each axis',
    'gazebo': 'Gazebo SDF <imu>: std per sample and a Gauss-Markov bias, of each axis',
}
"""Target -> description of its file."""

WITHOUT_PARAMETERS = ('robot_localization', 'fuse')
"""Filters that read the covariances of each message."""


def target_of(name: str) -> Target:
    """Return the target with this name, or raise AllanError with the known names."""
    if name in WITHOUT_PARAMETERS:
        raise AllanError(
            f'{name} has no parameters for the noise of an IMU: it reads the covariances of the '
            'messages, which the node allan_imu_relay fills in; for the parameters of a driver, '
            'use the target covariance'
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
