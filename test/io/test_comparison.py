# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of runs: what is compared, the order of statements, and the files."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import pytest

from allan_ros.core.errors import AllanError
from allan_ros.core.fit import TERMS, Coefficient
from allan_ros.io.comparison import (
    CSV_COLUMNS,
    Subject,
    compare_runs,
    comparison_document,
    comparison_headline,
    csv_table,
    markdown,
    write_comparison,
)
from allan_ros.io.datasheets import Datasheet, Limit, Source
from allan_ros.io.documents import labels_of
from allan_ros.io.plots import comparison_figure
from allan_ros.io.results import Results


def scaled(results: Results, factor: float, term: str = 'N', axis: str = 'gyro_z') -> Results:
    """Return the results with one coefficient changed by a factor."""
    of_axis = results.axes[axis]
    c = of_axis.fit.noise[term]
    assert c.value is not None and c.ci95 is not None
    low, high = c.ci95
    changed = Coefficient(c.value * factor, (low * factor, high * factor))
    fit = replace(of_axis.fit, noise={**of_axis.fit.noise, term: changed})
    return replace(results, axes={**results.axes, axis: replace(of_axis, fit=fit)})


def test_a_run_does_not_differ_from_itself(small_results: Results) -> None:
    comparison = compare_runs([Subject('a', small_results), Subject('b', small_results)])
    assert not comparison.differs
    assert {d.verdict for d in comparison.pairs[0].differences} <= {'alike', 'undecided'}
    [said] = comparison_headline(comparison)
    assert said.startswith('b and a do not differ significantly in ')


@pytest.mark.parametrize('factor, word', [(1.5, '1.50x noisier'), (1 / 1.5, '1.50x quieter')])
def test_the_verdict_names_what_differs_most(
    small_results: Results, factor: float, word: str
) -> None:
    other = scaled(small_results, factor)
    comparison = compare_runs([Subject('a', small_results), Subject('b', other)])
    assert comparison.differs
    assert [(d.axis, d.quantity) for d in comparison.pairs[0].significant] == [('gyro_z', 'N')]
    [said] = comparison_headline(comparison)
    assert said.startswith(f'b is {word} than a in gyro z N (1.4')


def test_every_run_is_held_against_the_first_and_every_datasheet(small_results: Results) -> None:
    n = small_results.axes['gyro_x'].fit.noise['N'].value
    assert n is not None
    sheet = Datasheet('X', '', {'s': Source('X')}, {'gyro_x': {'N': Limit(n / 2, '1')}}, {})
    runs = [Subject(label, small_results) for label in 'abc']
    comparison = compare_runs(runs, [sheet])
    assert [(p.first, p.second) for p in comparison.pairs] == [('a', 'b'), ('a', 'c')]
    assert [(label, b.verdict) for label, b in comparison.datasheets] == [
        ('a', 'exceeds'), ('b', 'exceeds'), ('c', 'exceeds'),
    ]  # fmt: skip
    assert comparison.differs
    assert list(comparison_headline(comparison))[-1] == 'c exceeds the datasheet of X in gyro x N'
    assert compare_runs(runs[:1], [sheet]).pairs == ()


def test_runs_without_a_common_axis_are_rejected(small_results: Results) -> None:
    gyro, accel = (
        replace(small_results, axes={n: a for n, a in small_results.axes.items() if n[0] == first})
        for first in 'ga'
    )
    with pytest.raises(AllanError, match=r'no common axis: b has accel_x, .*, a has gyro_x'):
        compare_runs([Subject('a', gyro), Subject('b', accel)])


def test_plots_have_any_format_and_narrow_ones_no_ratios(
    small_results: Results, tmp_path: Path
) -> None:
    runs = [Subject(f'run_$_{i}', small_results) for i in range(3)]
    comparison = compare_runs(runs)
    paths = write_comparison(tmp_path, comparison, plots=('pdf',))
    assert [p.name for p in paths if p.suffix == '.pdf'] == [
        'compare_gyro.pdf',
        'compare_accel.pdf',
    ]
    figure = comparison_figure(comparison, 'gyro')
    assert figure is not None and len(figure.axes) == 6
    assert '°/h' in figure.axes[0].get_ylabel()


def test_the_files_agree(small_results: Results, tmp_path: Path) -> None:
    comparison = compare_runs(
        [Subject('a', small_results), Subject('b', scaled(small_results, 1.5))]
    )
    names = {path.name for path in write_comparison(tmp_path, comparison)}
    assert names == {
        'comparison.json', 'comparison.md', 'comparison.csv',
    }  # fmt: skip
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)
    document = json.loads((tmp_path / 'comparison.json').read_text())
    assert document == json.loads(json.dumps(comparison_document(comparison)))
    rows = list(csv.DictReader(io.StringIO(csv_table(comparison))))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert len(rows) == len(comparison.pairs[0].differences)
    [row] = [r for r in rows if r['verdict'] == 'higher']
    assert (row['axis'], row['quantity'], row['unit']) == ('gyro_z', 'N', 'rad/s/sqrt(Hz)')
    assert float(row['second_value']) == pytest.approx(1.5 * float(row['first_value']))
    assert float(row['ratio']) == pytest.approx(1.5)
    text = markdown(comparison)
    assert text.startswith('b is 1.50x noisier than a')
    assert sum(line.endswith('| higher |') for line in text.splitlines()) == 1


