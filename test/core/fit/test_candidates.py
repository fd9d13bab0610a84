# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rating of candidates agrees with the likelihood of a fit that contains them."""

import numpy as np
import pytest
from support.sums import noise, sums_of

from allan_ros.core.fit.candidates import Candidates, LowBandFit
from allan_ros.core.fit.likelihood import AxisData
from allan_ros.core.fit.statistics import statistics
from allan_ros.core.noise import RANDOM_TERMS, SEARCHED, Model
from allan_ros.core.simulator import simulate_axis


@pytest.fixture(scope='module')
def known():
    """Two segments of different lengths; the contrasts of the longer one are divided."""
    return statistics(sums_of(noise(20_000, 3, 1), cuts=(7000,)))


@pytest.mark.parametrize('name', [one.name for one in SEARCHED])
def test_moments_are_those_of_a_fit_with_the_candidate_at_zero(known, name):
    data = AxisData.of(known, 0)
    fit = data.solve(RANDOM_TERMS)
    (kind,) = (each for each in Candidates(known).kinds if each.first.name == name)
    found = kind.moments(data, fit, LowBandFit.all_of(data, fit))
    some = {0, len(kind.processes) // 2, *kind.slow.tolist()[::5]}
    assert len(known.groups) > 2 and len(some) > 1
    p = np.append(fit.p, 0.0)
    for i in some:
        process = kind.processes[i]
        columns = data.columns((*RANDOM_TERMS, process))
        if not np.any(kind.slow == i):  # in the block means, only its aliases remain
            for low in columns.low:
                low[-1] = 0.0
        _, information, moment = data.moments(columns, p)
        scale = np.sqrt(information[-1, -1])
        score = float(moment[-1] - information[-1] @ p)
        assert found.score[i] / scale == pytest.approx(score / scale, rel=1e-6, abs=1e-6), process
        assert found.information[i] == pytest.approx(information[-1, -1], rel=1e-6), process
        np.testing.assert_allclose(found.shared[i], information[-1, :-1], rtol=1e-6)


@pytest.mark.parametrize('seed', [3, 4])
def test_a_candidate_that_equals_a_term_has_no_gain(seed):
    """Beside K, a Gauss-Markov process of the longest correlation times is no other noise."""
    terms = Model.of(N=1.0, B=0.1, K=1e-3)
    y = simulate_axis(20_000, 1.0, terms, np.random.default_rng(seed))[:, None]
    known = statistics(sums_of(y))
    candidates, axis = Candidates(known), AxisData.of(known, 0)
    fit = axis.solve(RANDOM_TERMS, tolerance=0.03)
    low = LowBandFit.all_of(axis, fit)
    for kind in candidates.kinds:
        if kind.first.low_band == 'dense':
            gains = kind.gains(axis, fit, low) * kind.allowed(8.0, 0.5)
            assert np.all(gains < 20.0) and len(gains) > 4
