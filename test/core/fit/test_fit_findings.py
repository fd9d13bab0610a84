# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from support.sums import sums_of

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.estimate import Estimate
from allan_ros.core.findings import finding
from allan_ros.core.fit.fit_findings import (
    LENGTHS_S,
    SECONDS_FOR_N,
    line_finding,
    longest_recommended,
    merge_equal,
    recommended_duration,
    with_harmonics,
)
from allan_ros.core.fit.result import AxisFit
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.noise import Part
from allan_ros.core.noise.processes.sinusoid import Sinusoid
from allan_ros.view.finding_text import texts_of

HOUR = 3600.0
N = 1e-4


def test_equal_findings_are_joined():
    one = finding('low_pass', ('gyro_x',), frequency=5.0)
    other = finding('low_pass', ('gyro_z',), frequency=5.0)
    third = finding('lack_of_fit', ('gyro_y',), frequency=3.0, deviation=0.1)
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
    line = Part(Sinusoid(hertz), 0.01)
    found = line_finding(('accel_x',), [line], 0.01)
    assert found.id == id and texts_of(found).message.startswith(words)


@pytest.mark.parametrize(
    ('samples', 'id'),
    [
        (np.full((5000, 1), 9.8), 'no_noise'),
        (np.full((60, 1), 9.8), 'record_too_short'),
        (np.full((2, 1), 9.8), 'record_too_short'),
        (np.random.default_rng(0).normal(size=(8, 1)), 'record_too_short'),
    ],
)
def test_an_axis_without_numbers_states_the_reason(samples, id):
    (found,) = fit_likelihood(sums_of(samples, axes=('gyro_x',))).findings
    assert found.id == id
    assert found.axes == ('gyro_x',)


def test_a_sinusoid_and_its_harmonics_are_one_finding():
    lines = [Part(Sinusoid(f), a) for a, f in ((0.3, 15.0), (0.4, 30.0))]
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
    lines = [Part(Sinusoid(f), 1.0) for f in frequencies]
    assert [len(group) for group in with_harmonics(lines)] == sizes


def seen(value):
    return Estimate(value, (0.9 * value, 1.1 * value))


def unseen(upper, value=None):
    return Estimate(value, None, upper, 'not_observable')


def fit_of(**noise):
    return AxisFit({**{t: unseen(1.0) for t in 'QBKR'}, 'N': seen(N), **noise})


LIMITED = {'B': unseen(5e-5), 'K': unseen(1e-9)}


@pytest.mark.parametrize(
    ('noise', 'seconds', 'limits', 'advice'),
    [
        ({'B': seen(1e-5), 'K': seen(1e-7)}, 60.0, {}, None),  # none for Q and R
        # at 100 s white noise is N/10 = 1e-5; a B of 1e-6 and a K of 1e-7 are far below it
        ({'B': unseen(1e-6), 'K': unseen(1e-7)}, 60.0, {}, None),
        *(({}, seconds, {}, (4 * HOUR, ('B', 'K'))) for seconds in (60.0, 600.0, HOUR)),
        ({}, 5 * HOUR, {}, None),
        # an estimate that is not resolved has no effect
        *(({'K': unseen(1.0, k)}, 60.0, {}, (4 * HOUR, ('B', 'K'))) for k in (1e-9, 1e-5)),
        (LIMITED, 60.0, {'B': 2e-5}, (HOUR, ('B',))),  # 8.5 N/sqrt(T) = 2e-5 at 30 min 6 s
        (LIMITED, 60.0, {'B': 6e-5}, None),
        (LIMITED, 60.0, {'B': 1e-9}, None),  # longer than any recommended length
        ({'N': unseen(1.0)}, 5.0, {}, (SECONDS_FOR_N, ('N',))),
        ({'N': unseen(1.0)}, 90.0, {}, None),
    ],
)
def test_the_length_follows_from_n_and_the_limits_that_matter(noise, seconds, limits, advice):
    assert recommended_duration(fit_of(**noise), seconds, limits) == advice


def test_the_longest_recommendation_contains_all_terms():
    advice = [None, (60.0, ('N',)), (HOUR, ('K', 'B'))]
    assert longest_recommended(advice) == (HOUR, ('N', 'B', 'K'))
    assert longest_recommended([None]) is None


@pytest.mark.parametrize('seconds', [200.0, 2000.0, 20000.0])
def test_at_most_four_hours_are_recommended_for_white_noise(seconds):
    samples = np.random.default_rng(1).normal(size=(int(10 * seconds), 1))
    engine = RunningSums(axes=('gyro_x',))
    engine.update(samples, 0, (len(samples) - 1) * 10**8)
    engine.end_segment()
    fit = fit_likelihood(engine.sums).axes['gyro_x']
    advice = recommended_duration(fit, seconds)
    assert advice is None or (seconds < advice[0] <= 4 * HOUR < LENGTHS_S[-1])