def without_numbers(results: Results) -> Results:
    """Return the results with neither coefficients nor curves."""
    nothing = {term: Coefficient(None) for term in TERMS}
    axes = {
        name: replace(axis, fit=replace(axis.fit, noise=nothing), curve=None)
        for name, axis in results.axes.items()
    }
    return replace(results, axes=axes)


def test_runs_without_numbers_cannot_be_compared(small_results: Results) -> None:
    empty = without_numbers(small_results)
    comparison = compare_runs([Subject('a', empty), Subject('b', empty)])
    assert repr(comparison) == 'b and a have nothing that can be compared'
    assert comparison_figure(comparison, 'gyro') is None


def test_a_difference_in_the_other_direction_is_counted(small_results: Results) -> None:
    other = scaled(scaled(small_results, 3.0), 1 / 1.5, axis='accel_x')
    comparison = compare_runs([Subject('a', small_results), Subject('b', other)])
    assert repr(comparison).startswith('b is 3.00x noisier than a in gyro z N (')
    assert repr(comparison).endswith('comparisons (1 of them in the opposite direction)')


def test_a_table_for_each_datasheet(small_results: Results) -> None:
    n = small_results.axes['gyro_x'].fit.noise['N'].value
    assert n is not None
    sheet, empty = (
        Datasheet(name, '', {'s': Source('X')}, limits, {})
        for name, limits in (('X|<', {'gyro_x': {'N': Limit(n / 2, '3 | 4')}}), ('Y', {}))
    )
    comparison = compare_runs([Subject('a', small_results)], [sheet, empty])
    lines = markdown(comparison).splitlines()
    assert '## a and the datasheet of X\\|&lt;' in lines
    [row] = [line for line in lines if line.startswith('| gyro_x')]
    assert row.endswith('| 3 \\| 4 | exceeds |')
    assert 'the datasheet of Y has no limit for the axes of a' in lines


def test_an_axis_without_noise_is_reported(small_results: Results) -> None:
    curve = small_results.axes['gyro_x'].curve
    assert curve is not None
    zero = replace(curve, **dict.fromkeys(('adev', 'ci_low', 'ci_high'), 0.0 * curve.adev))
    axis = replace(small_results.axes['gyro_x'], curve=zero)
    run = Subject('a', replace(small_results, axes={**small_results.axes, 'gyro_x': axis}))
    figure = comparison_figure(compare_runs([run, run]), 'gyro')
    assert figure is not None
    assert not figure.axes[0].lines


def test_labels_are_short_if_they_are_unique() -> None:
    assert labels_of(['a/results.json', 'b/sums.json']) == ['a', 'b']
    assert labels_of(['runs/one', 'two.mcap']) == ['one', 'two']
    assert labels_of(['a/x.json', 'b/x.json']) == ['a/x.json', 'b/x.json']


HOSTILE = 'a\x1b[31m|\u202e<b>\r\n$x_{'


def test_labels_are_shown_safely(small_results: Results, tmp_path: Path) -> None:
    comparison = compare_runs([Subject(HOSTILE, small_results), Subject('b', small_results)])
    shown = repr(comparison) + markdown(comparison) + csv_table(comparison)
    assert not set(shown) & set('\x1b\u202e\r')
    assert '\\x1b' in shown and '\\|' in markdown(comparison)
    rows = [line for line in markdown(comparison).splitlines() if line.startswith('|')]
    assert {line.replace('\\|', '').count('|') for line in rows} == {8}
    assert write_comparison(tmp_path, comparison)


@pytest.mark.parametrize('value', [5e-324, 1e-150, 1e150])
def test_huge_and_tiny_values_compare(value: float, small_results: Results) -> None:
    fit = small_results.axes['gyro_x'].fit
    for c in (
        Coefficient(value, (5e-324, 1e150)),
        Coefficient(value, (value, value)),
        Coefficient(1e-12, (1e-150, 1e-12)),
        Coefficient(None, None, value, 'not_observable'),
    ):
        noise = {**fit.noise, 'N': c}
        axis = replace(small_results.axes['gyro_x'], fit=replace(fit, noise=noise))
        other = replace(small_results, axes={**small_results.axes, 'gyro_x': axis})
        for runs in ((small_results, other), (other, small_results), (other, other)):
            comparison = compare_runs([Subject(*run) for run in zip('ab', runs)])
            assert repr(comparison) and csv_table(comparison) and markdown(comparison)
