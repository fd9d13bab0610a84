# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A fit uses one thread, and leaves the number of threads of the user as it was."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import numpy, threading
from allan_ros.io.analysis import _openblas, one_thread
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


def test_threads_are_limited_within_a_fit_and_restored() -> None:
    assert subprocess.run([sys.executable, '-c', SCRIPT]).returncode == 0
