# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The package as a whole: one version, a license header everywhere, metadata that colcon finds."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

import allan_ros

ROOT = Path(__file__).resolve().parents[1]

HEADER = (
    'Copyright 2026 the allan_ros authors',
    'SPDX-License-Identifier: Apache-2.0',
)

WITH_HEADER = ('.py', '.toml', '.yaml', '.xml')


def tracked_files() -> list[Path]:
    """Return the files of the project, without generated ones."""
    listed = subprocess.run(
        ['git', 'ls-files', '--cached', '--others', '--exclude-standard'],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    names = listed.stdout.splitlines()
    if listed.returncode:  # a source archive is not a git checkout
        names = [
            str(p.relative_to(ROOT))
            for r in ('allan_ros', 'test')
            for p in ROOT.glob(f'{r}/**/*.py')
        ]
    return [ROOT / name for name in names if (ROOT / name).is_file()]


@pytest.mark.parametrize('words', HEADER)
def test_every_source_file_has_a_license_header(words: str) -> None:
    files = [
        path
        for path in tracked_files()
        if path.suffix in WITH_HEADER or path.name in ('Makefile', 'run')
    ]
    assert len(files) > 20
    without = [
        str(path.relative_to(ROOT))
        for path in files
        if words not in ''.join(path.read_text(encoding='utf-8').splitlines(True)[:5])
    ]
    assert without == []


def test_the_version_is_the_same_everywhere() -> None:
    manifest = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    (setup,) = re.findall(r"version='([^']+)'", (ROOT / 'setup.py').read_text(encoding='utf-8'))
    assert allan_ros.__version__ == manifest == setup


def test_metadata_is_where_colcon_reads_it() -> None:
    # Either of these breaks `colcon build` or its --symlink-install.
    assert '[project]' not in (ROOT / 'pyproject.toml').read_text(encoding='utf-8')
    assert 'python_requires' not in (ROOT / 'setup.cfg').read_text(encoding='utf-8')


def test_metadata_is_read_through_the_link_that_colcon_makes(tmp_path: Path) -> None:
    pytest.importorskip('setuptools')
    (tmp_path / 'setup.py').symlink_to(ROOT / 'setup.py')
    command = [sys.executable, 'setup.py', '--version']
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert ended.stdout.split()[-1:] == [allan_ros.__version__], ended.stderr


def test_every_console_script_is_there() -> None:
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    scripts = re.findall(r"f'(allan\w*) = \{PACKAGE\}\.([\w.]+):(\w+)'", setup)
    assert 'allan' in [name for name, _, _ in scripts]
    for _, module, name in scripts:
        source = ROOT / 'allan_ros' / (module.replace('.', '/') + '.py')
        assert re.search(rf'^(def |class )?{name}( =|\()', source.read_text(encoding='utf-8'), re.M)


def test_every_license_that_is_named_is_there_and_every_configuration_is_installed() -> None:
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    licenses = ElementTree.parse(ROOT / 'package.xml').findall('license')
    assert f"license='{' AND '.join(str(each.text) for each in licenses)}'" in setup
    assert all((ROOT / each.attrib['file']).is_file() for each in licenses)
    folders = [path.name for path in (ROOT / 'config').iterdir() if path.is_dir()]
    assert len(folders) > 2
    assert [name for name in folders if f"glob('config/{name}/" not in setup] == []


NO_ROSDEP_KEY = {'lz4', 'rosbags', 'zstandard'}


def test_dependencies_are_the_same_everywhere() -> None:
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    (block,) = re.findall(r'install_requires=\[(.*?)\n    \]', setup, re.DOTALL)
    required = set(re.findall(r"'(\w+)>=", block))
    depends = ElementTree.parse(ROOT / 'package.xml').findall('exec_depend')
    names = {str(each.text) for each in depends}
    keys = {f'python3-{name.lower().removeprefix("py")}' for name in required - NO_ROSDEP_KEY}
    assert {name for name in names if name.startswith('python3-')} == keys
    install = (ROOT / 'docs' / 'start.md').read_text(encoding='utf-8')
    assert all(name in install for name in NO_ROSDEP_KEY)
    declaration = (ROOT / 'QUALITY_DECLARATION.md').read_text(encoding='utf-8')
    assert [name for name in required if name not in declaration] == []


def test_the_workflow_runs_every_python_that_is_declared() -> None:
    setup = (ROOT / 'setup.py').read_text(encoding='utf-8')
    declared = re.findall(r"Python :: (3\.\d+)'", setup)
    workflow = (ROOT / '.github' / 'workflows' / 'ci.yml').read_text(encoding='utf-8')
    assert len(declared) > 2 and [v for v in declared if f"'{v}'" not in workflow] == []
