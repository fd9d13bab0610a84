# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.fit import fit_noise
from allan_ros.core.fit.interpretation import (
    LENGTHS_S,
    SECONDS_FOR_N,
    longest_recommended,
    recommended_duration,
)
from allan_ros.core.fit.model import AxisFit, Coefficient

HOUR = 3600.0
N = 1e-4


def seen(value):
    return Coefficient(value, (0.9 * value, 1.1 * value))


def unseen(upper, value=None):
    return Coefficient(value, None, upper, 'not_observable')


def fit_of(**noise):
    return AxisFit({**{t: unseen(1.0) for t in 'QBKR'}, 'N': seen(N), **noise})


def test_no_longer_record_is_recommended_for_q_and_r():
    assert recommended_duration(fit_of(B=seen(1e-5), K=seen(1e-7)), 60.0) is None


def test_a_limit_that_cannot_matter_needs_no_longer_recording():
    # at 100 s white noise is N/10 = 1e-5; a B of 1e-6 and a K of 1e-7 are far below it
    assert recommended_duration(fit_of(B=unseen(1e-6), K=unseen(1e-7)), 60.0) is None


def test_a_relevant_limit_gives_a_fixed_length():
    lengths = {recommended_duration(fit_of(), seconds) for seconds in (60.0, 600.0, HOUR)}
    assert lengths == {(4 * HOUR, ('B', 'K'))}
    assert recommended_duration(fit_of(), 5 * HOUR) is None


def test_the_length_does_not_depend_on_an_unresolved_estimate():
    assert recommended_duration(fit_of(K=unseen(1.0, 1e-9)), 60.0) == recommended_duration(
        fit_of(K=unseen(1.0, 1e-5)), 60.0
    )


def test_datasheet_limits_set_the_length():
    fit = fit_of(B=unseen(5e-5), K=unseen(1e-9))
    # 8.5 N/sqrt(T) = 2e-5 at 30 min 6 s
    assert recommended_duration(fit, 60.0, {'B': 2e-5}) == (HOUR, ('B',))
    assert recommended_duration(fit, 60.0, {'B': 6e-5}) is None
    assert (
        recommended_duration(fit, 60.0, {'B': 1e-9}) is None
    )  # longer than any recommended duration


def test_without_n_a_minute_is_recommended_first():
    fit = fit_of(N=unseen(1.0))
    assert recommended_duration(fit, 5.0) == (SECONDS_FOR_N, ('N',))
    assert recommended_duration(fit, 90.0) is None


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
    fit = fit_noise(engine.sums).axes['gyro_x']
    advice = recommended_duration(fit, seconds)
    assert advice is None or (seconds < advice[0] <= 4 * HOUR < LENGTHS_S[-1])
