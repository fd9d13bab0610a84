# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An IMU exceeds a limit only when the complete interval lies beyond the limit."""

from __future__ import annotations

import pytest

from allan_ros.core.compare import compare_with_limits, verdict
from allan_ros.core.fit.model import TERMS, Coefficient

NOT_OBSERVABLE = Coefficient(None, None, 0.5, 'not_observable')


@pytest.mark.parametrize(
    'coefficient, expected',
    [
        (Coefficient(0.9, (0.8, 1.0)), 'within'),
        (Coefficient(1.1, (1.0, 1.2)), 'within'),  # by the margin
        (Coefficient(1.2, (1.1, 1.3)), 'open'),
        (Coefficient(1.3, (1.25, 1.35)), 'beyond'),
        (Coefficient(2.0, (0.5, 3.5)), 'open'),
        (NOT_OBSERVABLE, 'within'),
        (Coefficient(None, None, 5.0, 'not_observable'), 'open'),
        (Coefficient(9.0, (8.0, 10.0), 10.0, 'not_observable'), 'open'),
        (Coefficient(9.0), 'open'),
    ],
)
def test_verdicts_at_a_limit_of_one_and_a_margin_of_a_fifth(coefficient, expected):
    assert verdict(coefficient, 1.0, 0.2) == expected


def test_only_what_has_a_limit_is_compared():
    noise = {term: Coefficient(1.0, (0.9, 1.1)) for term in TERMS}
    limits = {'gyro_x': {'N': 0.5, 'B': 2.0}}
    found = compare_with_limits('sheet', limits, {'gyro_x': noise}, 0.2)
    assert [(c.term, c.verdict, c.at_least) for c in found] == [
        ('N', 'beyond', 1.8), ('B', 'within', 0.45),
    ]  # fmt: skip
    assert compare_with_limits('sheet', limits, {'accel_x': noise}, 0.2) == ()
