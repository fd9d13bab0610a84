# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table and the page of a batch: hostile names, empty batches, sorting in a browser."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from support.chromium import Chromium

from allan_ros.results.plan import Limits, Plan
from allan_ros.results.results import Results
from allan_ros.results.unit_check import check_unit
from allan_ros.view.batch_files import UnitRow, index_html, summary_csv

HOSTILE = '</script><script>document.title = "taken"</script>'

N = Limits(None, 1e-3, 'rad/s/sqrt(Hz)')


def rows_of(results: Results, names: list[str]) -> list[UnitRow]:
    check = check_unit(results, Plan('p', {'gyro_x': {'N': N}}, {'rate': Limits(1.0, None, 'Hz')}))
    return [
        UnitRow(name, f'SN{i}', 'healthy', f'reason of {name}', results, check, f'{i}/report.html')
        for i, name in enumerate(names)
    ]


def test_a_batch_without_a_readable_unit_has_both_files() -> None:
    unreadable = UnitRow('a', '', 'error', 'no data', None, None, exit_code=1)
    assert (
        summary_csv([unreadable], 'deg/h') == 'unit,verdict,exit_code,reason\na,error,1,no data\n'
    )
    page = index_html([unreadable])
    assert '1 units: 1 error' in page and '<svg' not in page


def test_a_row_states_values_and_limits_in_the_unit_of_the_plan(small_results: Results) -> None:
    (row,) = csv.DictReader(io.StringIO(summary_csv(rows_of(small_results, ['a']), 'deg/h')))
    n = small_results['gyro_x'].fit.noise['N'].value
    assert row['gyro_x N [rad/s/sqrt(Hz)]'] == f'{n:.6g}'
    assert row['gyro_x N upper limit [rad/s/sqrt(Hz)]'] == '0.001'
    assert row['rate [Hz]'] == '50' and float(row['gyro_y N [deg/sqrt(h)]']) > 0.0
    assert not any('gyro_y N upper limit' in name for name in row)


def test_names_are_text(small_results: Results) -> None:
    page = index_html(rows_of(small_results, [HOSTILE]), HOSTILE)
    assert HOSTILE not in page and page.count('<script>') == 1


def test_a_click_sorts_the_units(small_results: Results, tmp_path: Path, browser: Chromium) -> None:
    page = tmp_path / 'index.html'
    page.write_text(index_html(rows_of(small_results, ['unit 2', 'unit 10', 'unit 1'])))
    browser.open(page, 1000)
    names = "[...document.querySelectorAll('tbody tr')].map(r => r.cells[1].textContent).join()"
    heading = "document.querySelectorAll('thead th')[1].click()"
    assert browser.evaluate(names) == 'unit 2,unit 10,unit 1'
    browser.evaluate(heading)
    assert browser.evaluate(names) == 'unit 1,unit 2,unit 10'
    browser.evaluate(heading)
    assert browser.evaluate(names) == 'unit 10,unit 2,unit 1'
    assert browser.evaluate("document.querySelectorAll('polyline').length") == 18
