# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Charts of real recordings in a real browser: labels, zoom, overlaps, saved pictures."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from allan_ros.core.allan.spectrum import spectrum_of
from support.chromium import Chromium

from allan_ros.io.recorded import ReadJob, read_recording
from allan_ros.io.report import ReportContext, render_report
from allan_ros.io.results import analyze_recorded
from allan_ros.io.signal import summarize_signal

ADIS_LSB = np.repeat([0.05 * np.pi / 180.0, 0.00333 * 9.80665], 3)

RECORDINGS = ('adis16405', 'mpu6050', 'short')

LABELS = 'Chart.all.map(u => u.axes.map(a => (a._values || []).filter(text => text)))'


def recordings(shared: Path, folder: Path) -> dict[str, Path]:
    """Return recordings of half an hour (ADIS16405), 11 minutes (MPU-6050) and one minute."""
    counts = np.load(shared / 'adis16405' / 'imu2_counts.npz')
    samples = np.column_stack([counts['gyro'], counts['accel']])[:180_000] * ADIS_LSB
    time = np.arange(len(samples)) / 100.0
    imu = np.column_stack([time, samples])
    found = {'mpu6050': shared / 'mpu6050.npz'}
    for name, rows in (('adis16405', len(imu)), ('short', 6000)):
        found[name] = folder / f'{name}.npz'
        np.savez(found[name], imu=imu[:rows])
    return found


