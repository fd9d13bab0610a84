# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: it draws, responds, switches units, and sends no requests."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.chromium import Chromium

import allan_ros as ar
from allan_ros.core.estimate import Estimate
from allan_ros.core.filters.motion_factors import DriveRatio, NoiseInMotion, SensorInMotion
from allan_ros.core.imu import ImuBatch, ImuIdentity
from allan_ros.core.stream.health import Event, Segment
from allan_ros.core.stream.signal import SignalEnvelope, TemperatureTrace, summarize_signal
from allan_ros.results.datasheets import load_sensor
from allan_ros.results.results import Results
from allan_ros.view.report import render_report

MAX_BYTES = 2_000_000
"""Largest size of a page in bytes: small enough for an email and a phone."""

HOSTILE = '</script><script>document.title = "taken"</script>'

OPENED = 'document.querySelectorAll("details").forEach(d => { d.open = true; })'

DRAWN = 'Chart.all.every(c => c.box.querySelectorAll("path").length > 3 && c.labels.x)'

CROSSING = """(boxes => {
  const crossing = [];
  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
    const across = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const down = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (across > 2 && down > 5) crossing.push([a, b]);
  }));
  return crossing;
})"""
"""Function that returns the pairs of texts that cover each other."""

IN_CHART = (
    CROSSING
    + """([...Chart.all[INDEX].box.querySelectorAll('svg text')]
  .filter(t => t.textContent).map(t => [t.textContent, t.getBoundingClientRect()]))"""
)

IN_PAGE = (
    CROSSING
    + """([...document.querySelectorAll('main *, header *')].filter(e =>
    e.checkVisibility() && !e.closest('.spoken, svg, legend'))
  .flatMap(e => [...e.childNodes].filter(n => n.nodeType === 3 && n.data.trim()).flatMap(n => {
    const r = document.createRange(); r.selectNode(n);
    return [...r.getClientRects()].map(q => [n.data.trim().slice(0, 30), q]); })))"""
)


