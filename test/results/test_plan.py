# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Test plans: reading, verdicts on single quantities, and planted faults of units."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import allan_ros as ar
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import AXES
from allan_ros.readers.files import parse_yaml
from allan_ros.results.datasheets import sensor_names
from allan_ros.results.plan import (
    AXIS_UNITS,
    IMU_UNITS,
    Limits,
    Plan,
    plan_from_document,
    plan_text,
)
from allan_ros.results.results import Results

RATE = 50.0

DOCUMENT: dict[str, Any] = {
    'schema': 'allan_ros/plan/1',
    'name': 'line 4',
    'gyro': {
        'N': {'lower': 0.1, 'upper': 0.4, 'unit': 'deg/sqrt(h)'},
        'bias': {'lower': -0.5, 'upper': 0.5, 'unit': 'deg/s'},
        'drift': {'upper': 0.05, 'unit': 'deg/s'},
        'bandwidth': {'lower': 20.0, 'unit': 'Hz'},
        'temperature_drift': {'lower': -0.01, 'upper': 0.01, 'unit': 'deg/s/K'},
    },
    'gyro_y': {'N': {'upper': 0.2, 'unit': 'deg/sqrt(h)'}},
    'accel': {'bias': {'lower': -30, 'upper': 30, 'unit': 'mg'}},
    'gravity': {'lower': 9.75, 'upper': 9.86, 'unit': 'm/s^2'},
    'orientation': {'up': [0, 0, 2], 'upper': 1.5, 'unit': 'deg'},
    'rate': {'lower': 49.5, 'upper': 50.5, 'unit': 'Hz'},
    'duration': {'lower': 2, 'unit': 'min'},
    'used': {'lower': 99, 'unit': '%'},
    'temperature': {'lower': 20, 'upper': 40, 'unit': 'degC'},
}


def plan(**changed: Any) -> Plan:
    return plan_from_document({**DOCUMENT, **changed}, 'line4.yaml')


def unit(spoil: Any = None, rate: float = RATE, minutes: float = 4.0, **faults: Any) -> Results:
    """Return the results of a unit at 30 degC whose temperature rises by 5 K."""
    batch = ar.simulate(hours=minutes / 60.0, rate=rate, seed=3, **faults)
    t = np.arange(len(batch.samples)) / rate
    columns = {'t': t, **dict(zip(AXES, batch.samples.T.copy()))}
    columns['temperature'] = 27.5 + 5.0 * t / t[-1]
    if spoil is not None:
        spoil(columns)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'unit.csv'
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, '%.9g', ',', header=','.join(columns), comments='')
        return ar.analyze(path)


def verdicts(results: Results, of: Plan) -> dict[tuple[str, str], str]:
    return {(c.axis, c.quantity): c.verdict for c in of.checks(results)}


@pytest.fixture(scope='module')
def good() -> Results:
    return unit()


def test_a_good_unit_is_within(good: Results) -> None:
    # the simulation has fixed seeds; N has 4 minutes for an interval of 2 %
    assert set(verdicts(good, plan()).values()) == {'within'}


def flip(columns: dict[str, np.ndarray]) -> None:
    columns['accel_z'] *= -1.0


def swap(columns: dict[str, np.ndarray]) -> None:
    x, z = columns['accel_x'], columns['accel_z']
    columns['accel_x'], columns['accel_z'] = z, x


def scale(columns: dict[str, np.ndarray]) -> None:
    for axis in AXES[3:]:
        columns[axis] *= 1.1


def radians(columns: dict[str, np.ndarray]) -> None:
    for axis in AXES[:3]:
        columns[axis] /= 57.3


def bias(columns: dict[str, np.ndarray]) -> None:
    columns['gyro_x'] += np.radians(5.0)


def shift(columns: dict[str, np.ndarray]) -> None:
    columns['accel_y'] += 0.6


def heat(columns: dict[str, np.ndarray]) -> None:
    columns['gyro_z'] += np.radians(0.1) * (columns['temperature'] - 30.0)


@pytest.mark.parametrize(
    'spoil, found',
    [
        (flip, ('', 'orientation')),
        (swap, ('', 'orientation')),
        (scale, ('', 'gravity')),
        (radians, ('gyro_z', 'N')),
        (bias, ('gyro_x', 'bias')),
        (shift, ('accel_y', 'bias')),
        (heat, ('gyro_z', 'drift')),
        (heat, ('gyro_z', 'temperature_drift')),
    ],
)
def test_a_planted_fault_exceeds(spoil: Any, found: tuple[str, str]) -> None:
    assert verdicts(unit(spoil), plan())[found] == 'exceeds'


def test_a_filter_and_another_rate_exceed() -> None:
    assert verdicts(unit(low_pass=3.0), plan())['gyro_x', 'bandwidth'] == 'exceeds'
    assert verdicts(unit(rate=25.0), plan())['', 'rate'] == 'exceeds'


def test_limits_of_the_recording_leave_the_unit_unjudged() -> None:
    found = verdicts(unit(minutes=1.0), plan(temperature={'upper': 20, 'unit': 'degC'}))
    assert found['', 'duration'] == found['', 'temperature'] == 'undecided'


