# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The terminal report fits the terminal and is complete."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from support.findings import example

from allan_ros.cli.result_lines import (
    comparison_lines,
    findings_lines,
    results_lines,
)
from allan_ros.core.estimate import Estimate, interval_text, value_text
from allan_ros.core.filters.noise_parameters import FilterLevel
from allan_ros.core.findings import CATALOG, Finding, finding
from allan_ros.core.fit.result import TERMS, Deviation
from allan_ros.core.imu import shown_unit
from allan_ros.export import origin_text, target_rows
from allan_ros.results.comparison import compare_runs
from allan_ros.results.datasheets import load_sensor
from allan_ros.results.results import Results
from allan_ros.view.coefficient_table import coefficient_table
from allan_ros.view.finding_text import texts_of
from allan_ros.view.verdict_text import headline, summary_lines, verdict_of

LONG = Finding('x', 'warning', ('gyro_x',), stated=('word ' * 40 + 'end', 'do this'))


def lines_of(results: Results, units: str, width: int, complete: bool = False) -> list[str]:
    return list(results_lines(results, verdict_of(results), units, width, complete=complete))


@pytest.mark.parametrize('width', [60, 80, 100, 200])
@pytest.mark.parametrize('units', ['deg/h', 'SI'])
def test_no_line_is_wider_than_the_terminal(small_results: Results, width: int, units: str) -> None:
    results = replace(small_results, findings=(LONG,))
    lines = lines_of(results, units, width)
    assert max(map(len, lines)) <= width


@pytest.mark.parametrize('units', ['deg/h', 'SI'])
@pytest.mark.parametrize('id', CATALOG)
def test_no_finding_is_cut_or_wider_than_80_columns(
    small_results: Results, id: str, units: str
) -> None:
    found = example(id, 0.123456)
    results = replace(small_results, findings=(found,))
    narrow, wide = (list(findings_lines(results, units, w, False, False)) for w in (80, 10_000))
    assert max(map(len, narrow)) <= 80
    assert ' '.join(line.strip() for line in narrow) == ' '.join(wide)
    assert '...' not in wide[1] and wide[1].endswith(texts_of(found, units).remedy)


def test_the_prefix_of_a_row_fits_its_largest_value() -> None:
    large = Estimate(0.0274, (0.026, 0.029))
    table = coefficient_table({'accel_x': dict.fromkeys(TERMS, large)}, 'deg/h', prefixes=True)
    cells = {(heading.name, heading.unit): cells for heading, cells in table.rows}
    ((cell,),) = (cells['B', 'mg'],)
    assert (cell.text, cell.detail) == ('2.794', '2.65..2.96')


def test_constant_data_have_one_line(small_results: Results) -> None:
    nothing = {term: Estimate(None, status='not_observable') for term in TERMS}
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise=nothing, deviation=None))
        for name, axis in small_results.axes.items()
    }
    lines = lines_of(replace(small_results, axes=axes), 'deg/h', 80)
    assert 'gyro x, y, z: no coefficients' in lines
    assert not any(line.startswith(('N ', 'gyro  ')) or ' - ' in line for line in lines)


def test_a_raised_k_has_its_factor_and_the_measured_value(small_results: Results) -> None:
    raised = FilterLevel(Estimate(3e-6, name='K', axis='gyro_x'), 1e-6)
    assert origin_text(raised) == 'K of gyro x, raised 3 times from 1e-06 as measured'
    lines = lines_of(small_results, 'deg/h', 200)
    rows = {row.key: row for row in target_rows(small_results, 'kalibr')}
    shown = [line.split() for line in lines if line.split(' ')[0] in rows]
    assert [float(value) for _, value, *_ in shown] == pytest.approx(
        [row.value for row in rows.values()], rel=1e-3
    )


@pytest.mark.parametrize('width', [60, 200])
def test_every_coefficient_is_printed_at_any_width(small_results: Results, width: int) -> None:
    text = '\n'.join(lines_of(small_results, 'deg/h', width))
    for axis, result in small_results.axes.items():
        for term in TERMS:
            unit, coefficient = shown_unit(axis, term, 'deg/h'), result.fit.noise[term]
            assert unit.name in text
            assert value_text(coefficient, unit) in text
            assert interval_text(coefficient, unit) in text


@pytest.mark.parametrize(
    ('received', 'number'), [(60_100, '60,000'), (120_000, '60,000 of 120,000')]
)
def test_the_headline_states_how_many_samples_are_excluded(
    small_results: Results, received: int, number: str
) -> None:
    provenance = small_results.provenance
    counts = replace(provenance.counts, received=received)
    assert headline(replace(small_results, provenance=replace(provenance, counts=counts))) == (
        f'unit 7: {number} samples at 50 Hz, 20 min of static data in 1 segment, '
        'fitted by likelihood'
    )


