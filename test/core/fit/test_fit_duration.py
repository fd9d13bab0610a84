# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import pytest

from allan_ros.core.fit.findings import record_times
from allan_ros.core.fit.model import AxisFit, Coefficient

HOUR = 3600.0


def seen(value, relative):
    return Coefficient(value, ((1 - relative) * value, (1 + relative) * value))


def unseen(value=None):
    return Coefficient(value, None, 1.0, 'not_observable')


def test_a_term_that_is_known_takes_no_longer():
    fit = AxisFit({t: seen(1e-3, 0.05) for t in 'QNBKR'})
    for time in record_times(fit, 0.01, HOUR).values():
        assert (time.observable, time.tight) == (HOUR, HOUR)


def test_half_the_interval_takes_four_times_the_record():
    fit = AxisFit({t: seen(1e-3, 0.2) for t in 'QNBKR'})
    times = record_times(fit, 0.01, HOUR)
    for term in 'QNBK':
        assert times[term].tight == pytest.approx(4 * HOUR)


def test_a_term_of_which_nothing_is_known_has_no_time():
    fit = AxisFit({'N': seen(1e-3, 0.01), **{t: unseen() for t in 'QBKR'}})
    times = record_times(fit, 0.01, HOUR)
    assert all(times[t].observable is None and times[t].tight is None for t in 'QBKR')


def test_a_walk_shows_when_51_n_over_t_is_down_to_it():
    fit = AxisFit({'N': seen(1e-3, 0.01), 'K': unseen(1e-6), **{t: unseen() for t in 'QBR'}})
    time = record_times(fit, 0.01, HOUR)['K']
    assert time.observable == pytest.approx(51.0 * 1e-3 / 1e-6)
    assert time.tight > time.observable


def test_a_ramp_shows_later_beside_a_larger_walk():
    times = [
        record_times(
            AxisFit(
                {'N': seen(1e-3, 0.01), 'B': unseen(), 'K': seen(k, 0.3), 'Q': unseen()}
                | {'R': unseen(1e-7)}
            ),
            0.01,
            HOUR,
        )['R'].observable
        for k in (1e-6, 1e-5)
    ]
    assert times[0] < times[1]


def test_never_less_than_half_as_long_again():
    fit = AxisFit({'N': seen(1e-3, 0.01), **{t: unseen(10.0) for t in 'QBKR'}})
    for term in 'QBKR':
        assert record_times(fit, 0.01, HOUR)[term].observable == 1.5 * HOUR
