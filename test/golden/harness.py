# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Golden results: every number of several recordings, stored in the folder ``expected``.

``make golden`` writes them, ``make golden-check`` and `test_golden.py` compare them with the
present results. A change of the code that should not change numbers must leave them as they are. A
change that should is followed by ``make golden``, and the differences are read before the commit.

The simulated samples are in ``inputs.npz`` (see ``inputs.py``). Real recordings are not part of the
package: only their results are stored, and they are skipped where the recordings are missing.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import allan_ros as ar

from .adapter import batch_of, numbers, statuses, write_bag
from .inputs import GRAVITY, PLACE

EXPECTED = Path(__file__).with_name('expected')

SHARED = Path(os.environ.get('ALLAN_ROS_SHARED', Path(__file__).parents[3] / 'shared')) / 'data'

DIGITS = 11
"""Significant digits of the stored numbers."""

TOLERANCE = 1e-9
"""Largest relative difference of two numbers that are the same."""

ROUNDING = 1e-5
"""Largest relative difference of fitted numbers between versions of numpy, which round differently:
the search for the maximum of the likelihood ends near 1e-6 of a coefficient."""

STRICT_ROUNDING = 1e-6
"""Largest relative difference of fitted numbers with one version of numpy on different processors,
which choose different instructions."""

FITTED = ('axes/*', 'findings/*', 'checks/*')
"""Paths of fitted numbers, except for the measured curves in `MEASURED`."""

MEASURED = ('tau', 'n', 'adev', 'low', 'high')

EXCEPTIONS = (
    # path, largest relative difference, reason
    ('*/fit/gof_z', 1e-4, 'a deviate near 0 has no relative precision'),
    ('*/growth/*', 1e-3, 'derived from the autocovariance of each process, by quadrature'),
    ('export/state_space/*', 0.02, 'states approximate flicker noise'),
    ('export/gazebo/*', 0.02, 'a Gauss-Markov process approximates the model'),
    ('export/kf_gins/*', 0.02, 'a Gauss-Markov process approximates the model'),
    ('export_as_measured/gazebo/*', 0.02, 'a Gauss-Markov process approximates the model'),
    ('export_as_measured/kf_gins/*', 0.02, 'a Gauss-Markov process approximates the model'),
    ('export/*', 1e-3, 'K is raised until it covers the error growth'),
    ('export_as_measured/*', 1.1e-5, 'the files have six digits'),
    ('status/*', 1.1e-2, 'the texts have three digits'),
)

GYRO, ACCEL = ('gx', 'gy', 'gz'), ('ax', 'ay', 'az')


