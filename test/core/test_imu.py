# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.fit.result import TERMS
from allan_ros.core.imu import (
    DATASHEET_UNITS,
    SI_UNITS,
    UNITS,
    ImuBatch,
    from_datasheet,
    real_numbers,
    to_si,
)

# What one SI unit is in the datasheets' unit, each written out by hand.
ONE_SI = {
    ('gyro', 'Q'): 1e6,
    ('gyro', 'N'): 180 / math.pi * 60,
    ('gyro', 'B'): 180 / math.pi * 3600,
    ('gyro', 'K'): 180 / math.pi * 216000,
    ('gyro', 'R'): 180 / math.pi * 1.296e7,
    ('accel', 'Q'): 1e6,
    ('accel', 'N'): 60,
    ('accel', 'B'): 1e6 / 9.80665,
    ('accel', 'K'): 1e6 / 9.80665 * 60,
    ('accel', 'R'): 1e6 / 9.80665 * 3600,
}


@pytest.mark.parametrize('sensor, term', ONE_SI)
def test_datasheet_units_by_hand(sensor, term):
    assert from_datasheet(term, sensor, ONE_SI[sensor, term]) == pytest.approx(1.0, rel=1e-14)
    assert UNITS[DATASHEET_UNITS[sensor][term]].si == SI_UNITS[sensor][term]


@pytest.mark.parametrize(
    'value, unit, si, expected',
    [
        (0.05, 'deg/s/sqrt(Hz)', 'rad/s/sqrt(Hz)', 8.726646e-4),
        (3600.0, 'deg/h/sqrt(Hz)', 'rad/s/sqrt(Hz)', math.pi / 180),
        (1000.0, 'ug/sqrt(Hz)', 'm/s^2/sqrt(Hz)', 9.80665e-3),
        (1.0, 'mg/sqrt(Hz)', 'm/s^2/sqrt(Hz)', 9.80665e-3),
        (8.0, 'g', 'm/s^2', 78.4532),
        (3.33, 'mg', 'm/s^2', 0.032656),
    ],
)
def test_other_units(value, unit, si, expected):
    assert to_si(value, unit, si) == pytest.approx(expected, rel=1e-5)


def test_every_term_has_a_unit_on_both_sensors():
    for units in (SI_UNITS, DATASHEET_UNITS):
        assert {s: tuple(u) for s, u in units.items()} == {'gyro': TERMS, 'accel': TERMS}


@pytest.mark.parametrize('unit', ['deg/hour', 'deg/s'])
def test_a_unit_of_something_else_is_rejected_with_those_that_fit(unit):
    with pytest.raises(AllanError, match=r'use one of .*deg/sqrt\(h\)'):
        to_si(1.0, unit, 'rad/s/sqrt(Hz)')


@pytest.mark.parametrize('dtype', [int, float, np.int16])
def test_masked_numbers_become_nan(dtype):
    values = np.ma.array([1, 2, 3], dtype=dtype, mask=[False, True, False])
    assert np.array_equal(real_numbers(values), [1.0, math.nan, 3.0], equal_nan=True)


def test_a_single_stamp_that_is_no_array_of_stamps_is_rejected():
    with pytest.raises(AllanError, match='pass one row of six axes per stamp'):
        ImuBatch(np.array(0), np.zeros((1, 6)))
