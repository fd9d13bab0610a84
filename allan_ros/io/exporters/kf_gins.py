# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""KF-GINS ``imunoise``: random walks in deg/sqrt(hr) and m/s/sqrt(hr), a Gauss-Markov bias.

src/kf_gins.cpp converts deg/sqrt(hr), m/s/sqrt(hr), deg/hr, mGal and hr to SI; the bias is a
first-order Gauss-Markov process with the noise 2 sigma^2 / corrtime
(src/kf-gins/gi_engine.cpp).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ...core.findings import finding
from ...core.imu import HOUR
from .model import FilterNoise, in_unit, rounded
from .target import Entry, Target
from .yaml_form import YamlForm

PARENT = ('imunoise',)

DEFAULT_HOURS = 4.0
"""corrtime of dataset/kf-gins.yaml."""

BIASES = {'gbstd': ('gyro', 'deg/h'), 'abstd': ('accel', 'mGal')}
"""Key -> the sensor whose bias it is, and its unit."""


def _entries(model: FilterNoise) -> Iterator[Entry]:
    for key, sensor, unit in (('arw', 'gyro', 'deg/sqrt(h)'), ('vrw', 'accel', 'm/s/sqrt(h)')):
        yield model.three((*PARENT, key), sensor, 'N', '', unit, in_unit(unit))
    for key, (sensor, unit) in BIASES.items():
        entry = model.three((*PARENT, key), sensor, 'bias', '', unit, in_unit(unit))
        flat = [level.axis for level in model.level(sensor, 'bias').levels if level.term == 'B']
        if flat:
            said = finding('export_no_gauss_markov', tuple(flat), key=key)
            entry = replace(entry, findings=(said,))
        yield entry
    yield _correlation_time(model)


def _correlation_time(model: FilterNoise) -> Entry:
    """Return the one correlation time of the file: the shortest found, as the bias moves most."""
    path = (*PARENT, 'corrtime')
    found = [
        (axis.fit.gauss_markov, name)
        for name, axis in model.results.axes.items()
        if axis.fit.gauss_markov is not None
    ]
    if not found:
        words = f'[h]: not measured; {DEFAULT_HOURS:g} h, unless your own file has another'
        return Entry(path, DEFAULT_HOURS, words, keep=True)
    process, name = min(found, key=lambda pair: pair[0].correlation_time)
    low, high = (end / HOUR for end in process.correlation_time_ci95)
    hours = process.correlation_time / HOUR
    words = f'[h] = correlation time of {name} {hours:.4g} h, 95 % interval {low:.4g} .. {high:.4g}'
    return Entry(path, rounded(hours), words)


TARGET = Target(
    'kf_gins_imu.yaml',
    'continuous random walks, and the standard deviation and correlation time of a first-order '
    'Gauss-Markov bias (src/kf_gins.cpp, src/kf-gins/gi_engine.cpp)',
    _entries,
    YamlForm(),
    three=True,
    notes=(
        'gbstd and abstd are also what the filter believes of the bias at the start: set '
        'initbgstd and initbastd, because a bias at switching on is mostly larger',
        'gsstd and asstd (scale factors) are no noise and not measured here',
        'x, y, z are those of the messages; KF-GINS wants forward, right, down',
    ),
)
