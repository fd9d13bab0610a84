# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The audit lists the installed packages, and does not treat a missing answer as a good one."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / 'scripts' / 'audit.py'


@pytest.fixture
def audit(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the script as a module."""
    spec = importlib.util.spec_from_file_location('audit', SCRIPT)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(sys, 'argv', ['audit.py'])
    return module


def answer(audit: ModuleType, monkeypatch: pytest.MonkeyPatch, **of_numpy: object) -> None:
    """Let pip-audit report these fields for numpy, and no vulnerability for the other packages."""
    said = [{'name': name, 'version': '1', 'vulns': []} for name in audit.required()]
    (numpy,) = (each for each in said if each['name'] == 'numpy')
    if 'skip_reason' in of_numpy:
        del numpy['vulns']
    numpy.update(of_numpy)
    code = f'print({json.dumps({"dependencies": said})!r})'
    monkeypatch.setattr(audit, 'TOOL', [sys.executable, '-c', code])


def test_each_package_is_listed_with_version_and_license(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, 'argv', ['audit.py', '--offline'])
    assert audit.main() == 0
    rows = {row.split()[0]: row.split()[1:] for row in capsys.readouterr().out.splitlines()}
    assert {'numpy', 'scipy', 'pyyaml'} <= set(rows)
    assert 'pytest' not in rows  # extras are not installed by default
    assert 'BSD' in ' '.join(rows['numpy'])


def test_no_known_vulnerability_is_exit_code_0(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer(audit, monkeypatch)
    assert audit.main() == 0


def test_a_vulnerability_is_named(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer(audit, monkeypatch, vulns=[{'id': 'PYSEC-1', 'fix_versions': ['2.0']}])
    assert audit.main() == audit.VULNERABLE
    assert 'VULNERABLE: numpy 1: PYSEC-1, fixed in 2.0' in capsys.readouterr().out


def test_a_skipped_package_is_not_reported_as_safe(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer(audit, monkeypatch, skip_reason='not found')
    assert audit.main() == audit.NOT_AUDITED
    assert 'NOT AUDITED: 1 of ' in capsys.readouterr().err


def test_a_tool_that_fails_is_reported(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(audit, 'TOOL', [sys.executable, '-c', 'raise SystemExit("no network")'])
    assert audit.main() == audit.NOT_AUDITED
    assert 'no network' in capsys.readouterr().err
