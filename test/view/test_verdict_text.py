# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict: its level follows from findings and comparisons, and its text names the causes."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from support.exports import scaled

from allan_ros.core.estimate import Estimate
from allan_ros.core.findings import Finding, finding
from allan_ros.core.fit.result import AxisFit
from allan_ros.core.imu import AXES
from allan_ros.results.comparison import compare_runs, significant_of
from allan_ros.results.datasheets import Datasheet, Limit
from allan_ros.results.documents import results_to_document
from allan_ros.results.results import Results
from allan_ros.view.verdict_text import verdict_of


def against_itself(results: Results, factor: float) -> Results:
    """Return results that are compared with ``factor`` times the upper ends of their N and B."""
    limits = {
        axis: {t: Limit(factor * (terms[t].ci95 or (0.0, terms[t].upper95))[1], '') for t in 'NB'}
        for axis, terms in results.noise.items()
    }
    sheet = Datasheet('May', '', {}, limits)
    return replace(results, datasheet=sheet, margin=0.0)


def calm(results: Results) -> Results:
    return replace(results, findings=tuple(f for f in results.findings if f.severity == 'info'))


@pytest.mark.parametrize(
    ('factor', 'level', 'said'),
    [
        (1.01, 'healthy', 'All 12 numbers are within May.'),
        (0.999, 'unknown', '.*undecided: N of all axes.*'),
        (0.5, 'failed', r'Above May: N of gyro \(at least 2 times 0.12.* deg/sqrt\(h\).*'),
    ],
)
def test_the_level_follows_from_the_limits(
    small_results: Results, factor: float, level: str, said: str
) -> None:
    verdict = verdict_of(against_itself(calm(small_results), factor))
    assert verdict.level == level
    assert re.fullmatch(said, verdict.summary)
    assert any('allan export' in step for step in verdict.next_steps) == (level == 'healthy')


def test_n_within_its_limit_is_enough(small_results: Results) -> None:
    known = against_itself(calm(small_results), 1.01)
    assert known.datasheet is not None
    limits = {
        axis: {**terms, 'B': replace(terms['B'], value=terms['B'].value / 1.02)}
        for axis, terms in known.datasheet.limits.items()
    }
    verdict = verdict_of(replace(known, datasheet=replace(known.datasheet, limits=limits)))
    assert verdict.level == 'healthy'
    assert verdict.summary == (
        '6 of 12 numbers are within May, none is above; undecided: B of all axes.'
    )


def test_without_a_reference_the_precision_is_stated(small_results: Results) -> None:
    verdict = verdict_of(calm(small_results))
    assert verdict.level == 'measured'
    assert re.fullmatch(r'N to [\d.]+ %, B and K need \d h\.', verdict.summary)
    assert any('--sensor' in step for step in verdict.next_steps)


def test_the_remedies_of_warnings_come_first(small_results: Results) -> None:
    warnings = tuple(
        finding('vibration', (axis,), frequency=f, amplitude=1e-4)
        for f, axis in ((50, 'gyro_x'), (51, 'gyro_y'))
    )
    within = against_itself(small_results, 1.01)
    verdict = verdict_of(replace(within, findings=warnings))
    assert verdict.level == 'attention'
    assert verdict.reasons[0].startswith('gyro x, gyro y: Vibration at 50 to 51 Hz')
    assert verdict.next_steps[0] == 'Isolate or move the sensor (gyro x, gyro y).'
    for axes, words in ((tuple(small_results.axes), 'all axes'), (AXES[:4], 'gyro, accel x')):
        named = replace(small_results, findings=(replace(warnings[0], axes=axes),))
        assert verdict_of(named).next_steps[0] == f'Isolate or move the sensor ({words}).'


