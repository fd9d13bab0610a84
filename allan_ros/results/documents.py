# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write and read the JSON documents `results.json` and `sums.json`.

Unknown values are null, never NaN. Reading is strict: AllanError is raised for another version of
the schema, a value of a wrong type, and a missing field without a default. The message states the
position in the document.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.allan.curve import CI_LEVEL, AxisCurve
from ..core.allan.document import sums_from_document, sums_to_document
from ..core.allan.sums import AllanSums
from ..core.check import MARGIN
from ..core.errors import AllanError, one_line
from ..core.estimate import Estimate
from ..core.fields import Fields, SignedInt, plain
from ..core.findings import CATALOG, QUANTITIES, SEVERITIES, Finding, missing_values, quantity
from ..core.fit.result import TERMS, AxisFit
from ..core.imu import AXES, SENSORS, SI_UNITS, ImuIdentity, sensor_of
from ..core.noise import PROCESSES, Model, Part
from ..core.noise.model import Covariance
from ..core.settings import expect
from ..core.stream.health import LISTED_SEGMENTS, Counts, Segment
from ..readers import SourceInfo
from ..readers.files import PATH, read_json, to_json
from ..readers.recording_sums import Provenance, RecordingSums
from ..version import __version__
from .analysis import analyze_recorded
from .axis_result import AxisResult
from .datasheets import sheet_from_document, sheet_to_document
from .results import Results

RESULTS_SCHEMA = 'allan_ros/results/3'
SUMS_FILE_SCHEMA = 'allan_ros/sums_file/2'

RESULTS, SUMS = 'results.json', 'sums.json'
"""Names of the documents in the folder of an analysis: the results, and the Allan sums from which
the results are computed."""

TOOL = {'name': 'allan_ros', 'version': __version__}

SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 1e-9, 1e9
"""Range of valid sample periods in s: from the resolution of a stamp, 1 ns, to thirty years."""

MAX_SETTINGS = 100
"""Largest number of settings in a document, and of items in a setting that is a list."""

FIT = ('m_min', 'filtered', 'white_scatter', 'drift_scatter', 'gof_z', 'lack_of_fit')
"""Successive fields of an axis in results.json that are copied from `AxisFit`."""

AXIS = ('rounding', 'turn_on', 'temperature', 'at_rest', 'growth')
"""Successive fields of an axis in results.json that are copied from `AxisResult`."""

DOCUMENT_KEYS = {
    'correlation_time': 'tau',
    'correlation_time_ci95': 'tau_ci95',
    'regions': 'reading',
}
"""Field of a dataclass -> key in results.json, for fields whose name and key differ."""


def results_to_document(results: Results, curves: bool = True) -> dict[str, Any]:
    """Return the results as a document ``allan_ros/results/3`` in SI.

    Findings are written without texts, except findings whose texts were read from a document
    (`Finding.stated`). If ``curves`` is False, the document contains no curves and is much shorter.
    """
    return {
        'schema': RESULTS_SCHEMA,
        'tool': TOOL,
        'frame_id': results.identity.frame_id,
        'hardware_id': results.identity.hardware_id,
        'method': results.method,
        'rate_hz': plain(results.rate_hz),
        'tau0_s': plain(results.tau0),
        'samples': results.samples,
        'duration_s': plain(results.duration_s),
        'segment_count': results.segments,
        **_provenance_to_document(results.provenance),
        'findings': [f.document() for f in results.findings],
        'datasheet': None
        if results.datasheet is None
        else sheet_to_document(results.datasheet, results.datasheet_checks, results.margin),
        'motion': plain(results.motion),
        'axes': {
            name: _axis_to_document(name, axis, curves) for name, axis in results.axes.items()
        },
    }


