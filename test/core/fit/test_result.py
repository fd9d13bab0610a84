# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.allan_table import grid_for

from allan_ros.core.allan.curve import AllanCurve, chi_squared_limits
from allan_ros.core.estimate import Estimate
from allan_ros.core.fit.result import (
    TERMS,
    AxisFit,
    dominant_regions,
    largest_deviation,
    model_line,
    model_of_terms,
)
from allan_ros.core.imu import from_datasheet
from allan_ros.core.noise import GaussMarkov, Model

TAU0, TWO_HOURS = 0.01, 720000

# Cong et al. 2019, table 1: Q urad, N deg/sqrt(h), B deg/h, K deg/h^1.5, R deg/h^2.
PAPER = {
    'gyro_x': (0.138, 0.242, 5.237, 31.807, 76.242),
    'gyro_y': (0.124, 0.168, 4.972, 8.169, 11.068),
    'gyro_z': (0.100, 0.245, 6.058, 50.568, 66.250),
}


def exact(longest_tau=1300.0, **axes):
    """The expected curves and perfect fits of axes given in datasheet units."""
    terms = {
        axis: {t: from_datasheet(t, 'gyro', v) for t, v in zip(TERMS, values)}
        for axis, values in axes.items()
    }
    m, _ = grid_for(TWO_HOURS)
    m = m[m * TAU0 <= longest_tau]
    avar = [Model.of(**t).avar(m * TAU0, TAU0) for t in terms.values()]
    adev = np.sqrt(np.stack(avar, axis=1))
    edf = np.repeat(TWO_HOURS / m[:, None], len(axes), axis=1)
    types = np.zeros(adev.shape, np.int64)
    curve = AllanCurve(m, m * TAU0, m, adev, adev, adev, tuple(axes), edf, types)
    noise = {
        axis: {
            k: Estimate(v or None, status='estimated' if v else 'not_observable')
            for k, v in t.items()
        }
        for axis, t in terms.items()
    }
    fits = {axis: AxisFit(each, model_of_terms(each)) for axis, each in noise.items()}
    return curve, fits


def regions_of(axis, *values, longest_tau=1300.0):
    curve, fits = exact(longest_tau, **{axis: values})
    return dominant_regions(curve, fits[axis])


def test_axis_x_of_the_paper():
    """The paper reads .01-20 s N, 20-100 s B, 100-1300 s K and R in turn."""
    n, b, *late = regions_of('gyro_x', *PAPER['gyro_x'])
    assert (n.term, b.term) == ('N', 'B')
    assert n.tau_low == pytest.approx(0.01)
    assert n.tau_high == pytest.approx(20, rel=0.3)
    assert b.tau_high == pytest.approx(100, rel=0.35)
    assert [r.term for r in late] == ['K', 'K+R']
    assert late[-1].tau_high == pytest.approx(1300, rel=0.15)


def test_axes_y_and_z_of_the_paper():
    """The paper reads .01-20 s N, 20-1300 s B (y; by its own coefficients they cross at 9 s), and
    .01-20 s N, then K and R from 20 to 180 s (z).
    """
    n, b = regions_of('gyro_y', *PAPER['gyro_y'])
    assert (n.term, b.term) == ('N', 'B')
    assert n.tau_high == b.tau_low == pytest.approx(9.3, rel=0.15)
    assert b.tau_high == pytest.approx(1300, rel=0.15)
    regions = regions_of('gyro_z', *PAPER['gyro_z'])
    assert [r.term for r in regions] == ['N', 'B', 'K']
    assert regions[0].tau_high == pytest.approx(20, rel=0.4)


def test_regions_touch_and_cover_the_curve():
    curve, fits = exact(**PAPER)
    for axis in PAPER:
        regions = dominant_regions(curve, fits[axis])
        assert regions[0].tau_low == curve.tau[0]
        assert regions[-1].tau_high == curve.tau[-1]
        for a, b in pairwise(regions):
            assert a.tau_high == b.tau_low and a.term != b.term


def test_narrow_regions_are_joined():
    # K dominates only over a factor of two, so K and R form one range.
    late = regions_of('gyro_x', 0, 0.1, 0, 40.0, 350.0, longest_tau=60.0)
    assert late[-1].term == 'K+R'
    # B alone dominates only briefly here, so its range names the second largest term, too.
    assert any('+' in r.term and 'B' in r.term for r in regions_of('gyro_x', 0, 0.2, 3.4, 35.0, 0))


@pytest.mark.parametrize('term', TERMS)
def test_pure_noise_is_one_region(term):
    (region,) = regions_of('gyro_x', *(float(t == term) for t in TERMS))
    assert region.term == term


def test_unknown_terms_dominate_nowhere():
    curve, _ = exact(**PAPER)
    unknown = AxisFit({t: Estimate(None, status='not_observable') for t in TERMS})
    assert dominant_regions(curve, unknown) == []


def test_only_points_that_are_certain_are_compared_with_the_model():
    """White noise over 2 h whose curve drops by 80 % at long times, and at one short time."""
    curve, fits = exact(3600.0, gyro_x=(0.0, 0.242, 0.0, 0.0, 0.0))
    adev = np.where(curve.edf > 6.0, 1.0, 0.2) * curve.adev
    low, high = chi_squared_limits(adev**2, curve.edf)
    curve = replace(curve, adev=adev, ci_low=low, ci_high=high)
    line = model_line(fits['gyro_x'], TAU0, curve)
    assert np.all(curve.is_uncertain == (curve.edf <= 6.0)) and curve.is_uncertain.any()
    assert largest_deviation(line, curve.axis(0)) is None
    for column in (adev, low, high):
        column[10] *= 0.2
    assert largest_deviation(line, curve.axis(0)) == pytest.approx((-0.8, curve.tau[10]))


def test_limits_replace_only_terms_that_are_not_resolved():
    noise = {
        'N': Estimate(1e-3, (0.9e-3, 1.1e-3)),
        'B': Estimate(1e-4, None, 2e-4, 'likely'),
        'K': Estimate(None, None, 3e-5, 'not_observable'),
        'R': Estimate(None, status='not_observable'),
    }
    model = Model.of((2e-4, GaussMarkov(300.0)), N=1e-3, B=1e-4, R=2e-9)
    fit = AxisFit(noise, model)
    limits = fit.model_at_limits
    assert limits == Model.of((2e-4, GaussMarkov(300.0)), N=1e-3, B=2e-4, K=3e-5, R=2e-9)
    assert fit.likely == ('B',)


def test_a_model_of_terms_has_the_sign_of_the_ramp():
    noise = {'N': Estimate(1e-3), 'B': Estimate(None), 'R': Estimate(-1e-8)}
    assert model_of_terms(noise) == Model.of(N=1e-3, R=-1e-8)
