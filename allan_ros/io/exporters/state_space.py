# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The complete process model: a JSON document, a Python module, and the simulators that run it.

Schema ``allan_ros/state_space/1``: under ``axes``, for each axis, the levels ``white``, ``walk``
and ``gauss_markov`` in SI, the matrices of `allan_ros.core.filters.state_space` at one rate under
``discrete``, and under ``reductions`` what filters with fewer states should be given.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.filters.growth import Growth
from ...core.filters.noise_parameters import AxisReduction, reduce_axis
from ...core.filters.reductions import STATES, Horizons, Reduction
from ...core.filters.state_space import StateSpace
from ...core.imu import SI_UNITS, sensor_of
from .forms import JsonForm, LineForm
from .model import FilterNoise, rounded
from .target import INS_HORIZON_S, VIO_HORIZON_S, Entry, Target

SCHEMA = 'allan_ros/state_space/1'

CONTENT = 'exact discrete state space of the fitted processes (IEEE Std 952; van Loan 1978)'


MATRIX_DIGITS = 12
"""Significant digits of the matrices: diagonal elements of Phi are close to 1."""


def _space(reduced: AxisReduction, inflate: float) -> StateSpace:
    one = reduced.reduction
    return StateSpace(
        rounded(inflate * one.white), rounded(inflate * one.walk), _processes(one, inflate)
    )


def _processes(one: Reduction, inflate: float = 1.0) -> tuple[tuple[float, float], ...]:
    return tuple((rounded(inflate * sigma), rounded(tau)) for sigma, tau in one.gauss_markov)


def _matrix(values: NDArray[np.float64]) -> list[list[float]]:
    return [[float(f'{value:.{MATRIX_DIGITS}g}') for value in row] for row in values]


def _document(noise: FilterNoise) -> Iterator[Entry]:
    yield Entry(('schema',), SCHEMA)
    yield Entry(('rate_hz',), noise.rate)
    for axis in noise.results.axes:
        reduced = noise.reduction(axis, 'processes', expect_walk=True)
        yield Entry(('axes', axis), _axis(noise, axis, reduced), is_limit=_limited(reduced))


def _limited(reduced: AxisReduction) -> bool:
    return reduced.white.is_limit or bool(reduced.walk and reduced.walk.is_limit)


def _axis(noise: FilterNoise, axis: str, reduced: AxisReduction) -> dict[str, Any]:
    """Return the document of one axis."""
    fit, options = noise.results.axes[axis].fit, noise.options
    space = _space(reduced, options.inflate)
    processes = [f'gauss_markov {i}' for i in range(len(space.gauss_markov))]
    step = 1.0 / noise.rate
    reductions = [
        _reduction(reduce_axis(axis, fit, states, Horizons.up_to(horizon)).reduction)
        for horizon in dict.fromkeys((VIO_HORIZON_S, INS_HORIZON_S, noise.horizons.high))
        for states in STATES
    ]
    return {
        'unit': SI_UNITS[sensor_of(axis)]['B'],
        'white': space.white,
        'walk': space.walk,
        'gauss_markov': [{'sigma': sigma, 'tau': tau} for sigma, tau in space.gauss_markov],
        'ramp': rounded(fit.selected.terms.R),
        'limits': [one.term for one in (reduced.white, reduced.walk) if one and one.is_limit],
        'discrete': {
            'states': ['integral', 'walk', *processes],
            'step': step,
            'Phi': _matrix(space.transition(step)),
            'Qd': _matrix(space.noise(step)),
            'R': rounded(space.sample_variance(noise.rate)),
        },
        'reductions': reductions,
        'growth': [_growth(one) for one in noise.results.axes[axis].growth],
    }


def _growth(one: Growth) -> dict[str, Any]:
    ends = one.ci95 and [rounded(end) for end in one.ci95]
    return {'horizon': one.horizon, 'window': one.window, 'std': rounded(one.std), 'ci95': ends}


def _reduction(one: Reduction) -> dict[str, Any]:
    return {
        'states': one.states,
        'horizon': list(one.horizons),
        'white': rounded(one.white),
        'walk': rounded(one.walk),
        'gauss_markov': [{'sigma': sigma, 'tau': tau} for sigma, tau in _processes(one)],
        'ratio': [rounded(ratio) for ratio in one.ratio],
    }


def _module(noise: FilterNoise) -> Iterator[Entry]:
    axes = {}
    limited = False
    for axis in noise.results.axes:
        reduced = noise.reduction(axis, 'processes', expect_walk=True)
        limited = limited or _limited(reduced)
        space = _space(reduced, noise.options.inflate)
        axes[axis] = {
            'white': space.white,
            'walk': space.walk,
            'gauss_markov': [list(pair) for pair in space.gauss_markov],
        }
    yield Entry(('AXES',), axes, is_limit=limited)


