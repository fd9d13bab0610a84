# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
import pytest

from allan_ros.core.findings import CATALOGUE, SEVERITIES, duration_text


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
