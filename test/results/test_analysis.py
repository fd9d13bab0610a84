# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An analysis uses one thread, and leaves the number of threads of the user as it was."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import numpy, threading
from allan_ros.results.analysis import _openblas, one_thread
import scipy.linalg
libraries = list(_openblas())
for _, set_number in libraries:
    set_number(2)
counts = lambda: {get() for get, _ in libraries}
before = counts()
inner, leave = threading.Event(), threading.Event()
def work():
    with one_thread():
        inner.set()
        leave.wait()
other = threading.Thread(target=work)
with one_thread():
    other.start()
    inner.wait()
    assert counts() <= {1}, counts()
assert counts() <= {1}, counts()  # the other thread is still in a fit
leave.set()
other.join()
assert counts() == before, counts()
"""


IN_ANALYZE = """
import allan_ros as ar
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.results.analysis import _openblas
import scipy.linalg
seen, update = set(), ImuStream.update
def watched(self, batch):
    seen.update(get() for get, _ in _openblas())
    update(self, batch)
for _, set_number in _openblas():
    set_number(2)
ImuStream.update = watched
ar.analyze(ar.simulate(hours=0.02))
assert seen <= {1}, seen
"""


@pytest.mark.parametrize('script', [SCRIPT, IN_ANALYZE])
def test_threads_are_limited_within_an_analysis_and_restored(script: str) -> None:
    assert subprocess.run([sys.executable, '-c', script]).returncode == 0
