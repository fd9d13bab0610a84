# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""No forbidden calls in the source code, and no input can name a path outside its folder."""

from __future__ import annotations

import ast
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from allan_ros.core.errors import AllanError, one_line
from allan_ros.readers.files import write_atomic

LOG = logging.getLogger('test')

PACKAGE = Path(__file__).resolve().parents[1] / 'allan_ros'
FILES = sorted(PACKAGE.rglob('*.py'))

FORBIDDEN_CALLS = {
    'eval', 'exec', 'compile', '__import__', 'os.system', 'os.popen', 'tempfile.mktemp',
    'yaml.load', 'yaml.full_load', 'yaml.unsafe_load', 'yaml.safe_load',
    'np.load', 'numpy.load', 'np.fromfile', 'marshal.loads', 'shelve.open',
}  # fmt: skip
FORBIDDEN_IMPORTS = {'pickle', 'marshal', 'shelve', 'dill', 'cloudpickle', 'telnetlib', 'ftplib'}


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_nothing_from_outside_is_executed(path: Path) -> None:
    for name, call in calls(path):
        assert name not in FORBIDDEN_CALLS
        given = {k.arg for k in call.keywords}
        assert 'allow_pickle' not in given
        assert not (name.startswith('subprocess.') and 'shell' in given)
    tree = ast.parse(path.read_text(encoding='utf-8'))
    imported = {a.name.split('.')[0] for n in ast.walk(tree) if isinstance(n, ast.Import)
                for a in n.names}  # fmt: skip
    imported |= {(n.module or '').split('.')[0] for n in ast.walk(tree)
                 if isinstance(n, ast.ImportFrom) and not n.level}  # fmt: skip
    assert not imported & FORBIDDEN_IMPORTS


def test_the_scan_finds_forbidden_calls(tmp_path: Path) -> None:
    bad = tmp_path / 'bad.py'
    bad.write_text('import yaml\nyaml.unsafe_load(text)\n')
    assert {name for name, _ in calls(bad)} & FORBIDDEN_CALLS


def test_the_loader_of_yaml_is_a_safe_one() -> None:
    import yaml

    from allan_ros.readers.files import parse_yaml

    with pytest.raises(yaml.YAMLError):
        parse_yaml('!!python/object/apply:os.getcwd []')


def test_a_link_in_place_of_the_checkpoint_is_replaced_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / 'victim'
    victim.write_text('precious')
    link = tmp_path / 'imu.json'
    link.symlink_to(victim)
    write_atomic(link, 'sums')
    assert victim.read_text() == 'precious'
    assert not link.is_symlink() and link.read_text() == 'sums'


@pytest.mark.parametrize('label', ['../x', '/etc/x', 'a/b', '..', 'a\0b', 'a b', '~', 'é/..'])
def test_a_label_is_not_a_path(label: str) -> None:
    pytest.importorskip('rclpy')
    from allan_ros.nodes.node_settings import InputSettings

    with pytest.raises(AllanError, match='labels'):
        InputSettings(topics=('a', 'b'), labels=(label, 'other'))


@pytest.mark.parametrize('topic', ['../../x', '/a/../../x', 'a b'])
def test_no_topic_leads_a_checkpoint_out_of_its_folder(topic: str) -> None:
    pytest.importorskip('rclpy')
    from allan_ros.nodes.node_settings import InputSettings

    try:
        settings = InputSettings(topics=(topic, 'imu'))
    except AllanError:
        return
    assert all('/' not in label and label != '..' for _, label, *_ in settings.imus())


@pytest.mark.parametrize('text', ['\x1b[2J', 'a\nb', '\u202eabc', '\ud800', '\0', 'x' * 10**6])
def test_a_name_cannot_drive_the_terminal(text: str) -> None:
    said = str(AllanError(f'{text}: no such file'))
    assert said.isprintable() and len(said) < 2100
    assert said.endswith(': no such file')
    assert one_line('as it is, é 𝄞') == 'as it is, é 𝄞'
