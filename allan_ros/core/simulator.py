# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of IMU recordings with known noise and with faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import AllanError, one_line
from .imu import AXES, SENSORS, STANDARD_GRAVITY, ImuBatch
from .noise import SEARCHED, Model, Process
from .noise.derived import simulate
from .noise.process import Parameter
from .settings import LIST, CheckedSettings, check_range, expect, parameter

Floats = NDArray[np.float64]

BATCH_SAMPLES = 32768
"""Number of samples in each batch but the last."""

LEVEL = (0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY)
"""Mean of the six axes of an IMU at rest and level, with z up, in rad/s and m/s^2."""

PRESETS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    # The gyro is the ADIS16475-3 that Cong, Wang, Yan 2019 measured (table 1). B of the
    # accelerometer is chosen so that the minimum of the curve, 0.664 B, equals the 3.6 ug of the
    # ADIS16475 datasheet (Rev. D, features). No source states N of the accelerometer; the value is
    # typical of its class.
    'paper': {
        'gyro_x': {'Q': 0.138, 'N': 0.242, 'B': 5.237, 'K': 31.807, 'R': 76.242},
        'gyro_y': {'Q': 0.124, 'N': 0.168, 'B': 4.972, 'K': 8.169, 'R': 11.068},
        'gyro_z': {'Q': 0.100, 'N': 0.245, 'B': 6.058, 'K': 50.568, 'R': 66.250},
        'accel_x': {'N': 0.012, 'B': 5.42},
        'accel_y': {'N': 0.012, 'B': 5.42},
        'accel_z': {'N': 0.012, 'B': 5.42},
    },
}
"""Name of a preset -> axis -> term -> coefficient in datasheet units."""

Periods = tuple[tuple[float, float], ...]
"""Periods of time, each as (start, length) in s."""

_offset = partial(parameter, 0.0, 'offset at the start that decays as the sensor warms up')
_gyro = partial(parameter, unit='rad/s', low=0.0)
_accel = partial(parameter, unit='m/s^2', low=0.0)
_time = partial(parameter, unit='s', low=1e-6)
_frequency = partial(parameter, unit='Hz', low=1e-9)
_periods = partial(parameter, (), unit='s')


ADDED = {kind.name: kind for kind in SEARCHED if not kind.is_line}
"""Name -> class of a noise process that may be added to all axes of a sensor."""


def _process_options() -> Iterator[tuple[str, type, Any]]:
    """Yield name, type and dataclass field of each option of the processes in `ADDED`.

    The options of a process are its standard deviation for each sensor, and the parameters of its
    shape.
    """
    for name, process in ADDED.items():
        meaning = f'of an added {process.name.replace("_", " ")} process'
        yield f'{name}_gyro', float, _gyro(0.0, f'standard deviation {meaning}')
        yield f'{name}_accel', float, _accel(0.0, f'standard deviation {meaning}')
        for shape in process.parameters:
            parameter_name = shape.name.replace('_', ' ')
            field_of_option, default = SHAPE_OPTIONS[shape.unit]
            option_field = field_of_option(default, f'{parameter_name} {meaning}')
            yield _option_name(name, shape), float, option_field


def _option_name(process_name: str, shape: Parameter) -> str:
    return f'{process_name}_{shape.name.removeprefix("correlation_")}'


SHAPE_OPTIONS = {'s': (_time, 300.0), 'Hz': (_frequency, 10.0)}
"""Unit of a shape parameter -> tuple of a function and a number. The function returns the dataclass
field of the option that sets such a parameter, and the number is the default of this option."""

AddedProcesses = make_dataclass(
    'AddedProcesses', _process_options(), bases=(CheckedSettings,), frozen=True
)


