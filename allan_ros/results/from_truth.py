# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The true noise of a simulated recording as `Results`, with which measurements are compared."""

from __future__ import annotations

import os
from pathlib import Path

from ..core.estimate import UNKNOWN, Estimate
from ..core.fields import Fields
from ..core.fit.result import TERMS, AxisFit
from ..core.imu import ImuIdentity
from ..core.noise import Model
from ..readers import SourceInfo
from ..readers.files import read_yaml
from ..readers.recorded import Provenance
from .axis_result import AxisResult
from .results import Results
from .simulation import TRUTH_SCHEMA, TRUTH_SUFFIX, read_noise

TRUTH = 'truth'
"""Value of `Results.method` for results that contain the true noise."""


def is_truth(path: str | os.PathLike[str]) -> bool:
    """Return whether the file at a path is a truth file, judged by its name and schema."""
    file_path = Path(path)
    if not (file_path.name == 'truth.json' or file_path.name.endswith(TRUTH_SUFFIX)):
        return False
    document = read_yaml(file_path)
    return isinstance(document, dict) and document.get('schema') == TRUTH_SCHEMA


def results_of_truth(path: str | os.PathLike[str]) -> Results:
    """Return the noise in the truth file of a simulated recording as results.

    The intervals have no width, because the noise is known exactly. A term that was not simulated
    has no value, so that measured results are not compared with it. Raises AllanError when the file
    is invalid.
    """
    fields = Fields(read_yaml(Path(path)), str(path))
    tau0, seconds = 1.0 / fields.number('rate_hz'), fields.number('seconds')
    axes = {
        axis: AxisResult(tau0, AxisFit(_estimates(model), model), name=axis)
        for axis, model in read_noise(path).items()
    }
    samples = round(seconds / tau0)
    provenance = Provenance((SourceInfo(str(path), '', '', ''),))
    return Results(ImuIdentity(TRUTH), TRUTH, tau0, samples, seconds, 1, axes, provenance, ())


def _estimates(model: Model) -> dict[str, Estimate]:
    values = {term: model.value(term) for term in TERMS}
    return {
        term: Estimate(value, (value, value)) if value else UNKNOWN
        for term, value in values.items()
    }