_CODE = '''

def matrices(axis, dt):
    """Return Phi and Qd of (integral, walk, Gauss-Markov ...) over dt s, and R of one sample."""
    noise = AXES[axis]
    n, k = noise['white'], noise['walk']
    size = 2 + len(noise['gauss_markov'])
    phi, q = np.eye(size), np.zeros((size, size))
    phi[0, 1] = dt
    q[0, 0] = n * n * dt + k * k * dt**3 / 3
    q[0, 1] = q[1, 0] = k * k * dt**2 / 2
    q[1, 1] = k * k * dt
    for i, (sigma, tau) in enumerate(noise['gauss_markov'], 2):
        x = dt / tau
        phi[i, i], phi[0, i] = math.exp(-x), -tau * math.expm1(-x)
        if x > 0.05:
            growth = 2 * x + 4 * math.expm1(-x) - math.expm1(-2 * x)
        else:
            growth = x**3 * (2 / 3 - x * (0.5 - x * (7 / 30 - x / 12)))
        q[0, 0] += (sigma * tau) ** 2 * growth
        q[0, i] = q[i, 0] = sigma**2 * tau * math.expm1(-x) ** 2
        q[i, i] = -(sigma**2) * math.expm1(-2 * x)
    return phi, q, n * n / dt


class ImuNoise:
    """Simulated noise of all axes; the result of a call is added to ideal samples."""

    def __init__(self, rng=None):
        self.rng = rng or np.random.default_rng()
        self.bias = {
            axis: [0.0, *(sigma * self.rng.standard_normal() for sigma, _ in noise['gauss_markov'])]
            for axis, noise in AXES.items()
        }

    def __call__(self, dt):
        """Return the noise of the next sample of each axis, dt s after the last one."""
        sample = {}
        for axis, noise in AXES.items():
            bias, draw = self.bias[axis], self.rng.standard_normal
            bias[0] += noise['walk'] * math.sqrt(dt) * draw()
            for i, (sigma, tau) in enumerate(noise['gauss_markov'], 1):
                driven = sigma * math.sqrt(-math.expm1(-2 * dt / tau))
                bias[i] = math.exp(-dt / tau) * bias[i] + driven * draw()
            sample[axis] = sum(bias) + noise['white'] / math.sqrt(dt) * draw()
        return sample

    def add(self, angular_velocity, linear_acceleration, dt):
        """Return the two vectors (x, y, z) with noise added."""
        sample = self(dt)
        gyro, accel = (
            np.array([sample.get(f'{sensor}_{axis}', 0.0) for axis in 'xyz'])
            for sensor in ('gyro', 'accel')
        )
        return np.asarray(angular_velocity) + gyro, np.asarray(linear_acceleration) + accel
'''

_FORM = LineForm('{key} = {value}', before='\nimport math\n\nimport numpy as np\n\n', after=_CODE)


def _python(file_name: str, convention: str, *notes: str) -> Target:
    return Target(
        file_name,
        convention,
        _FORM,
        entries=_module,
        notes=notes,
        three=True,
        horizon_s=INS_HORIZON_S,
        walk=False,
    )


STATE_SPACES = {
    'state_space': Target(
        'state_space.json',
        f'{CONTENT}; states (integral, walk, Gauss-Markov ...), R = N^2 f',
        JsonForm(),
        entries=_document,
        notes=(
            'walk is a state even if it is 0: it holds the turn-on bias',
            'walk covers a ramp over the horizon, because a ramp has no state of its own; where K '
            'is not resolved it contains 15 % of the expected K^2',
        ),
        three=True,
        horizon_s=INS_HORIZON_S,
        walk=False,
    ),
    'state_space_python': _python(
        'imu_state_space.py', CONTENT, 'AXES holds N, K and (sigma, tau) of each axis in SI'
    ),
    'isaac_sim': _python(
        'isaac_sim_imu_noise.py',
        f'{CONTENT}; the IMU sensor of Isaac Sim adds no noise, so a script adds it to its reading',
        'noise = ImuNoise(); frame = imu.get_current_frame(); gyro, accel = '
        "noise.add(frame['ang_vel'], frame['lin_acc'], physics_dt)",
    ),
    'webots': _python(
        'webots_imu_noise.py',
        f'{CONTENT}; the lookupTable of the Gyro and Accelerometer nodes scales noise with the '
        'value, none at rest, so the controller adds it',
        'noise = ImuNoise(); gyro, accel = noise.add(gyro.getValues(), accelerometer.getValues(), '
        'timestep / 1000)',
    ),
}
"""Name -> target."""