def test_a_short_record_is_not_judged_and_the_verdict_comes_before_the_tables(
    small_results: Results,
) -> None:
    brief = replace(small_results.compared(sensor='adis16475-3'), duration_s=5.0, findings=())
    lines = lines_of(brief, 'SI', 200)
    assert lines[1] == 'not judged: Too short to judge: 5 s at rest.'
    (compared,) = (line for line in lines if line.startswith('compared with the datasheet'))
    assert compared.endswith(': not judged')


def test_a_method_without_intervals_is_reported(small_results: Results) -> None:
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise={term: Estimate(1.0) for term in TERMS}))
        for name, axis in small_results.axes.items()
    }
    results = replace(small_results, axes=axes, method='paper')
    assert 'method paper gives no intervals' in lines_of(results, 'SI', 100)


def test_no_method_is_blamed_if_there_are_no_coefficients(small_results: Results) -> None:
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise={term: Estimate(None) for term in TERMS}))
        for name, axis in small_results.axes.items()
    }
    lines = lines_of(replace(small_results, axes=axes), 'SI', 100)
    assert 'gyro x, y, z: no coefficients' in lines
    assert not any('intervals' in line for line in lines)


def test_the_largest_deviation_is_shown_where_there_is_one(small_results: Results) -> None:
    axes = {
        name: replace(axis, fit=replace(axis.fit, deviation=bent))
        for name, axis in small_results.axes.items()
        for bent in [Deviation(-0.123, 31.7) if name == 'accel_z' else None]
    }
    results = replace(small_results, axes=axes)
    rows = [line for line in lines_of(results, 'SI', 200) if line.startswith('deviation')]
    assert len(rows) == 1
    assert rows[0].endswith('-12 % at 32 s')
    brief = lines_of(replace(results, duration_s=4.8), 'SI', 200)
    assert not any(line.startswith('deviation') for line in brief)


def test_findings_are_colored_only_on_request(small_results: Results) -> None:
    results = replace(small_results, findings=(LONG,))
    plain, colored = (
        list(findings_lines(results, 'SI', 80, colors, True)) for colors in (False, True)
    )
    assert plain[1].startswith('warning: gyro x: word')
    assert colored[1].startswith('\x1b[33mwarning\x1b[0m')
    assert plain[2:] == colored[2:]


def test_five_findings_at_most_and_all_on_demand(small_results: Results) -> None:
    axes = tuple(small_results.axes)
    first = finding('settling', ('gyro_x',), size=1.0, time=7200.0)
    many = tuple(
        Finding(f'kind_{i}', 'warning', (axis,), stated=(f'Cause {"abcdefgh"[i]}.', f'Do {i}.'))
        for i in range(8)
        for axis in axes[:2]
    )
    note = Finding('n', 'info', stated=('Note.', 'Nothing.'))
    results = replace(small_results, findings=(*many, note, first))
    short = lines_of(results, 'SI', 100)
    shown = [line for line in short if line.startswith(('warning', 'info', 'and '))]
    assert len(shown) == 6
    assert shown[-1] == 'and 5 more findings: -v shows all'
    # what changes the numbers is named first
    assert shown[0].startswith('info: gyro x: The bias settles by 1.00 rad/s')
    assert shown[1] == 'warning: gyro x, gyro y: Cause a. Do 0.'
    complete = lines_of(results, 'SI', 100, complete=True)
    assert sum(line.startswith('warning: ') for line in complete) == 8
    assert 'info: Note. Nothing.' in complete


def test_findings_follow_the_units(small_results: Results) -> None:
    found = finding('vibration', ('accel_x',), frequency=8.0, amplitude=0.0098)
    results = replace(small_results, findings=(found,))
    for units, amplitude in (('SI', '0.00980 m/s^2'), ('deg/h', '999 ug')):
        assert f'amplitude {amplitude};' in '\n'.join(lines_of(results, units, 200))
    assert 'amplitude 999 ug;' in '\n'.join(summary_lines(results))


def test_a_comparison_with_a_datasheet_has_no_two_empty_lines_in_a_row(
    small_results: Results,
) -> None:
    comparison = compare_runs({'a': small_results}, [load_sensor('mpu-6050')])
    lines = list(comparison_lines(comparison, 'deg/h', 100))
    assert '' in lines and ('', '') not in pairwise(lines)


def test_a_term_that_neither_recording_resolves_has_no_row(small_results: Results) -> None:
    runs = compare_runs({'a': small_results, 'b': small_results})
    lines = list(comparison_lines(runs, 'deg/h', 100))
    headings = [i for i, line in enumerate(lines) if line.startswith(('gyro ', 'accel '))]
    assert headings and all(lines[i + 1][:1].isalpha() for i in headings)