class Samples(NamedTuple):
    """Samples (n, 6) in SI, their times in s, and temperatures in degC if there are any."""

    t: np.ndarray
    values: np.ndarray
    celsius: np.ndarray | None = None

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The columns of a table."""
        table = {'t': self.t, **dict(zip((*GYRO, *ACCEL), self.values.T))}
        return table if self.celsius is None else {**table, 'temperature': self.celsius}


def stored(name: str) -> Samples:
    """Return the simulated samples of this name."""
    with np.load(PLACE) as file:
        counts, step, rate = (file[key] for key in (name, f'{name}_step', f'{name}_rate'))
    values = counts * step
    values[:, 5] += GRAVITY
    t = np.arange(len(values)) / float(rate)
    return Samples(t, values[:, :6], values[:, 6] if values.shape[1] > 6 else None)


def analyzed(samples: Samples, **options: Any) -> dict[str, Any]:
    """Return the numbers of the samples, and of the statuses of nodes where they can run."""
    results = ar.analyze(samples.columns, **options)
    return {**numbers(results), **nodes(results, samples)}


def nodes(results: ar.Results, samples: Samples) -> dict[str, Any]:
    if find_spec('diagnostic_msgs') is None or samples.values.shape[1] < 6:
        return {}
    return {'status': statuses(results, [batch_of(np.rint(samples.t * 1e9), samples.values)])}


def simulated(name: str, **options: Any) -> Callable[[], dict[str, Any]]:
    """Return a function that analyzes the simulated samples of this name."""
    return lambda: analyzed(stored(name), **options)


def two_rates() -> dict[str, Any]:
    """Analyze an accelerometer whose samples are repeated three times."""
    samples = stored('processes')
    values = samples.values.copy()
    values[:, 3:] = np.repeat(values[::3, 3:], 3, axis=0)[: len(values)]
    return analyzed(Samples(samples.t, values))


def warm() -> dict[str, Any]:
    """Analyze a table with the temperature."""
    samples = stored('warm')
    with tempfile.TemporaryDirectory() as folder:
        path, columns = Path(folder) / 'warm.csv', samples.columns
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, '%.12g', ',', header=','.join(columns), comments='')
        results = ar.analyze(path)
    return {**numbers(results), **nodes(results, samples)}


def faulty() -> dict[str, Any]:
    """Analyze a bag with lost, repeated and damaged messages, beside the faults of the samples."""
    t, values, _ = stored('faulty')
    row = np.arange(len(t))
    t = t + 1e-3 * ((row * 7919 % 1000) / 1000.0 - 0.5)  # jitter
    values[20_500:20_503, 1] = np.nan
    kept = (row * 7919 % 97 != 0) & ~((row >= 5_000) & (row < 5_600))
    order = np.sort(np.r_[row[kept], row[kept][2_000:2_010]])  # ten messages are repeated
    t[order[13_000] :] += 3.0  # the clock is set
    known = Samples(t[order], values[order])
    batch = batch_of(1_700_000_000 * 10**9 + np.rint(known.t * 1e9), known.values)
    with tempfile.TemporaryDirectory() as folder:
        results = ar.analyze(write_bag(Path(folder) / 'faulty.mcap', batch))
        return {**numbers(results), **nodes(results, known)}


def three_days() -> dict[str, Any]:
    """Add three recordings, and compare them with a datasheet and with the first one."""
    days = [ar.analyze(stored(name).columns) for name in ('monday', 'tuesday', 'wednesday')]
    together = ar.analyze(days).compared(sensor='adis16475-3', baseline=days[0])
    return numbers(together)


def adis16405() -> dict[str, Any]:
    counts = np.load(SHARED / 'adis16405' / 'imu2_counts.npz')
    gyro, accel = np.deg2rad(counts['gyro'] * 0.05), counts['accel'] * 0.00333 * GRAVITY
    values = np.column_stack([gyro, accel])[:30_000].astype(float)
    return analyzed(Samples(np.arange(len(values)) / 100.0, values))


def adis16467() -> dict[str, Any]:
    known = np.load(SHARED / 'static' / 'adis16467_foot2.npz')
    gyro = known['gyro_counts'] * known['gyro_scale_rad_s']
    accel = known['accel_counts'] * known['accel_scale_m_s2']
    t = np.cumsum(known['dt_ms'].astype(float)) * 1e-3
    celsius = known['temp_dC'] * 0.1
    part = slice(0, 40_000)
    return analyzed(Samples(t[part], np.column_stack([gyro, accel])[part], celsius[part]))


def mpu6050() -> dict[str, Any]:
    table = np.load(SHARED / 'mpu6050.npz')['imu']
    results = ar.analyze(SHARED / 'mpu6050.npz', sensor='mpu-6050')
    return {**numbers(results), **nodes(results, Samples(table[:, 0], table[:, 1:]))}


@dataclass(frozen=True)
class Recording:
    """A recording: ``measure`` returns its numbers; ``file`` is in the shared data, if any."""

    measure: Callable[[], dict[str, Any]]
    file: str = ''

    @property
    def is_present(self) -> bool:
        return not self.file or (SHARED / self.file).is_file()


RECORDINGS: Mapping[str, Recording] = {
    'processes': Recording(simulated('processes')),
    'processes_least_squares': Recording(simulated('processes', method='paper')),
    'correlated': Recording(simulated('correlated')),
    'vibration': Recording(simulated('vibration', motion_gate=False)),
    'filtered': Recording(simulated('filtered')),
    'warm': Recording(warm),
    'two_rates': Recording(two_rates),
    'faulty': Recording(faulty),
    'three_days': Recording(three_days),
    'adis16405': Recording(adis16405, 'adis16405/imu2_counts.npz'),
    'adis16467': Recording(adis16467, 'static/adis16467_foot2.npz'),
    'mpu6050': Recording(mpu6050, 'mpu6050.npz'),
}


def flat(value: Any, path: str = '') -> Iterator[tuple[str, Any]]:
    """Yield each path in nested mappings, and the list of numbers or the text there."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from flat(inner, f'{path}/{key}' if path else str(key))
    elif isinstance(value, (str, bool)) or value is None:
        yield path, value if value is None else str(value)
    else:
        items = np.asarray(value, dtype=object).ravel().tolist()
        yield path, [_rounded(item) for item in items]


