# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate an IMU with stated noise and faults, and read the truth of a simulated recording.

Specification
-------------
A specification of a simulated IMU is a YAML or JSON file. ``noise`` maps axes to coefficients. Each
coefficient is a number in datasheet units, or an object with the keys value and unit. The keys
``gyro`` and ``accel`` apply to all axes of the sensor; the key of one axis, such as ``gyro_z``,
takes precedence. ``faults`` has the fields of `Faults`, in SI:

    noise:
      gyro: {N: 0.3, B: {value: 7, unit: deg/h}}
      gyro_z: {N: 0.4}
    faults: {drop: 0.01, motion: [[60, 2.5]], vibration_gyro: 0.001, vibration_frequency: 25}

The truth file next to a simulated recording has the same format, and additional keys for the
duration, the sample rate and the seed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from ..core.errors import AllanError
from ..core.estimate import UNKNOWN, Estimate
from ..core.fields import Fields, located
from ..core.fit.result import TERMS, AxisFit
from ..core.imu import AXES, SI_UNITS, ImuBatch, ImuIdentity, from_datasheet, joined, sensor_of
from ..core.noise import LETTERS, Model
from ..core.settings import SLOWEST_HZ, check_range, expect, settings_from
from ..core.simulator import PRESETS, Faults, simulate_imu
from ..readers import SourceInfo
from ..readers.files import read_yaml, to_json, with_checked_paths, write_atomic
from ..readers.recording_sums import Provenance
from .axis_result import AxisResult
from .datasheets import load_sensor
from .results import Results

TRUTH_SCHEMA = 'allan_ros/truth/1'

TRUTH_SUFFIX = '.truth.json'
"""Suffix of the truth file: the truth of ``name.mcap`` is in ``name.mcap.truth.json``."""

TRUTH = 'truth'
"""Value of `Results.method` for results that contain the true noise."""

AxesNoise = Mapping[str, Model]

NO_NOISE: AxesNoise = {axis: Model() for axis in AXES}


def truth_path(recording: str | os.PathLike[str]) -> Path:
    """Return the path of the file that states the true noise of a simulated recording."""
    path = Path(recording)
    return path.with_name(path.name + TRUTH_SUFFIX)


def read_specification(path: str | os.PathLike[str]) -> tuple[Fields | None, Faults]:
    """Read a specification of a simulated IMU from a YAML or JSON file.

    Returns the stated noise (None if the file states no noise) and the faults. Raises AllanError if
    the file cannot be read or an entry is invalid; the message states the position of the entry.
    """
    fields = Fields(read_yaml(Path(path)), str(path))
    if 'schema' in fields:
        fields.schema(TRUTH_SCHEMA)
    fields.allow_only('noise', 'faults', 'schema', 'seconds', 'rate_hz', 'seed')
    fault_fields = fields.optional_fields('faults')
    with located(f'{path}.faults'):
        fault_values = (
            {}
            if fault_fields is None
            else {name: fault_fields.value(name) for name in fault_fields}
        )
        faults = settings_from(Faults, fault_values)
    return fields.optional_fields('noise'), faults


def read_noise(path: str | os.PathLike[str]) -> AxesNoise:
    """Read the noise of an IMU from a specification: axis -> noise model in SI.

    Axes of which the file states nothing have no noise. Raises AllanError if the file cannot be
    read or is invalid.
    """
    stated, _ = read_specification(path)
    return with_noise(NO_NOISE, stated or Fields({}, str(path)))


def with_noise(noise: AxesNoise, stated: Fields) -> AxesNoise:
    """Return the noise of the six axes, in which ``stated`` replaces coefficients of ``noise``.

    ``noise`` maps each axis to a noise model in SI. ``stated`` contains coefficients by sensor or
    axis. Raises AllanError if a coefficient is invalid.
    """
    stated.allow_only(*SI_UNITS, *AXES)
    return {
        axis: noise[axis].changed(
            **{
                term: value
                for name in (sensor_of(axis), axis)
                if name in stated
                for term, value in _terms(stated.fields(name), sensor_of(axis)).items()
            },
        )
        for axis in AXES
    }


