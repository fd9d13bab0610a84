# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The document results.json: the results with the texts of findings and verdict."""

from __future__ import annotations

from typing import Any

from ..core.fields import plain
from ..results.documents import results_to_document
from ..results.results import Results
from .finding_text import finding_document
from .verdict_text import verdict_of


def result_document(results: Results, units: str = 'deg/h', curves: bool = True) -> dict[str, Any]:
    """Return the results as the document ``allan_ros/results/3`` (results.json).

    Numbers are in SI; ``units`` ('deg/h' or 'SI') are the units in the texts of the findings and of
    the verdict. Without ``curves``, the curves and the verdict are omitted.
    """
    judged = {'verdict': plain(verdict_of(results, units))} if curves else {}
    found = [finding_document(each, units) for each in results.findings]
    return {**results_to_document(results, curves), **judged, 'findings': found}
