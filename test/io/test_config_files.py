# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping files: those that come with the package, and bad ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.io.files import config_names
from allan_ros.io.user_files import load_filter

GOOD = """
schema: allan_ros/filter/1
name: mine
constants: {h: 2.0}
parameters:
  noise: {sensor: accel, axis: each, expression: N * h, limits: [0.0, 1.0], unit: m/s^2}
"""


def test_every_mapping_of_the_package_can_be_read():
    assert config_names('filters') == ['imu_filter_madgwick', 'noise_densities']
    for name in config_names('filters'):
        assert load_filter(name).name == name


def test_a_file_is_read_as_it_is_written(tmp_path: Path):
    path = tmp_path / 'mine.yaml'
    path.write_text(GOOD)
    mapping = load_filter(str(path))
    (parameter,) = mapping.parameters
    assert (mapping.name, mapping.constants) == ('mine', {'h': 2.0})
    assert (parameter.name, parameter.sensor, parameter.rule) == ('noise', 'accel', 'each')
    assert parameter.expression.text == 'N * h' and parameter.limits == (0.0, 1.0)


@pytest.mark.parametrize(
    'old, new, reason',
    [
        ('filter/1', 'filter/2', 'schema'),
        ('accel', 'mag', 'sensor'),
        ('N * h', 'N * g', 'contains g'),
        ('N * h', 'open(N)', 'numbers, names'),
        ('unit', 'units', "'units' is unknown"),
        ('[0.0, 1.0]', '[1.0]', 'pair of numbers'),
        ('{h: 2.0}', '[2.0]', 'an object is expected'),
        ('expression: N * h, ', '', 'expression'),
    ],
)
def test_a_bad_file_is_rejected_with_its_name(tmp_path: Path, old: str, new: str, reason: str):
    path = tmp_path / 'bad.yaml'
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(AllanError) as refused:
        load_filter(str(path))
    assert reason in str(refused.value) and 'bad.yaml' in str(refused.value)


def test_a_missing_mapping_names_those_there_are():
    with pytest.raises(AllanError, match='choose one of imu_filter_madgwick, noise_densities'):
        load_filter('ekf')