def stated_noise(
    preset: str = '',
    sensor: str = '',
    spec: Fields | None = None,
    changes: Mapping[str, Mapping[str, float]] | None = None,
) -> AxesNoise:
    """Return the noise to simulate: axis -> noise model in SI.

    Parameters
    ----------
    preset : str
        Name of predefined noise; '' for none.
    sensor : str
        Name of a datasheet, whose N and B are used if there is no preset; '' for none.
    spec : Fields, optional
        Noise in a specification; its coefficients replace coefficients of the preset or datasheet.
    changes : mapping, optional
        Axis or sensor -> term -> coefficient in datasheet units. These coefficients replace
        coefficients from all other sources.

    Raises
    ------
    AllanError
        When none of the four arguments is given, or when a name or coefficient is invalid.
    """
    noise = NO_NOISE
    if preset:
        if preset not in PRESETS:
            raise AllanError(f'preset {preset!r} is unknown: choose one of {", ".join(PRESETS)}')
        noise = with_noise(noise, Fields({**PRESETS[preset]}, f'preset {preset}'))
    elif sensor:
        limits = load_sensor(sensor).values()
        noise = {axis: Model.of(**limits.get(axis, {})) for axis in AXES}
    elif not changes and spec is None:
        raise AllanError(
            'no noise to simulate: give --preset paper, --sensor NAME, --spec FILE or --gyro N=1e-4'
        )
    if spec is not None:
        noise = with_noise(noise, spec)
    return with_noise(noise, Fields({**(changes or {})}, 'noise'))


def _terms(stated: Fields, sensor: str) -> dict[str, float]:
    coefficients: dict[str, float] = {}
    stated.allow_only(*SI_UNITS[sensor])
    for term in stated:
        if isinstance(stated.value(term), dict):
            coefficients[term] = stated.fields(term).quantity(SI_UNITS[sensor][term])
        else:
            coefficients[term] = from_datasheet(term, sensor, stated.number(term))
    with located(stated.where):
        Model.of(**coefficients)
    return coefficients


def write_truth(
    recording: str | os.PathLike[str],
    noise: AxesNoise,
    *,
    seconds: float,
    rate: float,
    seed: int,
    faults: Faults,
) -> Path:
    """Write the truth file of a simulated recording next to the recording, and return its path.

    Parameters
    ----------
    recording : path
        Path of the recording.
    noise : mapping of axis to Model
        True noise of each axis in SI. Only the terms Q, N, B, K and R are written.
    seconds, rate : float
        Duration in s, and sample rate in Hz.
    seed : int
        Seed of the random numbers.
    faults : Faults
        Faults of the simulation. The file contains only faults that differ from their defaults.

    Raises
    ------
    AllanError
        When the file cannot be written.
    """
    changed_faults = {k: v for k, v in asdict(faults).items() if v != getattr(Faults(), k)}
    document: dict[str, Any] = {
        'schema': TRUTH_SCHEMA,
        'seconds': seconds,
        'rate_hz': rate,
        'seed': seed,
        'faults': changed_faults,
        'noise': {
            axis: {
                term: {'value': model.value(term), 'unit': SI_UNITS[sensor_of(axis)][term]}
                for term in LETTERS
            }
            for axis, model in noise.items()
        },
    }
    path = truth_path(recording)
    write_atomic(path, to_json(document))
    return path


def is_truth(path: str | os.PathLike[str]) -> bool:
    """Return whether the file at a path is a truth file, judged by its name and schema.

    Raises AllanError if a file with such a name cannot be read.
    """
    file_path = Path(path)
    if not (file_path.name == 'truth.json' or file_path.name.endswith(TRUTH_SUFFIX)):
        return False
    document = read_yaml(file_path)
    return isinstance(document, dict) and document.get('schema') == TRUTH_SCHEMA


