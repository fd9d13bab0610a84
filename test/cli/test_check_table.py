# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan check` on recordings of known state gives the exit codes of docs/engineering/checks.md."""

from __future__ import annotations

from pathlib import Path

import pytest


def test_every_recording_has_the_exit_code_of_its_state(
    repository: Path, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(repository / 'scripts'))
    from check_table import PAGE, run_cases

    page = PAGE.read_text(encoding='utf-8')
    for case, code, line in run_cases(shared_data, tmp_path):
        assert code == case.exit_code, line
        assert f'| `{case.path}` | {case.state} |' in page
