# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from support.sums import sums_of

from allan_ros.core.findings import finding
from allan_ros.core.fit.fit_findings import Line, line_finding, merge_equal, with_harmonics
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.view.finding_text import texts_of


def test_equal_findings_are_joined():
    one = finding('low_pass', ('gyro_x',), frequency=5.0)
    other = finding('low_pass', ('gyro_z',), frequency=5.0)
    third = finding('lack_of_fit', ('gyro_y',), deviation=0.1, low=3.0, high=6.0)
    both, last = merge_equal([one, third, other])
    assert both.axes == ('gyro_x', 'gyro_z')
    assert last == third


@pytest.mark.parametrize(
    ('hertz', 'id', 'words'),
    [
        (0.57, 'vibration', 'Vibration at 0.57 Hz'),
        (0.024, 'slow_disturbance', 'Periodic disturbance with a period of 42 s'),
        (1 / 1200, 'slow_disturbance', 'Periodic disturbance with a period of 20 min'),
    ],
)
def test_the_finding_of_a_sinusoid_depends_on_its_frequency(hertz, id, words):
    line = Line(hertz, 0.01)
    found = line_finding(('accel_x',), [line], 0.01)
    assert found.id == id and texts_of(found).message.startswith(words)


@pytest.mark.parametrize(
    ('samples', 'id'),
    [
        (np.full((5000, 1), 9.8), 'no_noise'),
        (np.random.default_rng(0).normal(size=(8, 1)), 'record_too_short'),
    ],
)
def test_an_axis_without_numbers_states_the_reason(samples, id):
    (found,) = fit_likelihood(sums_of(samples, axes=('gyro_x',))).findings
    assert found.id == id
    assert found.axes == ('gyro_x',)


def test_a_sinusoid_and_its_harmonics_are_one_finding():
    lines = [Line(f, a) for a, f in ((0.3, 15.0), (0.4, 30.0))]
    found = line_finding(('accel_x',), lines, 0.01)
    assert found.values['amplitude'].value == pytest.approx(0.5)
    assert (
        texts_of(found).message.startswith('Vibration at 15 Hz') and '30' in texts_of(found).message
    )


@pytest.mark.parametrize(
    'frequencies, sizes',
    [
        ((0.224, 47.0, 94.2), [1, 2]),  # a fast sinusoid is no harmonic of a slow one
        ((47.0, 47.3), [1, 1]),  # nor is a close one
    ],
)
def test_only_low_multiples_are_harmonics(frequencies, sizes):
    lines = [Line(f, 1.0) for f in frequencies]
    assert [len(group) for group in with_harmonics(lines)] == sizes
