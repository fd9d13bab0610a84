# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: it draws, responds, switches units, copies, and sends no requests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.chromium import Chromium

from allan_ros.core.allan.spectrum import RunningSpectrum, spectrum_of
from allan_ros.core.imu import ImuBatch, ImuIdentity
from allan_ros.core.stream.health import Segment
from allan_ros.io.datasheets import load_sensor
from allan_ros.io.report import ReportContext, render_report
from allan_ros.io.results import Results
from allan_ros.io.signal import SignalEnvelope, TemperatureTrace, summarize_signal

MAX_BYTES = 2_000_000
"""Largest size of a page in bytes: small enough for an email and a phone."""

HOSTILE = '</script><script>document.title = "taken"</script>'

INK = """(() => {
  const {width, height} = CANVAS, data = CANVAS.getContext('2d').getImageData(0, 0, width, height);
  return new Set(new Uint32Array(data.data.buffer)).size; })()"""
"""Expression for the number of colors of a canvas; 1 if nothing was drawn."""


@pytest.fixture(scope='module')
def page(small_results: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page with all optional parts, of an IMU whose name contains HTML."""
    n, period = 20_000, 20_000_000
    stamps = 10**18 + np.arange(n, dtype=np.int64) * period
    envelope = SignalEnvelope()
    envelope.update(ImuBatch(stamps, np.random.default_rng(1).normal(size=(n, 6))))
    running = RunningSpectrum(tuple(small_results.axes))
    running.update(np.random.default_rng(2).normal(size=(6, 9000)))
    spectrum = spectrum_of(running.sums, small_results.tau0)
    assert spectrum is not None
    results = replace(small_results, identity=ImuIdentity(HOSTILE, ''))
    results = results.against_datasheet(load_sensor('adis16475-3'), 0.1)
    temperature = TemperatureTrace(
        '/imu/temp', stamps[::50], stamps[::50], np.linspace(20.0, 31.0, 400)
    )
    spans = [Segment(int(stamps[5000]), 15_000, 300.0, 'motion')]
    summary = summarize_signal([envelope], spans, 1000, {}, [temperature])
    results = replace(results, baselines={'May': small_results})
    context = ReportContext(summary, [spectrum], {'command': 'x'}, ['results.json'])
    path = tmp_path_factory.mktemp('page') / 'report.html'
    path.write_text(render_report(results, context, 'deg/h'), encoding='utf-8')
    return path


@pytest.mark.parametrize(('width', 'dark'), [(1280, False), (390, True)])
def test_the_page_draws_and_sends_no_request(
    browser: Chromium, page: Path, width: int, dark: bool
) -> None:
    assert page.stat().st_size < MAX_BYTES
    browser.complaints.clear()
    browser.requests.clear()
    browser.open(page, width, dark)
    canvases = browser.evaluate('document.querySelectorAll("canvas").length')
    # of each sensor: curve, bias and noise over time, bias against temperature, spectrum,
    # temperature, three signals
    assert canvases == 2 * (1 + 3 + 1 + 1 + 3)
    for i in range(canvases):
        browser.wait_for(
            INK.replace('CANVAS', f'document.querySelectorAll("canvas")[{i}]') + ' > 9'
        )
    assert browser.evaluate('document.documentElement.scrollWidth') <= width
    assert browser.evaluate('document.title').startswith('Noise of </script>')
    assert browser.complaints == []
    assert browser.requests == [page.as_uri()]
    ground = browser.evaluate('getComputedStyle(document.body).backgroundColor')
    assert (ground == 'rgb(255, 255, 255)') is not dark


def test_hovering_and_keys_show_the_numbers(browser: Chromium, page: Path) -> None:
    browser.open(page, 1280)
    browser.evaluate('document.querySelector(".allan .u-over").scrollIntoView({block: "center"})')
    x, y = browser.evaluate(
        '(r => [r.x + r.width / 2, r.y + r.height / 2])'
        '(document.querySelector(".allan .u-over").getBoundingClientRect())'
    )
    browser.point_at(x, y)
    browser.point_at(x + 2, y)
    browser.wait_for('!document.querySelector(".allan .tip").hidden')
    said = browser.evaluate('document.querySelector(".allan .tip").innerText')
    assert said.startswith('τ ')
    assert [line[0] for line in said.splitlines()[1:4]] == ['x', 'y', 'z']
    assert '°/h' in said and '..' in said
    browser.evaluate(
        '(box => { box.focus(); box.dispatchEvent(new KeyboardEvent("keydown", {key: "Home"})); })'
        '(document.querySelector(".allan .plot"))'
    )
    assert 'τ 0.02000 s' in browser.evaluate('document.querySelector(".allan .spoken").textContent')


def test_the_part_left_out_is_reported_with_its_temperature(browser: Chromium, page: Path) -> None:
    browser.open(page, 1280)
    said = browser.evaluate('document.querySelector(".chart.signal .note").textContent')
    assert 'left out because the IMU moved' in said
    heading = browser.evaluate(
        'document.querySelector(".chart.temperature h3").firstChild.textContent'
    )
    assert heading == 'Temperature: 20.0 to 31.0 °C'
    browser.evaluate(
        '(box => { box.focus(); box.dispatchEvent(new KeyboardEvent("keydown", {key: "Home"})); })'
        '(document.querySelector(".signal .plot"))'
    )
    spoken = browser.evaluate('document.querySelector(".signal .spoken").textContent')
    assert spoken.endswith('20.0 °C, left out: the IMU moved')


def test_axes_and_parts_are_switched(browser: Chromium, page: Path) -> None:
    browser.open(page, 1280)
    canvas = 'document.querySelector(".allan canvas").toDataURL()'
    for key in ('y', 'N', 'fit', 'limits', 'references'):
        before = browser.evaluate(canvas)
        browser.evaluate(f'document.querySelector(".allan button[data-key={key}]").click()')
        pressed = f'document.querySelector(".allan button[data-key={key}]").ariaPressed'
        assert browser.evaluate(pressed) == 'false'
        browser.wait_for(f'{canvas} !== {before!r}')


def test_units_are_switched_everywhere_and_copied(browser: Chromium, page: Path) -> None:
    browser.open(page, 1280)
    shown = (
        'JSON.stringify([Chart.all[0].axes[1].label,'
        'document.querySelector(".coefficients tbody tr:nth-child(1) th").innerText])'
    )
    assert '°/√h' in browser.evaluate(shown)
    browser.evaluate('document.querySelector("[name=units][value=SI]").click()')
    assert 'rad/s' in browser.evaluate(shown) and '°' not in browser.evaluate(shown)
    browser.evaluate('document.querySelector(".copy button").click()')
    browser.wait_for('document.querySelector(".copy [role=status]").textContent === "TSV copied"')
