# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of several recordings: scatter of the bias, rounding and growth, and their document."""

from __future__ import annotations

import json

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.readers.files import to_json
from allan_ros.results.documents import results_from_document, results_to_document

OFFSETS = np.array([1e-3, -2e-3, 4e-3])
WHITE, RATE, SAMPLES = 1e-3, 10.0, 6000


@pytest.fixture(scope='module')
def merged() -> ar.Results:
    """Return the results of three recordings, with one of these offsets on all axes of each."""
    rng = np.random.default_rng(6)
    runs = [
        ar.analyze(offset + WHITE * rng.standard_normal((SAMPLES, 3)), rate=RATE, motion_gate=False)
        for offset in OFFSETS
    ]
    return ar.analyze([ar.analyze(runs[:2]), runs[2]])


def test_the_bias_scatters_between_recordings(merged: ar.Results) -> None:
    turn_on = merged['gyro_x'].turn_on
    assert turn_on is not None
    assert turn_on.recordings == 3
    # the mean of a recording has an error of 1e-3 / sqrt(6000) = 1.3e-5
    assert turn_on.mean == pytest.approx(OFFSETS.mean(), abs=5e-5)
    assert turn_on.scatter.value == pytest.approx(OFFSETS.std(ddof=1), abs=8e-5)
    low, high = turn_on.scatter.ci95
    assert low < turn_on.scatter.value < high


def test_rounded_samples_have_their_step() -> None:
    step = 1.5 * WHITE
    samples = WHITE * np.random.default_rng(8).standard_normal((SAMPLES, 3))
    rounded = ar.analyze(step * np.round(samples / step), rate=RATE, motion_gate=False)
    assert rounded['gyro_z'].rounding == pytest.approx(step, rel=1e-6)
    plain = ar.analyze(samples, rate=RATE, motion_gate=False)['gyro_z']
    assert plain.rounding is None and plain.turn_on is None


def test_the_document_keeps_them(merged: ar.Results) -> None:
    document = json.loads(to_json(results_to_document(merged)))
    axis = document['axes']['gyro_y']
    assert axis['turn_on']['recordings'] == 3
    assert [growth['horizon'] for growth in axis['growth']] == [1.0, 10.0, 30.0, 100.0, 300.0]
    assert all(low < high for low, high in (growth['std']['ci95'] for growth in axis['growth']))
    read = results_from_document(document)['gyro_y']
    assert read.turn_on == merged['gyro_y'].turn_on
    assert read.rounding == merged['gyro_y'].rounding
