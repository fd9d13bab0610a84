# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The document results.json: results, with the texts of the findings and the verdict."""

from __future__ import annotations

from typing import Any

from ..core.fields import plain
from ..results.documents import results_to_document
from ..results.results import Results
from .finding_text import finding_document
from .verdict_text import verdict_of


def result_document(results: Results, units: str = 'deg/h', curves: bool = True) -> dict[str, Any]:
    """Return the results as the document ``allan_ros/results/3`` (results.json).

    Most numbers are in SI; exceptions are, for example, stamps in ns and the tilt in degrees. The
    texts of the findings and of the verdict use ``units``, 'deg/h' or 'SI'. Texts that were read
    from a file are not changed. Without ``curves``, the curves and the verdict are omitted.
    """
    verdict_entry = {'verdict': plain(verdict_of(results, units))} if curves else {}
    finding_documents = [finding_document(each, units) for each in results.findings]
    return {**results_to_document(results, curves), **verdict_entry, 'findings': finding_documents}