def results_from_document(document: object, where: str = 'results') -> Results:
    """Return the results in a document ``allan_ros/results/3``.

    ``where`` names the document in error messages. Raises AllanError if the document is invalid.
    """
    fields = Fields(document, where, DOCUMENT_KEYS)
    fields.schema(RESULTS_SCHEMA)
    provenance = _provenance_from_document(fields)
    stated_axes = fields.fields('axes')
    axes = {
        name: _axis_from_document(name, stated_axes.fields(name)) for name in _axes_of(stated_axes)
    }
    stated_sheet = fields.optional_fields('datasheet')
    motion = None
    if (motion_fields := fields.optional_fields('motion')) is not None:
        from ..core.filters.motion_factors import NoiseInMotion

        motion = motion_fields.record(NoiseInMotion)
    return Results(
        identity=ImuIdentity(fields.text('frame_id', ''), fields.text('hardware_id', '')),
        method=fields.text('method'),
        tau0=_period_from_document(fields),
        samples=fields.integer('samples', least=0),
        duration_s=fields.number('duration_s', least=0.0),
        segments=fields.integer('segment_count', least=0),
        axes=axes,
        provenance=provenance,
        findings=provenance.findings,
        datasheet=sheet_from_document(stated_sheet) if stated_sheet else None,
        margin=stated_sheet.number('margin') if stated_sheet else MARGIN,
        motion=motion,
    )


def sums_file_to_document(sums: Iterable[AllanSums], provenance: Provenance) -> dict[str, Any]:
    """Return Allan sums and their provenance as the document of a sums.json."""
    return {
        'schema': SUMS_FILE_SCHEMA,
        'tool': TOOL,
        **_provenance_to_document(provenance),
        'last_stamp_ns': provenance.last_stamp_ns,
        'findings': [f.document() for f in provenance.findings],
        'sums': [sums_to_document(s) for s in sums],
    }


def fingerprint(document: Mapping[str, Any]) -> str:
    """Return a hash of the Allan sums in the document of a sums.json.

    Equal Allan sums, which include stamps and the identity of the IMU, have equal hashes.
    """
    text = to_json({'sums': document.get('sums')})
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def sums_file_from_document(
    document: object, where: str = 'sums'
) -> tuple[tuple[AllanSums, ...], Provenance]:
    """Return the Allan sums and the provenance in the document of a sums.json.

    ``where`` names the document in error messages. Raises AllanError if the document is invalid.
    """
    fields = Fields(document, where, DOCUMENT_KEYS)
    fields.schema(SUMS_FILE_SCHEMA)
    return (
        tuple(sums_from_document(s, f'{where}: sums') for s in fields.sequence('sums')),
        _provenance_from_document(fields),
    )


def load(path: str | os.PathLike[str], method: str = 'likelihood') -> Results:
    """Read the results of an earlier analysis from its folder, a results.json, or a sums.json.

    If only a sums.json is read, its Allan sums are fitted again by ``method``. Raises AllanError
    when the file is missing or invalid, when the results.json and the sums.json in a folder are of
    different analyses, or when the Allan sums cannot be fitted.
    """
    expect(PATH, 'a path', path=path)
    # unlike `Path.is_dir`, `os.path.isdir` raises no error if a folder is unreadable
    is_folder, document_path = os.path.isdir(path), Path(path)
    if is_folder:
        has_sums, has_results = (os.path.isfile(document_path / n) for n in (SUMS, RESULTS))
        document_path = Path(file_in(path, SUMS if has_sums and not has_results else RESULTS))
    document: Any = read_json(document_path)
    if isinstance(document, dict) and document.get('schema') == SUMS_FILE_SCHEMA:
        recorded = RecordingSums(
            str(document_path), *sums_file_from_document(document, str(document_path))
        )
        return analyze_recorded(recorded, method)
    results = results_from_document(document, str(document_path))
    file = document_path.parent / SUMS
    if not is_folder or not os.path.isfile(file):
        return results
    sums: Any = read_json(file)
    recorded = RecordingSums(str(file), *sums_file_from_document(sums, str(file)))
    if document.get('fingerprint') != fingerprint(sums):
        # for example, a process was killed after it had written one of the two files
        raise AllanError(
            f'{path}: {RESULTS} and {SUMS} are of different analyses: analyze the recording again, '
            'or give one of the two files'
        )
    return replace(results, recorded=recorded)


def load_sums(path: str | os.PathLike[str]) -> RecordingSums:
    """Read the Allan sums from a sums.json, a checkpoint, or the folder of an analysis.

    Raises AllanError when the file is missing or invalid.
    """
    sums_path = file_in(path, SUMS)
    return RecordingSums(sums_path, *sums_file_from_document(read_json(sums_path), sums_path))


