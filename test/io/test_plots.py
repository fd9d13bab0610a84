# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots show the numbers, also when some are missing."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.core.stream.health import Segment
from allan_ros.io.plot_layout import render_figure, ticks
from allan_ros.io.plot_style import PictureSettings, load_style
from allan_ros.io.plots import sensor_figure
from allan_ros.io.results import Results
from allan_ros.io.signal import SignalEnvelope, SignalSummary, summarize_signal

DEG_PER_HOUR = math.pi / 180.0 / 3600.0


def a_summary(recordings: int = 1) -> SignalSummary | None:
    envelope = SignalEnvelope()
    samples = np.random.default_rng(1).normal(size=(500, 6))
    envelope.update(ImuBatch(np.arange(500, dtype=np.int64) * 20_000_000, samples))
    return summarize_signal([envelope] * recordings, [Segment(0, 400, 8.0)], 1000)


def test_each_axis_has_a_row_with_its_signal(small_results: Results) -> None:
    figure = sensor_figure(small_results, 'gyro', a_summary(2))
    assert len(figure.axes) == 6
    assert render_figure(figure, 'png').startswith(b'\x89PNG')
    assert len(sensor_figure(small_results, 'accel').axes) == 3


def test_the_curve_is_drawn_in_the_stated_unit(small_results: Results) -> None:
    panel = sensor_figure(small_results, 'gyro').axes[0]
    (measured,) = [line for line in panel.lines if line.get_label() == 'measured']
    adev = small_results.axes['gyro_x'].curve.adev
    assert np.allclose(measured.get_ydata(), adev / DEG_PER_HOUR, rtol=1e-12)
    assert '°/h' in panel.get_ylabel()
    si = sensor_figure(small_results, 'gyro', units='si').axes[0]
    assert 'rad/s' in si.get_ylabel()


def test_the_parts_add_up_to_the_fit(small_results: Results) -> None:
    axis = small_results.axes['accel_x']
    m = axis.curve.m
    parts = axis.part_adev(m)
    resolved = {t for t, c in axis.fit.noise.items() if c.status == 'estimated' and c.value}
    assert set(parts) == resolved
    assert set(axis.limit_adev(m)) == set('QNBKR') - resolved
    squares = sum(adev**2 for adev in parts.values())
    assert np.allclose(axis.total_adev(m) ** 2, squares, rtol=1e-12)


def test_an_absent_sensor_has_no_picture(small_results: Results) -> None:
    assert sensor_figure(replace(small_results, axes={}), 'gyro') is None


@pytest.mark.filterwarnings('error')
def test_a_curve_without_noise_is_drawn_all_the_same(small_results: Results) -> None:
    axis = small_results.axes['gyro_x']
    zero = np.zeros(len(axis.curve.m))
    flat = replace(axis, curve=replace(axis.curve, adev=zero, ci_low=zero, ci_high=zero))
    figure = sensor_figure(replace(small_results, axes={'gyro_x': flat}), 'gyro', a_summary())
    assert render_figure(figure, 'png')


def test_every_format_is_written_and_a_pdf_contains_its_fonts(small_results: Results) -> None:
    figure = sensor_figure(small_results, 'accel', a_summary())
    assert render_figure(figure, 'svg').startswith(b'<?xml')
    pdf = render_figure(figure, 'pdf')
    assert pdf.startswith(b'%PDF')
    assert b'/FontFile2' in pdf  # TrueType, type 42
    assert b'/Type3' not in pdf


def test_a_column_is_as_wide_as_a_column_and_shows_the_curves_alone(small_results: Results) -> None:
    figure = sensor_figure(small_results, 'gyro', a_summary(), style=load_style('column'))
    assert figure.get_size_inches()[0] == 3.5
    assert len(figure.axes) == 3


def test_a_style_sheet_of_the_user_is_kept(small_results: Results, tmp_path: Path) -> None:
    sheet = tmp_path / 'mine.mplstyle'
    sheet.write_text('font.size: 11\naxes.facecolor: ffeecc\n')
    panel = sensor_figure(small_results, 'gyro', style=load_style(str(sheet))).axes[0]
    assert panel.yaxis.label.get_size() == 11
    assert panel.get_facecolor() == pytest.approx((1.0, 0.933, 0.8, 1.0), abs=1e-3)
    assert 'image.cmap' in load_style('grayscale')


@pytest.mark.parametrize(
    'text', ['font.sise: 9\n', 'no colon here\n', 'font.size: large-ish\n', '\0']
)
def test_a_sheet_that_is_none_is_rejected_in_one_line(tmp_path: Path, text: str) -> None:
    sheet = tmp_path / 'bad.mplstyle'
    sheet.write_text(text)
    with pytest.raises(AllanError, match=r'bad\.mplstyle: is not a style sheet') as caught:
        load_style(str(sheet))
    assert '\n' not in str(caught.value)


def test_unknown_styles_and_forms_are_rejected() -> None:
    with pytest.raises(AllanError, match="no plot style 'http"):
        load_style('http://example.org/my.mplstyle')
    with pytest.raises(AllanError, match="plot_format is 'gif': choose one of png, svg, pdf"):
        PictureSettings(plot_format=('png', 'gif'))


@pytest.mark.parametrize(
    ('limits', 'labels'),
    [
        ((0.01, 2000.0), [0.1, 1.0, 10.0, 100.0, 1000.0]),
        ((2.0, 150.0), [5.0, 10.0, 20.0, 50.0, 100.0]),
        ((0.54, 1.85), [0.7, 1.0, 1.2, 1.5]),  # a ratio: on both sides of 1
        ((0.93, 1.08), [0.96, 1.0, 1.04]),
    ],
)
def test_an_axis_has_at_least_three_labels(
    limits: tuple[float, float], labels: list[float]
) -> None:
    labeled, grid = ticks(*limits)
    assert labeled.tolist() == pytest.approx(labels)
    assert set(labeled) <= set(grid)