def test_an_error_gives_no_verdict_and_a_dead_sensor_fails(small_results: Results) -> None:
    within = against_itself(small_results, 1.01)
    error = Finding('never_still', 'error', stated=('Never still.', 'Let it rest.'))
    dead = Finding('no_noise', 'error', ('gyro_x',), stated=('No noise.', 'Check it.'))
    assert verdict_of(replace(within, findings=(error,))).level == 'unknown'
    verdict = verdict_of(replace(within, findings=(dead,)))
    assert (verdict.level, verdict.summary) == ('failed', 'gyro x: No noise.')
    nothing = AxisFit({t: Estimate(None, status='not_observable') for t in 'QNBKR'})
    axes = {name: replace(a, fit=nothing) for name, a in small_results.axes.items()}
    verdict = verdict_of(replace(small_results, axes=axes, findings=()))
    assert verdict.level == 'unknown'
    assert verdict.summary.startswith('Nothing could be measured')


def test_too_short_a_record_is_not_judged(small_results: Results) -> None:
    short = replace(calm(small_results), duration_s=5.0)
    verdict = verdict_of(against_itself(short, 1.01))
    assert (verdict.level, verdict.summary) == ('unknown', 'Too short to judge: 5 s at rest.')


def test_no_file_calls_a_record_that_is_too_short_beyond_a_limit(small_results: Results) -> None:
    sheet = Datasheet('X', '', {}, {'gyro_x': {'N': Limit(1e-9, '1')}})
    short = replace(small_results, duration_s=5.0)
    assert small_results.against_datasheet(sheet, 0.0).comparisons[0].verdict == 'exceeds'
    judged = [
        short.against_datasheet(sheet, 0.0),
        replace(small_results.against_datasheet(sheet, 0.0), duration_s=5.0),
        replace(short, baselines={'May': scaled(small_results, 0.5)}),
    ]
    for results in judged:
        assert {c.verdict for c in results.comparisons} == {'undecided'}
    document = results_to_document(judged[0])
    assert document['datasheet']['verdict'] == 'undecided'
    assert 'exceeds_limit' not in {finding['id'] for finding in document['findings']}


def test_a_method_without_intervals_is_named(small_results: Results) -> None:
    plain = {t: Estimate(1e-5) for t in 'QNBKR'}
    axes = {n: replace(a, fit=replace(a.fit, noise=plain)) for n, a in small_results.axes.items()}
    verdict = verdict_of(replace(small_results, axes=axes, method='paper'))
    assert verdict.summary == 'Method paper gives no intervals.'


def test_comparisons_are_with_every_baseline(small_results: Results) -> None:
    runs = {'May': small_results, 'June': small_results}
    comparisons = replace(small_results, baselines=runs, margin=0.0).comparisons
    assert {c.reference for c in comparisons} == {'May', 'June'}
    assert not any(c.verdict == 'exceeds' for c in comparisons)


def test_an_earlier_run_and_compare_agree(small_results: Results) -> None:
    """What `compare` calls higher by more than the margin exceeds the earlier run."""
    louder = scaled(small_results, 1.5)
    comparisons = louder.compared(baseline=small_results, margin=0.2).comparisons
    [changes] = compare_runs({'a': small_results, 'b': louder}).differences.values()
    beyond = [(c.axis, c.quantity) for c in comparisons if c.verdict == 'exceeds']
    assert beyond == [(d.axis, d.quantity) for d in significant_of(changes)] == [('gyro_z', 'N')]
    assert louder.check(baseline=small_results).summary.startswith(
        'Above the earlier run: N of gyro z (at least 1.5 times '
    )


def test_a_curve_that_rose_fails_although_no_coefficient_changed(small_results: Results) -> None:
    """A vibration that is fitted as a separate term changes only the curve."""
    axis = small_results.axes['accel_x']
    rise = np.where(axis.curve.tau < 1.0, 1.0, 2.0)
    columns = {name: rise * getattr(axis.curve, name) for name in ('adev', 'ci_low', 'ci_high')}
    risen = replace(axis, curve=replace(axis.curve, **columns))
    results = replace(small_results, axes={**small_results.axes, 'accel_x': risen})
    verdict = results.check(baseline=small_results)
    assert verdict.level == 'failed'
    assert re.match(
        r'Above the earlier run: deviation at .* s of accel x \(at least 1\.', verdict.summary
    )
