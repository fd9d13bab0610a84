# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that tests of several packages share."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from support.chromium import Chromium, find_chromium

from allan_ros.api.classes import Results
from allan_ros.core.allan.sums import AllanSums
from allan_ros.core.fit.result import NoiseModel
from allan_ros.core.fit.stationary import fit_stationary
from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_imu
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers import SourceInfo
from allan_ros.readers.recording_sums import Provenance
from allan_ros.results.analysis import analyze_sums

# The time an example takes depends on the machine, not on the law that is tested.
settings.register_profile('allan_ros', deadline=None)
settings.load_profile('allan_ros')

# A shell starts background jobs with SIGINT ignored, and child processes inherit this.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parents[1]
"""The checkout."""


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> Any:
    """Let launch_testing collect only the tests in test/launch.

    Where it is installed, it imports each module before pytest does. A module that skips itself,
    or that fails, would then end the collection of all tests.
    """
    if 'launch' in module_path.relative_to(ROOT).parts:
        return None
    return pytest.Module.from_parent(parent, path=module_path)


@pytest.fixture(scope='session')
def repository() -> Path:
    """Return the folder of the checkout."""
    return ROOT


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Return the folder of real recordings, which are not part of the package.

    It is ``$ALLAN_ROS_SHARED/data``, or ``../shared/data`` next to the checkout. Without it the
    test is skipped.
    """
    shared = Path(os.environ.get('ALLAN_ROS_SHARED', ROOT.parent / 'shared'))
    if not (shared / 'data').is_dir():
        pytest.skip('skipped: no shared data')
    return shared / 'data'


_fits: dict[bytes, tuple[AllanSums, NoiseModel]] = {}


def fit_once(
    sums: AllanSums, method: str = 'likelihood', settle: bool = True
) -> tuple[AllanSums, NoiseModel]:
    """Return `fit_stationary` of the arguments; equal arguments are fitted once per process."""
    key = pickle.dumps((sums, method, settle))
    if key not in _fits:
        _fits[key] = fit_stationary(sums, method, settle)
    return _fits[key]


@pytest.fixture(autouse=True, scope='session')
def each_fit_is_computed_once() -> Iterator[None]:
    """Reuse identical fits: most tests analyze one of a few recordings, and fits take most of
    the time.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('allan_ros.results.analysis.fit_stationary', fit_once)
        yield


@pytest.fixture(scope='session')
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    """Return a real browser; without one the test is skipped."""
    found = find_chromium()
    if found is None:
        pytest.skip('skipped: no Chromium')
    chromium = Chromium(found, tmp_path_factory.mktemp('chromium'))
    yield chromium
    chromium.close()


GYRO = Model.of(N=7e-5, B=2.5e-5, K=4e-6)
ACCEL = Model.of(N=2e-4, B=4e-5)


@pytest.fixture(scope='session')
def small_run() -> tuple[AllanSums, Provenance]:
    """Return the sums of 20 simulated minutes at 50 Hz, and their provenance."""
    accumulator = ImuStream(hardware_id='unit 7')
    for batch in simulate_imu(1200.0, 50.0, [GYRO] * 3, [ACCEL] * 3, seed=5, start_ns=10**18):
        accumulator.update(batch)
    accumulator.end()
    known = accumulator.result()
    source = SourceInfo('runs/one.mcap', '/imu/data', 'sensor_msgs/msg/Imu', 'mcap')
    (sums,) = known.sums
    return sums, Provenance(
        (source,), known.segments, known.findings, known.health.counts, {'skip': 0.0, 'topic': ''}
    )


@pytest.fixture(scope='session')
def small_results(small_run: tuple[AllanSums, Provenance]) -> Results:
    """Return the results of `small_run` by the default method."""
    sums, provenance = small_run
    return Results.of(analyze_sums([sums], provenance))
