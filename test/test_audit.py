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


def test_each_package_is_listed_with_version_and_license(
    audit: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, 'argv', ['audit.py', '--offline'])
    assert audit.main() == 0
    rows = {row.split()[0]: row.split()[1:] for row in capsys.readouterr().out.splitlines()}
    assert {'numpy', 'scipy', 'pyyaml'} <= set(rows)
    assert 'pytest' not in rows  # extras are not installed by default
    assert 'BSD' in ' '.join(rows['numpy'])


VULNERABILITY = {'vulns': [{'id': 'PYSEC-1', 'fix_versions': ['2.0']}]}


@pytest.mark.parametrize(
    ('of_numpy', 'code', 'said'),
    [
        ({'vulns': []}, 0, ''),
        (VULNERABILITY, 1, 'VULNERABLE: numpy 1: PYSEC-1, fixed in 2.0'),
        ({'skip_reason': 'not found'}, 2, 'NOT AUDITED: 1 of '),
        (None, 2, 'no network'),
    ],
)
def test_no_missing_answer_is_treated_as_a_good_one(
    audit: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    of_numpy: dict[str, object] | None,
    code: int,
    said: str,
) -> None:
    """The answer of pip-audit has these fields for numpy; without them, the tool fails."""
    answer = [{'name': name, 'version': '1', 'vulns': []} for name in audit.required()]
    answer = [{'name': 'numpy', 'version': '1', **(of_numpy or {})} if each['name'] == 'numpy'
              else each for each in answer]  # fmt: skip
    script = f'print({json.dumps({"dependencies": answer})!r})'
    if of_numpy is None:
        script = 'raise SystemExit("no network")'
    monkeypatch.setattr(audit, 'TOOL', [sys.executable, '-c', script])
    assert audit.main() == code
    shown = capsys.readouterr()
    assert said in shown.out + shown.err
