# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Proposed values of filter parameters and their intervals, compared with values by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.mapping import (
    Expression,
    FilterMapping,
    FilterParameter,
    Proposal,
    check_mapping,
    narrow_enough,
    propose,
)
from allan_ros.core.fit import AxisFit, Coefficient

UNSEEN = Coefficient(None, None, 4e-5, 'not_observable')


def axis(n: float, b: Coefficient = UNSEEN, k: Coefficient = UNSEEN) -> AxisFit:
    seen = Coefficient(n, (0.9 * n, 1.1 * n))
    return AxisFit({'Q': UNSEEN, 'N': seen, 'B': b, 'K': k, 'R': UNSEEN})


AXES = {'gyro_x': axis(1e-3), 'gyro_y': axis(3e-3), 'gyro_z': axis(2e-3)}


def parameter(expression: str, **others) -> FilterParameter:
    return FilterParameter('p', 'gyro', Expression(expression), **others)


def test_rules_for_three_axes_give_values_computed_by_hand():
    worst = propose(parameter('N**2 * f'), AXES, 200.0, {})
    assert worst.values == pytest.approx((9e-6 * 200.0,))
    assert (worst.low, worst.high) == pytest.approx((0.81 * 1.8e-3, 1.21 * 1.8e-3))
    mean = propose(parameter('N', rule='mean'), AXES, 200.0, {})
    assert mean.values == pytest.approx((math.sqrt(14e-6 / 3.0),))
    each = propose(parameter('2 * N', rule='each'), AXES, 200.0, {})
    assert each.values == pytest.approx((2e-3, 6e-3, 4e-3))
    assert each.ratio == pytest.approx(1.1 / 0.9)


def test_a_constant_named_f_replaces_the_rate():
    assert propose(parameter('f * h'), AXES, 200.0, {'h': 3.0}).values == (600.0,)
    assert propose(parameter('f'), AXES, 200.0, {'f': 50.0}).values == (50.0,)


def test_a_term_that_is_not_resolved_widens_the_interval_by_its_effect():
    little = propose(parameter('sqrt(N**2 + B**2)'), AXES, 200.0, {})
    assert little.values[0] == pytest.approx(math.hypot(3e-3, 4e-5))
    assert little.low == pytest.approx(2.7e-3) and little.ratio < 1.25
    much = propose(parameter('sqrt(N**2 + (1000 * B)**2)'), AXES, 200.0, {})
    assert much.ratio > 10.0
    unknown = propose(parameter('K'), AXES, 200.0, {})
    assert unknown.values == (4e-5,) and unknown.low == 0.0 and unknown.ratio == math.inf
    ready, waiting = narrow_enough([little, replace(much, name='m')], 1.5)
    assert ready == [little] and set(waiting) == {'m'} and 'within a factor of 1.5' in waiting['m']


def test_the_interval_of_a_decreasing_expression_is_ordered():
    falling = propose(parameter('1 / N'), AXES, 200.0, {})
    assert falling.low == pytest.approx(1 / 3.3e-3) and falling.high == pytest.approx(1 / 2.7e-3)
    assert propose(parameter('N / B'), AXES, 200.0, {}).ratio == math.inf  # B may be 0


def test_values_are_kept_within_the_limits():
    held = propose(parameter('N', limits=(0.01, 1.0)), AXES, 200.0, {})
    assert held.values == (0.01,) and held.limited
    assert held.high == pytest.approx(3.3e-3)  # the interval contains the true value


def test_a_missing_sensor_or_term_is_rejected():
    with pytest.raises(AllanError, match='no accel'):
        propose(FilterParameter('p', 'accel', Expression('N')), AXES, 200.0, {})
    nothing = axis(1e-3, b=Coefficient(None, status='not_observable'))
    with pytest.raises(AllanError, match='neither a value nor a limit'):
        propose(parameter('B'), {**AXES, 'gyro_y': nothing}, 200.0, {})
    without_interval = {
        name: replace(fit, noise={**fit.noise, 'N': Coefficient(1e-3)})
        for name, fit in AXES.items()
    }
    assert propose(parameter('N'), without_interval, 200.0, {}).ratio == math.inf


def test_a_value_differs_by_a_fraction():
    p = Proposal('p', (1.05,), 1.0, 1.1)
    assert p.differs((1.0,), 0.01) and not p.differs((1.0,), 0.1)
    assert p.differs((0.0,), 0.1) and p.differs((1.05, 1.05), 0.1)
    assert p.differs((math.nan,), 0.1)  # the default of some nodes for an unset parameter


@pytest.mark.parametrize(
    'wrong, reason',
    [
        (FilterParameter('p', 'mag', Expression('N')), 'sensor'),
        (parameter('N', rule='best'), 'axis'),
        (parameter('N', limits=(1.0, 0.0)), 'lower one first'),
        (parameter('N * g'), 'contains g'),
    ],
)
def test_an_invalid_mapping_is_rejected(wrong, reason):
    with pytest.raises(AllanError, match=reason):
        check_mapping(FilterMapping('f', (wrong,)))
    check_mapping(FilterMapping('f', (parameter('N * h * f'),), {'h': 1.0}))
