# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pictures: they show the numbers, and survive every hole in them."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from allan_ros.core.batch import ImuBatch
from allan_ros.io.envelope import SignalEnvelope
from allan_ros.io.plots import sensor_figure, to_png
from allan_ros.io.results import Results

DEG_PER_HOUR = math.pi / 180.0 / 3600.0


def a_signal() -> SignalEnvelope:
    envelope = SignalEnvelope()
    samples = np.random.default_rng(1).normal(size=(500, 6))
    envelope.update(ImuBatch(np.arange(500, dtype=np.int64) * 20_000_000, samples))
    return envelope


def test_a_row_an_axis_and_the_signal_beside_it(small_results: Results) -> None:
    figure = sensor_figure(small_results, 'gyro', [a_signal(), a_signal()])
    assert len(figure.axes) == 6
    assert to_png(figure).startswith(b'\x89PNG')
    assert len(sensor_figure(small_results, 'accel').axes) == 3


def test_the_curve_is_drawn_in_the_unit_it_says(small_results: Results) -> None:
    panel = sensor_figure(small_results, 'gyro').axes[0]
    (measured,) = [line for line in panel.lines if line.get_label() == 'measured']
    adev = small_results.axes['gyro_x'].curve.adev
    assert np.allclose(measured.get_ydata(), adev / DEG_PER_HOUR, rtol=1e-12)
    assert 'deg/h' in panel.get_ylabel()
    si = sensor_figure(small_results, 'gyro', units='si').axes[0]
    assert 'rad/s' in si.get_ylabel()


def test_the_parts_add_up_to_the_fit(small_results: Results) -> None:
    axis = small_results.axes['accel_x']
    m = axis.curve.m
    ramp = axis.part_adev(m)[:, 4] if axis.fit.noise['R'].status == 'estimated' else 0.0
    squares = (axis.part_adev(m)[:, :4] ** 2).sum(axis=1) + ramp**2
    assert np.allclose(axis.total_adev(m) ** 2, squares, rtol=1e-12)


def test_an_absent_sensor_has_no_picture(small_results: Results) -> None:
    assert sensor_figure(replace(small_results, axes={}), 'gyro') is None


@pytest.mark.filterwarnings('error')
def test_a_curve_without_noise_is_drawn_all_the_same(small_results: Results) -> None:
    axis = small_results.axes['gyro_x']
    zero = np.zeros(len(axis.curve.m))
    flat = replace(axis, curve=replace(axis.curve, adev=zero, ci_low=zero, ci_high=zero))
    figure = sensor_figure(replace(small_results, axes={'gyro_x': flat}), 'gyro', [a_signal()])
    assert to_png(figure)


def test_plots_do_without_pyplot() -> None:
    program = 'import sys, allan_ros.io.plots; sys.exit("matplotlib.pyplot" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', program]).returncode == 0
