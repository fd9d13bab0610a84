# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates: units, signs, which of the two intervals is shown, and numbers as text."""

from __future__ import annotations

import math

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate, interval_text, known_numbers, significant, value_text
from allan_ros.core.imu import ShownUnit

PLAIN = ShownUnit('', 1.0)


def test_the_sign_belongs_to_the_value_and_its_interval() -> None:
    ramp = Estimate(-2.0, (-2.5, -1.5))
    assert value_text(ramp, PLAIN) == '-2.000'
    assert interval_text(ramp, PLAIN) == '-2.50..-1.50'
    assert known_numbers(ramp, PLAIN) == (-2.0, -2.5, -1.5, None)
    assert ramp.magnitude == Estimate(2.0, (1.5, 2.5))
    assert ramp.magnitude.magnitude == ramp.magnitude


def test_the_predictive_interval_is_shown_once_it_is_known() -> None:
    known = Estimate(1.0, (0.9, 1.1))
    assert known.ci95 == (0.9, 1.1)
    wider = Estimate(1.0, (0.9, 1.1), predictive_ci95=(0.5, 1.5))
    assert wider.ci95 == (0.5, 1.5)
    assert interval_text(wider, PLAIN) == '0.500..1.50'
    assert wider.document()['recording_ci95'] == (0.9, 1.1)


def test_every_number_is_converted_to_another_unit() -> None:
    one = Estimate(1.0, (0.5, 2.0), 3.0, 'estimated', (0.4, 2.5), 'B', 'rad/s', 'gyro_x')
    other = one.to('deg/s')
    factor = 180.0 / math.pi
    assert other == Estimate(
        *(factor, (0.5 * factor, 2.0 * factor), 3.0 * factor, 'estimated'),
        *((0.4 * factor, 2.5 * factor), 'B', 'deg/s', 'gyro_x'),
    )
    with pytest.raises(AllanError, match='deg/h'):
        one.to('ug')
    with pytest.raises(AllanError, match='take coefficients from an axis'):
        Estimate(1.0).to('deg/h')


@pytest.mark.parametrize(
    ('estimate', 'text'),
    [
        (Estimate(1.0, (0.0, 2.0), 2.0, 'not_observable'), '< 2.00'),
        (Estimate(None, None, math.inf, 'not_observable'), '-'),
        (Estimate(None), '-'),
    ],
)
def test_a_number_that_is_not_resolved_is_shown_by_its_limit(estimate: Estimate, text: str) -> None:
    assert value_text(estimate, PLAIN) == text
    assert estimate.shown.value is None
    assert interval_text(estimate, PLAIN) == ''


def test_a_narrow_interval_has_more_digits() -> None:
    assert interval_text(Estimate(0.242, (0.2414, 0.2426)), PLAIN) == '0.2414..0.2426'


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
        (-0.0, 3, '0'),
        (math.inf, 3, 'inf'),
    ],
)
def test_digits(value: float, digits: int, text: str) -> None:
    assert significant(value, digits) == text
