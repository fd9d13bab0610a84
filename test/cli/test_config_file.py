# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Defaults from `allan.toml` or pyproject.toml."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from allan_ros.cli.main import main

if sys.version_info < (3, 11):
    pytest.importorskip('tomli')


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def method_of(capsys: pytest.CaptureFixture[str]) -> object:
    return json.loads(capsys.readouterr().out)['method']


def test_options_of_the_command_line_override_the_file(
    folder: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / 'allan.toml').write_text(
        'units = "si"\nmethod = "relative"\n[analyze]\njson = true\nplots = ["png"]\n'
    )
    assert main(['analyze', str(recording)]) == 0
    assert method_of(capsys) == 'relative'
    assert main(['analyze', str(recording), '--method', 'gls']) == 0
    assert method_of(capsys) == 'gls'
    # a key for all verbs is ignored by a verb without this option
    assert main(['sensors']) == 0


def test_a_section_of_pyproject_does_the_same(
    folder: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / 'pyproject.toml').write_text(
        '[tool.ruff]\nx = 1\n[tool.allan.analyze]\nmethod = "relative"\njson = true\n'
    )
    assert main(['analyze', str(recording)]) == 0
    assert method_of(capsys) == 'relative'


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('[analyse]\nunits = "si"\n', '[analyse] is not a verb'),
        ('[analyze]\nunit = "si"\n', 'has no option --unit: did you mean units?'),
        ('[analyze]\njson = "yes"\n', 'json is a switch'),
        ('[analyze]\nunits = true\n', 'units needs a text or a number'),
        ('units = \n', 'is not TOML'),
    ],
)
def test_a_mistake_in_the_file_is_one_line(
    folder: Path, recording: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / 'allan.toml').write_text(text)
    assert main(['analyze', str(recording)]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count('\n') == 1


def test_a_wrong_value_is_wrong_usage(folder: Path, recording: Path) -> None:
    (folder / 'allan.toml').write_text('units = "furlong"\n')
    with pytest.raises(SystemExit) as stop:
        main(['analyze', str(recording)])
    assert stop.value.code == 2