def _rounded(item: Any) -> Any:
    """Return a number with `DIGITS` digits; what is not finite, as text, because JSON has none."""
    if item is None or isinstance(item, (str, bool)):
        return item if item is None else str(item)
    number = float(item)
    return float(f'{number:.{DIGITS}g}') if math.isfinite(number) else str(number)


class Difference(NamedTuple):
    """A number or text that changed; ``change`` is relative, and None for texts."""

    path: str
    before: Any
    after: Any
    change: float | None = None

    def __str__(self) -> str:
        change = '' if self.change is None else f' ({self.change:.1e})'
        return f'{self.path}: {self.before} -> {self.after}{change}'


def tolerance_of(path: str, strict: bool = False) -> float:
    """Return the largest relative difference at this path; ``strict`` if numpy is the same."""
    for pattern, tolerance, _ in EXCEPTIONS:
        if fnmatchcase(path, pattern):
            return tolerance
    is_measured = '/curve/' in path and path.rpartition('/')[2] in MEASURED
    is_fitted = any(fnmatchcase(path, pattern) for pattern in FITTED) and not is_measured
    if not is_fitted:
        return TOLERANCE
    return STRICT_ROUNDING if strict else ROUNDING


def differences(
    before: Mapping[str, Any], after: Mapping[str, Any], strict: bool = False
) -> list[Difference]:
    """Compare two flat results: one difference per path, at its largest relative change.

    Statuses are not compared where nodes cannot run.
    """
    found = []
    have_status = any(path.startswith('status/') for path in after)
    for path in {**before, **after}:
        if path.startswith('status/') and not have_status:
            continue
        old, new = before.get(path, 'absent'), after.get(path, 'absent')
        if not (isinstance(old, list) and isinstance(new, list) and len(old) == len(new)):
            if old != new:
                found.append(Difference(path, _short(old), _short(new)))
            continue
        worst = None
        for a, b in zip(old, new):
            if a == b:
                continue
            both = isinstance(a, float | int) and isinstance(b, float | int)
            change = abs(a - b) / max(abs(a), abs(b)) if both else math.inf
            if change > tolerance_of(path, strict) and (worst is None or change > worst[2]):
                worst = (a, b, change)
        if worst is not None:
            found.append(Difference(path, *worst))
    return found


def _short(value: Any) -> Any:
    return value if not isinstance(value, list) or len(value) < 5 else f'{len(value)} numbers'


def measure(name: str) -> dict[str, Any]:
    """Return the flat numbers of a recording."""
    return dict(flat(RECORDINGS[name].measure()))


def read(name: str) -> dict[str, Any]:
    """Return the stored numbers of a recording; empty if there are none."""
    path = EXPECTED / f'{name}.json'
    return json.loads(path.read_text(encoding='utf-8')) if path.is_file() else {}


def write(name: str, found: Mapping[str, Any]) -> None:
    """Store the numbers of a recording, with one line per path."""
    EXPECTED.mkdir(exist_ok=True)
    lines = [f'{json.dumps(path)}: {json.dumps(value)}' for path, value in found.items()]
    path = EXPECTED / f'{name}.json'
    path.write_text('{\n' + ',\n'.join(lines) + '\n}\n', encoding='utf-8')


def main(arguments: list[str] | None = None) -> int:
    """Compare with the stored results, print each difference, and store the new ones if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('names', nargs='*', help='recordings (default: all)')
    parser.add_argument('--check', action='store_true', help='only compare; exit code 1 if changed')
    chosen = parser.parse_args(arguments)
    changed = 0
    for name in chosen.names or RECORDINGS:
        if not RECORDINGS[name].is_present:
            print(f'{name}: skipped: no shared data')
            continue
        found = measure(name)
        stored_numbers = read(name)
        differing = differences(stored_numbers, found, strict=True)
        beyond = len(differences(stored_numbers, found))
        changed += len(differing)
        print(f'{name}: {len(found)} paths, {len(differing)} differences, {beyond} beyond rounding')
        for each in differing:
            print(f'  {each}')
        if not chosen.check:
            write(name, found)
    return 1 if chosen.check and changed else 0


if __name__ == '__main__':
    sys.exit(main())
