# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Expressions in configuration files: only arithmetic is accepted."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from allan_ros.core.errors import AllanError
from allan_ros.core.filters.mapping import MAX_LENGTH, Expression


def test_arithmetic_follows_the_rules_of_python():
    values = {'N': 2.0, 'B': 3.0, 'h': 4.0, 'f': 100.0}
    for text, expected in (
        ('N', 2.0),
        ('sqrt(3/4) * sqrt(N**2 / h + 0.4413 * B**2)', math.sqrt(0.75 * (1.0 + 0.4413 * 9.0))),
        ('-N + +B', 1.0),
        ('N**2 * f', 400.0),
        ('max(N, B, 1e-3)', 3.0),
        ('abs(N - B)', 1.0),
        (' 1 ', 1.0),
    ):
        assert Expression(text).value(values) == pytest.approx(expected)
    assert Expression('sqrt(N) * B').names == {'N', 'B'}


@pytest.mark.parametrize(
    'text',
    [
        '',
        'N +',
        '__import__("os")',
        'N.real',
        'N[0]',
        '"text"',
        'True',
        '1j',
        'lambda: 1',
        '[N]',
        'N if B else 1',
        'N < B',
        'N and B',
        '(N := 1)',
        'eval(N)',
        'sqrt()',
        'sqrt(x=1)',
        'max(*N)',
        'f"{N}"',
        '\0',
        'N' * (MAX_LENGTH + 1),
        '(' * 150,
    ],
)
def test_only_arithmetic_is_accepted(text):
    with pytest.raises(AllanError):
        Expression(text)


@pytest.mark.parametrize(
    'text',
    ['N / 0', 'sqrt(-N)', '10**10**10', '(-N)**0.5', 'sqrt(N, N)', 'max(N)', 'K', '1e308 * 10'],
)
def test_an_expression_without_a_finite_value_is_rejected(text):
    with pytest.raises(AllanError):
        Expression(text).value({'N': 1.0})


@given(st.text(max_size=60))
def test_any_text_is_evaluated_or_rejected(text):
    with contextlib.suppress(AllanError):
        made = Expression(text)
        assert math.isfinite(made.value(dict.fromkeys(made.names, 1.5)))