def file_in(path: str | os.PathLike[str], name: str) -> str:
    """Return ``path``; if it is a folder, return the path of the file ``name`` in this folder.

    Raises AllanError if the folder does not contain this file.
    """
    if not os.path.isdir(path):
        return str(path)
    file = Path(path) / name
    if not os.path.isfile(file):
        raise AllanError(
            f'{path}: no {name} in this folder: give the folder of an analysis, or the file'
        )
    return str(file)


def labels_of(paths: Sequence[str]) -> list[str]:
    """Return a label for each path.

    The label is the name of the folder, or the name of the file without its suffix; for a
    results.json or sums.json, it is the name of the folder that contains the file. If two such
    labels are equal or one is empty, the paths are the labels.
    """

    def short_name(path: Path) -> str:
        if path.name in (RESULTS, SUMS):
            return path.resolve().parent.name
        return path.name if os.path.isdir(path) else path.stem

    short_names = [short_name(Path(path)) for path in paths]
    are_unique = len(set(short_names)) == len(short_names) and all(short_names)
    return short_names if are_unique else [str(path) for path in paths]


def _provenance_to_document(provenance: Provenance) -> dict[str, Any]:
    longest_segments = sorted(provenance.segments, key=lambda s: -s.samples)[:LISTED_SEGMENTS]
    return {
        'source': plain(provenance.sources),
        'segments': plain(longest_segments),
        'counts': plain(provenance.counts),
        'settings': dict(provenance.settings),
    }


def _provenance_from_document(fields: Fields) -> Provenance:
    splits = fields.fields('counts').fields('splits')
    split_counts = Counter({reason: splits.integer(reason, least=0) for reason in splits})
    return Provenance(
        fields.typed('source', tuple[SourceInfo, ...]),
        fields.typed('segments', tuple[Segment, ...]),
        tuple(map(finding_from_document, fields.each('findings'))),
        fields.fields('counts').record(Counts, splits=split_counts),
        _settings_from_document(fields.fields('settings')),
        fields.typed('last_stamp_ns', SignedInt | None),
    )


def finding_from_document(fields: Fields) -> Finding:
    """Return a finding from its JSON object.

    If another version wrote the document, the present catalog may not contain the id of the
    finding, or may require other values. The finding then gets the message and the remedy in the
    document. Raises AllanError if the finding is invalid.
    """
    stated_values = fields.optional_fields('values')
    values = (
        {name: _value_from_document(stated_values, name) for name in stated_values}
        if stated_values
        else {}
    )
    entry = CATALOG.get(fields.text('id'))
    texts = None
    if entry is None or missing_values(entry, values):
        texts = one_line(fields.text('message')), one_line(fields.text('remedy'))
        values = {}
    axes = fields.typed('axes', tuple[str, ...])
    severity: Any = fields.choice('severity', SEVERITIES)
    return Finding(one_line(fields.text('id')), severity, axes, values, texts)


def _value_from_document(fields: Fields, name: str) -> Any:
    value = fields.value(name)
    if isinstance(value, list):
        return tuple(map(_quantity_from_document, fields.each(name)))
    if isinstance(value, dict):
        return _quantity_from_document(fields.fields(name))
    return fields.number(name) if isinstance(value, float) else value


def _quantity_from_document(fields: Fields) -> Estimate:
    value, low, high = (
        None if fields.value(key) is None else fields.number(key)
        for key in ('value', 'low', 'high')
    )
    sensor, term = fields.choice('sensor', tuple(SENSORS)), fields.choice('term', QUANTITIES)
    ci95 = None if low is None or high is None else (low, high)
    return quantity(value, sensor, term, ci95, None if ci95 else high)


def _settings_from_document(fields: Fields) -> Mapping[str, Any]:
    settings: dict[str, Any] = {}
    for name in fields:
        value = fields.value(name)
        items = value if isinstance(value, list) else [value]
        is_plain = all(v is None or isinstance(v, (bool, str, int, float)) for v in items)
        are_too_many = len(items) > MAX_SETTINGS or len(settings) == MAX_SETTINGS
        if not is_plain or are_too_many or math.inf in items:
            raise AllanError(f'{fields.where}: {name!r:.40} is not a known setting')
        settings[name] = value
    return settings


def _period_from_document(fields: Fields) -> float:
    period = fields.number('tau0_s', least=SHORTEST_PERIOD_S)
    if period > LONGEST_PERIOD_S:
        raise AllanError(f'{fields.where}.tau0_s is {period}: too long for an IMU')
    return period


