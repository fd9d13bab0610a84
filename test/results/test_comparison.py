# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of runs: what is compared, the order of statements, and the document."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.exports import scaled

from allan_ros.core.check import worst_verdict
from allan_ros.core.errors import AllanError
from allan_ros.core.estimate import Estimate
from allan_ros.core.findings import finding
from allan_ros.core.fit.result import TERMS
from allan_ros.readers.files import to_json
from allan_ros.results.comparison import (
    RunComparison,
    compare_runs,
    comparison_document,
    significant_of,
)
from allan_ros.results.datasheets import Datasheet, Limit, Source
from allan_ros.results.documents import labels_of
from allan_ros.results.results import Results
from allan_ros.view.comparison import sentences

HOSTILE = 'a\x1b[31m|\u202e<b>\r\n$x_{'


def compared(*results: Results, sheets: tuple[Datasheet, ...] = ()) -> RunComparison:
    return compare_runs(dict(zip('abc', results)), sheets)


def text_of(comparison: RunComparison) -> str:
    return '\n'.join(sentences(comparison))


def limited(name: str, **limits: Limit) -> Datasheet:
    return Datasheet(name, '', {'s': Source('X')}, {'gyro_x': limits} if limits else {})


def test_a_run_does_not_differ_from_itself(small_results: Results) -> None:
    comparison = compared(small_results, small_results)
    assert not comparison.differs
    assert {d.verdict for d in comparison.differences['b']} <= {'alike', 'undecided'}
    assert text_of(comparison).startswith('b and a do not differ significantly in ')


@pytest.mark.parametrize('factor, ratio', [(1.5, '1.50 (1.4'), (1 / 1.5, '0.667 (0.6')])
def test_the_sentence_names_what_differs_most(
    small_results: Results, factor: float, ratio: str
) -> None:
    other = scaled(small_results, 1.3, axis='accel_x')
    comparison = compared(small_results, other, scaled(other, factor))
    assert comparison.first == 'a' and list(comparison.differences) == ['b', 'c']
    assert comparison.differs
    found = [(d.axis, d.quantity) for d in significant_of(comparison.differences['c'])]
    assert found == [('gyro_z', 'N'), ('accel_x', 'N')]
    said = text_of(comparison).splitlines()[1]
    assert said.startswith('c differs from a in 2 of ')
    assert f' comparisons, most in gyro z N: {ratio}' in said


def test_every_run_is_held_against_every_datasheet(small_results: Results) -> None:
    n = small_results.axes['gyro_x'].fit.noise['N'].value
    sheets = (limited('X', N=Limit(n / 2, '3')), limited('Y'))
    comparison = compared(*[small_results] * 3, sheets=sheets)
    exceeded = [
        label
        for label, one in comparison.checked
        if worst_verdict(one.datasheet_checks) == 'exceeds'
    ]
    assert exceeded == [*'abc'] and comparison.differs
    assert 'c exceeds the datasheet of X in ' in text_of(comparison)
    alone = compared(small_results, sheets=sheets)
    assert alone.differences == {}
    assert 'a cannot be judged by the datasheet of Y' in text_of(alone)
    short = replace(small_results, duration_s=5.0)
    assert not compared(short, sheets=sheets).differs


def test_runs_without_a_common_axis_are_rejected(small_results: Results) -> None:
    gyro, accel = (
        replace(small_results, axes={n: a for n, a in small_results.axes.items() if n[0] == first})
        for first in 'ga'
    )
    with pytest.raises(AllanError, match=r'no common axis: b has accel_x, .*, a has gyro_x'):
        compared(gyro, accel)


def test_the_document_and_the_text_show_labels_safely(small_results: Results) -> None:
    comparison = compare_runs({HOSTILE: small_results, 'b': scaled(small_results, 1.5)})
    assert not set(text_of(comparison)) & set('\x1b\u202e\r') and '\\x1b' in text_of(comparison)
    document = json.loads(to_json(comparison_document(comparison)))
    [known] = [d for d in document['pairs'][0]['differences'] if d['verdict'] == 'higher']
    assert (known['axis'], known['quantity']) == ('gyro_z', 'N')
    assert known['ratio'] == pytest.approx(1.5)


def test_runs_without_numbers(small_results: Results) -> None:
    nothing = {term: Estimate(None) for term in TERMS}
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise=nothing), curve=None)
        for name, axis in small_results.axes.items()
    }
    empty = replace(small_results, axes=axes)
    assert text_of(compared(empty, empty)) == 'b and a have no quantity that can be compared'


def test_the_largest_difference_can_be_a_limit(small_results: Results) -> None:
    gyro_x = small_results.axes['gyro_x']
    below = Estimate(None, None, 1e-3 * gyro_x.fit.noise['N'].value, 'not_observable', name='N')
    fit = replace(gyro_x.fit, noise={**gyro_x.fit.noise, 'N': below})
    unresolved = replace(
        small_results, axes={**small_results.axes, 'gyro_x': replace(gyro_x, fit=fit)}
    )
    text = text_of(compared(unresolved, scaled(small_results, 1.5)))
    assert 'most in gyro x N: > ' in text


def test_a_recording_in_motion_is_named_first(small_results: Results) -> None:
    moved = replace(small_results, findings=(finding('not_noise', ('gyro_x', 'gyro_z')),))
    first, *others = text_of(compared(small_results, moved)).split('\n')
    assert first.startswith('b: This is not a noise recording: ') and len(others) == 1


def test_labels_are_short_if_they_are_unique(tmp_path: Path) -> None:
    (tmp_path / 'run.v2').mkdir()
    assert labels_of([str(tmp_path / 'run.v2'), 'run.v1/results.json']) == ['run.v2', 'run.v1']
    assert labels_of(['a/results.json', 'b/sums.json']) == ['a', 'b']
    assert labels_of(['runs/one', 'two.mcap']) == ['one', 'two']
    assert labels_of(['a/x.json', 'b/x.json']) == ['a/x.json', 'b/x.json']


@pytest.mark.parametrize('value', [5e-324, 1e-150, 1e150])
def test_huge_and_tiny_values_compare(value: float, small_results: Results) -> None:
    axis = small_results.axes['gyro_x']
    for c in (
        Estimate(value, (5e-324, 1e150)),
        Estimate(value, (value, value)),
        Estimate(1e-12, (1e-150, 1e-12)),
        Estimate(None, None, value, 'not_observable'),
    ):
        changed = replace(axis, fit=replace(axis.fit, noise={**axis.fit.noise, 'N': c}))
        other = replace(small_results, axes={**small_results.axes, 'gyro_x': changed})
        for runs in ((small_results, other), (other, small_results), (other, other)):
            assert text_of(compared(*runs)) and to_json(comparison_document(compared(*runs)))
