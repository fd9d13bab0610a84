# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import re

import pytest

from allan_ros.core.findings import CATALOG, SEVERITIES, duration_text, finding


def test_every_kind_of_finding_has_a_severity_a_message_and_a_remedy():
    for id, wording in CATALOG.items():
        assert id.isidentifier() and wording.severity in SEVERITIES
        for text in (wording.message, wording.remedy):
            assert text and text == text.strip() and '>' not in text and '\n' not in text
            assert text[-1] in '.}', text


def test_words_follow_their_number():
    one, two = (finding('gaps', lost=n, cuts=n).message for n in (1, 2))
    assert one == '1 sample is missing; 1 gap splits the recording.'
    assert two == '2 samples are missing; 2 gaps split the recording.'


def test_every_number_before_a_noun_has_the_singular():
    counts = 'count|times|lost|cuts|bridged|received|publishers|stated|read|points|samples'
    always_several = {'several_publishers', 'relay_several_publishers'}
    for id, wording in CATALOG.items():
        counted = re.search(rf'\{{({counts})\}}( lost| isolated)? [a-z]+s\b', wording.message)
        assert counted is None or id in always_several, wording.message


@pytest.mark.parametrize(
    'seconds, digits, text',
    [(34.5, 3, '34.5 s'), (34.5, 2, '34 s'), (655.0, 3, '10.9 min'), (7200.0, 3, '2 h'),
     (1e-3, 2, '0.001 s'), (0.0, 2, '0 s'), (864000.0, 3, '10 days')],
)  # fmt: skip
def test_durations(seconds, digits, text):
    assert duration_text(seconds, digits) == text
