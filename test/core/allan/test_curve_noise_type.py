# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.allan.curve import noise_types_of_avar
from allan_ros.core.noise import term_avar
from allan_ros.core.simulate import NoiseTerms

M = np.array([1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024])


@pytest.mark.parametrize('term, alpha', [('Q', 2), ('N', 0), ('B', -1), ('K', -2), ('R', -2)])
def test_the_slope_determines_the_type_of_pure_noise(term, alpha):
    avar = term_avar(M, 0.01, NoiseTerms(**{term: 1e-3})).sum(axis=1)[:, None]
    types = noise_types_of_avar(M, avar, 10**6)
    assert (types[4:] == alpha).all()  # below, a random walk steps once a sample


def test_the_last_noise_type_is_kept_near_the_end_of_the_record():
    avar = np.stack([1.0 / M, np.full(len(M), np.nan), np.zeros(len(M))], axis=1)
    avar[-2:, 0] = 10.0, 100.0  # two outliers of a record of 2048 samples
    assert (noise_types_of_avar(M, avar, 2048) == 0).all()
