# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.findings import example

from allan_ros.core import findings
from allan_ros.core.fields import Fields
from allan_ros.core.findings import (
    CATALOG,
    SEVERITIES,
    Finding,
    by_consequence,
    finding,
    grouped,
    is_note,
    quantity,
    quantity_text,
)
from allan_ros.core.imu import SI_UNITS, shown_unit
from allan_ros.core.number_text import duration_text, significant
from allan_ros.results.documents import finding_from_document


def test_every_kind_of_finding_has_a_severity_a_message_and_a_remedy():
    for id, wording in CATALOG.items():
        assert id.isidentifier() and wording.severity in SEVERITIES
        for text in (wording.message_template, wording.remedy_template):
            assert text and text == text.strip() and '>' not in text and '\n' not in text
            assert text[-1] in '.}]', text


@pytest.mark.parametrize('optional', [True, False])
@pytest.mark.parametrize('id', CATALOG)
def test_every_text_is_complete_in_both_units(id, optional):
    found = example(id, optional=optional)
    for units in ('deg/h', 'SI'):
        for text in found.texts(units):
            assert not re.search(r'[{}]|\[\[|\]\]|\.\.|\bNone(?! of)|\bnan\b|  ', text), text
            assert not re.search(r'\d%', text), text
            assert text[-1] == '.'


def test_a_quantity_is_shown_in_the_units_of_the_output():
    for axis in ('gyro_x', 'accel_x'):
        found = finding('bias_steps', (axis,), size=1e-5, share=0.5, at='3 h')
        unit = shown_unit(axis, 'B', 'deg/h')
        assert f'up to {significant(1e-5 * unit.factor, 3)} {unit.name}' in found.message
        assert '1.00e-05 ' + SI_UNITS[axis[:-2]]['B'] in found.texts('SI').message


@pytest.mark.parametrize(
    ('known', 'text'),
    [
        (quantity(0.0274, 'accel', 'signal'), '2.79 mg'),
        (quantity(0.00274, 'accel', 'B'), '279 ug'),
        (quantity(27.4, 'accel', 'B'), '2.79 g'),
        (quantity(0.01, 'gyro', 'signal'), '0.573 deg/s'),
        (quantity(1e-5, 'gyro', 'signal'), '2.06 deg/h'),
        (quantity(1e-4, 'gyro', 'N', (0.9e-4, 1.1e-4)), '0.344 deg/sqrt(h) (0.309 to 0.378)'),
        (quantity(None, 'gyro', 'N', upper95=1e-4), '< 0.344 deg/sqrt(h)'),
    ],
)
def test_the_prefix_fits_and_the_interval_follows(known, text):
    assert quantity_text(known) == text


@pytest.mark.parametrize('id', CATALOG)
def test_a_document_has_all_values_and_gives_the_same_text(id):
    found = example(id, number=0.25)
    document = json.loads(json.dumps(found.document('SI'), allow_nan=False))
    read = finding_from_document(Fields(document, 'finding'))
    assert read == found and str(read) == str(found)


def test_a_finding_of_another_version_keeps_its_texts():
    document = {**example('vibration').document(), 'id': 'unheard', 'message': 'A {brace} of 5 %.'}
    for changed in (document, {**document, 'id': 'vibration', 'values': {}}):
        read = finding_from_document(Fields(changed, 'finding'))
        assert read.message == 'A {brace} of 5 %.'


def test_every_number_before_a_noun_has_the_singular():
    counts = 'count|times|lost|splits|interpolated|received|publishers|stated|read|points|samples'
    always_several = {'several_publishers', 'relay_several_publishers'}
    for id, wording in CATALOG.items():
        message = wording.message_template
        counted = re.search(rf'\{{({counts})\}}( lost| isolated)? [a-z]+s\b', message)
        assert counted is None or id in always_several, message
    one, two = (finding('gaps', lost=n, splits=n).message for n in (1, 2))
    assert one == '1 sample is missing; 1 gap splits the recording.'
    assert two == '2 samples are missing; 2 gaps split the recording.'


