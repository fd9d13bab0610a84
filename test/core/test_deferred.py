# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Imports of scipy at the first use."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
import numpy
from allan_ros.core.deferred import linalg, special
assert 'scipy' not in sys.modules
assert special.ndtr(0.0) == 0.5 and linalg.norm([3.0, 4.0]) == 5.0
assert 'numpy.f2py' not in sys.modules and 'numpy.testing' not in sys.modules
numpy.testing.assert_equal(1, 1)
import scipy.optimize
assert scipy.optimize.brentq(lambda x: x - 1.0, 0.0, 3.0) == 1.0
"""


def test_scipy_is_imported_late_and_without_unused_modules_of_numpy():
    subprocess.run([sys.executable, '-c', CODE], check=True)
