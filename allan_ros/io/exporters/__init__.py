# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that filters, calibration tools and simulators read.

The tables of targets are in `targets` and `simulators`; `model` gives their numbers and the header
comment, `forms` the text. A new target is an entry of a table and a line in `TARGETS`.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...core.errors import AllanError
from ...core.findings import Finding, finding
from .target import ExportOptions

if TYPE_CHECKING:
    from ..results import Results
    from .target import Target

__all__ = ['TARGETS', 'Export', 'ExportOptions', 'make_export', 'target_of']

TARGETS = {
    'kalibr': 'Kalibr imu.yaml: continuous densities N and K',
    'openvins': 'OpenVINS kalibr_imu_chain.yaml: continuous densities N and K',
    'vins_fusion': 'VINS-Mono and VINS-Fusion: std per sample, N sqrt(f) or --exact, and K sqrt(f)',
    'orb_slam3': 'ORB-SLAM3 settings: continuous densities N and K, and the rate',
    'lio_sam': 'LIO-SAM ROS 2 parameters: continuous densities N and K',
    'fast_lio': 'FAST-LIO and FAST-LIO2 ROS 2 parameters: variances N^2 f and K^2 f',
    'gtsam': 'GTSAM PreintegrationCombinedParams in Python: continuous covariances N^2 and K^2',
    'basalt': 'Basalt calibration JSON: continuous densities N and K of each axis',
    'msckf_vio': 'MSCKF_VIO parameters: continuous densities N and K',
    'fusioncore': 'FusionCore ROS 2 parameters: std per sample, bias variance per step',
    'px4': 'PX4 EKF2 parameters: std per EKF step, within their ranges',
    'ardupilot': 'ArduPilot EK3 parameters: std per EKF step, within their ranges',
    'kf_gins': 'KF-GINS imunoise: deg/sqrt(hr), m/s/sqrt(hr) and a Gauss-Markov bias, of each axis',
    'ob_gins': 'OB_GINS imumodel: deg/sqrt(hr), m/s/sqrt(hr) and a Gauss-Markov bias',
    'ic_gvins': 'IC-GVINS imumodel: the same keys as OB_GINS',
    'navego': 'NaveGo structure for ins_gnss.m: SI densities and a Gauss-Markov bias, of each axis',
    'imu_filter_madgwick': 'imu_filter_madgwick ROS 2 parameters: gain and zeta at a horizon',
    'state_space': 'JSON allan_ros/state_space/1: all processes, discrete matrices, reductions',
    'state_space_python': 'Python module: all processes, discrete matrices, a noise generator',
    'gazebo': 'Gazebo SDF <imu>: std per sample and a Gauss-Markov bias, of each axis',
    'px4_sitl': 'PX4 SITL and RotorS IMU plugin: densities and a Gauss-Markov bias',
    'airsim': 'AirSim settings.json: deg/sqrt(h), mg/sqrt(Hz) and a random walk of the bias',
    'gnss_ins_sim': 'gnss-ins-sim error dictionary: random walks and a Gauss-Markov bias',
    'isaac_sim': 'Isaac Sim: Python module that adds the noise to the readings of the IMU sensor',
    'webots': 'Webots: Python module that adds the noise in the controller',
}
"""Target -> what its file is."""


@dataclass(frozen=True)
class Export:
    """A file for a filter as text, and what the user should know about it."""

    text: str
    findings: tuple[Finding, ...]


def target_of(name: str) -> Target:
    """Return the target of that name.

    Raises
    ------
    AllanError
        When it is unknown; it lists the known.
    """
    if name not in TARGETS:
        near = difflib.get_close_matches(name.lower().replace('-', '_'), TARGETS, 1)
        meant = f'did you mean {near[0]}? Known are' if near else 'choose one of'
        raise AllanError(f'target {name!r} is unknown: {meant} {", ".join(TARGETS)}')
    from . import simulators, targets

    return {**targets.TARGETS, **simulators.SIMULATORS}[name]


def make_export(
    results: Results,
    name: str,
    options: ExportOptions = ExportOptions(),
    existing: str | None = None,
) -> Export:
    """Return the file of a target, or the user's existing text with its numbers merged in.

    Parameters
    ----------
    results : Results
    name : str
        One of `TARGETS`.
    options : ExportOptions
    existing : str or None
        Text of the user's own file to merge into.

    Raises
    ------
    AllanError
        When the target is unknown, an option does not fit it, the results lack what its file must
        hold, or the existing text cannot take it.
    """
    from .model import FilterNoise, header_lines

    target = target_of(name)
    noise = FilterNoise(results, options, target)
    entries = noise.entries()
    header = header_lines(name, noise, entries)
    text = (
        target.form.render(entries, header)
        if existing is None
        else target.form.merge(existing, entries, header)
    )
    findings = [note for entry in entries for note in entry.findings]
    findings += noise.reduction_findings()
    limits = [entry.key for entry in entries if entry.is_limit]
    if limits:
        findings.append(finding('export_limits', keys=', '.join(dict.fromkeys(limits))))
    return Export(text, tuple(dict.fromkeys(findings)))
