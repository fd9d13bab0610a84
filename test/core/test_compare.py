# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An IMU exceeds a limit only when the complete interval lies beyond the limit."""

from __future__ import annotations

import numpy as np
import pytest

from allan_ros.core.compare import Difference, verdict
from allan_ros.core.fit.model import Coefficient

NOT_OBSERVABLE = Coefficient(None, None, 0.5, 'not_observable')


@pytest.mark.parametrize(
    'coefficient, expected',
    [
        (Coefficient(0.9, (0.8, 1.0)), 'within'),
        (Coefficient(1.1, (1.0, 1.2)), 'within'),  # by the margin
        (Coefficient(1.2, (1.1, 1.3)), 'undecided'),
        (Coefficient(1.3, (1.25, 1.35)), 'exceeds'),
        (Coefficient(2.0, (0.5, 3.5)), 'undecided'),
        (NOT_OBSERVABLE, 'within'),
        (Coefficient(None, None, 5.0, 'not_observable'), 'undecided'),
        (Coefficient(9.0, (8.0, 10.0), 10.0, 'not_observable'), 'undecided'),
        (Coefficient(9.0), 'undecided'),
    ],
)
def test_verdicts_at_a_limit_of_one_and_a_margin_of_a_fifth(coefficient, expected):
    assert verdict(coefficient, 1.0, 0.2) == expected


@pytest.mark.parametrize(
    ('ratio', 'ci95', 'answer'),
    [
        (1.0, (0.97, 1.03), 'same'),
        (1.03, (1.01, 1.051), 'same'),  # the 90 % interval ends at 1.0476
        (1.04, (1.02, 1.06), 'undecided'),
        (1.1, (1.06, 1.14), 'different'),
        (1.0 / 1.1, (1.0 / 1.14, 1.0 / 1.06), 'different'),
        (None, (0.0, 1.01), 'undecided'),
    ],
)
def test_equality_up_to_a_fraction_is_tested_from_both_sides(ratio, ci95, answer):
    d = Difference('gyro_x', 'N', None, 1.0, ratio, ci95, 0.5)
    assert d.equivalence(0.05) == answer


def test_false_equality_at_the_limit_is_five_percent():
    """The logarithm of the ratio is normal about the limit, and its interval is known."""
    rng = np.random.default_rng(5)
    limit, sigma = np.log(1.05), 0.01
    found = []
    for x in rng.normal(limit, sigma, 4000):
        ci95 = (np.exp(x - 1.96 * sigma), np.exp(x + 1.96 * sigma))
        d = Difference('gyro_x', 'N', None, 1.0, np.exp(x), ci95, 0.5)
        found.append(d.equivalence(0.05) == 'same')
    assert abs(np.mean(found) - 0.05) < 4 * (0.05 * 0.95 / 4000) ** 0.5
