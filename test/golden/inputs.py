# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the samples in ``inputs.npz`` were simulated: with numpy alone, without the package.

The samples are stored, because a later numpy may draw other random numbers. ``python inputs.py``
writes the file again; the golden results must then be written again, too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PLACE = Path(__file__).with_name('inputs.npz')

GRAVITY = 9.80665


class Simulator:
    """Draws n samples of noise at a rate in Hz."""

    def __init__(self, n: int, rate: float, seed: int) -> None:
        self.n, self.rate = n, rate
        self.random = np.random.default_rng(seed)
        self.t = np.arange(n) / rate

    def white(self, density: float) -> Floats:
        return self.random.normal(scale=density * np.sqrt(self.rate), size=self.n)

    def quantization(self, q: float) -> Floats:
        """Return differences of white noise: q sqrt(12) / sqrt(12) per angle increment."""
        return np.diff(self.random.normal(scale=q * self.rate, size=self.n + 1))

    def walk(self, k: float) -> Floats:
        return np.cumsum(self.random.normal(scale=k / np.sqrt(self.rate), size=self.n))

    def flicker(self, b: float) -> Floats:
        """Return noise with the spectrum b^2 / (2 pi f), one-sided b^2 / (pi f)."""
        f = np.fft.rfftfreq(4 * self.n, 1.0 / self.rate)[1:]
        size = np.sqrt(b**2 / (2.0 * np.pi * f) * self.rate * 4 * self.n)
        draw = self.random.normal(size=(2, len(f))) / np.sqrt(2.0)
        return np.fft.irfft(np.r_[0.0, size * (draw[0] + 1j * draw[1])], 4 * self.n)[: self.n]

    def gauss_markov(self, sigma: float, time: float) -> Floats:
        keep = np.exp(-1.0 / (self.rate * time))
        steps = self.random.normal(scale=sigma * np.sqrt(1.0 - keep**2), size=self.n)
        return recursive(np.r_[self.random.normal(scale=sigma), steps[1:]], keep)

    def sinusoid(self, amplitude: float, frequency: float) -> Floats:
        phase = self.random.uniform(0.0, 2.0 * np.pi)
        return amplitude * np.sin(2.0 * np.pi * frequency * self.t + phase)

    def resonance(self, sigma: float, frequency: float, time: float) -> Floats:
        """Return two Gauss-Markov amplitudes of a sine and a cosine."""
        angle = 2.0 * np.pi * frequency * self.t
        sine, cosine = (self.gauss_markov(sigma, time) for _ in range(2))
        return sine * np.sin(angle) + cosine * np.cos(angle)

    def low_pass(self, values: Floats, corner: float) -> Floats:
        keep = np.exp(-2.0 * np.pi * corner / self.rate)
        return recursive(values * (1.0 - keep), keep)


def recursive(steps: Floats, keep: float) -> Floats:
    """Return y with y[i] = keep y[i - 1] + steps[i]."""
    out = np.empty_like(steps)
    last = 0.0
    for i, step in enumerate(steps.tolist()):
        last = keep * last + step
        out[i] = last
    return out


def processes() -> tuple[Floats, float]:
    """Return the five terms of IEEE Std 952, in different combinations."""
    s = Simulator(18_000, 50.0, 1)
    return np.column_stack([
        s.white(1e-4) + s.quantization(4e-5),
        s.white(1e-4) + s.flicker(2e-4),
        s.white(1e-4) + s.walk(4e-5) + 1.2e-5 * s.t,
        s.white(1e-3) + s.walk(3e-4),
        s.white(1e-3) + s.flicker(1.5e-3),
        s.white(1e-3) + s.quantization(5e-4) + s.flicker(1e-3) + s.walk(1e-4),
    ]), 50.0  # fmt: skip


def correlated() -> tuple[Floats, float]:
    """Return Gauss-Markov noise with correlation times from 3 samples to the recording."""
    s = Simulator(18_000, 50.0, 2)
    return np.column_stack([
        s.white(1e-4) + s.gauss_markov(1.5e-3, 0.06),
        s.white(1e-4) + s.gauss_markov(5e-4, 2.0),
        s.white(1e-4) + s.gauss_markov(5e-4, 0.5) + s.gauss_markov(3e-4, 20.0),
        s.white(1e-3) + s.gauss_markov(2e-3, 200.0),
        s.white(1e-3) + s.gauss_markov(3e-3, 8.0) + s.flicker(5e-4),
        s.white(1e-3),
    ]), 50.0  # fmt: skip


