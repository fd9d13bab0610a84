# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The terminal report fits the terminal and says everything."""

from __future__ import annotations

from dataclasses import replace

import pytest

from allan_ros.cli.console import finding_lines
from allan_ros.cli.tables import results_lines
from allan_ros.core.findings import Finding
from allan_ros.core.fit import TERMS, Coefficient
from allan_ros.io.format import interval_text, shown_unit, value_text
from allan_ros.io.results import Results
from allan_ros.io.summary import headline

LONG = Finding('x', 'warning', 'word ' * 40 + 'end', 'do this', ('gyro_x',))


@pytest.mark.parametrize('width', [60, 80, 100, 200])
@pytest.mark.parametrize('units', ['datasheet', 'si'])
def test_no_line_is_wider_than_the_terminal(small_results: Results, width: int, units: str) -> None:
    results = replace(small_results, findings=(LONG,))
    lines = list(results_lines(results, units, width))
    assert max(map(len, lines)) <= width


@pytest.mark.parametrize('width', [60, 200])
def test_every_coefficient_is_there_whatever_the_width(small_results: Results, width: int) -> None:
    text = '\n'.join(results_lines(small_results, 'datasheet', width))
    for axis, result in small_results.axes.items():
        for term in TERMS:
            unit, coefficient = shown_unit(axis, term, 'datasheet'), result.fit.noise[term]
            assert unit.name in text
            assert value_text(coefficient, unit) in text
            assert interval_text(coefficient, unit) in text


def test_headline(small_results: Results) -> None:
    assert headline(small_results) == (
        'unit 7: 60,000 samples at 50 Hz, 20.0 min of static data in 1 segment, fitted by gls'
    )


def test_a_method_without_intervals_says_so(small_results: Results) -> None:
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise={term: Coefficient(1.0) for term in TERMS}))
        for name, axis in small_results.axes.items()
    }
    results = replace(small_results, axes=axes, method='paper')
    said = list(results_lines(results, 'si', 100))
    assert 'method paper gives no intervals and no verdicts' in said


def test_misfit_is_shown_only_where_there_is_one(small_results: Results) -> None:
    axis = small_results.axes['accel_z']
    bent = replace(axis, fit=replace(axis.fit, misfit=0.123))
    results = replace(small_results, axes={**small_results.axes, 'accel_z': bent})
    rows = [line for line in results_lines(results, 'si', 200) if line.startswith('misfit')]
    assert len(rows) == 1
    assert rows[0].endswith('12%')


def test_findings_are_coloured_only_when_asked() -> None:
    plain, coloured = finding_lines(LONG, 80), finding_lines(LONG, 80, colours=True)
    assert plain[0].startswith('warning: gyro_x: word')
    assert coloured[0].startswith('\x1b[33mwarning\x1b[0m')
    assert plain[1:] == coloured[1:]
