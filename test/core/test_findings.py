# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import pytest

from allan_ros.core.findings import CATALOGUE, SEVERITIES, Finding, duration_text, grouped


def of(axis, message, severity='warning', id='x', remedy='Fix it.'):
    return Finding(id, severity, message, remedy, (axis,) if axis else ())


def test_equal_causes_become_one_with_the_range_of_each_number():
    merged = grouped(
        [
            of('accel_x', 'Vibration at 0.579 Hz, amplitude 0.0095 m/s^2.'),
            of('accel_y', 'Vibration at 0.573 Hz, amplitude 0.0048 m/s^2.'),
        ]
    )
    assert len(merged) == 1
    assert merged[0].message == (
        'Vibration at 0.573 to 0.579 Hz, amplitude 0.0048 to 0.0095 m/s^2.'
    )
    assert merged[0].axes == ('accel_x', 'accel_y')


def test_intervals_are_joined_and_equal_numbers_kept():
    texts = ['N is 2.4 deg (2.3..2.5), above 0.66.', 'N is 2.2 deg (2.1..2.25), above 0.66.']
    (merged,) = grouped(of(axis, text) for axis, text in zip(('gyro_x', 'gyro_y'), texts))
    assert merged.message == 'N is 2.2 to 2.4 deg (2.1..2.5), above 0.66.'


def test_other_words_other_causes_and_findings_without_axes_stay_apart():
    kept = [of('gyro_x', 'Lost 3.'), of('gyro_y', 'Found 3.'), of('', 'a_1.bag'), of('', 'a_2.bag')]
    assert set(grouped(kept)) == set(kept)


def test_the_most_severe_comes_first():
    levels = ('info', 'error', 'warning')
    assert [f.severity for f in grouped(of('', level, level) for level in levels)] == [
        'error',
        'warning',
        'info',
    ]


def test_every_kind_of_finding_has_a_severity_a_message_and_a_remedy():
    for id, wording in CATALOGUE.items():
        assert id.isidentifier() and wording.severity in SEVERITIES
        for text in (wording.message, wording.remedy):
            assert text and text == text.strip() and '>' not in text and '\n' not in text
            assert text[-1] in '.}', text


@pytest.mark.parametrize(
    'seconds, digits, text',
    [(34.5, 3, '34.5 s'), (34.5, 2, '34 s'), (655.0, 3, '10.9 min'), (7200.0, 3, '2 h'),
     (1e-3, 2, '0.001 s'), (0.0, 2, '0 s'), (864000.0, 3, '10 days')],
)  # fmt: skip
def test_durations(seconds, digits, text):
    assert duration_text(seconds, digits) == text