def test_equal_causes_become_one_with_the_range_of_each_number():
    (merged,) = grouped(
        finding('vibration', (axis,), frequency=frequency, amplitude=amplitude)
        for axis, frequency, amplitude in (
            ('accel_x', 0.579, 0.0095),
            ('accel_y', 0.573, 0.0048),
            ('accel_z', 0.575, 0.0048),
        )
    )
    assert merged.message.startswith('Vibration at 0.573 to 0.579 Hz, amplitude 489 to 969 ug;')
    assert merged.texts('SI').message.count('0.00480 to 0.00950 m/s^2') == 1
    assert merged.axes == ('accel_x', 'accel_y', 'accel_z')
    first, second = (
        finding('exceeds_limit', (axis,), term='N', value=quantity(n, 'gyro', 'N', (low, high)),
                limit=quantity(1e-4, 'gyro', 'N'), reference='A', margin=0.05)
        for axis, n, low, high in (('gyro_x', 2e-4, 1.9e-4, 2.1e-4), ('gyro_y', 3e-4, 2e-4, 4e-4))
    )  # fmt: skip
    (merged,) = grouped((first, second))
    assert merged.message == (
        'N is 0.688 to 1.03 deg/sqrt(h) (0.653 to 1.38), above the 0.344 deg/sqrt(h) of A by more '
        'than 5 %.'
    )


@given(
    st.lists(st.sampled_from(['vibration', 'lack_of_fit', 'no_noise', 'gaps', 'held']), max_size=9)
)
def test_merging_loses_no_axis_and_keeps_different_findings_apart(ids):
    axes = ('gyro_x', 'gyro_y', 'accel_z')
    found = [example(id, i + 1.0, axes[i % 3]) for i, id in enumerate(ids)]
    merged = grouped(found)
    pairs = {(f.id, axis) for f in found for axis in f.axes}
    assert {(f.id, axis) for f in merged for axis in f.axes} == pairs
    assert grouped(merged) == merged
    kept = [Finding('x', 'info', 'The file {path}.', 'Fix it.', (), {'path': p}) for p in 'ab']
    assert set(grouped(kept)) == set(kept)


def test_findings_are_in_the_order_of_their_consequence():
    expected = [
        finding('no_noise', ('gyro_x',)),
        finding('gyro_unit', n=1.0, rate=1.0),
        Finding('unknown', 'error', '', ''),
        finding('bias_steps', ('gyro_x',), size=1.0, share=0.5, at='3 h'),
        finding('lack_of_fit', ('accel_x',), low=1.0, high=2.0, deviation=0.3),
        finding('vibration', ('gyro_x',), frequency=1.0, amplitude=1.0),
        finding('settled_part', ('gyro_x',), early=60.0, size=1.0),
        Finding('unknown', 'warning', '', ''),
        finding('lack_of_fit', ('accel_x',), low=1.0, high=2.0, deviation=0.01),
        finding('level_changes', ('gyro_x',), which='here', value=1.0, low=0.99, high=1.003),
        Finding('unknown', 'info', '', ''),
    ]
    assert by_consequence(expected) == tuple(expected)
    assert set(by_consequence(reversed(expected))[:5]) == set(expected[:5])
    assert [is_note(each) for each in expected] == [False] * 8 + [True] * 3


def test_the_order_names_only_findings_that_exist():
    listed = [*findings._FAULTS, *findings._NUMBERS]
    others = {*findings.LIVE, *findings.UNUSABLE, *findings.MINOR}
    assert {*listed, *others} <= set(CATALOG) and len(set(listed)) == len(listed)


@given(st.floats(1e-12, 1e12), st.integers(2, 6))
def test_shown_numbers_equal_the_values_to_their_digits(value, digits):
    expected = pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))
    assert float(significant(value, digits)) == expected


@pytest.mark.parametrize(
    'seconds, digits, text',
    [(34.5, 3, '34.5 s'), (34.5, 2, '34 s'), (655.0, 3, '10.9 min'), (7200.0, 3, '2 h'),
     (1e-3, 2, '0.001 s'), (0.0, 2, '0 s'), (864000.0, 3, '10 days')],
)  # fmt: skip
def test_durations(seconds, digits, text):
    assert duration_text(seconds, digits) == text
