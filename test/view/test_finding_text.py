# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The texts of findings: complete, in the units of the output, with singular and plural."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.findings import example

from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import significant
from allan_ros.core.findings import CATALOG, finding, grouped, quantity
from allan_ros.core.imu import SI_UNITS, shown_unit
from allan_ros.view.finding_text import (
    FIELD,
    OPTIONAL,
    explained,
    finding_document,
    finding_line,
    texts_of,
    words,
)


def test_every_finding_has_a_message_and_a_remedy():
    assert {*words()} == {*CATALOG}
    for known in words().values():
        for text in (known.message, known.remedy):
            assert text and text == text.strip() and '>' not in text and '\n' not in text
            assert text[-1] in '.}]', text
        assert known.section and '{' not in known.explanation


def test_each_finding_has_one_entry():
    text = (Path(__file__).parents[2] / 'allan_ros/view/findings.md').read_text('utf-8')
    ids = re.findall(r'(?m)^### (.*)$', text)
    assert len(ids) == len({*ids}) == len(CATALOG)


@pytest.mark.parametrize('id', CATALOG)
def test_the_text_uses_exactly_the_values_of_the_finding(id):
    known, kind = words()[id], CATALOG[id]
    text = f'{known.message} {known.remedy}'
    fields = FIELD.findall(text)
    assert {name for name, _ in fields} == {*kind.values}
    needed = {name for name, _ in FIELD.findall(OPTIONAL.sub('', text))}
    assert kind.optional == {*kind.values} - needed
    for name, spec in fields:
        if '|' not in spec and kind.values[name]:
            assert spec.rstrip('0123456789') == kind.values[name], name


@pytest.mark.parametrize('optional', [True, False])
@pytest.mark.parametrize('id', CATALOG)
def test_every_text_is_complete_in_both_units(id, optional):
    found = example(id, optional=optional)
    for units in ('deg/h', 'SI'):
        for text in texts_of(found, units):
            assert not re.search(r'[{}]|\[\[|\]\]|\.\.|\bNone(?! of)|\bnan\b|  ', text), text
            assert not re.search(r'\d%', text), text
            assert text[-1] == '.'


def test_a_quantity_is_shown_in_the_units_of_the_output():
    for axis in ('gyro_x', 'accel_x'):
        found = finding('bias_steps', (axis,), size=1e-5, share=0.5, at='3 h')
        unit = shown_unit(axis, 'B', 'deg/h')
        assert f'up to {significant(1e-5 * unit.factor, 3)} {unit.name}' in texts_of(found).message
        assert '1.00e-05 ' + SI_UNITS[axis[:-2]]['B'] in texts_of(found, 'SI').message


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
    found = finding('tilted', ('gyro_x',), change=known, angle=2.0, times=1)
    assert text in texts_of(found).message


def test_every_number_before_a_noun_has_the_singular():
    counts = 'count|times|lost|splits|interpolated|received|publishers|stated|read|points|samples'
    always_several = {'several_publishers', 'relay_several_publishers'}
    for id, known in words().items():
        message = known.message
        counted = re.search(rf'\{{({counts})\}}( lost| isolated)? [a-z]+s\b', message)
        assert counted is None or id in always_several, message
    one, two = (texts_of(finding('gaps', lost=n, splits=n)).message for n in (1, 2))
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
    assert texts_of(merged).message.startswith(
        'Vibration at 0.573 to 0.579 Hz, amplitude 489 to 969 ug;'
    )
    assert texts_of(merged, 'SI').message.count('0.00480 to 0.00950 m/s^2') == 1
    assert merged.axes == ('accel_x', 'accel_y', 'accel_z')
    first, second = (
        finding('exceeds_limit', (axis,), term='N', value=quantity(n, 'gyro', 'N', (low, high)),
                limit=quantity(1e-4, 'gyro', 'N'), reference='A', margin=0.05)
        for axis, n, low, high in (('gyro_x', 2e-4, 1.9e-4, 2.1e-4), ('gyro_y', 3e-4, 2e-4, 4e-4))
    )  # fmt: skip
    (merged,) = grouped((first, second))
    assert texts_of(merged).message == (
        'N is 0.688 to 1.03 deg/sqrt(h) (0.653 to 1.38), above the 0.344 deg/sqrt(h) of A by more '
        'than 5 %.'
    )


def test_few_different_frequencies_are_listed_and_not_read_as_a_band():
    def said(*frequencies):
        axes = ('gyro_x', 'gyro_y', 'gyro_z', 'gyro_x')
        found = [
            finding('vibration', (axis,), frequency=frequency, amplitude=1e-3)
            for axis, frequency in zip(axes, frequencies)
        ]
        (merged,) = grouped(found)
        return texts_of(merged).message.partition(' Hz')[0]

    assert said(31.4, 19.1, 19.1) == 'Vibration at 31.4 and 19.1'
    assert said(31.4, 19.1, 25.0) == 'Vibration at 31.4, 19.1 and 25'
    assert said(19.1, 19.3) == 'Vibration at 19.1 to 19.3'
    assert said(10.0, 20.0, 30.0, 40.0) == 'Vibration at 10 to 40'


def test_aliases_are_listed_in_the_order_of_their_frequencies():
    (merged,) = grouped(
        finding('vibration', (axis,), frequency=frequency, alias=100.0 - frequency, amplitude=1e-3)
        for axis, frequency in (('gyro_x', 40.0), ('gyro_y', 48.0))
    )
    said = texts_of(merged).message
    assert said.startswith('Vibration at 40 and 48 Hz (or an alias of 60 and 52 Hz)')


def test_a_document_has_the_texts_in_its_units():
    found = example('vibration', 1e-5)
    for units in ('deg/h', 'SI'):
        document = finding_document(found, units)
        assert (document['message'], document['remedy']) == texts_of(found, units)
        assert document['values'] == found.document()['values']


def test_an_error_is_explained_by_its_findings():
    found = finding('never_still', seconds=20.0)
    error = explained(AllanError('a.csv: no static data:', (found,)))
    assert str(error) == f'a.csv: no static data: {finding_line(found)}'
    plain = AllanError('a.csv: no such file')
    assert explained(plain) is plain
