# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures show the numbers, also when some are missing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from allan_ros.results.results import Results
from allan_ros.view.plots import figure_files, render_figure, sensor_figure

DEG_PER_HOUR = math.pi / 180.0 / 3600.0


def test_the_curve_is_drawn_in_the_stated_unit(small_results: Results) -> None:
    panel = sensor_figure(small_results, 'gyro').axes[0]
    (measured,) = [line for line in panel.lines if line.get_label() == 'measured']
    adev = small_results.axes['gyro_x'].curve.adev
    assert np.allclose(measured.get_ydata(), adev / DEG_PER_HOUR, rtol=1e-12)
    (uncertain,) = [line for line in panel.lines if line.get_label() == 'uncertain']
    assert 0 < len(uncertain.get_ydata()) < len(adev) / 4
    assert '°/h' in panel.get_ylabel()
    si = sensor_figure(small_results, 'gyro', units='SI').axes[0]
    assert 'rad/s' in si.get_ylabel()


def test_the_parts_add_up_to_the_fit(small_results: Results) -> None:
    axis = small_results.axes['accel_x']
    m = axis.curve.m
    parts = axis.part_adev(m)
    in_model = {term for term in 'QNBKR' if axis.fit.model.value(term)}
    assert {t for t, c in axis.fit.noise.items() if c.resolved} <= in_model
    assert set(parts) == in_model
    assert set(axis.limit_adev(m)) == set('QNBKR') - in_model
    squares = sum(adev**2 for adev in parts.values())
    assert np.allclose(axis.total_adev(m) ** 2, squares, rtol=1e-12)


@pytest.mark.filterwarnings('error')
def test_a_curve_without_noise_is_drawn_all_the_same(small_results: Results) -> None:
    axis = small_results.axes['gyro_x']
    zero = np.zeros(len(axis.curve.m))
    flat = replace(axis, curve=replace(axis.curve, adev=zero, ci_low=zero, ci_high=zero))
    figure = sensor_figure(replace(small_results, axes={'gyro_x': flat}), 'gyro')
    assert render_figure(figure, 'png')


def test_each_sensor_with_a_curve_gives_a_file_in_each_format(small_results: Results) -> None:
    axes = {name: small_results.axes[name] for name in ('gyro_x', 'accel_z')}
    files = figure_files(replace(small_results, axes=axes), ('png', 'svg', 'pdf'))
    assert len(files) == 6
    assert files['allan_gyro.png'].startswith(b'\x89PNG')
    assert files['allan_gyro.svg'].startswith(b'<?xml')
    pdf = files['allan_accel.pdf']
    assert b'/FontFile2' in pdf and b'/Type3' not in pdf  # TrueType, type 42
    assert figure_files(replace(small_results, axes={}), ('png',)) == {}