def test_what_is_not_measured_is_undecided(good: Results) -> None:
    only_z = replace(good, axes={'gyro_z': replace(good['gyro_z'], at_rest=None)})
    found = verdicts(only_z, plan())
    assert found['gyro_x', 'N'] == found['gyro_z', 'bias'] == found['', 'gravity'] == 'undecided'
    assert found['gyro_z', 'N'] == 'within'


def test_a_bias_is_judged_at_its_temperature(good: Results) -> None:
    limits = {'lower': -0.5, 'upper': 0.5, 'unit': 'deg/s'}
    near, far = (plan(gyro={'bias': {**limits, 'at': at}}) for at in (31.0, 60.0))
    assert verdicts(good, near)['gyro_x', 'bias'] == 'within'
    (check,) = (c for c in far.checks(good) if c.axis == 'gyro_x')
    assert check.verdict == 'undecided' and '29.8 degC' in check.note


def test_a_temperature_model_gives_the_bias_at_another_temperature() -> None:
    def cycle(columns: dict[str, np.ndarray]) -> None:
        t = columns['t'] / columns['t'][-1]
        columns['temperature'] = 30.0 + 5.0 * np.sin(4.0 * np.pi * t)
        columns['gyro_x'] += np.radians(0.2) * (columns['temperature'] - 30.0)

    results = unit(cycle)
    limits = {'lower': 0.7, 'upper': 0.9, 'unit': 'deg/s', 'at': 34.0}
    assert verdicts(results, plan(gyro={'bias': limits}))['gyro_x', 'bias'] == 'within'


def test_what_a_plan_does_not_limit_is_listed(good: Results) -> None:
    short = plan_from_document({'schema': 'allan_ros/plan/1', 'gyro_x': DOCUMENT['gyro']}, 'p.yaml')
    listed = short.unchecked(good)
    assert 'gyro_y N' in listed and 'gyro_x N' not in listed and 'gyro Q' in listed
    assert 'accel bias' in listed and set(IMU_UNITS) <= set(listed)
    everything = {
        sensor: {q: Limits(-1e9, 1e9, '') for q in AXIS_UNITS[sensor]} for sensor in AXIS_UNITS
    }
    full = Plan(
        'p', {a: everything[a[:-2]] for a in AXES}, dict.fromkeys(IMU_UNITS, Limits(0, 1, ''))
    )
    assert full.unchecked(good) == []


@pytest.mark.parametrize('name', sensor_names())
def test_each_datasheet_gives_a_plan(name: str) -> None:
    import yaml

    sheet = ar.sensor(name)
    made = plan_from_document(yaml.safe_load(plan_text(sheet)), name)
    for axis, terms in sheet.limits.items():
        for term, limit in terms.items():
            known = made.axes[axis][term]
            assert known.upper == pytest.approx(1.2 * limit.value, rel=5e-3)
            assert (known.lower is not None) == (term == 'N')
    uncommented = (
        plan_text(sheet).replace('# rate:', 'rate:').replace('# orientation:', 'orientation:')
    )
    uncommented = uncommented.replace('# duration:', 'duration:').replace('# temp', 'temp')
    known = plan_from_document(yaml.safe_load(uncommented), name)
    assert set(known.whole) == set(IMU_UNITS)


@pytest.mark.parametrize(
    'name',
    ['IMU: v2', '- x', '[a', '123', 'A #3', 'null', "it's", 'two\nlines', '\u00b5 ' * 60],
)
def test_a_plan_has_the_name_of_its_datasheet(name: str) -> None:
    sheet = replace(ar.sensor('bmi088'), name=name)
    plan = plan_from_document(parse_yaml(plan_text(sheet)), 'plan.yaml')
    assert plan.name == name
    assert plan.axes.keys() == set(AXES)


@pytest.mark.parametrize(
    'changed, message',
    [
        ({'gyro': {'N': {'upper': 1.0, 'unit': 'deg/h'}}}, 'line4.yaml.gyro.N: unit'),
        ({'gyro': {'N': {'unit': 'deg/sqrt(h)'}}}, 'has no limit'),
        ({'gyro': {'bias': {'upper': 1.0, 'unit': 'deg/s'}}}, 'state lower and upper'),
        ({'gyro': {'mass': {'upper': 1.0}}}, "'mass' is unknown"),
        ({'rate': {'lower': 3, 'upper': 2, 'unit': 'Hz'}}, 'lower is above upper'),
        ({'rate': {'lower': 3, 'unit': 's'}}, "unit 's' cannot be used here: use one of 'Hz'"),
        ({'gyro': {'temperature_drift': {'upper': 3, 'unit': 'deg/s'}}}, 'use one of rad/s/K'),
        ({'orientation': {'up': [0, 0, 0], 'upper': 1, 'unit': 'deg'}}, 'is not a direction'),
        ({'orientation': None}, 'needs orientation.up'),
        ({'schema': 'allan_ros/plan/9'}, 'schema is'),
    ],
)
def test_an_invalid_plan_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(AllanError) as caught:
        plan(**changed)
    assert message in str(caught.value) and '\n' not in str(caught.value)


def test_a_plan_without_limits_is_refused() -> None:
    with pytest.raises(AllanError, match='has no limits'):
        plan_from_document({'schema': 'allan_ros/plan/1', 'name': 'empty'}, 'empty.yaml')
