# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Formatting of numbers for people."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.findings import Finding, finding
from allan_ros.core.fit import Coefficient
from allan_ros.io.format import (
    ShownUnit,
    grouped,
    interval_text,
    shown_unit,
    significant,
    text_in_units,
    value_text,
)

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


@given(st.floats(1e-12, 1e12), st.integers(2, 6))
def test_shown_numbers_equal_the_values_to_their_digits(value: float, digits: int) -> None:
    assert float(significant(value, digits)) == pytest.approx(
        value, rel=0.51 * 10.0 ** (1 - digits)
    )


def test_a_value_has_its_interval_and_its_sign() -> None:
    ramp = Coefficient(2.0, (1.5, 2.5), sign=-1)
    assert value_text(ramp, PLAIN) == '-2.000'
    assert interval_text(ramp, PLAIN) == '1.50..2.50'


def test_a_sharp_interval_is_shown_sharply() -> None:
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


def test_units() -> None:
    # 1 deg/h = pi/180/3600 rad/s, 1 ug = 9.80665e-6 m/s^2
    assert shown_unit('gyro_x', 'B', 'datasheet') == (
        'deg/h',
        pytest.approx(180.0 / math.pi * 3600.0),
    )
    assert shown_unit('accel_z', 'B', 'datasheet') == ('ug', pytest.approx(1.0 / 9.80665e-6))
    assert shown_unit('gyro_y', 'K', 'si') == ('rad/s^2/sqrt(Hz)', 1.0)
    assert shown_unit('gyro_y', 'signal', 'datasheet') == ('deg/s', pytest.approx(180.0 / math.pi))


def finding_of(axis, message, severity='warning', id='x', remedy='Fix it.'):
    return Finding(id, severity, message, remedy, (axis,) if axis else ())


def test_the_mean_acceleration_of_a_wrong_unit_stays_as_recorded() -> None:
    message = finding('accel_unit', norm=0.9974, unit='g').message
    assert text_in_units(message, 'datasheet') == message


def test_equal_causes_become_one_with_the_range_of_each_number():
    merged = grouped(
        [
            finding_of('accel_x', 'Vibration at 0.579 Hz, amplitude 0.0095 m/s^2.'),
            finding_of('accel_y', 'Vibration at 0.573 Hz, amplitude 0.0048 m/s^2.'),
        ]
    )
    assert len(merged) == 1
    assert merged[0].message == (
        'Vibration at 0.573 to 0.579 Hz, amplitude 0.0048 to 0.0095 m/s^2.'
    )
    assert merged[0].axes == ('accel_x', 'accel_y')


def test_intervals_are_joined_and_equal_numbers_kept():
    texts = ['N is 2.4 deg (2.3..2.5), above 0.66.', 'N is 2.2 deg (2.1..2.25), above 0.66.']
    (merged,) = grouped(finding_of(axis, text) for axis, text in zip(('gyro_x', 'gyro_y'), texts))
    assert merged.message == 'N is 2.2 to 2.4 deg (2.1..2.5), above 0.66.'


def test_different_findings_are_not_joined():
    kept = [
        finding_of('gyro_x', 'Lost 3.'),
        finding_of('gyro_y', 'Found 3.'),
        finding_of('', 'a_1.bag'),
        finding_of('', 'a_2.bag'),
    ]
    assert set(grouped(kept)) == set(kept)


def test_the_most_severe_comes_first():
    levels = ('info', 'error', 'warning')
    assert [f.severity for f in grouped(finding_of('', level, level) for level in levels)] == [
        'error',
        'warning',
        'info',
    ]


def test_every_value_of_a_finding_follows_the_units() -> None:
    sizes = {'size': 5.0, 'size_unit': 'deg/h', 'before': 3.0, 'after': 2.0}
    levels = {'which': 'within the recording', 'value': 0.2, 'low': 0.1, 'high': 0.3}
    for found in (
        finding('bias_steps', ('gyro_x',), unit='deg/h^1.5', **sizes),
        finding('level_changes', ('gyro_x',), unit='deg/sqrt(h)', **levels),
    ):
        shown = text_in_units(found.message, 'si')
        assert 'deg' not in shown and shown.count('rad/s') == 3
