# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The output of results in a notebook."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

from allan_ros.api.classes import Results
from allan_ros.core.imu import ImuIdentity


def test_results_are_shown_with_verdict_units_and_intervals(small_results: Results) -> None:
    page = small_results._repr_html_()
    root = ElementTree.fromstring(page.replace('<wbr>', ''))
    assert small_results.verdict.summary in page.replace('&#x27;', "'")
    tables = list(root.iter('table'))
    assert [len(list(table.iter('tr'))) for table in tables] == [6, 6]
    n = small_results['gyro_x'].N.to('deg/sqrt(h)')
    assert f'{n.value:.4f}' in page and '°/√h' in page
    assert 'data-units' not in page  # no style sheet chooses between units


def test_the_name_of_an_imu_cannot_contain_html(small_results: Results) -> None:
    named = replace(small_results, identity=ImuIdentity('<script>alert(1)</script>'))
    assert '<script>' not in named._repr_html_()
