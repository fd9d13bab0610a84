# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The contract of every registered noise process: each place that must handle it does."""

from __future__ import annotations

import ast
import json
import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

import allan_ros
import allan_ros as ar
from allan_ros.core.findings import CATALOG
from allan_ros.core.noise.derived import avar, gauss_markov_approximation, growth_variance, simulate
from allan_ros.core.noise.process import FREQUENCY, Process, Search
from allan_ros.core.noise.processes.white import White
from allan_ros.core.noise.registry import PROCESSES, RANDOM_TERMS, REPLACEMENTS, SEARCHED
from allan_ros.results.documents import results_from_document, results_to_document

N = 4096
"""Samples of a simulated record."""

SEARCH = Search(N, 16, 0.01, np.arange(8, 32) / 64.0, np.full(24, 64.0), 8.0)


def example(one: type[Process]) -> Process:
    """Return a process with a shape in the middle of its grid."""
    candidates = list(one.grid(SEARCH)) or [one()]
    return candidates[len(candidates) // 2]


EVERY = pytest.mark.parametrize(
    'process', [example(one) for one in PROCESSES.values()], ids=[*PROCESSES]
)


def tapers(n: int) -> NDArray[np.complex128]:
    """Return two tapers without a constant, (2, n)."""
    t = (np.arange(n) + 0.5) / n
    a = np.sin(np.pi * t) ** 2 * np.exp(-2j * np.pi * np.array([[3.0], [9.0]]) * t)
    return np.asarray(a - a.mean(axis=1, keepdims=True))


def contrast_variance(process: Process, weights: NDArray[np.number]) -> NDArray[np.float64]:
    """Return the variance of sum w_i y_i for consecutive samples y_i.

    The weights w, (..., n), have the sum 0. With complex weights, the result is the mean square of
    the magnitude, for example the expected power of a tapered block.
    """
    n = np.shape(weights)[-1]
    factors = np.fft.ifft(np.abs(np.fft.fft(weights, 2 * n)) ** 2).real[..., :n]  # of gamma(1, j)
    factors[..., 1:] *= 2.0
    return np.asarray(factors @ process.gamma(1, np.arange(n)))


@EVERY
def test_gamma_predicts_all_statistics_of_simulated_samples(process: Process) -> None:
    """False alarms: 5 standard errors of the mean of 300 records; 13 numbers, below 1e-4."""
    rng = np.random.default_rng(3)
    m, horizon, window, n = np.array([1, 2, 7, 40, 200]), 60, 25, 64
    records = []
    for _ in range(300):
        y = simulate([(1.0, process)], N, rng)
        assert y.shape == (N,)
        theta = np.concatenate([[0.0], np.cumsum(y)])
        second = (theta[2 * k :] - 2.0 * theta[k:-k] + theta[: -2 * k] for k in m.tolist())
        found = [np.mean(d**2) / (2.0 * k**2) for d, k in zip(second, m)]
        start = np.arange(window, N - horizon, horizon + window)
        before, after = theta[start] - theta[start - window], theta[start + horizon] - theta[start]
        found.append(np.mean((after - horizon / window * before) ** 2))
        blocks = y.reshape(-1, n)
        found += np.mean(np.abs(tapers(n) @ blocks.T) ** 2, axis=1).tolist()
        means = y.reshape(-1, 16).mean(axis=1)
        found += [np.mean((means[j:] - means[:-j]) ** 2) / 2.0 for j in (1, 3, 10)]
        records.append(found)
    gamma = process.gamma(16, np.array([0, 1, 3, 10]))
    expected = np.concatenate(
        [
            avar(process, m),
            [growth_variance(process, horizon, window)],
            contrast_variance(process, tapers(n)),
            gamma[0] - gamma[1:],
        ]
    )
    mean, error = np.mean(records, axis=0), np.std(records, axis=0) / math.sqrt(len(records))
    assert np.all(np.abs(mean - expected) < 5.0 * error + 1e-6 * expected)


def in_units(process: Process) -> list[Process]:
    """Return the process with shapes much shorter and much longer than a sample period."""
    scaled = [process.in_unit(unit) for unit in (1e-4, 1.0, 1e4)]
    return [
        each
        for each in scaled
        if not any(p.unit == 'Hz' and x > 0.49 for p, x in zip(each.parameters, each.shape))
    ]


@EVERY
@pytest.mark.parametrize('m', [2, 5, 16])
@pytest.mark.parametrize('lag', [0, 1, 3])
def test_gamma_of_means_is_the_mean_over_all_pairs_of_samples(
    process: Process, m: int, lag: int
) -> None:
    """So the constant of gamma is the same for all averaging times and lags."""
    a = np.arange(m)
    for scaled in in_units(process):
        pairs = scaled.gamma(1, np.abs(np.subtract.outer(a, a + lag * m)))
        scale = np.ptp(scaled.gamma(1, np.arange(4 * m)))
        assert float(scaled.gamma(m, lag)) == pytest.approx(np.mean(pairs), abs=1e-5 * scale)


@EVERY
@pytest.mark.parametrize('m', [1e5, 1e7])
def test_no_digits_are_lost_at_long_times(process: Process, m: float) -> None:
    """Allan variance and growth are positive for shapes far above and below the averaging time."""
    for scaled in in_units(process):
        least = -1e-9 * np.abs(scaled.gamma(m, 0))
        assert avar(scaled, m) >= least and np.isfinite(avar(scaled, m))
        assert growth_variance(scaled, m, m / 100.0) >= least * m**2


@EVERY
def test_the_states_have_the_variances_of_gamma_or_there_is_a_reason(process: Process) -> None:
    states = process.states()
    assert (states is None) == bool(process.no_states)
    if states is None:
        return
    n = len(states.output)
    block = np.block([[-states.dynamics, states.noise], [np.zeros((n, n)), states.dynamics.T]])
    power = expm(block)
    phi = power[n:, n:].T
    noise = phi @ power[:n, n:]
    for weights in (np.repeat([1.0, -1.0], 20) / 20.0, np.cos(np.pi * (np.arange(30) + 0.5) / 15)):
        adjoint, variance = np.zeros(n), 0.0
        for k in reversed(range(len(weights))):
            adjoint = weights[k] * states.output + phi.T @ adjoint
            variance += adjoint @ (noise if k else states.initial) @ adjoint
        assert variance == pytest.approx(float(contrast_variance(process, weights)), rel=1e-6)


@EVERY
def test_a_sum_of_gauss_markov_processes_replaces_missing_states(process: Process) -> None:
    """Those that have no exact states, for the reason that they have too long a memory.

    No sum of them resembles white noise, its differences, or a sinusoid.
    """
    if not process.no_states or not process.is_drift or process.is_line or process.is_white:
        return
    m = np.round(np.geomspace(8.0, 300.0, 20))
    approximation = gauss_markov_approximation(process, np.geomspace(4.0, 12000.0, 9), m)
    total = sum((v * avar(one, m) for v, one in approximation), np.zeros(len(m)))
    np.testing.assert_allclose(total, avar(process, m), rtol=0.06)


@EVERY
def test_the_description_is_complete(process: Process) -> None:
    assert [p.name for p in process.parameters] == [f.name for f in fields(process)]
    assert hash(process) == hash(process.with_shape({})) and process.title and process.meaning
    assert process.meaning.endswith('.') and len(process.label) < 40
    assert process.in_unit(0.01).in_unit(100.0).shape == pytest.approx(process.shape)
    value = process.coefficient_of(process.variance_of(3.0, 0.01), 0.01)
    assert value == pytest.approx(3.0)
    assert not process.finding or process.finding in CATALOG
    assert type(process).__module__.endswith(f'processes.{process.name}')


def test_every_process_with_a_shape_is_found_by_the_fit() -> None:
    shaped = {one for one in PROCESSES.values() if one.parameters}
    assert {*SEARCHED, *REPLACEMENTS.values()} == shaped
    for one in shaped:
        candidates = list(one.grid(SEARCH))
        has_computed_shape = one in REPLACEMENTS.values() and not candidates
        assert len(set(candidates)) == len(candidates) > 2 or has_computed_shape
        assert one.threshold(100) > 0.0 and one.finding
        for each in candidates:
            for parameter, value in zip(each.parameters, each.shape):
                low, high = each.bounds(parameter, SEARCH)
                assert 0.0 < low <= high and value < 2.0 * high
    assert [one.letter for one in RANDOM_TERMS] == ['Q', 'N', 'B', 'K']
    findings = [one.finding for one in shaped]
    assert len(set(findings)) == len(findings), 'each process has a finding of its own'


@pytest.mark.parametrize('text', ['label', 'meaning'])
def test_every_process_states_its_own_texts(text: str) -> None:
    """A process that is a subclass of another one must not be shown under the name of that one."""
    inherited = [one.name for one in PROCESSES.values() if text not in vars(one)]
    assert not inherited, f'{text}: inherited'


@pytest.mark.parametrize('one', SEARCHED, ids=lambda one: one.name)
def test_a_fast_process_may_be_a_low_pass_filter_and_a_slow_one_has_a_slowest_time(
    one: type[Process],
) -> None:
    times = [4.0, 1000.0]
    fast, slow = (
        one(*(time if p.unit == 's' else 1.0 / time for p in one.parameters)) for time in times
    )
    assert not slow.bends_spectrum and (fast.bends_spectrum or FREQUENCY in one.parameters)
    for process in (fast, slow):
        # the time scales with the unit of time, and is known for a drift with a shape
        assert process.in_unit(0.1).slowest_time == pytest.approx(10.0 * process.slowest_time)
        assert math.isfinite(process.slowest_time)
        assert process.slowest_time > 0.0 or not process.is_drift


SHAPE = {'s': 100.0, 'Hz': 0.05}
"""Numbers of the shape of a process in the tests of the fit, in samples and cycles per sample."""


@pytest.mark.parametrize('one', SEARCHED, ids=lambda one: one.name)
def test_the_fit_finds_the_process_and_all_outputs_have_it(one: type[Process]) -> None:
    """It has the variance of the white noise, so that it is found in every record."""
    process = one(*(SHAPE[parameter.unit] for parameter in one.parameters))
    y = simulate([(1.0, White()), (1.0, process)], 40_000, np.random.default_rng(2))
    results = ar.analyze(1e-4 * y, rate=100.0, axes='gyro_z', motion_gate=False)
    model = results['gyro_z'].fit.model
    assert [part.process.name for part in model.shaped.parts] == [one.name]
    (part,) = model[one.name]
    assert part.process.in_unit(0.01).shape == pytest.approx(process.shape, rel=0.5)
    assert part.process.title in results['gyro_z'].part_adev([1, 10, 100])
    stored = results_from_document(json.loads(json.dumps(results_to_document(results))))
    assert stored['gyro_z'].fit.model[one.name] == (part,)
    assert one.name in results.export('state_space') or process.states() is None
    assert one.finding in {finding.id for finding in results.findings}


NAMED = {
    'export/filter_noise.py',  # formats with one Gauss-Markov bias
    'export/own_file.py',
}
"""Modules outside of `core/noise` that name a process with a shape."""


def test_only_export_formats_name_a_process() -> None:
    """All other modules iterate over the registry, so that no process is forgotten in one."""
    shaped = [one for one in PROCESSES.values() if one.parameters]
    names = {one.name for one in shaped} | {one.__name__ for one in shaped}
    package, found = Path(allan_ros.__file__).parent, set()
    for path in package.rglob('*.py'):
        module = path.relative_to(package).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            said = {getattr(node, name, None) for name in ('value', 'id', 'attr')}
            if not module.startswith('core/noise/') and any(
                isinstance(each, str) and each in names for each in said
            ):
                found.add(module)
    assert found <= NAMED
