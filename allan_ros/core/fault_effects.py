# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `Faults` do to the samples and stamps of a simulated IMU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .faults import Faults

Floats = NDArray[np.float64]
Spans = tuple[tuple[float, float], ...]

BUMP_TAIL = 40.0
"""A knock is followed for that many decay times: it is then below rounding (e^-40)."""

MOTION_FREQUENCIES = (0.31, 0.73, 1.13)
"""Hz: a motion is a sum of these, with random phases, so that it does not repeat soon."""

BURST_SPACING = 0.002
"""Seconds between the stamps of samples a host reads in one go (an MPU6050 at 100 Hz)."""

BURST_SHORTEST = 0.02
"""The shortest silence between bursts, as a share of the longest."""


def disturb_samples(
    samples: Floats, tau0: float, faults: Faults, sensor: str, seed: np.random.SeedSequence
) -> None:
    """Add to the samples of one sensor, in place, what its faults add, in the order it happens.

    What moves the sensor or its bias comes first, then what its own electronics do to it.

    Parameters
    ----------
    samples : (n, 3) float64 array
        Changed in place.
    tau0 : float
        Sample period in s.
    faults : Faults
        What to do.
    sensor : 'gyro' or 'accel'
        Which amplitudes to take.
    seed : numpy.random.SeedSequence
        The same for both sensors, so that a knock hits both at the same time.
    """
    n, axes = samples.shape
    times: Floats = np.arange(n, dtype=np.float64) * tau0
    # One stream a fault: whether one is asked for does not change the others.
    fault_rngs = {
        name: np.random.default_rng([*seed.generate_state(4).tolist(), i])
        for i, name in enumerate(('gauss_markov', 'vibration', 'bumps', 'motion'))
    }
    own = 0 if sensor == 'gyro' else 1

    def amplitude(fault: str) -> float:
        return float(getattr(faults, f'{fault}_{sensor}'))

    if amplitude('warmup') != 0.0:
        samples += (amplitude('warmup') * np.exp(-times / faults.warmup_time))[:, None]
    if amplitude('gauss_markov') > 0.0:
        white = fault_rngs['gauss_markov'].standard_normal((2, n, axes))[own]
        correlation = np.exp(-tau0 / faults.gauss_markov_time)
        white[1:] *= np.sqrt(1.0 - correlation**2)
        samples += amplitude('gauss_markov') * _recursion(correlation, white)
    if amplitude('vibration') > 0.0:
        phases = fault_rngs['vibration'].uniform(0.0, 2.0 * np.pi, (2, axes))[own]
        angle = 2.0 * np.pi * faults.vibration_frequency * times[:, None]
        samples += amplitude('vibration') * np.sin(angle + phases)
    if faults.bumps:
        _add_bumps(samples, tau0, faults, amplitude('bump'), fault_rngs['bumps'])
    if faults.motion:
        phases = fault_rngs['motion'].uniform(0.0, 2.0 * np.pi, (2, len(MOTION_FREQUENCIES), axes))
        moving = in_spans(times, faults.motion)
        for frequency, phase in zip(MOTION_FREQUENCIES, phases[own]):
            angle = 2.0 * np.pi * frequency * times[moving, None]
            share = amplitude('motion') / len(MOTION_FREQUENCIES)
            samples[moving] += share * np.sin(angle + phase)
    if faults.low_pass > 0.0:
        pole = np.exp(-2.0 * np.pi * faults.low_pass * tau0)
        start = samples[0].copy()
        samples -= start
        samples[:] = _recursion(pole, (1.0 - pole) * samples)
        samples += start
    if sensor == 'accel' and faults.accel_rate > 0.0:
        samples[:] = samples[_held_index(n, tau0, faults.accel_rate)]
    if amplitude('lsb') > 0.0:
        np.round(samples / amplitude('lsb'), out=samples)
        samples *= amplitude('lsb')


def _recursion(pole: float, inputs: Floats) -> Floats:
    """Return y_k = pole y_(k-1) + x_k down the first axis, y_0 = x_0."""
    from scipy.signal import lfilter  # slow to import: only those who ask for it pay

    return np.asarray(lfilter([1.0], [1.0, -pole], inputs, axis=0))


def _add_bumps(
    samples: Floats, tau0: float, faults: Faults, amplitude: float, rng: np.random.Generator
) -> None:
    """Add decaying oscillations at random times, in random directions, in place."""
    n, axes = samples.shape
    length = int(np.ceil(BUMP_TAIL * faults.bump_decay / tau0))
    t = np.arange(length) * tau0
    ringing = np.exp(-t / faults.bump_decay) * np.cos(2.0 * np.pi * faults.bump_frequency * t)
    for first in rng.integers(0, n, faults.bumps):
        direction = rng.standard_normal((1, axes))
        direction /= np.linalg.norm(direction)
        rows = samples[first : first + length]
        rows += amplitude * ringing[: len(rows), None] * direction


def _held_index(n: int, tau0: float, rate: float) -> NDArray[np.int64]:
    """Return for each sample the one it repeats: the first at or after its reading's time."""
    # A tick of the slower clock that falls on a sample must not be missed by rounding.
    ticks = np.floor(np.arange(n) * tau0 * rate + 1e-9)
    held = np.minimum(np.ceil(ticks / (tau0 * rate) - 1e-9), np.arange(n))
    return np.asarray(held, np.int64)


def in_spans(times: Floats, spans: Spans) -> NDArray[np.bool_]:
    """Return which of the times, in s, lie in one of the spans (start, length)."""
    inside = np.zeros(len(times), bool)
    for start, length in spans:
        inside |= (times >= start) & (times < start + length)
    return inside


def lost_samples(
    n: int, tau0: float, faults: Faults, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return which samples never arrive: those in gaps, and the drops; never the first."""
    lost = in_spans(np.arange(n, dtype=np.float64) * tau0, faults.gaps)
    if faults.drop > 0.0:
        lost |= rng.random(n) < faults.drop
    lost[0] = False
    return lost


def disturb_stamps(
    stamps_ns: NDArray[np.int64], faults: Faults, seed: np.random.SeedSequence
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the header stamps and the record times of samples taken at the given times.

    Jitter moves both; a bursty host stamps what it finds when it reads, in quick succession.

    Parameters
    ----------
    stamps_ns : (n,) int64 array
        True times.
    faults : Faults
        Its jitter and burst.
    seed : numpy.random.SeedSequence
        Of the jitter and the bursts.

    Returns
    -------
    header_ns, record_ns : (n,) int64 arrays
        In nanoseconds.
    """
    jitter_seed, burst_seed = seed.spawn(2)
    out = stamps_ns
    if faults.jitter > 0.0:
        noise = np.random.default_rng(jitter_seed).standard_normal(len(out)) * faults.jitter
        out = out + np.round(noise * 1e9).astype(np.int64)
    if faults.burst > 0.0:
        rng = np.random.default_rng(burst_seed)
        elapsed = (out - out[0]) * 1e-9
        shortest = BURST_SHORTEST * faults.burst
        reads = np.cumsum(rng.uniform(shortest, faults.burst, int(elapsed[-1] / shortest) + 2))
        read = reads[np.searchsorted(reads, elapsed)]
        # A sample is stamped when it is read, but not before the one ahead of it is done with.
        queue = BURST_SPACING * np.arange(len(out))
        out = out[0] + np.round((queue + np.maximum.accumulate(read - queue)) * 1e9).astype(
            np.int64
        )
    return out, out.copy()
