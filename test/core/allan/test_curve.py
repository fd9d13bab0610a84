# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
import support.sums

from allan_ros.core.allan.curve import allan_curve, edf, noise_types_of_avar
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.errors import AllanError
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_axis

AXES = ('gyro_x', 'gyro_y')
FACTORS = 2 ** np.arange(11)


def sums_of(*segments):
    cuts = np.cumsum([len(y) for y in segments])[:-1].tolist()
    return support.sums.sums_of(np.concatenate(segments), cuts=cuts, axes=AXES)


def noise(n, seed=0, terms=(Model.of(N=1e-3), Model.of(K=1e-3))):
    rng = np.random.default_rng(seed)
    return np.stack([simulate_axis(n, 0.01, t, rng) for t in terms], axis=1)


def test_points_have_time_count_and_deviation():
    sums = sums_of(noise(5000))
    curve = allan_curve(sums)
    assert curve.axes == AXES
    np.testing.assert_allclose(curve.tau, curve.m * 0.01, rtol=1e-6)
    assert np.array_equal(curve.n, sums.count)
    np.testing.assert_allclose(curve.adev**2, sums.avar)
    assert (curve.ci_low < curve.adev).all() and (curve.adev < curve.ci_high).all()


def test_degrees_of_freedom_follow_the_noise_and_the_segments():
    y = noise(4000)
    one = allan_curve(sums_of(y))
    three = allan_curve(sums_of(y, noise(4000, 1), noise(4000, 2)))
    i = int(np.argmax(one.m == 64))
    assert one.noise_type[i].tolist() == [0, -2]
    for axis, alpha in enumerate((0, -2)):
        assert one.edf[i, axis] == pytest.approx(edf(alpha, 64, 8, one.n[i]))
        assert three.edf[i, axis] == pytest.approx(3 * one.edf[i, axis])


def test_pooled_and_kept_segments_have_the_same_degrees_of_freedom():
    segments = [noise(300, seed) for seed in range(60)]
    curve = allan_curve(sums_of(*segments))
    i = int(np.argmax(curve.m == 32))
    expected = 60 * edf(0, 32, 4, curve.n[i] // 60)
    assert curve.edf[i, 0] == pytest.approx(expected)


def test_constant_values_have_a_curve_of_zeros():
    curve = allan_curve(sums_of(np.full((100, 2), 2.5)))
    assert not curve.adev.any() and not curve.ci_high.any()


def test_sums_without_samples_have_no_curve():
    with pytest.raises(AllanError, match='at least two samples'):
        allan_curve(AllanSums.empty())


@pytest.mark.parametrize('term, alpha', [('Q', 2), ('N', 0), ('B', -1), ('K', -2), ('R', -2)])
def test_the_slope_determines_the_type_of_pure_noise(term, alpha):
    avar = Model.of(**{term: 1e-3}).avar(FACTORS * 0.01, 0.01)[:, None]
    types = noise_types_of_avar(FACTORS, avar, 10**6)
    assert (types[4:] == alpha).all()  # below, a random walk steps once a sample


def test_the_last_noise_type_is_kept_near_the_end_of_the_record():
    avar = np.stack([1.0 / FACTORS, np.full(len(FACTORS), np.nan), np.zeros(len(FACTORS))], axis=1)
    avar[-2:, 0] = 10.0, 100.0  # two outliers of a record of 2048 samples
    assert (noise_types_of_avar(FACTORS, avar, 2048) == 0).all()