def vibration() -> tuple[Floats, float]:
    """Return sinusoids, harmonics, close and slow sinusoids, and resonances."""
    s = Simulator(15_000, 50.0, 3)
    return np.column_stack([
        s.white(1e-4) + s.sinusoid(4e-4, 7.3),
        s.white(1e-4) + sum(s.sinusoid(5e-4 / k, 4.1 * k) for k in (1, 2, 3)),
        s.white(1e-4) + s.sinusoid(4e-4, 9.0) + s.sinusoid(3e-4, 9.4) + s.sinusoid(3e-4, 0.05),
        s.white(1e-3) + s.resonance(6e-3, 12.0, 0.4),
        s.white(1e-3) + s.resonance(4e-3, 5.0, 4.0) + s.sinusoid(3e-3, 11.0),
        s.white(1e-3) + s.sinusoid(3e-3, 22.0),
    ]), 50.0  # fmt: skip


def filtered() -> tuple[Floats, float]:
    """Return noise behind low-pass filters, which is rounded to coarse steps."""
    s = Simulator(15_000, 50.0, 4)
    gyro = [s.low_pass(s.white(1e-4), corner) for corner in (3.0, 8.0)]
    gyro += [s.low_pass(s.white(1e-4), 8.0) + s.walk(3e-5)]
    accel = [s.low_pass(s.low_pass(s.white(1e-3), 9.0), 9.0), s.white(1e-3), s.white(1e-3)]
    return np.column_stack([*gyro, *accel]), 50.0


def warm() -> tuple[Floats, float]:
    """Return a warm-up, and a bias that depends on the temperature (last column, degC)."""
    s = Simulator(12_000, 20.0, 5)
    hours = s.t / 600.0
    celsius = 30.0 + 6.0 * np.sin(2.0 * np.pi * 1.5 * hours) + 0.2 * np.sin(60.0 * hours)
    settling = np.exp(-s.t / 45.0)
    return np.column_stack([
        s.white(1e-4) + 3e-3 * settling,
        s.white(1e-4) + 1e-4 * (celsius - 30.0),
        s.white(1e-4) + 5e-5 * (celsius - 30.0) + 5e-6 * (celsius - 30.0) ** 2,
        s.white(1e-3) + 2e-2 * settling,
        s.white(1e-3) + 6e-4 * (celsius - 30.0),
        s.white(1e-3) + s.flicker(1e-3),
        celsius,
    ]), 20.0  # fmt: skip


def faulty() -> tuple[Floats, float]:
    """Return shocks, two motions, an axis that is stuck, spikes, and a change of the noise.

    Gaps, lost and repeated messages are made by `golden.adapter.faulty_stamps`.
    """
    s = Simulator(24_000, 50.0, 6)
    columns = [s.white(1e-4) for _ in range(3)] + [s.white(1e-3) for _ in range(3)]
    columns[2][18_000:] *= 2.5
    for start, length, size in ((3_000, 9, 0.02), (7_000, 12, 0.05), (7_900, 6, 0.03)):
        for column in columns:
            burst = s.random.normal(scale=size, size=length)
            column[start : start + length] += burst * (1 if column is columns[0] else 3)
    for start, length in ((9_000, 400), (15_000, 250)):
        for i, column in enumerate(columns):
            swing = np.sin(np.linspace(0.0, 6.0 * np.pi + i, length)) * (0.4 if i < 3 else 1.5)
            column[start : start + length] += swing
    columns[4][11_500:12_500] = columns[4][11_500]
    columns[0][s.random.integers(0, s.n, 15)] += 0.02
    return np.column_stack(columns), 50.0


def day(seed: int) -> tuple[Floats, float]:
    """Return a short recording of an IMU whose bias is drawn anew."""
    s = Simulator(6_000, 25.0, seed)
    columns = [s.white(1e-4) + s.random.normal(scale=2e-3) for _ in range(3)]
    columns += [s.white(1e-3) + s.random.normal(scale=2e-2) for _ in range(3)]
    return np.column_stack(columns), 25.0


RECORDINGS: dict[str, Any] = {
    'processes': processes,
    'correlated': correlated,
    'vibration': vibration,
    'filtered': filtered,
    'warm': warm,
    'faulty': faulty,
    'monday': lambda: day(7),
    'tuesday': lambda: day(8),
    'wednesday': lambda: day(9),
}

STEPS = {'gyro': 2e-5, 'accel': 2e-4, 'temperature': 1e-2}
"""Resolution of the stored samples in rad/s, m/s^2 and K."""


def main() -> None:
    stored: dict[str, Any] = {}
    for name, simulated in RECORDINGS.items():
        values, rate = simulated()
        mean = np.array([1e-3, -2e-3, 3e-3, 0.05, -0.08, GRAVITY, 0.0])[: values.shape[1]]
        step = np.repeat([*STEPS.values()], (3, 3, 1))[: values.shape[1]]
        step = step * (20.0 if name == 'filtered' else 1.0) ** (np.arange(len(step)) == 4)
        counts = np.rint((values + mean * (np.arange(len(step)) != 5)) / step)
        assert np.abs(counts).max() < 2**15, name
        stored[name] = counts.astype(np.int16)
        stored[f'{name}_step'], stored[f'{name}_rate'] = step, rate
    np.savez_compressed(PLACE, **stored)
    print(f'{PLACE}: {PLACE.stat().st_size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
