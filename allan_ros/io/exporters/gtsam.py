# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""GTSAM: a Python module that sets the covariances of PreintegrationCombinedParams.

GTSAM reads no file. Its covariances are continuous: gtsam/navigation/PreintegrationParams.h and
CombinedImuFactor.cpp divide or multiply by the time step. Names and numbers are those of the C++
interface too. The plain PreintegrationParams has no bias covariances.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ...core.errors import AllanError
from ...core.imu import SI_UNITS
from .model import FilterNoise
from .target import Entry, Target

COVARIANCES = {
    'accelerometerCovariance': ('accel', 'N'),
    'gyroscopeCovariance': ('gyro', 'N'),
    'biasAccCovariance': ('accel', 'K'),
    'biasOmegaCovariance': ('gyro', 'K'),
}
"""Parameter -> the sensor and term whose square it is."""

INTEGRATION_COVARIANCE = 1e-8
"""Error of the integration itself, (m/s)^2/Hz; LIO-SAM takes it for that."""

_CODE = '''
import numpy as np

{numbers}
# Not from the Allan curve: the error of the numerical integration; the default is the identity.
integrationCovariance = [{integration!r}] * 3


def set_noise(params):
    """Set this noise on a gtsam.PreintegrationCombinedParams (or PreintegrationParams)."""
    params.setAccelerometerCovariance(np.diag(accelerometerCovariance))
    params.setGyroscopeCovariance(np.diag(gyroscopeCovariance))
    params.setIntegrationCovariance(np.diag(integrationCovariance))
    if hasattr(params, 'setBiasAccCovariance'):
        params.setBiasAccCovariance(np.diag(biasAccCovariance))
        params.setBiasOmegaCovariance(np.diag(biasOmegaCovariance))
    if hasattr(params, 'setBiasAccOmegaInit'):
        # Up to GTSAM 4.2 the default is the identity, which drowns the IMU. What is not known of
        # the bias at the start is the affair of the prior on it.
        params.setBiasAccOmegaInit(np.zeros((6, 6)))
    return params
'''


class _PythonForm:
    """A Python module."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a module of these entries, its header in comments."""
        numbers = ''.join(f'{entry.key} = {entry.value!r}\n' for entry in entries)
        code = _CODE.format(numbers=numbers, integration=INTEGRATION_COVARIANCE)
        return ''.join(f'# {line}\n' for line in header) + code

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Refuse: a program is not merged into by another program."""
        raise AllanError('gtsam writes a Python module: import it, or leave out --merge-into')


def _entries(model: FilterNoise) -> Iterator[Entry]:
    for key, (sensor, term) in COVARIANCES.items():
        unit = f'({SI_UNITS[sensor][term]})^2'
        yield model.three((key,), sensor, term, f'{term}^2', unit, lambda value: value**2)


TARGET = Target(
    'gtsam_imu.py',
    'continuous covariances (gtsam/navigation/PreintegrationParams.h, CombinedImuFactor.cpp)',
    _entries,
    _PythonForm(),
    three=True,
    notes=('the last two are for PreintegrationCombinedParams only',),
)
