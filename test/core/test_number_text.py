# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Formatting of numbers for people."""

from __future__ import annotations

import math

import pytest

from allan_ros.core.number_text import significant


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
