# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from allan_ros.core.fit.findings import common_step


def phase_of(samples, step):
    return np.concatenate([[0.0], np.cumsum(samples - samples[0])])[::step]


@pytest.mark.parametrize('lattice', [1e-6, 0.05, 3.0])
@pytest.mark.parametrize('relative', [0.1, 1.0, 4.0])
def test_step_of_rounded_samples_is_found(lattice, relative):
    rng = np.random.default_rng(5)
    noise = rng.normal(size=60000) * lattice / relative
    samples = 9.8 + lattice * np.round(noise / lattice)
    found = common_step(phase_of(samples, 512), lattice / relative)
    assert found == pytest.approx(lattice, rel=1e-6)


def test_smooth_samples_have_none():
    rng = np.random.default_rng(7)
    assert common_step(phase_of(rng.normal(size=60000), 512), 1.0) is None


def test_constant_samples_have_none():
    assert common_step(np.zeros(100), 1.0) is None


def test_few_points_of_real_noise_have_no_step_and_cause_no_warning():
    """Records of a few seconds; a warning of numpy is an error here."""
    rng = np.random.default_rng(0)
    with np.errstate(all='raise'):
        for _ in range(2000):
            phase = np.cumsum(rng.normal(size=rng.integers(5, 40)))
            assert common_step(phase, float(rng.uniform(0.1, 60.0))) is None