@pytest.fixture(scope='module')
def page(small_results: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page with all optional parts, of an IMU whose name contains HTML."""
    n, period = 20_000, 20_000_000
    stamps = 10**18 + np.arange(n, dtype=np.int64) * period
    envelope = SignalEnvelope()
    envelope.update(ImuBatch(stamps, np.random.default_rng(1).normal(size=(n, 6))))
    long = Estimate(2e-6, (1.234e-6, 3.456e-6))  # the longest name of a term is next to it
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise={**axis.fit.noise, 'K': long}))
        for name, axis in small_results.axes.items()
    }
    results = replace(small_results, axes=axes, identity=ImuIdentity(HOSTILE, ''))
    results = results.against_datasheet(load_sensor('adis16475-3'), 0.1)
    temperature = TemperatureTrace(
        '/imu/temp', stamps[::50], stamps[::50], np.linspace(20.0, 31.0, 400)
    )
    spans = [Segment(int(stamps[5000]), 15_000, 300.0)]
    moved = Event('motion', int(stamps[0]), 100.0)
    summary = summarize_signal([envelope], spans, 1000, [moved], [temperature])
    factors = SensorInMotion(*[Estimate(3.0, (2.5, 3.6))] * 3)
    drives = tuple(DriveRatio(5.0 + i, 0.5 * i, 1.0 + i % 4, 0.5 + i % 3) for i in range(12))
    motion = NoiseInMotion(factors, factors, (), drives)
    results = replace(results, baselines={'May': small_results}, motion=motion)
    path = tmp_path_factory.mktemp('page') / 'report.html'
    page = render_report(results, 'deg/h', summary, {'command': 'x'}, ['results.json'])
    path.write_text(page, encoding='utf-8')
    return path


@pytest.fixture(scope='module')
def real_page(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of 11 minutes of an MPU-6050."""
    folder = tmp_path_factory.mktemp('real')
    ar.analyze(shared_data / 'mpu6050.npz', method='paper').save(folder)
    return folder / 'report.html'


def opened(browser: Chromium, page: Path, width: int, dark: bool = False) -> None:
    browser.complaints.clear()
    browser.requests.clear()
    browser.open(page, width, dark)
    browser.evaluate(OPENED)
    browser.wait_for(DRAWN)


def place_of(browser: Chromium, selector: str) -> tuple[float, float, float, float]:
    """Scroll an element to the middle, and return its left, top, width and height."""
    found = f'document.querySelector({json.dumps(selector)})'
    browser.evaluate(f'{found}.scrollIntoView({{block: "center"}})')
    x, y, width, height = browser.evaluate(
        f'(r => [r.x, r.y, r.width, r.height])({found}.getBoundingClientRect())'
    )
    return x, y, width, height


@pytest.mark.parametrize(('width', 'dark'), [(1280, False), (390, True)])
@pytest.mark.parametrize('name', ['page', 'real_page'])
def test_the_page_is_drawn_without_overlaps_and_sends_no_request(
    browser: Chromium, name: str, width: int, dark: bool, request: pytest.FixtureRequest
) -> None:
    path: Path = request.getfixturevalue(name)
    assert path.stat().st_size < MAX_BYTES
    browser.open(path, width, dark)
    height = browser.evaluate('document.documentElement.scrollHeight')
    assert height < (3500 if width > 1000 else 6000)
    opened(browser, path, width, dark)
    assert browser.evaluate('document.documentElement.scrollWidth') <= width
    assert browser.complaints == []
    assert browser.requests == [path.as_uri()]
    ground = browser.evaluate('getComputedStyle(document.body).backgroundColor')
    assert (ground == 'rgb(255, 255, 255)') is not dark
    for system in ('SI', 'deg/h'):
        browser.evaluate(f'document.querySelector(\'[name=units][value="{system}"]\').click()')
        labels = browser.evaluate('Chart.all.map(c => [c.labels.x, c.labels.y])')
        assert [axis for chart in labels for axis in chart if len(axis) < 3] == []
        for value, text in (label for chart in labels for axis in chart for label in axis):
            assert float(f'{value:.2g}') == pytest.approx(value, rel=1e-9, abs=1e-12), text
        assert browser.evaluate(IN_PAGE) == []
        for i in range(len(labels)):
            assert browser.evaluate(IN_CHART.replace('INDEX', str(i))) == []


def test_the_first_screen_has_the_verdict_the_coefficients_and_the_numbers_for_a_filter(
    browser: Chromium, page: Path
) -> None:
    browser.open(page, 1280)
    browser.wait_for('Chart.all[0].box.querySelectorAll("path").length > 4')
    for selector in ('#verdict', '#gyro .coefficients', '#accel .coefficients', '#filter'):
        bottom = f'document.querySelector("{selector}").getBoundingClientRect().bottom'
        assert browser.evaluate(bottom) <= 800, selector
    top = 'document.querySelector("#accel-curve .plot").getBoundingClientRect().top'
    assert browser.evaluate(top) <= 900


def test_hovering_and_keys_show_the_numbers(browser: Chromium, page: Path) -> None:
    opened(browser, page, 1280)
    x, y, width, height = place_of(browser, '#gyro-curve .plot svg')
    browser.point_at(x + width / 2, y + height / 2)
    browser.wait_for('!document.querySelector("#gyro-curve .tip").hidden')
    said = browser.evaluate('document.querySelector("#gyro-curve .tip").innerText')
    assert said.startswith('τ ')
    assert [line[0] for line in said.splitlines()[1:4]] == ['x', 'y', 'z']
    assert '°/h' in said and '..' in said
    press = (
        '(box => { box.focus(); box.dispatchEvent(new KeyboardEvent("keydown", {key: "Home"})); })'
        '(document.querySelector("SELECTOR .plot"))'
    )
    browser.evaluate(press.replace('SELECTOR', '#gyro-curve'))
    assert 'τ 0.02000 s' in browser.evaluate(
        'document.querySelector("#gyro-curve .spoken").textContent'
    )
    browser.evaluate(press.replace('SELECTOR', '#signal'))
    spoken = browser.evaluate('document.querySelector("#signal .spoken").textContent')
    assert spoken.endswith('20.0 °C, excluded: the IMU moved')


def test_dragging_zooms_and_a_double_click_goes_back(browser: Chromium, page: Path) -> None:
    opened(browser, page, 1280)
    x, y, wide, high = place_of(browser, '#gyro-curve .plot svg')
    whole = browser.evaluate('Chart.all[0].spec.x.full()')
    middle = y + high / 2
    for kind, at in (
        *(('mouseMoved', 0.3), ('mousePressed', 0.3), ('mouseMoved', 0.6), ('mouseReleased', 0.6)),
    ):
        browser.call(
            'Input.dispatchMouseEvent', type=kind, x=x + at * wide, y=middle, button='left',
            clickCount=1,
        )  # fmt: skip
    browser.wait_for('Chart.all[0].zoom !== null')
    low, end = browser.evaluate('Chart.all[0].zoom.x')
    plot = wide - 62.0  # without the margins
    decades = np.log10(whole[1] / whole[0])
    assert np.log10(end / low) == pytest.approx(0.3 * wide / plot * decades, rel=0.02)
    browser.evaluate(
        'document.querySelector("#gyro-curve .plot svg").dispatchEvent(new MouseEvent("dblclick"))'
    )
    assert browser.evaluate('Chart.all[0].zoom') is None


def test_buttons_zoom_in_and_out(browser: Chromium, page: Path) -> None:
    opened(browser, page, 390)
    low, high = browser.evaluate('Chart.all[0].spec.x.full()')
    for factor, share in ((2, 0.5), (2, 0.25), (0.5, 0.5)):
        browser.evaluate(
            f'document.querySelector("#gyro-curve [data-zoom=\\"{factor}\\"]").click()'
        )
        near, far = browser.evaluate('Chart.all[0].zoom.x')
        assert np.log(far / near) == pytest.approx(share * np.log(high / low), rel=1e-6)
        assert near * far == pytest.approx(low * high, rel=1e-6), 'around the middle'
    browser.evaluate('document.querySelector("#gyro-curve [data-zoom=\\"0.5\\"]").click()')
    assert browser.evaluate('Chart.all[0].zoom') is None


def test_axes_and_parts_are_switched(browser: Chromium, page: Path) -> None:
    opened(browser, page, 1280)
    drawn = 'document.querySelector("#gyro-curve .plot svg").innerHTML'
    for key in ('y', 'model', 'limits', 'references'):
        before = browser.evaluate(drawn)
        button = f'document.querySelector("#gyro-curve button[data-key={key}]")'
        browser.evaluate(f'{button}.click()')
        assert browser.evaluate(f'{button}.ariaPressed') == 'false'
        assert browser.evaluate(drawn) != before


def test_units_are_switched_everywhere(browser: Chromium, page: Path) -> None:
    opened(browser, page, 1280)
    shown = 'document.querySelector("#gyro").innerText'
    assert '°/√h' in browser.evaluate(shown)
    browser.evaluate('document.querySelector("[name=units][value=SI]").click()')
    assert 'rad/s' in browser.evaluate(shown) and '°' not in browser.evaluate(shown)


def test_charts_are_saved_in_light_colors(browser: Chromium, page: Path) -> None:
    opened(browser, page, 1280, dark=True)
    svg = browser.evaluate('Chart.all[0].svg()')
    texts = {''.join(e.itertext()) for e in ET.fromstring(svg).iter() if e.tag.endswith('}text')}
    assert {'Allan deviation σ(τ) [°/h]', 'averaging time τ [s]', 'N'} <= texts
    assert '#ffffff' in svg and 'var(' not in svg and '#14171b' not in svg
    clicked = (
        'new Promise(done => { const click = HTMLAnchorElement.prototype.click;'
        'HTMLAnchorElement.prototype.click = function () {'
        ' HTMLAnchorElement.prototype.click = click; done(this.download); };'
        'document.querySelector("SELECTOR").click(); })'
    )
    for selector, name in (
        ('#gyro-curve [data-form=SVG]', 'allan_gyro.svg'),
        ('#gyro-curve [data-form=PNG]', 'allan_gyro.png'),
    ):
        answer = browser.call(
            'Runtime.evaluate',
            expression=clicked.replace('SELECTOR', selector),
            awaitPromise=True,
            returnByValue=True,
        )
        assert answer['result']['value'] == name


def test_all_parts_are_printed_with_legible_charts(browser: Chromium, page: Path) -> None:
    browser.open(page, 1280)
    browser.evaluate('dispatchEvent(new Event("beforeprint"))')
    assert browser.evaluate('document.querySelectorAll("details:not([open])").length') == 0
    # 342 pixels are 90 mm, so that a text of 12 pixels has 9 points
    widths = browser.evaluate(
        'Chart.all.map(c => c.box.querySelector("svg").viewBox.baseVal.width)'
    )
    assert set(widths) <= {342, 700} and len(widths) > 10
    browser.evaluate('dispatchEvent(new Event("afterprint"))')
    assert browser.evaluate('document.querySelectorAll("details:not([open])").length') > 4
