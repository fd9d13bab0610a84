# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers and coefficients as text."""

from __future__ import annotations

import math

import pytest

from allan_ros.core.coefficient_text import interval_text, value_text
from allan_ros.core.fit import Coefficient
from allan_ros.core.imu import ShownUnit
from allan_ros.core.number_text import significant

PLAIN = ShownUnit('rad/s', 1.0)


@pytest.mark.parametrize(
    ('value', 'digits', 'text'),
    [
        (0.241996, 4, '0.2420'),
        (31.8, 4, '31.80'),
        (9.9996, 4, '10.00'),
        (12345.6, 3, '12300'),
        (1.23456e-7, 3, '1.23e-07'),
        (-5.0, 2, '-5.0'),
        (0.0, 3, '0'),
        (math.inf, 3, 'inf'),
    ],
)
def test_digits(value: float, digits: int, text: str) -> None:
    assert significant(value, digits) == text


def test_a_value_has_its_interval_and_its_sign() -> None:
    ramp = Coefficient(2.0, (1.5, 2.5), sign=-1)
    assert value_text(ramp, PLAIN) == '-2.000'
    assert interval_text(ramp, PLAIN) == '-2.50..-1.50'
    # a narrow interval has more digits
    assert interval_text(Coefficient(0.242, (0.2414, 0.2426)), PLAIN) == '0.2414..0.2426'


@pytest.mark.parametrize(
    ('coefficient', 'text'),
    [
        (Coefficient(1.0, (0.0, 2.0), 2.0, 'not_observable'), '< 2.00'),
        (Coefficient(None, None, math.inf, 'not_observable'), '-'),
        (Coefficient(None), '-'),
    ],
)
def test_an_unresolved_term_is_shown_by_its_limit(coefficient: Coefficient, text: str) -> None:
    assert value_text(coefficient, PLAIN) == text
