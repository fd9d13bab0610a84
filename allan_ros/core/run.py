# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Run`: evenly spaced samples, as one stage of the segmenter hands them to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Run:
    """Evenly spaced samples that follow on the run before, unless ``cut`` says why they do not.

    Attributes
    ----------
    stamps : (n,) int64 array
        In ns, as they came (interpolated for bridged samples).
    rows : (axes, n) float64 array
    cut : str
        '' or the reason why no difference may straddle the start of this run.
    """

    stamps: NDArray[np.int64]
    rows: NDArray[np.float64]
    cut: str = ''
