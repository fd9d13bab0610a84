# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The number of a schema, and the version of the package, grow when a document changes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import allan_ros as ar
from allan_ros.results.comparison import comparison_document, inflation_document
from allan_ros.results.documents import results_to_document, sums_file_to_document
from allan_ros.version import __version__

RECORDED = Path(__file__).with_name('schemas.json')
"""Version -> schema -> digest of the structure of its documents, for all versions."""


def structure(value: Any) -> Any:
    """Return the names of all fields and the types of their values; of a list, the first element.

    The document is from a fixed simulation, so that optional fields are always the same.
    """
    if isinstance(value, dict):
        return {name: structure(each) for name, each in sorted(value.items())}
    if isinstance(value, (list, tuple)):
        return [structure(value[0])] if len(value) else []
    return 'number' if isinstance(value, (int, float)) else type(value).__name__


def documents() -> list[dict[str, Any]]:
    quiet, loud = (ar.analyze(ar.simulate(hours=0.05, rate=50, seed=seed)) for seed in (1, 2))
    recorded = quiet.recorded
    return [
        results_to_document(quiet),
        sums_file_to_document(recorded.sums, recorded.provenance),
        comparison_document(ar.compare(quiet, loud)),
        inflation_document(ar.inflate(quiet, loud)),
        json.loads(quiet.export('state_space')),
    ]


def test_a_change_of_a_document_has_a_new_schema_and_a_new_version() -> None:
    """Record a change on purpose: raise both, and add the version with its digests to the file."""
    found = {
        document['schema']: hashlib.sha256(json.dumps(structure(document)).encode()).hexdigest()[
            :16
        ]
        for document in documents()
    }
    versions = json.loads(RECORDED.read_text())
    assert versions.get(__version__) == found, f'{__version__}: {json.dumps(found, indent=1)}'
    digests: dict[str, str] = {}
    for version, schemas in versions.items():
        for schema, digest in schemas.items():
            assert digests.setdefault(schema, digest) == digest, f'{schema} changed in {version}'
