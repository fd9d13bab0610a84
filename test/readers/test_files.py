# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files are written completely or not at all, and untrusted YAML is read in limited memory."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml

from allan_ros.core.errors import AllanError
from allan_ros.readers import open_recording
from allan_ros.readers.files import config_file, parse_yaml, read_yaml, write_atomic
from fuzz.folder_target import MERGES, YAML_TRICKS


def test_content_replaces_content(tmp_path: Path) -> None:
    path = tmp_path / 'sums.json'
    write_atomic(path, 'gyroscope °/√h')
    write_atomic(path, b'\x89PNG')
    assert path.read_bytes() == b'\x89PNG'
    assert os.listdir(tmp_path) == ['sums.json']


def test_a_failed_write_keeps_the_old_file_and_leaves_no_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'sums.json'
    write_atomic(path, 'old')

    def full(_: int) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(AllanError, match='No space left on device'):
        write_atomic(path, 'new')
    assert path.read_text() == 'old'
    assert os.listdir(tmp_path) == ['sums.json']


def test_a_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(AllanError, match='cannot be written'):
        write_atomic(tmp_path / 'no' / 'where.json', '')


def test_others_may_read_what_the_umask_allows(tmp_path: Path) -> None:
    reference, path = tmp_path / 'plain', tmp_path / 'atomic'
    reference.write_text('')
    write_atomic(path, '')
    assert path.stat().st_mode == reference.stat().st_mode


def test_the_path_of_an_unknown_user_is_not_changed() -> None:
    name = '~no_such_user/imu.yaml'
    assert config_file('sensors', name, 'datasheet') == Path(name)
    assert config_file('sensors', '~/imu.yaml', 'datasheet') == Path.home() / 'imu.yaml'


def test_configuration_files_are_found_without_a_home_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv('XDG_CONFIG_HOME', raising=False)
    monkeypatch.setattr(os.path, 'expanduser', lambda path: path)  # as without a home folder
    assert config_file('sensors', 'mpu6050', 'datasheet').name == 'mpu-6050.yaml'


def test_a_configuration_file_may_have_capital_letters_in_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('XDG_CONFIG_HOME', str(tmp_path))
    file = tmp_path / 'allan_ros' / 'sensors' / 'My-IMU.yaml'
    file.parent.mkdir(parents=True)
    file.write_text('name: mine')
    for name in ('My-IMU', 'my-imu', 'myimu'):
        assert config_file('sensors', name, 'datasheet') == file
    file.unlink()
    file.symlink_to(tmp_path / 'missing')
    with pytest.raises(AllanError, match='no datasheet'):
        config_file('sensors', 'My-IMU', 'datasheet')


def test_a_date_that_does_not_exist_is_an_error_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / 'a.yaml'
    path.write_text('measured: 2024-13-45')
    with pytest.raises(AllanError, match='is not YAML'):
        read_yaml(path)


@pytest.mark.parametrize(
    'text, reason',
    [
        ('a: 1\nb: c: d', 'line 2: mapping values are not allowed here'),
        ('a: 1\n@b', "line 2: while scanning for the next token, found character '@' that"),
        ('a: 1\n\0', 'line 2 has a character that YAML does not allow'),
    ],
)
def test_an_error_in_a_yaml_file_states_the_line(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / 'a.yaml'
    path.write_text(text)
    with pytest.raises(AllanError) as error:
        read_yaml(path)
    assert str(error.value).startswith(f'{path}: is not YAML ({reason}')


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


@pytest.mark.parametrize(
    'text', ['2026-02-30', '!!bool x', '!!int ""', '!!timestamp x', f'1{":1" * 200}.5']
)
def test_a_value_that_contradicts_its_tag_is_an_error_of_the_yaml_file(text: str) -> None:
    with pytest.raises(yaml.YAMLError):
        parse_yaml(text)


@pytest.mark.parametrize('text', YAML_TRICKS)
def test_metadata_that_would_fill_the_memory_is_rejected(text: str, tmp_path: Path) -> None:
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(AllanError, match=r'metadata\.yaml'):
        open_recording(tmp_path)
