# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict: its light follows findings and comparisons, and its words name what they mean."""

from __future__ import annotations

from dataclasses import replace

from allan_ros.core.compare import Comparison, compare, reference_of_run
from allan_ros.core.findings import Finding
from allan_ros.core.fit import AxisFit, Coefficient
from allan_ros.core.imu import AXES
from allan_ros.io.report.verdict import verdict_of
from allan_ros.io.results import Results


def against_itself(results: Results, factor: float) -> list[Comparison]:
    """Return the comparison with a run whose limits are so many times its own."""
    own = reference_of_run('May', {name: a.fit.noise for name, a in results.axes.items()})
    limits = {
        axis: {t: factor * v for t, v in terms.items() if t in 'NB'}
        for axis, terms in own.limits.items()
    }
    reference = replace(own, limits=limits)
    return [
        c for name, a in results.axes.items() for c in compare(name, a.fit.noise, reference, 0.0)
    ]


def calm(results: Results) -> Results:
    return replace(results, findings=tuple(f for f in results.findings if f.severity == 'info'))


def test_a_good_imu_is_good_and_its_axes_are_compared(small_results: Results) -> None:
    said = verdict_of(calm(small_results), against_itself(small_results, 1.01), 'datasheet')
    assert (said.light, said.word) == ('good', 'Good')
    assert said.fine.startswith('Yes: all 12 numbers are surely within May')
    assert 'The gyro axes agree in white noise within' in said.fine
    assert said.long_enough.startswith('For N')
    assert 'K on' in said.long_enough
    assert any('allan export' in step for step in said.steps)


def test_one_number_beyond_makes_it_bad_and_is_named(small_results: Results) -> None:
    said = verdict_of(small_results, against_itself(small_results, 0.5), 'datasheet')
    assert said.light == 'bad'
    assert said.fine.startswith('No: above May are N of gyro x (0.2')
    assert 'deg' not in said.fine and '°/√h' in said.fine


def test_what_is_not_settled_is_no_blame(small_results: Results) -> None:
    said = verdict_of(calm(small_results), against_itself(small_results, 0.999), 'si')
    assert said.light == 'good'
    assert said.fine.startswith('It is not settled: 0 of 12 numbers')


def test_without_a_reference_it_says_how_to_name_one(small_results: Results) -> None:
    said = verdict_of(calm(small_results), [], 'datasheet')
    assert (said.light, said.word) == ('good', 'Nothing wrong found')
    assert '--sensor' in said.fine
    assert any('--sensor' in step for step in said.steps)


def test_warnings_ask_for_care_and_their_remedies_come_first(small_results: Results) -> None:
    warnings = tuple(
        Finding('x', 'warning', 'It hums.', 'Silence the fan.', (axis,))
        for axis in ('gyro_x', 'gyro_y')
    )
    said = verdict_of(replace(small_results, findings=warnings), [], 'datasheet')
    assert (said.light, said.word) == ('caution', 'With care')
    assert said.steps[0] == 'Silence the fan (gyro x, gyro y).'
    for axes, words in ((tuple(small_results.axes), 'all axes'), (AXES[:4], 'gyro, accel x')):
        named = replace(small_results, findings=(replace(warnings[0], axes=axes),))
        assert verdict_of(named, [], 'si').steps[0] == f'Silence the fan ({words}).'


def test_an_error_or_nothing_measured_is_bad(small_results: Results) -> None:
    error = Finding('x', 'error', 'never still', 'let it rest')
    assert verdict_of(replace(small_results, findings=(error,)), [], 'si').light == 'bad'
    nothing = AxisFit({t: Coefficient(None, status='not_observable') for t in 'QNBKR'})
    axes = {name: replace(a, fit=nothing) for name, a in small_results.axes.items()}
    said = verdict_of(replace(small_results, axes=axes, findings=()), [], 'si')
    assert (said.light, said.word) == ('bad', 'Not measured')
    assert said.fine.startswith('Nothing could be measured')
    assert not any('export' in step for step in said.steps)


def test_an_odd_axis_is_pointed_out(small_results: Results) -> None:
    axis = small_results.axes['gyro_y']
    loud = {**axis.fit.noise, 'N': Coefficient(1e-3, (0.9e-3, 1.1e-3))}
    axes = {**small_results.axes, 'gyro_y': replace(axis, fit=replace(axis.fit, noise=loud))}
    said = verdict_of(replace(small_results, axes=axes), [], 'si')
    assert 'Gyro y has 14' in said.fine


def test_a_method_without_intervals_says_that_it_cannot_tell(small_results: Results) -> None:
    axes = {
        name: replace(
            a, fit=replace(a.fit, noise={t: Coefficient(c.value) for t, c in a.fit.noise.items()})
        )
        for name, a in small_results.axes.items()
    }
    said = verdict_of(replace(small_results, axes=axes, method='paper'), [], 'si')
    assert said.long_enough == 'Method paper gives no intervals, so it cannot tell; gls can.'
