# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from allan_ros.core.fit.gls import fit_gls

from allan_ros.core.allan.running import RunningSums
from allan_ros.core.findings import duration_text, finding
from allan_ros.core.fit.findings import line_finding, merge_equal
from allan_ros.core.fit.model import Sinusoid


@pytest.mark.parametrize(
    ('seconds', 'words'),
    [
        (0.5, '0.5 s'),
        (119.0, '120 s'),
        (1234.0, '21 min'),
        (7200.0, '2 h'),
        (100000.0, '28 h'),
        (864000.0, '10 days'),
    ],
)
def test_durations_are_formatted_for_people(seconds, words):
    assert duration_text(seconds) == words


def test_equal_findings_are_joined():
    one = finding('low_pass', ('gyro_x',))
    other = finding('low_pass', ('gyro_z',))
    third = finding('misfit', ('gyro_y',), deviation=0.1, tau=3.0)
    both, last = merge_equal([one, third, other])
    assert both.axes == ('gyro_x', 'gyro_z')
    assert last == third


@pytest.mark.parametrize(
    ('hertz', 'id', 'words'),
    [
        (0.57, 'vibration', 'Vibration at 0.57 Hz'),
        (0.024, 'slow_disturbance', 'Periodic disturbance with a period of 42 s'),
        (1 / 1200, 'slow_cycle', 'A cycle with a period of 20 min'),
    ],
)
def test_the_finding_of_a_sinusoid_depends_on_its_frequency(hertz, id, words):
    line = Sinusoid(0.01, (0.009, 0.011), hertz, (hertz, hertz))
    found = line_finding(('accel_x',), [line], 0.01)
    assert found.id == id and found.message.startswith(words)


@pytest.mark.parametrize(
    ('lines', 'id', 'words'),
    [
        ([(0.3, 31.29), (0.4, 31.31)], 'vibration', 'Vibration at 31.3 Hz'),
        ([(0.4, 30.0), (0.02, 33.0)], 'vibration', 'Vibration at 30 Hz'),
        ([(0.4, 30.0), (0.2, 33.0)], 'broad_hump', 'Resonance between 30 and 33 Hz'),
        ([(0.4, 49.99)], 'vibration', 'Vibration at 50 Hz, amplitude'),
    ],
)
def test_sinusoids_that_describe_one_vibration_are_reported_as_one(lines, id, words):
    found = line_finding(('accel_x',), [Sinusoid(a, (a, a), f, (f, f)) for a, f in lines], 0.01)
    assert found.id == id and found.message.startswith(words)


def sums_of(*segments):
    engine = RunningSums(axes=('gyro_x',))
    for n, y in enumerate(segments):
        start = n * 10**12
        engine.update(np.reshape(y, (-1, 1)), start, start + (len(y) - 1) * 10**7)
        engine.end_segment()
    return engine.sums


@pytest.mark.parametrize(
    ('samples', 'id'),
    [
        (np.full(5000, 9.8), 'no_noise'),
        (np.random.default_rng(0).normal(size=8), 'record_too_short'),
    ],
)
def test_an_axis_without_numbers_states_the_reason(samples, id):
    (found,) = fit_gls(sums_of(samples)).findings
    assert found.id == id
    assert found.axes == ('gyro_x',)


def test_segments_with_different_ramps_are_reported():
    rng = np.random.default_rng(1)
    spans = [rng.normal(size=50000) + s * 1e-4 * np.arange(50000) for s in (1.0, -1.0)]
    (found,) = (f for f in fit_gls(sums_of(*spans)).findings if f.id == 'ramps_differ')
    rates = [found.values[name].value for name in ('longest', 'other')]
    assert rates == pytest.approx([1e-2, -1e-2], rel=0.02)  # 1e-4 rad/s per sample at 100 Hz
