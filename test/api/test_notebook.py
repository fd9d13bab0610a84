# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The notebook of the documentation runs from its first cell to its last."""

from __future__ import annotations

from pathlib import Path

import pytest


def test_every_cell_runs(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip('nbclient', reason='nbclient is not installed')
    nbformat = pytest.importorskip('nbformat')
    pytest.importorskip('ipykernel', reason='ipykernel is not installed')
    monkeypatch.setenv('IPYTHONDIR', str(tmp_path / 'ipython'))
    monkeypatch.setenv('PYTHONPATH', str(repository))
    notebook = nbformat.read(repository / 'docs' / 'notebook.ipynb', as_version=4)
    assert len(notebook.cells) == 10
    assert not any(cell.get('outputs') for cell in notebook.cells)
    client = nbclient.NotebookClient(
        notebook, timeout=300, resources={'metadata': {'path': str(tmp_path)}}
    )
    client.execute()
    shown = [output for cell in notebook.cells for output in cell.get('outputs', ())]
    forms = {form for output in shown for form in output.get('data', {})}
    assert {'text/html', 'image/png'} <= forms
    assert 'accelerometer_noise_density' in (tmp_path / 'imu.yaml').read_text()
