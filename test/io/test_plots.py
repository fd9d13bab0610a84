# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pictures and the report: they show the numbers, and survive every hole in them."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from allan_ros.core.batch import ImuBatch
from allan_ros.core.findings import Finding
from allan_ros.io.envelope import SignalEnvelope
from allan_ros.io.plots import sensor_figure, to_png, to_svg
from allan_ros.io.report import render_report, verdict
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


class Page(HTMLParser):
    """Collects the text of a page and refuses anything fetched from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ''
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ('script', 'link', 'img'), tag
        if tag not in ('meta', 'br'):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_report_stands_alone_and_escapes_what_it_is_told(small_results: Results) -> None:
    finding = Finding('x', 'warning', 'a <b> & "c"', 'do <i>', ('gyro_x',))
    results = replace(small_results, findings=(finding,))
    page = Page()
    page.feed(render_report(results, {'gyro': to_svg(sensor_figure(results, 'gyro'))}, 'datasheet'))
    page.close()
    assert page.open == []
    assert 'a <b> & "c"' in page.text
    assert 'Noise of unit 7' in page.text
    assert verdict(results, 'datasheet') in page.text
    assert 'runs/one.mcap' in page.text


def test_the_verdict_names_the_worst_axis_and_what_is_hidden(small_results: Results) -> None:
    said = verdict(small_results, 'datasheet')
    worst = max(small_results.axes[f'gyro_{a}'].fit.noise['N'].value for a in 'xyz')
    assert f'gyro N {worst / (math.pi / 180.0 / 60.0):.3g}' in said
    assert 'Not observable' in said
