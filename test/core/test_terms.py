# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.terms import NoiseTerms, term_avar


def test_long_tau_is_the_polynomial_of_the_standard():
    terms = NoiseTerms(Q=2e-3, N=0.3, B=0.05, K=0.02, R=-0.004)
    tau0, m = 0.01, np.array([1000, 30000])
    tau = m * tau0
    a = {-2: 3 * 2e-3**2, -1: 0.3**2, 0: 2 * math.log(2) / math.pi * 0.05**2}
    a |= {1: 0.02**2 / 3, 2: 0.004**2 / 2}
    polynomial = sum(value * tau**power for power, value in a.items())
    np.testing.assert_allclose(term_avar(m, tau0, terms).sum(axis=-1), polynomial, rtol=1e-6)


def test_a_random_walk_of_unit_steps_is_exact_at_one_sample():
    # V(1) = E(y_1 - y_0)^2/2 = 1/2 for steps of variance 1, not the 1/3 of continuous time.
    assert term_avar(1, 1.0, NoiseTerms(K=1.0))[3] == pytest.approx(0.5)


@pytest.mark.parametrize('bad', [{'N': -1.0}, {'B': math.nan}, {'R': math.inf}])
def test_impossible_coefficients_are_refused(bad):
    with pytest.raises(AllanError, match=f'^{next(iter(bad))} is'):
        NoiseTerms(**bad)
