# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Spectrum of white noise and of a random walk, for any chunking of the samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from allan_ros.core.allan.spectrum import (
    BLOCK,
    RunningSpectrum,
    Spectrum,
    SpectrumSums,
    spectrum_of,
)
from allan_ros.core.errors import AllanError
from allan_ros.core.imu import ImuBatch
from allan_ros.core.settings import SegmenterSettings
from allan_ros.core.stream.pipeline import ImuStream

TAU0 = 0.01
AXIS = ('gyro_x',)


def sums_of(rows: np.ndarray, chunk: int, axes: tuple[str, ...] = AXIS) -> SpectrumSums:
    running = RunningSpectrum(axes)
    for at in range(0, rows.shape[1], chunk):
        running.update(rows[:, at : at + chunk])
    return running.sums


def density(rows: np.ndarray) -> Spectrum:
    found = spectrum_of(sums_of(rows, 30_000), TAU0)
    assert found is not None
    return found


def test_white_noise_is_flat_at_twice_its_two_sided_density() -> None:
    # N = sigma sqrt(tau0), so that the one-sided density is 2 sigma^2 tau0 at every frequency.
    white = np.random.default_rng(1).normal(size=(1, 400_000)) * 3.0
    found = density(white)
    expected = 2.0 * 9.0 * TAU0
    assert found.frequency[0] < 2e-3 and found.frequency[-1] > 45.0
    # 68.3 % limits: of some 170 points, 55 % or fewer has a probability below 1e-3
    inside = (found.low[:, 0] < expected) & (expected < found.high[:, 0])
    assert inside.mean() > 0.55
    assert np.median(found.psd) == pytest.approx(expected, rel=0.02)


def test_a_random_walk_falls_as_the_square_of_frequency_across_all_levels() -> None:
    k = 2.0
    steps = np.random.default_rng(2).normal(size=(1, 400_000)) * k * np.sqrt(TAU0)
    found = density(np.cumsum(steps, axis=1))
    f = found.frequency
    # one-sided 2 K^2 / (2 pi f)^2, IEEE Std 952-1997 C.1.4, for a walk of steps a sample apart
    expected = 2.0 * k**2 * TAU0**2 / (4.0 * np.sin(np.pi * f * TAU0) ** 2)
    middle = (f > 0.01) & (f < 10.0)
    assert np.median(found.psd[middle, 0] / expected[middle]) == pytest.approx(1.0, abs=0.04)
    many = (f > 0.3) & (f < 10.0)  # of 20 blocks and more: 0.5 is over three standard deviations
    assert np.all(np.abs(np.log(found.psd[many, 0] / expected[many])) < 0.5)


def test_the_first_level_agrees_with_scipy() -> None:
    rows = np.random.default_rng(3).normal(size=(2, 10_000))
    sums = sums_of(rows, 777, ('gyro_x', 'gyro_y'))
    _, psd = signal.welch(rows, 1.0, 'hann', BLOCK, BLOCK // 2, detrend='constant')
    assert np.allclose(sums.power[0] / sums.blocks[0], psd.T, rtol=1e-9)


@pytest.mark.parametrize('chunk', [1, 333, 1024, 9_999])
def test_any_chunking_gives_the_same_spectrum(chunk: int) -> None:
    rows = np.random.default_rng(4).normal(size=(1, 9_999))
    one, other = sums_of(rows, 5_000), sums_of(rows, chunk)
    assert np.array_equal(one.blocks, other.blocks)
    assert np.allclose(one.power, other.power, rtol=1e-12)


def test_no_block_crosses_the_border_of_a_segment_and_sums_add() -> None:
    rows = np.random.default_rng(5).normal(size=(1, 2 * 5_000))
    rows[:, 5_000:] += 1e6
    running = RunningSpectrum(AXIS)
    running.update(rows[:, :5_000])
    running.end_segment()
    running.update(rows[:, 5_000:])
    added = sums_of(rows[:, :5_000], 999) + sums_of(rows[:, 5_000:], 999)
    assert np.array_equal(running.sums.blocks, added.blocks)
    assert np.allclose(running.sums.power, added.power, rtol=1e-9)
    with pytest.raises(AllanError, match='cannot be added'):
        added + sums_of(rows, 999, ('gyro_y',))


def test_a_record_shorter_than_a_block_has_none() -> None:
    assert spectrum_of(sums_of(np.ones((1, BLOCK - 1)), 100), TAU0) is None


def test_the_pipeline_keeps_the_spectrum_of_static_data_on_request() -> None:
    n = 60_000
    samples = np.random.default_rng(6).normal(size=(n, 6)) * 1e-3
    samples[:, 3:] += 9.8
    samples[20_000:24_000, :3] += 1.0  # in motion
    stamps = np.arange(n, dtype=np.int64) * 10_000_000
    accumulator = ImuStream(SegmenterSettings(), with_spectra=True)
    accumulator.update(ImuBatch(stamps, samples))
    accumulator.end()
    known = accumulator.result()
    found = spectrum_of(known.spectra[0], TAU0)
    assert found is not None and found.axes == known.sums[0].axes
    assert np.median(found.psd[:, 0]) == pytest.approx(2.0 * 1e-6 * TAU0, rel=0.1)
    assert found.psd[:, 0].max() < 1e-7
    plain = ImuStream()
    plain.update(ImuBatch(stamps, samples))
    assert plain.result().spectra == ()