@pytest.fixture(scope='module')
def pages(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp('charts')
    made = {}
    for name, path in recordings(shared_data, folder).items():
        recorded = read_recording(ReadJob(str(path), with_context=True))
        # only the first page needs a complete fit, which takes most of the time of these tests
        results = analyze_recorded(recorded, 'likelihood' if name == 'adis16405' else 'relative')
        known = results.provenance
        signal = summarize_signal(recorded.signals, known.segments, 1000, known.counts.cuts)
        spectra = [spectrum_of(s, results.tau0) for s in recorded.spectra]
        context = ReportContext(signal, [s for s in spectra if s is not None])
        made[name] = folder / f'{name}.html'
        made[name].write_text(render_report(results, context, 'deg/h'), encoding='utf-8')
    return made


def opened(browser: Chromium, page: Path, width: int) -> None:
    browser.complaints.clear()
    browser.open(page, width)
    browser.evaluate('document.querySelectorAll("details").forEach(d => { d.open = true; })')
    browser.wait_for(f'{LABELS}.every(axes => axes.every(labels => labels.length >= 3))')
    assert browser.complaints == []


@pytest.mark.parametrize('width', [390, 1280])
@pytest.mark.parametrize('name', RECORDINGS)
def test_every_axis_has_three_labels_within_the_figure(
    browser: Chromium, pages: dict[str, Path], name: str, width: int
) -> None:
    opened(browser, pages[name], width)
    assert browser.evaluate('document.documentElement.scrollWidth') <= width
    browser.evaluate('document.querySelector("[name=units][value=SI]").click()')
    browser.wait_for(f'{LABELS}.every(axes => axes.every(labels => labels.length >= 3))')


@pytest.mark.parametrize('name', RECORDINGS)
def test_labels_are_round_numbers_at_their_positions(
    browser: Chromium, pages: dict[str, Path], name: str
) -> None:
    opened(browser, pages[name], 1280)
    axes = browser.evaluate(
        'Chart.all.filter(u => u.title).flatMap(u => u.axes.map(a => '
        'a._splits.map((v, i) => [v, a._values[i]]).filter(([v, text]) => text)))'
    )
    for labels in axes:
        for value, text in labels:
            assert float(f'{value:.1e}') == pytest.approx(value, rel=1e-9), text
            if '·' not in text and '⁻' not in text and not text.startswith('10⁠'):
                assert float(text) == pytest.approx(value) or '⁴' <= text[-1] <= '⁹'


def drag(browser: Chromium, start: tuple[float, float], end: tuple[float, float]) -> None:
    for kind, (x, y) in (('mouseMoved', start), ('mousePressed', start), ('mouseMoved', end)):
        browser.call('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', clickCount=1)
    browser.call(
        'Input.dispatchMouseEvent', type='mouseReleased', x=end[0], y=end[1], button='left',
        clickCount=1,
    )  # fmt: skip


def scales(browser: Chromium) -> list[float]:
    found: list[float] = browser.evaluate(
        '(u => [u.scales.x.min, u.scales.x.max, u.scales.y.min, u.scales.y.max])(Chart.all[0])'
    )
    return found


@pytest.mark.parametrize('name', RECORDINGS)
def test_dragging_zooms_and_a_double_click_goes_back(
    browser: Chromium, pages: dict[str, Path], name: str
) -> None:
    opened(browser, pages[name], 1280)
    browser.evaluate('document.querySelector(".allan .u-over").scrollIntoView({block: "center"})')
    x, y, wide, high = browser.evaluate(
        '(r => [r.x, r.y, r.width, r.height])'
        '(document.querySelector(".allan .u-over").getBoundingClientRect())'
    )
    whole = scales(browser)
    middle = y + high / 2
    drag(browser, (x + 0.3 * wide, middle), (x + 0.6 * wide, middle))
    browser.wait_for(f'Chart.all[0].scales.x.max < {0.9 * whole[1]}')
    low, high_x, *_ = scales(browser)
    decades = np.log10(whole[1] / whole[0])
    # the range is the part that was dragged over, in logarithms
    assert np.log10(high_x / low) == pytest.approx(0.3 * decades, rel=0.05)
    browser.wait_for(f'{LABELS}[0].every(labels => labels.length >= 3)')
    for count in (1, 2):
        for kind in ('mousePressed', 'mouseReleased'):
            browser.call(
                'Input.dispatchMouseEvent', type=kind, x=x + 50, y=middle, button='left',
                clickCount=count,
            )  # fmt: skip
    browser.wait_for(f'Chart.all[0].scales.x.max > {0.99 * whole[1]}')
    assert scales(browser) == pytest.approx(whole)


CROSSING = """
  const crossing = [];
  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
    const across = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const down = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (across > ACROSS && down > DOWN) crossing.push([a, b]);
  }));
  return crossing;
})()"""

OF_A_CHART = """(() => {
  const host = document.createElement('div');
  host.innerHTML = Picture.svg(Chart.all[INDEX], 'title');
  document.body.append(host);
  const boxes = [...host.querySelectorAll('text')].filter(t => !t.hasAttribute('transform'))
    .map(t => [t.textContent, t.getBoundingClientRect()]);
  host.remove();""" + CROSSING.replace('ACROSS', '1').replace('DOWN', '3')

OF_THE_PAGE = """(() => {
  scrollTo(0, 0);
  const leaves = [...document.querySelectorAll('main *, header *, nav *')].filter(e =>
    e.checkVisibility() && !e.closest('.spoken, .plot, svg, legend') &&
    [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()));
  const boxes = leaves.flatMap(e => [...e.childNodes].filter(n => n.nodeType === 3 && n.data.trim())
    .flatMap(n => { const r = document.createRange(); r.selectNode(n);
      return [...r.getClientRects()].map(q => [n.data.trim().slice(0, 30), q]); }));""" + (
    CROSSING.replace('ACROSS', '2').replace('DOWN', '6')
)


@pytest.mark.parametrize('width', [390, 1280])
@pytest.mark.parametrize('name', RECORDINGS)
def test_no_text_covers_another(
    browser: Chromium, pages: dict[str, Path], name: str, width: int
) -> None:
    opened(browser, pages[name], width)
    assert browser.evaluate(OF_THE_PAGE) == []
    for i in range(browser.evaluate('Chart.all.length')):
        assert browser.evaluate(OF_A_CHART.replace('INDEX', str(i))) == []


def test_saved_pictures_are_complete(browser: Chromium, pages: dict[str, Path]) -> None:
    opened(browser, pages['adis16405'], 1280)
    svg: Any = browser.evaluate('Picture.svg(Chart.all[0], "Gyroscope")')
    texts = {''.join(e.itertext()) for e in ET.fromstring(svg).iter() if e.tag.endswith('}text')}
    assert {'Gyroscope', 'Allan deviation σ(τ) [°/h]', 'averaging time τ [s]'} <= texts
    assert 'N at 1 s' in texts
    clicked = (
        'new Promise(done => { const click = HTMLAnchorElement.prototype.click;'
        'HTMLAnchorElement.prototype.click = function () {'
        ' HTMLAnchorElement.prototype.click = click; done(this.download); };'
        'document.querySelector("SELECTOR").click(); })'
    )
    for selector, name in (
        ('.allan [data-form=SVG]', 'allan_gyro.svg'),
        ('.allan [data-form=PNG]', 'allan_gyro.png'),
        ('.copy [data-form=CSV]', 'coefficients_gyro.csv'),
    ):
        answer = browser.call(
            'Runtime.evaluate',
            expression=clicked.replace('SELECTOR', selector),
            awaitPromise=True,
            returnByValue=True,
        )
        assert answer['result']['value'] == name


def test_level_and_read_off_values_are_those_of_the_table(
    browser: Chromium, pages: dict[str, Path]
) -> None:
    opened(browser, pages['adis16405'], 1280)
    axes = browser.evaluate(
        'JSON.parse(document.getElementById("data").textContent).sensors[0].axes'
    )
    for axis in axes:
        if 'B' in axis['parts']:
            assert len(set(axis['parts']['B'])) == 1
        assert axis['read']['N'][0] == 1.0
        assert set(axis['parts']) & set(axis['upper']) == set()


def test_printing_replaces_the_canvas_by_a_vector_picture(
    browser: Chromium, pages: dict[str, Path]
) -> None:
    opened(browser, pages['adis16405'], 1280)
    browser.evaluate('dispatchEvent(new Event("beforeprint"))')
    assert browser.evaluate('document.querySelectorAll("figure.paper svg").length') == 8
    names = browser.evaluate('[...document.querySelectorAll("clipPath")].map(c => c.id)')
    assert names and len(set(names)) == len(names)
    browser.evaluate('dispatchEvent(new Event("afterprint"))')
    assert browser.evaluate('document.querySelectorAll("figure.paper").length') == 0