def results_of_truth(path: str | os.PathLike[str]) -> Results:
    """Return the noise in the truth file of a simulated recording as results.

    The intervals have no width, because the noise is known exactly. A term that was not simulated
    has no value, so that measured results are not compared with it. Raises AllanError when the file
    cannot be read or is invalid.
    """
    fields = Fields(read_yaml(Path(path)), str(path))
    tau0, seconds = 1.0 / fields.number('rate_hz', SLOWEST_HZ), fields.number('seconds', 0.0)
    axes = {
        axis: AxisResult(tau0, AxisFit(_estimates(model), model), name=axis)
        for axis, model in read_noise(path).items()
    }
    samples = round(seconds / tau0)
    provenance = Provenance((SourceInfo(str(path), '', '', ''),))
    return Results(
        identity=ImuIdentity(TRUTH),
        method=TRUTH,
        tau0=tau0,
        samples=samples,
        duration_s=seconds,
        segments=1,
        axes=axes,
        provenance=provenance,
        findings=(),
    )


def _estimates(model: Model) -> dict[str, Estimate]:
    values = {term: model.value(term) for term in TERMS}
    return {
        term: Estimate(value, (value, value)) if value else UNKNOWN
        for term, value in values.items()
    }


@with_checked_paths
def simulate(
    hours: float = 1.0,
    rate: float = 100.0,
    preset: str = 'paper',
    *,
    sensor: str = '',
    gyro: Mapping[str, Any] = {},
    accel: Mapping[str, Any] = {},
    seed: int = 0,
    frame_id: str = 'imu_link',
    **faults: Any,
) -> ImuBatch:
    """Simulate the samples of an IMU at rest with known noise.

    Parameters
    ----------
    hours, rate : float
        Duration in h, and sample rate in Hz.
    preset : str
        Name of predefined noise: 'paper' for the ADIS16475-3 of Cong et al. 2019, or '' for none.
    sensor : str
        A datasheet whose N and B are used instead of the preset: a name that `allan sensors` lists,
        or the path of a .yaml file. Terms that the datasheet does not state are 0.
    gyro, accel : mapping, optional
        Coefficients that replace coefficients of the preset or datasheet. Q, N, B, K and R of the
        gyro are in urad, deg/sqrt(h), deg/h, deg/h^1.5 and deg/h^2; of the accelerometer, in um/s,
        m/s/sqrt(h), ug, ug/sqrt(h) and ug/h. ``{'N': 0.3, 'B': 7}`` applies to all axes,
        ``{'z': {'N': 0.3}}`` to one axis.
    seed : int
        Seed of the random numbers, 0 or more.
    frame_id : str
        The frame_id of the messages.
    **faults
        Faults of the IMU, as in the files of `allan simulate --spec`. For example, ``motion`` and
        ``gaps`` are lists of pairs (start, length) in s, ``low_pass`` is a frequency in Hz, and
        ``drop`` is the probability that a sample is lost.

    Returns
    -------
    ImuBatch
        The samples: ``stamps_ns``, (n,), in ns, and ``samples``, (n, 6), in rad/s and m/s^2. The
        first sample is never lost; without jitter, its stamp is 0.

    Raises
    ------
    AllanError
        When an argument is unknown or invalid, or the samples do not fit into memory.

    Examples
    --------
    >>> import allan_ros as ar
    >>> ar.simulate(hours=0.01, rate=200, seed=3).samples.shape
    (7200, 6)
    >>> noisy_z = ar.simulate(hours=0.01, gyro={'z': {'N': 5.0}})
    """
    check_range(0.0, 1e6, 'h', hours=hours)
    expect(Real, rate=rate)
    expect(Integral, seed=seed)
    expect(str, preset=preset, sensor=sensor, frame_id=frame_id)
    changes = {**_noise_changes('gyro', gyro), **_noise_changes('accel', accel)}
    models = list(stated_noise('' if sensor else preset, sensor, changes=changes).values())
    batches = simulate_imu(
        hours * 3600.0,
        rate,
        models[:3],
        models[3:],
        seed=seed,
        faults=settings_from(Faults, faults),
        frame_id=frame_id,
    )
    return joined(list(batches))


def _noise_changes(sensor: str, given: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """Return ``given`` as a mapping by sensor or axis name, such as ``{'gyro_z': {'N': 0.3}}``."""
    expect(Mapping, 'a mapping of terms', **{sensor: given})
    is_by_axis = bool(given) and set(given) <= set('xyz')
    return {f'{sensor}_{axis}': given[axis] for axis in given} if is_by_axis else {sensor: given}
