# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The decision about a unit: limits, findings, and the order of a batch."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest

from allan_ros.core.findings import finding
from allan_ros.results.plan import Limits, Plan
from allan_ros.results.results import Results
from allan_ros.results.unit_check import (
    DECISIONS_WORST_FIRST,
    Decision,
    UnitCheck,
    check_unit,
    worst,
)
from allan_ros.view.finding_text import texts_of
from allan_ros.view.unit_text import (
    checks_text,
    limits_text,
    measured_text,
    unchecked_text,
    unit_sentences,
)

RATE = 50.0
WIDE = Limits(0.0, 1e3, 'Hz')


def plan(**limits: Limits) -> Plan:
    return Plan('line 4', {}, {'rate': WIDE, **limits})


def with_findings(results: Results, *found: object) -> Results:
    return replace(results, findings=tuple(found))


@pytest.fixture(scope='module')
def clean(small_results: Results) -> Results:
    """Return results without findings."""
    return with_findings(small_results)


def test_without_limits_nothing_is_judged(clean: Results) -> None:
    assert check_unit(clean).decision is Decision.NOT_JUDGED
    assert check_unit(clean, plan()).decision is Decision.WITHIN


@pytest.mark.parametrize(
    'limits, decision',
    [
        ({'rate': Limits(None, RATE - 1.0, 'Hz')}, Decision.EXCEEDS),
        ({'gravity': Limits(0.0, 1.0, 'm/s^2')}, Decision.EXCEEDS),
        ({'duration': Limits(1e6, None, 's')}, Decision.NOT_JUDGED),
        ({'temperature': Limits(0.0, 40.0, 'degC')}, Decision.NOT_JUDGED),
    ],
)
def test_limits_decide(clean: Results, limits: dict[str, Limits], decision: Decision) -> None:
    assert check_unit(clean, plan(**limits)).decision is decision


def test_an_exceeded_limit_precedes_an_undecided_one(clean: Results) -> None:
    both = plan(rate=Limits(99.0, None, 'Hz'), duration=Limits(1e6, None, 's'))
    found = check_unit(clean, both)
    assert found.decision is Decision.EXCEEDS
    assert [c.quantity for c in found.of('undecided')] == ['duration']


@pytest.mark.parametrize(
    'found, decision',
    [
        (finding('stuck', ('gyro_x',), count=9), Decision.EXCEEDS),
        (finding('clipped', ('gyro_x',), share=0.1), Decision.EXCEEDS),
        (finding('axes_equal', ('gyro_x', 'gyro_y')), Decision.EXCEEDS),
        (finding('not_finite', count=9), Decision.NOT_JUDGED),
        (finding('short', seconds=9.0), Decision.NOT_JUDGED),
        (finding('accel_scale', ('accel_x',), norm=3.0), Decision.NOT_JUDGED),
        (finding('spikes', count=9, share=1e-3), Decision.NOT_JUDGED),
        (finding('motion', share=0.01), Decision.WITHIN),
        (
            finding('unit_assumed', path='a', sensor='gyro', unit='rad/s', name='gx'),
            Decision.WITHIN,
        ),
    ],
    ids=lambda each: getattr(each, 'id', getattr(each, 'name', '')),
)
def test_a_suspect_unit_does_not_pass(clean: Results, found: object, decision: Decision) -> None:
    results = with_findings(clean, found)
    check = check_unit(results, plan())
    assert check.decision is decision
    assert bool(check.suspect) == (decision is not Decision.WITHIN)
    if check.suspect:
        said = unit_sentences(check, results, 'deg/h')
        assert any(texts_of(found, 'deg/h').message in sentence for sentence in said)


def test_noise_above_a_datasheet_exceeds_without_a_plan(clean: Results) -> None:
    compared = clean.compared(sensor='adis16475-3')
    assert check_unit(compared).decision is Decision.WITHIN
    assert check_unit(clean.compared(sensor='adis16495-1')).decision is Decision.EXCEEDS


def test_the_worst_decision_is_that_of_the_batch() -> None:
    for pair in permutations(DECISIONS_WORST_FIRST, 2):
        assert worst(pair) is min(pair, key=DECISIONS_WORST_FIRST.index)
    assert [int(d) for d in DECISIONS_WORST_FIRST] == [70, 3, 1, 4, 0]
    assert worst([]) is Decision.WITHIN


def test_texts_name_quantity_value_and_limits(clean: Results) -> None:
    check = check_unit(clean, plan(rate=Limits(99.0, 101.0, 'Hz')))
    (said,) = unit_sentences(check, clean, 'deg/h')
    assert said == 'Beyond line 4: rate 50.0 Hz (limit 99 to 101 Hz).'
    limits = Limits(None, 1e-6, 'deg/h', 4.848e-6)
    axes = Plan('p', {axis: {'bias': limits} for axis in ('gyro_x', 'gyro_y', 'gyro_z')})
    assert checks_text(axes.checks(clean), axes).startswith('gyro bias ')
    heat = check_unit(clean, plan(temperature=Limits(20.0, None, 'degC')))
    said = checks_text(heat.of('undecided'), heat.plan)
    assert 'temperature is unknown, because it was not recorded' in said
    met = check_unit(clean, plan())
    assert unit_sentences(met, clean, 'deg/h') == ['All limits of line 4 are met (1).']
    assert limits_text(Limits(0.95, None, '%', 0.01)) == 'at least 95 %'
    assert unchecked_text(met.unchecked).startswith('unchecked') and not unchecked_text(())
    assert (
        measured_text(clean['gyro_x'].fit.noise['N'], Limits(0.0, 1.0, 'rad/s/sqrt(Hz)'))[:2]
        != '< '
    )
    assert UnitCheck(Decision.WITHIN).of('within') == []
