# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Extreme numbers: tiny and huge samples, decades of data, and a comparison with exact
arithmetic.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.allan_table import grid_for
from support.numbers import check_numbers
from support.sums import sums_of

from allan_ros.core.allan.curve import allan_curve, edf
from allan_ros.core.allan.document import sums_from_document, sums_to_document
from allan_ros.core.allan.grid import MAX_LEVELS, MIN_VARIANCE, counts, grid
from allan_ros.core.allan.periods import Period, RecordedPeriods
from allan_ros.core.allan.recent import noise_steps
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.fit.least_squares import fit_paper
from allan_ros.core.fit.stationary import fit_likelihood
from allan_ros.core.imu import AXES, LARGEST, ImuIdentity
from allan_ros.core.noise import Model

SIZES = (5e-324, 1e-310, 1e-160, 1e-100, 1e-41, 1e-39, 1e-9, 1.0, 1e15, LARGEST)
FORMS = {
    'white': lambda n, rng: rng.normal(size=n),
    'walk': lambda n, rng: rng.normal(size=n).cumsum(),
    'quantization': lambda n, rng: np.diff(rng.normal(size=n), prepend=0.0),
    'constant': lambda n, rng: np.ones(n),
    'ramp': lambda n, rng: np.arange(n, dtype=float),
    'one shock': lambda n, rng: np.eye(1, n, n // 2)[0],
    'step': lambda n, rng: np.linspace(-1.0, 1.0, n).round() / 1.0,
    'alternating': lambda n, rng: (-1.0) ** np.arange(n),
}
"""Kind -> samples, to be scaled to any size."""

FITS = {'likelihood': fit_likelihood, 'paper': fit_paper}
"""Method -> function that fits all data."""

DECADES = 10**12
"""Samples: 32 years at 1 kHz."""

TRUTH = Model.of(N=1e-4, B=2e-6, K=1e-9)
PERIOD_NS = 10**6


@settings(max_examples=25, derandomize=True)
@given(
    st.sampled_from(sorted(FORMS)),
    st.sampled_from(SIZES),
    st.sampled_from([1, 2, 3, 17, 60, 400]),
    st.sampled_from(sorted(FITS)),
    st.lists(st.integers(1, 399), max_size=3),
)
def test_samples_of_any_size_give_numbers(
    form: str, size: float, n: int, method: str, cuts: list[int]
) -> None:
    y = FORMS[form](n, np.random.default_rng(n))
    y *= size / max(np.abs(y).max(), 1.0)
    sums = sums_of(y[:, None], cuts=sorted({c for c in cuts if c < n}), axes=AXES[:1])
    check_numbers(sums_to_document(sums))
    if sums.tau0 is None:
        return
    curve = allan_curve(sums)
    assert np.all(curve.adev >= 0.0) and np.all(np.isfinite(curve.adev))
    for fit in FITS[method](sums).axes.values():
        for term, coefficient in fit.noise.items():
            known = (coefficient.value, coefficient.upper95, *(coefficient.ci95 or ()))
            least = -np.inf if term == 'R' else 0.0
            assert all(v is None or least <= v < np.inf for v in known)


def test_a_signal_that_repeats_exactly_has_no_noise() -> None:
    y = np.sin(0.7 * np.arange(1000.0))[:, None]
    model = fit_likelihood(sums_of(y, axes=AXES[:1]))
    for coefficient in model.axes[AXES[0]].noise.values():
        # rounding errors, which depend on the processor, may give a limit far below the signal
        assert not coefficient.resolved and (coefficient.upper95 or 0.0) < 1e-6


def test_tiny_samples_give_exactly_scaled_variances() -> None:
    y = np.random.default_rng(1).normal(size=(500, 1))
    one, tiny = sums_of(y), sums_of(y * 2.0**-100)
    assert np.array_equal(tiny.avar, one.avar * 2.0**-200)


def test_a_variance_below_that_of_any_imu_is_zero() -> None:
    y = np.random.default_rng(1).normal(size=(500, 1))
    assert np.all(sums_of(2e-40 * y).avar[0] > MIN_VARIANCE)
    assert np.all(sums_of(1e-41 * y).avar == 0.0)


# --- counts -------------------------------------------------------------------------------------


def sums_in_theory(samples: int, segments: int = 1) -> AllanSums:
    """Return the expected sums of white noise, flicker and random walk in segments of equal
    length.
    """
    m, stride = grid_for(samples)
    count, groups = segments * counts(samples, m, stride), segments * counts(samples, m, m)
    twice = 2.0 * m.astype(float) ** 2 * TRUTH.avar(m * (PERIOD_NS * 1e-9), PERIOD_NS * 1e-9)
    total = segments * samples
    none = np.zeros(0, np.int64)
    period = Period(
        *(0, total, 0, count, (twice * count)[:, None], none, none),
        *(np.zeros((0, 1)), np.zeros(1), 0),
    )
    return AllanSums(
        ImuIdentity('imu'),
        AXES[:1],
        count,
        (twice * count)[:, None],
        groups,
        (twice * groups)[:, None],
        segments * (samples - 1) * PERIOD_NS,
        segments * (samples - 1),
        (RecordedPeriods((period.stored(),), (), np.zeros(1)),),
        ((total, segments),),
    )


@pytest.mark.parametrize('samples', [DECADES, 2 * int(grid(MAX_LEVELS)[0][-1])])
def test_decades_in_one_segment_are_counted_and_fitted(samples: int) -> None:
    sums = sums_in_theory(samples)
    assert sums.samples == samples and len(sums.m) <= len(grid(MAX_LEVELS)[0])
    expected = TRUTH.avar(sums.m * (PERIOD_NS * 1e-9), PERIOD_NS * 1e-9)
    for found in (sums, sums + sums) if samples == DECADES else (sums,):
        np.testing.assert_allclose(found.avar[:, 0], expected, rtol=1e-12)
    document = sums_to_document(sums)
    check_numbers(document)
    assert samples > DECADES or sums_from_document(document).samples == samples
    curve = allan_curve(sums)
    assert np.all(np.diff(curve.n) <= 0) and np.all(curve.n > 0)
    assert np.all(curve.ci_low < curve.adev) and np.all(curve.adev < curve.ci_high)
    if samples == DECADES:
        noise = fit_paper(sums).axes['gyro_x'].noise
        assert noise['N'].value == pytest.approx(TRUTH.value('N'), rel=1e-3)
        assert noise['B'].value == pytest.approx(TRUTH.value('B'), rel=0.1)


@pytest.mark.parametrize('exponent', [9, 10, 12, 15])
def test_degrees_of_freedom_do_not_wrap_round(exponent: int) -> None:
    # of white noise at m = 1: two thirds of the number of differences
    for number, each in ((1, 10**exponent), (10 ** (exponent - 6), 10**6)):
        assert edf(0, 1, 1, [each], [number]) == pytest.approx(2 / 3 * 10**exponent, rel=1e-5)


def test_steady_noise_has_no_step_after_decades() -> None:
    sums = sums_of(np.random.default_rng(0).normal(size=(40_000, 1)))
    (one,) = sums.recordings
    long = [
        replace(p, begin=p.begin << 38, samples=p.samples << 38, begin_ns=p.begin_ns << 20)
        for p in one.periods
    ]
    lengths = ((sums.samples << 38, 1),)
    sums = replace(sums, recordings=(replace(one, periods=tuple(long)),), lengths=lengths)
    assert noise_steps(sums, 3e13) == {}


# --- exact arithmetic ---------------------------------------------------------------------------


def test_the_engine_is_exact_for_integers() -> None:
    """A random walk of 2e5 integer steps on a large offset: every running sum is an integer,
    too.
    """
    y = np.random.default_rng(3).integers(-9, 10, 200_000)
    sums = sums_of((y + 2**40).astype(float)[:, None], [7777])
    theta = np.concatenate([[0], np.cumsum(y - y[0])]).astype(object)
    for i in (0, 5, 17, len(sums.m) - 1):
        m, stride = int(sums.m[i]), int(sums.stride[i])
        d = (theta[2 * m :] - 2 * theta[m:-m] + theta[: -2 * m])[::stride]
        exact = int((d * d).sum())
        assert abs(sums.sum_sq[i, 0] - exact) <= 1e-14 * exact
        assert sums.count[i] == len(d)
    (recording,) = sums.recordings
    assert recording.mean[0] == pytest.approx(float(y.mean()) + 2**40, rel=1e-15)
