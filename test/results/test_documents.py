# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""results.json and sums.json: complete round trips; wrong documents are rejected."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from allan_ros.core.allan.document import sums_to_document
from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate
from allan_ros.core.fields import Fields, Signed
from allan_ros.core.findings import Finding
from allan_ros.core.fit.result import Deviation
from allan_ros.core.noise import PROCESSES, Model, Part
from allan_ros.core.stream.health import Event, Segment
from allan_ros.readers.files import MAX_BYTES, read_json, to_json
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.documents import (
    load,
    results_from_document,
    results_to_document,
    sums_file_from_document,
    sums_file_to_document,
)
from allan_ros.results.results import Results


def through_text(document: dict[str, Any]) -> dict[str, Any]:
    """Return the document as another program reads it: strict JSON, in which NaN is an error."""

    def refuse(constant: str) -> None:
        raise AssertionError(f'{constant} in JSON')

    read: dict[str, Any] = json.loads(to_json(document), parse_constant=refuse)
    return read


def test_the_round_trip_of_results_is_complete(small_results: Results) -> None:
    finding = Finding(
        'unheard', 'warning', ('gyro_x', 'accel_z'), stated=('only 3 s', 'record longer')
    )
    results = replace(
        small_results,
        findings=(finding,),
        provenance=replace(small_results.provenance, findings=(finding,)),
    )
    document = through_text(results_to_document(results))
    again = through_text(results_to_document(results_from_document(document)))
    assert again == document


def test_a_sums_json_without_sums_or_of_another_kind_is_rejected(
    small_results: Results, tmp_path: Path
) -> None:
    document = sums_file_to_document((), small_results.provenance)
    (tmp_path / 'sums.json').write_text(to_json(document))
    with pytest.raises(AllanError, match='no Allan sums'):
        load(tmp_path / 'sums.json')
    (tmp_path / 'results.json').write_text(to_json(results_to_document(small_results)))
    (tmp_path / 'sums.json').write_text('[1]')
    with pytest.raises(AllanError, match=r'sums\.json'):
        load(tmp_path)


def test_the_fields_that_others_rely_on_are_there(small_results: Results) -> None:
    document = through_text(results_to_document(small_results))
    known = {'schema': 'allan_ros/results/3', 'samples': 60_000, 'segment_count': 1}
    assert known.items() <= document.items()
    (source,) = document['source']
    assert {'runs/one.mcap', '/imu/data', 'sensor_msgs/msg/Imu', 'mcap'} == {*source.values()}
    times = [document[key] for key in ('rate_hz', 'tau0_s', 'duration_s')]
    assert times == pytest.approx([50.0, 0.02, 1200.0])
    assert document['segments'][0]['start_ns'] == 10**18
    axis = document['axes']['gyro_z']
    assert axis['unit'] == 'rad/s' and {'gof_z', 'm_min'} <= set(axis)
    assert axis['curve']['ci_level'] == 0.683
    columns = ('m', 'tau', 'n', 'adev', 'ci_low', 'ci_high', 'model')
    assert len({len(axis['curve'][key]) for key in columns}) == 1
    n = axis['noise']['N']
    assert (n['unit'], n['status']) == ('rad/s/sqrt(Hz)', 'estimated')
    assert n['ci95'][0] < n['value'] < n['ci95'][1]
    assert axis['white_std_per_sample'] == pytest.approx(n['value'] * math.sqrt(50.0))
    assert set(axis['noise']) == set('QNBKR')
    assert 'curve' not in results_to_document(small_results, curves=False)['axes']['gyro_z']


def test_unknown_values_are_null(small_results: Results) -> None:
    axis = small_results.axes['gyro_x']
    noise = {**axis.fit.noise, 'K': Estimate(None, None, math.inf, 'not_observable')}
    curve = replace(axis.curve, ci_high=np.full(len(axis.curve.m), math.nan))
    unknown = replace(axis, fit=replace(axis.fit, noise=noise, gof_z=math.nan), curve=curve)
    results = replace(small_results, axes={'gyro_x': unknown})
    document = through_text(results_to_document(results))['axes']['gyro_x']
    assert document['noise']['K']['value'] is None
    assert document['noise']['K']['upper95'] is None
    assert document['walk_std_per_sample'] is None
    assert document['gof_z'] is None
    assert set(document['curve']['ci_high']) == {None}


def test_processes_and_deviations_are_kept(small_results: Results) -> None:
    axis = small_results.axes['accel_y']
    shapes = {name: range(3, 3 + len(one.parameters)) for name, one in PROCESSES.items()}
    parts = [
        Part(PROCESSES[name](*map(float, shape)), 2e-4, (1e-4, 3e-4), ((1.0, 9.0),) * len(shape))
        for name, shape in shapes.items()
    ]
    fit = replace(axis.fit, model=Model(tuple(parts)), deviation=Deviation(0.06, 240.0))
    results = replace(small_results, axes={'accel_y': replace(axis, fit=fit)})
    document = through_text(results_to_document(results))
    again = results_from_document(document).axes['accel_y'].fit
    assert (again.deviation, again.model) == (fit.deviation, fit.model)


def test_of_many_segments_the_longest_are_listed(small_results: Results) -> None:
    segments = tuple(Segment(i, i + 1, float(i + 1)) for i in range(1500))
    provenance = replace(small_results.provenance, segments=segments)
    document = results_to_document(replace(small_results, provenance=provenance))
    assert [s['samples'] for s in document['segments']] == list(range(1500, 500, -1))


