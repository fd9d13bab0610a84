# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page is self-contained, escapes foreign text, and shows the results."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
import yaml

from allan_ros.core.estimate import significant
from allan_ros.core.findings import Finding
from allan_ros.core.imu import ImuBatch, ImuIdentity
from allan_ros.core.stream.health import Event, Segment
from allan_ros.core.stream.signal import SignalEnvelope, TemperatureTrace, summarize_signal
from allan_ros.readers import SourceInfo
from allan_ros.results.results import Results
from allan_ros.view.report import render_report
from allan_ros.view.report.chart_data import sensor_charts, to_script
from allan_ros.view.report.sensor_tables import filter_html

VOID = ('meta', 'br', 'wbr', 'input')
HOSTILE = '</script><script>alert(1)</script><img src=x onerror=alert(2)>&"\'\u2028'


class Page(HTMLParser):
    """Collects the text and scripts of a page, and rejects external resources."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text = ''
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.open: list[tuple[str, dict[str, str | None]]] = []
        self.ids: list[str] = []
        self.policy = ''
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        assert tag not in ('link', 'img', 'iframe', 'object', 'embed'), tag
        assert not {'src', 'onerror', 'onclick', 'onload'} & set(found), found
        if 'id' in found:
            self.ids.append(str(found['id']))
        if found.get('http-equiv') == 'Content-Security-Policy':
            self.policy = str(found['content'])
        if tag == 'script':
            self.scripts.append((found, ''))
        if tag not in VOID:
            self.open.append((tag, found))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1][0] == 'script':
            attributes, text = self.scripts.pop()
            self.scripts.append((attributes, text + data))
        elif self.open and self.open[-1][0] != 'style':
            self.text += data


def a_signal(n: int = 5000, start_ns: int = 10**18) -> SignalEnvelope:
    envelope = SignalEnvelope()
    samples = np.random.default_rng(1).normal(size=(n, 6))
    envelope.update(ImuBatch(start_ns + np.arange(n, dtype=np.int64) * 20_000_000, samples))
    return envelope


def everything() -> dict[str, Any]:
    """Return all optional parts of a page."""
    return {
        'signal': summarize_signal([a_signal()], (), 1000),
        'method': {'command': 'allan analyze my_bag'},
        'files': ['results.json'],
    }


def data_of(page: Page) -> dict[str, Any]:
    (text,) = [text for attributes, text in page.scripts if attributes.get('id') == 'data']
    found: dict[str, Any] = json.loads(text)
    return found


def test_the_page_is_self_contained_and_runs_only_its_own_scripts(small_results: Results) -> None:
    page = Page(render_report(small_results, 'deg/h', **everything()))
    assert "default-src 'none'" in page.policy
    script_rule = re.search(r'script-src ([^;]*)', page.policy)
    assert script_rule is not None and 'unsafe' not in script_rule[1]
    running = [text for attributes, text in page.scripts if 'type' not in attributes]
    hashes = {
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in running
    }
    assert hashes == set(script_rule[1].split())
    assert len(page.ids) == len(set(page.ids))


def test_texts_of_a_recording_stay_text(small_results: Results) -> None:
    source = SourceInfo(HOSTILE, HOSTILE, HOSTILE, HOSTILE)
    results = replace(
        small_results,
        identity=ImuIdentity(HOSTILE, HOSTILE),
        findings=(Finding('x', 'warning', ('gyro_x',), stated=(HOSTILE, HOSTILE)),),
        provenance=replace(
            small_results.provenance, sources=(source,), settings={HOSTILE: HOSTILE}
        ),
        method=HOSTILE,
        baselines={HOSTILE: small_results},
    )
    extras = everything() | {'method': {HOSTILE: HOSTILE}}
    plain = Page(render_report(small_results, 'deg/h', **everything()))
    page = Page(render_report(results, 'deg/h', **extras))
    assert (len(page.scripts), page.policy) == (len(plain.scripts), plain.policy)
    assert page.text.count('alert(1)') >= 8
    assert data_of(page)['sensors'][0]['references'][0]['name'] == HOSTILE


def test_a_script_element_cannot_be_ended_by_its_data() -> None:
    text = to_script({'a': HOSTILE})
    assert not set('<>&\u2028') & set(text)
    assert json.loads(text) == {'a': HOSTILE}


@pytest.mark.parametrize('units', ['deg/h', 'SI'])
def test_the_page_agrees_with_the_results(small_results: Results, units: str) -> None:
    text = render_report(small_results, units, **everything())
    page = Page(text)
    for said in ('Noise of unit 7', 'runs/one.mcap', 'allan analyze my_bag', 'What to do next'):
        assert said in page.text
    assert f'value="{units}" checked' in text
    noise = small_results.axes['gyro_x'].fit.noise['N'].value
    assert f'{noise:.3e}' in page.text
    assert f'{noise * 60.0 * 180.0 / np.pi:.4f}' in page.text


def test_the_page_is_complete_with_an_absent_sensor_and_an_empty_curve(
    small_results: Results,
) -> None:
    gyro = {name: axis for name, axis in small_results.axes.items() if name != 'accel_z'}
    x = gyro['gyro_x']
    zero = dict.fromkeys(('adev', 'ci_low', 'ci_high'), np.zeros(len(x.curve.m)))
    gyro['gyro_x'] = replace(x, curve=replace(x.curve, **zero))
    gyro['gyro_y'] = replace(gyro['gyro_y'], curve=None)
    for axes in (gyro, {'accel_y': small_results.axes['accel_y']}, {}):
        results = replace(small_results, axes=axes)
        data = data_of(Page(render_report(results, 'SI')))
        assert [a['name'] for s in data['sensors'] for a in s['axes']] == list(axes)


def test_charts_contain_si_values_and_factors(small_results: Results) -> None:
    chart = sensor_charts(small_results, 'accel', None)
    curve = small_results.axes['accel_y'].curve
    assert np.allclose([chart['tau'], chart['axes'][1]['adev']], [curve.tau, curve.adev], rtol=1e-4)
    assert chart['units']['deg/h']['curve'] == ['µg', pytest.approx(1.0 / 9.80665e-6)]
    assert chart['units']['SI']['N'] == ['m/s²/√Hz', 1.0]


def test_the_numbers_for_a_filter_are_those_of_its_file(small_results: Results) -> None:
    table = filter_html(small_results)
    written = yaml.safe_load(small_results.export('kalibr'))
    keys = [key for key in written if key.endswith(('density', 'walk'))]
    assert len(keys) == 4
    for key in keys:
        row = table.partition(f'>{key}<')[2].partition('</tr>')[0]
        assert f'<td>{significant(written[key], 4)}<' in row
        raised = re.search(r'raised ([\d.]+) times from ([-\d.e]+) as measured', row)
        if raised:  # the factor and the coefficient as measured give the number
            assert float(raised[1]) * float(raised[2]) == pytest.approx(written[key], rel=0.05)
    gyro = {name: axis for name, axis in small_results.axes.items() if name.startswith('gyro')}
    assert 'imu.yaml is not written' in filter_html(replace(small_results, axes=gyro))


def test_excluded_and_missing_times_are_marked_in_the_plot() -> None:
    n, period = 10_000, 20_000_000
    stamps = 10**18 + np.arange(n, dtype=np.int64) * period
    stamps[5000:] += 50 * 10**9  # 50 s are missing, after 100 s
    signal = SignalEnvelope()
    signal.update(ImuBatch(stamps, np.random.default_rng(3).normal(size=(n, 6))))
    spans = [Segment(10**18 + 20 * 10**9, 4000, 80.0), Segment(10**18 + 150 * 10**9, 5000, 100.0)]
    summary = summarize_signal([signal, signal], spans, 100_000)
    assert summary is not None
    # the second recording has the same stamps, so the same gaps are found
    (first, second) = summary.excluded
    assert first == (0.0, pytest.approx(20.0), '')
    assert second.end - second.start == pytest.approx(20.0)
    (gap, _) = summary.gaps
    assert gap == (pytest.approx(100.0, abs=0.2), pytest.approx(150.0, abs=0.2))
    assert summary.starts == (0.0, pytest.approx(250.0, abs=0.5))
    assert np.isnan(summary.low).any(axis=1).sum() == 1


def test_the_signal_summary_states_why_data_are_excluded() -> None:
    n, second = 10_000, 10**9
    stamps = np.arange(n, dtype=np.int64) * 20_000_000  # 200 s
    samples = np.random.default_rng(4).normal(size=(n, 6))
    samples[4000:4010] += 100.0  # a shock at 80 s
    signal = SignalEnvelope()
    signal.update(ImuBatch(stamps, samples))
    spans = [Segment(20 * second, 3000, 59.8), Segment(82 * second, 3400, 68.0)]
    trace = TemperatureTrace(
        '/t', stamps[::50] - second, stamps[::50], np.linspace(20.0, 30.0, 200)
    )
    events = [Event('motion', at * second, 2.2) for at in (80, 150)]
    events.append(Event('shock', 100 * second, 0.5))
    summary = summarize_signal([signal], spans, 100, events, [trace])
    assert summary is not None
    assert [out.why for out in summary.excluded] == ['', 'motion', 'motion', 'shock']
    ends = [out.end for out in summary.excluded]
    assert ends == pytest.approx([20.0, 82.0, 200.0, 100.5], abs=2.0)
    assert not summary.used[np.searchsorted(summary.time_s, 100.5) - 1]
    assert (summary.reach < 10.0).all() and np.nanmax(summary.high) > 90.0
    assert not summary.used[summary.time_s < 19.0].any()
    assert summary.temperature is not None and summary.temperature.source == '/t'
    assert summary.temperature.time_s[0] == 0.0 and summary.temperature.celsius[-1] == 30.0


def test_temperatures_of_several_recordings_are_joined_with_a_break() -> None:
    signal = a_signal()
    start = int(signal.start_ns[0])
    late = start + 5 * 10**9 + np.arange(3, dtype=np.int64) * 10**9
    # the header stamps are from another clock, so record times are used
    trace = TemperatureTrace('/t', late - 10**17, late, np.array([20.0, 21.0, 22.0]))
    summary = summarize_signal([signal, signal, signal], (), 100, (), [trace, None, trace])
    assert summary is not None and summary.temperature is not None
    assert np.isnan(summary.temperature.celsius).tolist() == [False] * 3 + [True] + [False] * 3
    assert summary.temperature.time_s[0] == pytest.approx(5.0)
    assert summary.temperature.time_s[-1] == pytest.approx(summary.starts[2] + 7.0)
