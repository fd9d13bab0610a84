# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Axes with extreme numbers give finite numbers in every output."""

from __future__ import annotations

import json
import warnings

import pytest
from support.numbers import NO_NUMBER, check_numbers, noiseless_sums, noisy_sums

from allan_ros.core.errors import AllanError
from allan_ros.export import TARGETS, ExportOptions, make_export
from allan_ros.readers.files import parse_json, to_json
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums
from allan_ros.results.documents import (
    results_from_document,
    results_to_document,
    sums_file_from_document,
    sums_file_to_document,
)
from allan_ros.results.results import Results
from allan_ros.view.plots import sensor_figure
from fuzz.reading import check_line

SUMS = {'noisy': noisy_sums, 'noiseless': noiseless_sums}


@pytest.fixture(scope='module', params=[('noisy', 'likelihood'), ('noiseless', 'paper')])
def results(request: pytest.FixtureRequest) -> Results:
    """Return the results of one method for axes with samples of very different sizes."""
    kind, method = request.param
    return analyze_sums([SUMS[kind]()], Provenance(), method)


@pytest.mark.parametrize('kind', SUMS)
def test_sums_of_any_size_are_a_document(kind: str) -> None:
    text = to_json(sums_file_to_document([SUMS[kind]()], Provenance()))
    check_numbers(json.loads(text))
    (back,), _ = sums_file_from_document(parse_json(text, 'sums'))
    assert to_json(sums_file_to_document([back], Provenance())) == text


@pytest.mark.parametrize('curves', [True, False])
def test_results_and_noise_model_contain_numbers_or_null(results: Results, curves: bool) -> None:
    text = to_json(results_to_document(results, curves))
    check_numbers(json.loads(text))
    back = results_from_document(parse_json(text, 'results'))
    assert to_json(results_to_document(back, curves)) == text


def test_files_for_filters_contain_numbers_or_are_rejected(results: Results) -> None:
    written = 0
    for name in TARGETS:
        try:
            text = make_export(results, name, ExportOptions()).text
        except AllanError as error:
            check_line(str(error))
            continue
        assert not NO_NUMBER.search(text), name
        written += 1
    assert bool(written) == (results.method == 'likelihood')


def test_findings_and_pictures_need_no_excuse(results: Results) -> None:
    assert not any(NO_NUMBER.search(str(found)) for found in results.findings)
    with warnings.catch_warnings():
        warnings.simplefilter('error', RuntimeWarning)
        for sensor in ('gyro', 'accel'):
            figure = sensor_figure(results, sensor)
            assert figure is not None
            figure.draw_without_rendering()