@dataclass(frozen=True)
class Faults(AddedProcesses):  # type: ignore[misc, valid-type]
    """Imperfections of a simulated IMU and of its recording; none by default.

    In addition to the fields below, there are options for every noise process that a fit can add to
    the terms, except a sinusoid (see the options of the vibration). Examples are
    ``gauss_markov_gyro``, ``gauss_markov_accel`` and ``gauss_markov_time``.

    Raises
    ------
    AllanError
        When a value has a wrong type or lies outside its range.
    """

    warmup_gyro: float = _offset(unit='rad/s')
    warmup_accel: float = _offset(unit='m/s^2')
    warmup_time: float = parameter(
        300.0, 'time in which the warm-up offset decays to 1/e', unit='s', low=1e-3
    )
    vibration_gyro: float = _gyro(0.0, 'amplitude of a sinusoidal vibration on each gyro axis')
    vibration_accel: float = _accel(
        0.0, 'amplitude of a sinusoidal vibration on each accelerometer axis'
    )
    vibration_frequency: float = _frequency(1.0, 'frequency of the vibration')
    motion: tuple[tuple[float, float], ...] = _periods('periods of motion, each (start, length)')
    motion_gyro: float = _gyro(0.5, 'amplitude of the motion')
    motion_accel: float = _accel(1.0, 'amplitude of the motion')
    low_pass: float = parameter(
        0.0, 'corner frequency of a first-order low-pass filter; 0: none', unit='Hz', low=0.0
    )
    accel_rate: float = parameter(
        0.0,
        'rate of new accelerometer samples, which are repeated in between; 0: every sample is new',
        unit='Hz',
        low=0.0,
    )
    lsb_gyro: float = _gyro(0.0, 'quantization step of the gyro; 0: none')
    lsb_accel: float = _accel(0.0, 'quantization step of the accelerometer; 0: none')
    gaps: tuple[tuple[float, float], ...] = _periods(
        'periods without samples, each (start, length)'
    )
    drop: float = parameter(0.0, 'probability that a sample is lost', low=0.0, high=1.0)
    jitter: float = parameter(
        0.0, 'standard deviation of the stamps about the true times', unit='s', low=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ('motion', 'gaps'):
            periods = tuple(_period(name, each) for each in getattr(self, name))
            object.__setattr__(self, name, periods)


def _period(name: str, given: Any) -> tuple[float, float]:
    """Return ``given`` as a period (start, length) in s; raise AllanError if it is not a period."""
    expect(LIST, '(start, length)', **{name: given})
    if len(given) != 2:
        raise AllanError(f'{name} has {one_line(repr(given)):.60}: give (start, length) in s')
    start, length = given
    check_range(0.0, 1e10, 's', **{f'start of {name}': start})
    check_range(1e-9, 1e10, 's', **{f'length of {name}': length})
    return start, length


def samples_in(seconds: float, rate: float) -> int:
    """Return the number of samples in ``seconds`` at ``rate`` Hz.

    Raises AllanError if the number is rounded to 0, or if the duration or rate is implausible.
    """
    check_range(0.0, 1e10, 's', duration=seconds)
    check_range(1e-6, 1e6, 'Hz', rate=rate)
    if round(seconds * rate) < 1:
        raise AllanError(f'cannot simulate {seconds} s at {rate} Hz: give a longer time')
    return round(seconds * rate)


def simulate_axis(n: int, tau0: float, model: Model, rng: np.random.Generator) -> Floats:
    """Return n simulated samples of one axis with the noise of a model, in SI, (n,).

    The first sample is 0. The expected Allan variance of the samples is ``model.avar(tau, tau0)``,
    except if a low-pass filter would make the spectrum negative.

    Parameters
    ----------
    n : int
        Number of samples.
    tau0 : float
        Sample period in s.
    model : Model
        The noise in SI.
    rng : numpy.random.Generator
        Source of the random numbers.
    """
    y = simulate(_in_samples(model, tau0), n, rng)
    return np.asarray(y - y[0])


def _in_samples(model: Model, tau0: float) -> list[tuple[float, Process]]:
    """Return the coefficients and processes of a model with the sample period as unit of time."""
    return [(p.process.in_samples(p.value, tau0), p.process.in_unit(tau0)) for p in model.parts]


def simulate_imu(
    seconds: float,
    rate: float,
    gyro: Sequence[Model],
    accel: Sequence[Model],
    *,
    mean: ArrayLike = LEVEL,
    seed: int = 0,
    faults: Faults = Faults(),
    start_ns: int = 0,
    frame_id: str = 'imu_link',
) -> Iterator[ImuBatch]:
    """Simulate a recording with known noise, and yield its samples in batches.

    Every axis and every fault has its own random numbers, so an added fault does not change the
    random numbers of the noise or of the other faults. An exception is the jitter: it is drawn only
    for the samples that are not lost.

    Parameters
    ----------
    seconds, rate : float
        Duration in s, and sample rate in Hz.
    gyro, accel : three Model each
        Noise of x, y and z, in SI.
    mean : (6,) array
        Mean of each axis in rad/s and m/s^2, to which the noise is added. By default, the IMU is
        level.
    seed : int
        Seed of the random numbers, 0 or more; the same seed gives the same recording.
    faults : Faults
        Imperfections that are added to the samples and stamps.
    start_ns : int
        Stamp of the first sample in ns, before a jitter is added.
    frame_id : str
        The frame_id of the messages.

    Raises
    ------
    AllanError
        If the duration or the rate is out of range, the number of samples is rounded to 0, the seed
        is negative, or the samples do not fit into memory. The error is raised when the first batch
        is requested.
    """
    n, tau0 = samples_in(seconds, rate), 1.0 / rate
    if seed < 0:
        raise AllanError(f'seed is {seed}: give a whole number of 0 or more')
    axis_seeds, fault_seed = (s for s in np.random.SeedSequence(seed).spawn(2))
    try:
        samples = np.empty((n, len(AXES)))
    except (MemoryError, ValueError) as error:
        raise AllanError(
            f'{n:,} samples do not fit into memory: reduce the duration or the rate'
        ) from error
    for i, (model, axis_seed) in enumerate(zip((*gyro, *accel), axis_seeds.spawn(len(AXES)))):
        samples[:, i] = simulate_axis(n, tau0, model, np.random.default_rng(axis_seed))
    samples += np.asarray(mean, float)
    sample_seed, stamp_seed, loss_seed = fault_seed.spawn(3)
    _disturb_samples(samples, tau0, faults, sample_seed)
    stamps_ns = start_ns + np.round(np.arange(n) * (tau0 * 1e9)).astype(np.int64)
    kept_indices = np.flatnonzero(~_lost_samples(n, tau0, faults, np.random.default_rng(loss_seed)))
    stamps_ns = stamps_ns[kept_indices]
    if faults.jitter > 0.0:
        jitter = np.random.default_rng(stamp_seed.spawn(1)[0]).standard_normal(len(kept_indices))
        stamps_ns = stamps_ns + np.round(jitter * faults.jitter * 1e9).astype(np.int64)
    for first in range(0, len(kept_indices), BATCH_SAMPLES):
        rows = slice(first, first + BATCH_SAMPLES)
        header_ns = stamps_ns[rows]
        yield ImuBatch(header_ns, samples[kept_indices[rows]], header_ns.copy(), frame_id)


MOTION_FREQUENCIES = (0.31, 0.73, 1.13)
"""Frequencies in Hz of the sinusoids of a simulated motion. The sum of the sinusoids has a long
period."""


def _disturb_samples(
    samples: Floats, tau0: float, faults: Faults, seed: np.random.SeedSequence
) -> None:
    """Apply the faults that change samples, in place; ``samples`` is (n, 6)."""
    times: Floats = np.arange(len(samples), dtype=np.float64) * tau0
    # each fault has its own random generator, so that an added fault does not change other faults
    rngs = {
        name: np.random.default_rng([*seed.generate_state(4).tolist(), number])
        for name, number in (('vibration', 1), ('motion', 3))
    }

    def amplitudes(fault: str) -> Floats:
        sensors = [getattr(faults, f'{fault}_{sensor}') for sensor in SENSORS]
        return np.repeat(np.asarray(sensors, np.float64), 3)

    if np.any(amplitudes('warmup')):
        samples += amplitudes('warmup') * np.exp(-times / faults.warmup_time)[:, None]
    for name, kind in ADDED.items():
        if np.any(amplitudes(name)):
            process = kind(*(getattr(faults, _option_name(name, p)) for p in kind.parameters))
            rng = np.random.default_rng([*seed.generate_state(4).tolist(), *name.encode()])
            for axis, sigma in enumerate(amplitudes(name).tolist()):
                added = _in_samples(Model.of((sigma, process)), tau0)
                samples[:, axis] += simulate(added, len(samples), rng)
    if np.any(amplitudes('vibration')):
        phases = rngs['vibration'].uniform(0.0, 2.0 * np.pi, len(AXES))
        angle = 2.0 * np.pi * faults.vibration_frequency * times[:, None]
        samples += amplitudes('vibration') * np.sin(angle + phases)
    if faults.motion:
        is_moving = _in_periods(times, faults.motion)
        motion_phases = rngs['motion'].uniform(0.0, 2.0 * np.pi, (2, len(MOTION_FREQUENCIES), 3))
        for frequency, phase in zip(MOTION_FREQUENCIES, np.concatenate(motion_phases, axis=1)):
            angle = 2.0 * np.pi * frequency * times[is_moving, None]
            amplitude = amplitudes('motion') / len(MOTION_FREQUENCIES)
            samples[is_moving] += amplitude * np.sin(angle + phase)
    if faults.low_pass > 0.0:
        pole = np.exp(-2.0 * np.pi * faults.low_pass * tau0)
        first_sample = samples[0].copy()
        samples -= first_sample
        samples[:] = _recursion(pole, (1.0 - pole) * samples)
        samples += first_sample
    accel_samples = samples[:, SENSORS['accel']]
    if faults.accel_rate > 0.0:
        accel_samples[:] = accel_samples[_held_index(len(samples), tau0, faults.accel_rate)]
    for axes, lsb in zip(SENSORS.values(), (faults.lsb_gyro, faults.lsb_accel)):
        if lsb > 0.0:
            samples[:, axes] = np.round(samples[:, axes] / lsb) * lsb


def _recursion(pole: float, inputs: Floats) -> Floats:
    """Return y_k = pole y_(k-1) + x_k along the first axis; ``inputs`` are x_k, and y_0 = x_0."""
    from scipy.signal import lfilter  # slow to import, and rarely needed

    return np.asarray(lfilter([1.0], [1.0, -pole], inputs, axis=0))


def _held_index(n: int, tau0: float, rate: float) -> NDArray[np.int64]:
    """Return, for each of n samples, the index of the sample whose value is repeated, (n,).

    A sensor with the lower rate ``rate`` in Hz gets a new value at the ticks of its own clock.
    """
    # The offset 1e-9 keeps rounding errors from hiding a tick that coincides with a sample.
    ticks = np.floor(np.arange(n) * tau0 * rate + 1e-9)
    repeated_index = np.minimum(np.ceil(ticks / (tau0 * rate) - 1e-9), np.arange(n))
    return np.asarray(repeated_index, np.int64)


def _in_periods(times: Floats, periods: Periods) -> NDArray[np.bool_]:
    """Return whether each of n times in s lies in one of the periods, (n,)."""
    is_inside = np.zeros(len(times), bool)
    for start, length in periods:
        is_inside |= (times >= start) & (times < start + length)
    return is_inside


def _lost_samples(
    n: int, tau0: float, faults: Faults, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return whether each of n samples is lost in a gap or at random, (n,).

    The first sample is never lost.
    """
    is_lost = _in_periods(np.arange(n, dtype=np.float64) * tau0, faults.gaps)
    if faults.drop > 0.0:
        is_lost |= rng.random(n) < faults.drop
    is_lost[0] = False
    return is_lost
