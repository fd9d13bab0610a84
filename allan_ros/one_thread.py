# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keep linear algebra to one thread: entry points call this before anything imports numpy.

Our matrices are of a hundred rows. Spread over threads, which wait for each other by spinning, a
fit takes three times the CPU and no less time.
"""

from __future__ import annotations

import os

VARIABLES = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')
"""What the usual libraries read when they are loaded."""


def keep_to_one_thread() -> None:
    """Ask for one thread where the user asked for nothing else."""
    for name in VARIABLES:
        os.environ.setdefault(name, '1')
