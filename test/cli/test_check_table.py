# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan check` on recordings of known state gives the exit code of that state."""

from __future__ import annotations

from pathlib import Path

import pytest


def test_every_recording_has_the_exit_code_of_its_state(
    repository: Path, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(repository / 'scripts'))
    from check_table import run_cases

    for case, code, line in run_cases(shared_data, tmp_path):
        assert code == case.exit_code, line
