# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Untrusted YAML: plain values, and limited memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from allan_ros.core.errors import AllanError
from allan_ros.readers import open_recordings
from allan_ros.readers.files import parse_yaml
from fuzz.folder_target import MERGES, YAML_TRICKS


@pytest.mark.parametrize(
    'text, value',
    [
        ('{"N": 1e-4}', {'N': 1e-4}),
        ('a: &x [1]\nb: *x', {'a': [1], 'b': [1]}),
        ('[' * 50 + ']' * 50, None),
    ],
)
def test_yaml_is_parsed_to_its_values(text: str, value: Any) -> None:
    assert value is None or parse_yaml(text) == value
    assert parse_yaml(text) is not None


@pytest.mark.parametrize(
    'text', ['[' * 5000, '{a: ' * 5000, '- ' * 5000, '? ' * 5000, MERGES, 'a: {<<: {b: 1}}']
)
def test_slow_documents_are_rejected(text: str) -> None:
    with pytest.raises(yaml.YAMLError):
        parse_yaml(text)


@pytest.mark.parametrize('text', YAML_TRICKS)
def test_metadata_that_would_fill_the_memory_is_rejected(text: str, tmp_path: Path) -> None:
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(AllanError, match=r'metadata\.yaml'):
        open_recordings([tmp_path])