def _axes_of(fields: Fields) -> tuple[str, ...]:
    """Return the keys of a JSON object, which must be axis names, in the order of `AXES`."""
    if unknown := [name for name in fields if name not in AXES]:
        raise AllanError(
            f'{fields.where}: {unknown[0]!r:.40} is not an axis: use {", ".join(AXES)}'
        )
    return tuple(name for name in AXES if name in fields)


def _axis_to_document(name: str, axis: AxisResult, curves: bool) -> dict[str, Any]:
    fit, units = axis.fit, SI_UNITS[sensor_of(name)]
    document: dict[str, Any] = {
        'unit': units['B'],
        'tau0_s': axis.tau0,
        'noise': {t: {**plain(fit.noise[t]), 'unit': units[t]} for t in TERMS},
        **{name: plain(getattr(fit, name)) for name in FIT},
        'white_std_per_sample': _scaled(fit.noise['N'], axis.tau0**-0.5),
        'walk_std_per_sample': _scaled(fit.noise['K'], axis.tau0**0.5),
        **{name: plain(getattr(axis, name)) for name in AXIS},
        'model': _model_to_document(fit.model),
        'deviation': plain(fit.deviation),
        'reading': plain(axis.regions),
    }
    if fit.model.covariance is not None:
        document['covariance'] = plain(fit.model.covariance)
    if curves and axis.curve is not None:
        model = plain(axis.model_line().adev)
        document['curve'] = {**plain(axis.curve), 'model': model, 'ci_level': CI_LEVEL}
    return document


def _axis_from_document(name: str, fields: Fields) -> AxisResult:
    noise, stated_covariance, covariance = (
        fields.fields('noise'),
        fields.optional_fields('covariance'),
        None,
    )
    if stated_covariance is not None:
        names = stated_covariance.typed('names', tuple[str, ...])
        covariance = Covariance(names, stated_covariance.table('matrix', len(names), len(names)))
    fit = fields.record(
        AxisFit,
        noise={t: Estimate.from_document(noise.fields(t), signed=t == 'R') for t in TERMS},
        m_min=fields.integer('m_min', least=1),
        model=Model(tuple(map(_part_from_document, fields.each('model'))), covariance),
    )
    return fields.record(
        AxisResult,
        tau0=_period_from_document(fields),
        fit=fit,
        curve=_curve_from_document(fields.fields('curve')) if 'curve' in fields else None,
        name=name,
    )


def _model_to_document(model: Model) -> list[dict[str, Any]]:
    """Return the name, the coefficient and the shape of each process of a model.

    The 95 % intervals of the coefficients and of the shapes are included.
    """
    return [
        {
            'process': part.process.name,
            'value': plain(part.value),
            'ci95': plain(part.ci95),
            **plain(part.process.numbers),
            'shape_ci95': plain(part.shape_ci95),
        }
        for part in model.parts
    ]


def _part_from_document(fields: Fields) -> Part:
    process_class = PROCESSES[fields.choice('process', tuple(PROCESSES))]
    shape = [fields.number(p.name, least=SHORTEST_PERIOD_S) for p in process_class.parameters]
    value = fields.number('value', -math.inf if process_class.is_regressor else 0.0)
    shape_ci95 = fields.typed('shape_ci95', tuple[tuple[float, float], ...])
    if len(shape_ci95) not in (0, len(shape)):
        raise AllanError(
            f'{fields.where}.shape_ci95 has {len(shape_ci95)} intervals: give {len(shape)}'
        )
    return Part(
        process_class(*shape), value, fields.typed('ci95', tuple[float, float] | None), shape_ci95
    )


def _scaled(coefficient: Estimate, factor: float) -> float | None:
    if coefficient.value is None or coefficient.status != 'estimated':
        return None
    scaled: float | None = plain(coefficient.value * factor)
    return scaled


def _curve_from_document(fields: Fields) -> AxisCurve:
    curve = fields.record(AxisCurve)
    if len({len(column) for column in vars(curve).values()}) > 1:
        raise AllanError(f'{fields.where}: its columns have different lengths')
    tau = curve.tau
    if len(tau) and not (tau[0] > 0.0 and (np.diff(tau) > 0.0).all()):  # NaN fails the test, too
        raise AllanError(f'{fields.where}.tau is not positive and increasing')
    return curve
