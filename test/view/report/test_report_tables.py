# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of a report: predicted errors, scatter of the bias, and parts that are only likely."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from allan_ros.core.allan.at_rest import TurnOnBias
from allan_ros.core.estimate import Estimate, significant
from allan_ros.core.fit.result import AxisFit, model_of_terms
from allan_ros.results.axis_result import AxisResult
from allan_ros.results.results import Results
from allan_ros.view.format import NO_BREAK
from allan_ros.view.report.sensor_tables import growth_html, model_html

DEG = 180.0 / math.pi


def cells(html: str, units: str) -> list[str]:
    """Return the cells of a table in one system of units, tags replaced by a space."""
    other = {'deg/h': 'SI', 'SI': 'deg/h'}[units]
    shown = re.sub(rf'<span data-units="{other}">.*?</span>', '', html)
    found = re.findall(r'<td[^>]*>(.*?)</td>', shown)
    return [' '.join(re.sub('<[^>]*>', ' ', cell).split()) for cell in found]


def axis_of(**noise: Estimate) -> AxisResult:
    unknown = {term: Estimate(None, status='not_observable') for term in 'QNBKR'}
    terms = {**unknown, **noise}
    return AxisResult(0.01, AxisFit(terms, model_of_terms(terms)), name='gyro_x')


@pytest.mark.parametrize(('units', 'factor'), [('deg/h', DEG), ('SI', 1.0)])
def test_the_growth_is_that_of_the_axis(small_results: Results, units: str, factor: float) -> None:
    axes = {name: small_results.axes[name] for name in ('gyro_x', 'gyro_y')}
    html = ''.join(growth_html(axes))
    assert f'angle error <em>{"°" if units == "deg/h" else "rad"}</em>' in html
    expected = []
    for row in zip(*(axis.growth for axis in axes.values())):
        assert f'after {row[0].horizon:g}{NO_BREAK}s' in html
        for growth in row:
            low, high = (significant(end * factor, 2) for end in growth.std.ci95)
            expected.append(f'{significant(growth.std.value * factor, 2)} {low} ..{high}')
    assert cells(html, units) == expected


def test_of_terms_that_are_not_resolved_only_a_limit_is_given() -> None:
    limits = {term: Estimate(None, None, 1e-3, 'not_observable') for term in 'NBK'}
    axis = axis_of(**limits)
    assert all(growth.std.ci95[0] == 0.0 for growth in axis.growth)
    shown = cells(''.join(growth_html({'gyro_x': axis})), 'SI')
    highs = [significant(growth.std.ci95[1], 2) for growth in axis.growth]
    assert shown == [f'&lt; {high}' for high in highs]


def test_the_scatter_of_the_bias_is_named(small_results: Results) -> None:
    turn_on = TurnOnBias(3, 0.0, Estimate(0.01 / DEG, (0.005 / DEG, 0.06 / DEG)))
    axes = {'gyro_x': replace(small_results.axes['gyro_x'], turn_on=turn_on)}
    html = ''.join(growth_html(axes))
    assert 'Bias of x between 3 recordings: standard deviation' in html
    assert '36 °/h (18..220)' in html
    without = ''.join(growth_html({'gyro_x': small_results.axes['gyro_x']}))
    assert 'between' not in without


def test_a_part_that_is_only_likely_is_marked() -> None:
    likely = Estimate(1e-4, None, 1.2e-4, 'likely')
    axis = axis_of(N=Estimate(1e-3, (9e-4, 1.1e-3)), B=likely)
    assert axis.fit.likely == ('B',)
    html = ''.join(model_html({'gyro_x': axis}))
    assert '>B, likely but not resolved (?)</td>' in html