def test_the_round_trip_of_sums_is_exact(small_run) -> None:
    sums, provenance = small_run
    document = through_text(sums_file_to_document([sums], provenance))
    (again,), its_provenance = sums_file_from_document(document)
    assert sums_to_document(again) == sums_to_document(sums)
    assert its_provenance == provenance


def spoiled(document: dict[str, Any], path: tuple[str | int, ...], value: object) -> Any:
    """Return a copy with one field replaced, or removed if the value is `KeyError`."""
    copied = copy.deepcopy(document)
    place: Any = copied
    for key in path[:-1]:
        place = place[key]
    if value is KeyError:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return copied


@pytest.mark.parametrize(
    ('path', 'value', 'said'),
    [
        (('schema',), 'allan_ros/results/9', 'allan_ros/results/9'),
        (('tau0_s',), KeyError, 'tau0_s is missing'),
        (('tau0_s',), True, 'a number'),
        (('samples',), 1.5, 'a whole number'),
        (('axes', 'gyro_x', 'noise', 'N'), KeyError, 'N is missing'),
        (('axes', 'gyro_x', 'noise', 'N', 'value'), 'big', 'axes.gyro_x.noise.N.value'),
        (('axes', 'gyro_x', 'noise', 'N', 'value'), 10**400, 'axes.gyro_x.noise.N.value'),
        (('axes', 'gyro_x', 'noise', 'N', 'ci95'), [1.0], 'a pair of numbers'),
        (('axes', 'gyro_x', 'noise', 'N', 'status'), 'perhaps', 'one of estimated'),
        (('axes', 'gyro_x', 'curve', 'm'), [1], 'different lengths'),
        (('source',), [3], r'source\[0\]'),
        (('axes',), [], 'an object'),
        (('axes', 'yaw'), {}, "'yaw' is not an axis"),
        (('axes', 'gyro_x', 'curve', 'tau', 1), 0.0, 'tau is not positive and increasing'),
        (('tau0_s',), 1e10, 'too long for an IMU'),
        (('settings', 'skip'), {'a': 1}, "'skip' is not a known setting"),
        (('axes', 'gyro_x', 'deviation'), {'tau': 3.0}, 'relative'),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_wrong_field_is_named(
    small_results: Results, path: tuple[str | int, ...], value: object, said: str
) -> None:
    document = through_text(results_to_document(small_results))
    with pytest.raises(AllanError, match=said):
        results_from_document(spoiled(document, path, value))


@pytest.mark.parametrize('document', [None, [], 3, 'x', {}, {'schema': 'allan_ros/results/3'}])
def test_a_file_that_is_not_a_sums_file_is_rejected(document: object) -> None:
    with pytest.raises(AllanError):
        sums_file_from_document(document)


@pytest.mark.parametrize(
    ('content', 'said'),
    [
        ('', 'is not JSON'),
        ('{"a": ', 'is not JSON'),
        ('[' * 100_000, 'is not JSON'),
        ('[NaN]', 'NaN is not a number'),
        ('["\\ud800"]', 'is not JSON'),
        (f'[{"1" * 1000}]', 'an integer of 1000 digits'),
        (' ' * (MAX_BYTES + 1), f'is larger than {MAX_BYTES} bytes'),
    ],
    ids=lambda text: text[:20],
)
def test_a_file_that_is_not_json_is_reported(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / 'sums.json'
    with pytest.raises(AllanError, match='no such file'):
        read_json(path)
    path.write_text(content)
    with pytest.raises(AllanError, match=said):
        read_json(path)


def test_a_finding_of_two_runs_is_reported_once(small_run) -> None:
    _, provenance = small_run
    one = replace(provenance, findings=(Finding('a', 'info', stated=('m', 'r')),))
    both = one + one
    assert both.findings == one.findings
    assert len(both.sources) == 2
    assert both.counts.received == 2 * provenance.counts.received
    assert provenance.counts.received == 60_000
    assert Provenance() + Provenance() == Provenance()


class Kind(NamedTuple):
    name: str
    count: int
    size: float
    shift: Signed
    limit: float | None
    ends: tuple[float, float] | None = None


@pytest.mark.parametrize(
    'change, message',
    [
        ({}, ''),
        ({'name': 3}, 'x.name is 3: a text is expected'),
        ({'count': -1}, 'x.count is -1'),
        ({'count': 1.5}, 'x.count is 1.5: a whole number'),
        ({'size': -1.0}, 'x.size is -1.0: a number of at least 0'),
        ({'size': None}, 'x.size is None: a number'),
        ({'limit': 'a'}, "x.limit is 'a'"),
        ({'ends': [1.0]}, 'x.ends is a list of length 1: a pair'),
    ],
)
def test_a_record_is_read_by_the_types_of_its_fields(change, message):
    document = {'name': 'a', 'count': 1, 'size': 2, 'shift': -3.0, 'limit': None, **change}
    fields = Fields(document, 'x')
    if message:
        with pytest.raises(AllanError, match=message.replace('.', r'\.')):
            fields.record(Kind)
    else:
        assert fields.record(Kind) == Kind('a', 1, 2.0, -3.0, None)
        assert fields.record(Kind, count=7).count == 7


def test_an_event_of_a_stream_is_read_as_written() -> None:
    event = Event('motion', 5, 2.5, {'accel_x': -0.1, 'gyro_z': 1e-4})
    document = json.loads(json.dumps({**event._asdict(), 'changes': dict(event.changes)}))
    assert Fields(document, 'x').record(Event) == event
