# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What becomes of every fault of an IMU: is it named, does the stream heal, are good data used?

    python bench/bench_faults.py                          all faults, 5 seeds
    python bench/bench_faults.py frozen 15_percent --seeds 2 --begins boot

The samples pass `ImuStream`, `ConstantAxes` and `TransportMonitor` as in a node, one second at a
time, without ROS. Each cell of the table has four numbers in percent of the seeds: the fault is
named within 10 s; no finding names it any more from 30 s after its end; N of all axes is right at
the end; and at least 90 % of the good data are used. A dash marks what a cell cannot have: a fault
that lasts does not heal, and has no good data if it lasts from boot.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from allan_ros.core.findings import Finding, finding
from allan_ros.core.imu import AXES, STANDARD_GRAVITY, ImuBatch
from allan_ros.core.stream.health import Accumulation, StreamHealth
from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.core.stream.present_faults import noise_now
from allan_ros.core.stream.transport import ConstantAxes, TransportMonitor, TransportStatistics

RATE = 100
"""Sample rate in Hz."""

BEGIN_S, AFTER_S = 120, 180
"""Time before a fault in mid-run, and after one that heals, in s."""

DURATIONS_S = 30, 120
"""Times after which a fault heals, in s."""

LASTING_S = 180
"""Time for which a fault that lasts is watched, in s."""

NAMED_S, HEALED_S, USED_SHARE = 10.0, 30.0, 0.9
"""Goals: time to the first finding and from the end of a fault to the last one, in s, and share of
the good data in the sums."""

N_ERROR = 0.03
"""Largest relative error of the white noise: five standard deviations of that of 120 s."""

START_NS = 1_700_000_000_000_000_000

SIGMA = np.array([1.5e-3] * 3 + [2e-2] * 3)
LSB = np.array([np.radians(1 / 131)] * 3 + [STANDARD_GRAVITY / 16384] * 3)

Samples = np.ndarray
Change = Callable[[Samples, np.random.Generator], Samples]


def simulated(seconds: float, rng: np.random.Generator) -> Samples:
    """Return samples of an IMU at rest with a bias and a drift, before rounding, (n, 6)."""
    n = round(seconds * RATE)
    bias = np.append(rng.normal(size=5) * ([2e-3] * 3 + [0.1] * 2), 9.8)
    drift = rng.normal(size=6) * ([1e-3] * 3 + [1e-2] * 3)
    return bias + np.linspace(0.0, 1.0, n)[:, None] * drift + SIGMA * rng.normal(size=(n, 6))


def rounded(x: Samples) -> Samples:
    """Return samples with a resolution of 16 bits."""
    return np.asarray(np.round(x / LSB) * LSB)


def of_axes(axes: list[int], change: Change) -> Change:
    """Return the change of some axes only."""

    def changed(x: Samples, rng: np.random.Generator) -> Samples:
        out = x.copy()
        out[:, axes] = change(x, rng)[:, axes]
        return out

    return changed


GYRO, ACCEL, ALL = [0, 1, 2], [3, 4, 5], [0, 1, 2, 3, 4, 5]


def scaled(factors: list[float]) -> Change:
    """Return the change by a factor per axis, as by another unit of measurement."""
    return lambda x, rng: x * factors


def every_second(x: Samples) -> Samples:
    """Return a flag for every second sample, (n, 1)."""
    return np.arange(len(x))[:, None] % 2 == 1


def vibration(x: Samples) -> Samples:
    """Return a vibration of 31 Hz with three times the noise, (n, 6)."""
    return 3.0 * SIGMA * np.sin(2 * np.pi * 31.0 * np.arange(len(x))[:, None] / RATE + np.arange(6))


@dataclass(frozen=True)
class Fault:
    """A fault: the change of its samples, or of their stamps, and the findings that name it.

    ``is_fault`` is False if the data remain good. ``noise_changes`` if they remain white noise of
    another level, which becomes normal if it lasts.
    """

    names: str
    change: Change = lambda x, rng: x
    stamps: Callable[[np.ndarray], np.ndarray] = lambda t: t
    is_fault: bool = True
    noise_changes: bool = False


FAULTS = {
    'frozen': Fault('stuck stuck_now no_noise', of_axes([1], lambda x, rng: x[:1] + 0 * x)),
    'dead': Fault('stuck stuck_now no_noise', of_axes([1], lambda x, rng: 0 * x)),
    'zero_filled': Fault(
        'stuck stuck_now no_noise sensor_all_zero', of_axes(GYRO, lambda x, rng: 0 * x)
    ),
    'every_second_zero': Fault(
        'zero_filled', of_axes(ACCEL, lambda x, rng: np.where(every_second(x), 0.0, x))
    ),
    'held': Fault('held repeated', of_axes(ACCEL, lambda x, rng: x[np.arange(len(x)) // 2 * 2])),
    '15_percent': Fault(
        'noise_decreased',
        lambda x, rng: x.mean(0) + 0.15 * (x - x.mean(0)),
        noise_changes=True,
    ),
    'clipped': Fault(
        'clipped stuck noise_decreased',
        of_axes([5], lambda x, rng: np.minimum(x, np.quantile(x, 0.02, axis=0))),
        noise_changes=True,
    ),
    'toggling': Fault(
        'noise_decreased stuck',
        of_axes(GYRO, lambda x, rng: LSB * (rng.random(x.shape) < 0.3)),
        noise_changes=True,
    ),
    'unit_g': Fault('accel_unit', scaled([1] * 3 + [1 / STANDARD_GRAVITY] * 3)),
    'unit_deg': Fault('gyro_unit gyro_unit_changed', scaled([np.degrees(1)] * 3 + [1] * 3)),
    'no_gravity': Fault('gravity_removed', lambda x, rng: x - [0, 0, 0, 0, 0, STANDARD_GRAVITY]),
    'stamps_zero': Fault('stamps_missing input_unusable', stamps=lambda t: 0 * t),
    'stamps_equal': Fault('stamps_missing input_unusable', stamps=lambda t: t[:1] + 0 * t),
    'restart': Fault('clock_jumps', stamps=lambda t: t - START_NS + 10**9, is_fault=False),
    'spikes': Fault(
        'spikes',
        of_axes([1], lambda x, rng: x + 50 * SIGMA * (rng.random(x.shape) < 0.005)),
        is_fault=False,
        noise_changes=True,
    ),
    'doubled': Fault(
        'noise_increased noise_now',
        lambda x, rng: x.mean(0) + 2.0 * (x - x.mean(0)),
        is_fault=False,
        noise_changes=True,
    ),
    'fan': Fault(
        'noise_increased noise_now',
        lambda x, rng: x + vibration(x) + 3 * SIGMA * rng.normal(size=x.shape),
        noise_changes=True,
    ),
}


@dataclass
class Seen:
    """What the status of a node showed, once a second: findings, state, and sums at the end."""

    findings: list[set[str]] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    result: Accumulation | None = None


class Input:
    """The input of a node without ROS: its stream, and the findings of its status."""

    def __init__(self, publish_s: int = 10) -> None:
        self.stream = ImuStream()
        self._publish_s = publish_s  # period in s at which the sums are computed
        self._monitor = TransportMonitor('imu/data', 0.0)
        self._constant = ConstantAxes()
        self._statistics = TransportStatistics()
        self._sums = self.stream.result().sums
        self._events: object = None

    def status(self, time_s: float, batch: ImuBatch) -> tuple[StreamHealth, tuple[Finding, ...]]:
        """Process the samples of a second, and return the health and the findings of the status."""
        self.stream.update(batch)
        self._constant.update(batch.samples)
        self._statistics.received += len(batch)
        health, found = self.stream.present_health(self._sums)
        c = health.counts
        events = health.state, health.discarded, sum(c.splits.values()), c.used > 0
        if (
            events != self._events or round(time_s) % self._publish_s == 0
        ):  # and for each publication
            self._events = events
            result = self.stream.result()
            self._sums, health, found = result.sums, result.health, result.findings
        if health.rate_hz and (stuck := self._constant.stuck(health.rate_hz)):
            found = *found, finding('stuck_now', stuck)
        found = self._monitor.observe(
            time_s, self._statistics, health, ('driver',), 5.0, tuple(found)
        )
        return health, (*found, *noise_now(health, self._sums))


def watched(stamps: np.ndarray, samples: Samples) -> Seen:
    """Return what is seen of a stream in steps of a second."""
    live, seen = Input(), Seen()
    for second, at in enumerate(range(0, len(samples), RATE), start=1):
        rows = slice(at, at + RATE)
        health, found = live.status(float(second), ImuBatch(stamps[rows], samples[rows]))
        seen.findings.append({each.id for each in found})
        seen.states.append(health.state)
    live.stream.end()
    seen.result = live.stream.result()
    return seen


@dataclass(frozen=True)
class Outcome:
    """What a run showed; None for what it cannot have. Times in s, ``error`` relative."""

    named_s: float | None
    healed_s: float | None
    error: float | None
    used: float | None

    @property
    def flags(self) -> tuple[bool | None, ...]:
        """Whether each goal is reached."""
        limits = (NAMED_S, HEALED_S, N_ERROR)
        values = (self.named_s, self.healed_s, self.error)
        flags = [None if v is None else v <= limit for v, limit in zip(values, limits)]
        return *flags, None if self.used is None else self.used >= USED_SHARE


def run(fault: Fault, begin_s: int, lasts_s: int | None, seed: int) -> Outcome:
    """Simulate a fault from a time on, which heals unless ``lasts_s`` is None."""
    rng = np.random.default_rng([seed, begin_s, lasts_s or 0])
    end_s = begin_s + (lasts_s or LASTING_S)
    x = simulated(end_s + (AFTER_S if lasts_s else 0), rng)
    stamps = START_NS + np.arange(len(x)) * (10**9 // RATE)
    inside = slice(begin_s * RATE, end_s * RATE)
    x, good = rounded(x), len(x)
    x[inside] = fault.change(x[inside], rng)
    stamps[inside] = fault.stamps(stamps[inside])
    seen = watched(stamps, x)
    assert seen.result is not None
    names = set(fault.names.split())
    times = [s for s, ids in enumerate(seen.findings, start=1) if ids & names]
    named = next((s - begin_s for s in times if s > begin_s), np.inf)
    bad_states = ('noise_increased', 'noise_decreased', 'moving', 'waiting', 'learning')
    ill = [s for s, state in enumerate(seen.states, start=1) if state in bad_states]
    past = {'stuck', 'clock_jumps', 'backward_stamps', 'spikes'}  # events of the last minute
    still = [s for s, ids in enumerate(seen.findings, start=1) if ids & (names - past)]
    healed = max([s - end_s for s in (*still, *ill)], default=0.0) if lasts_s else None
    if healed is not None:
        healed = max(healed, 0)
    if fault.is_fault:
        good -= inside.stop - inside.start
    sums = max(seen.result.sums, key=lambda s: s.samples, default=None)
    error = used = None
    if good and sums is not None:
        used = sum(s.samples for s in seen.result.sums if 'gyro_x' in s.axes) / good
    elif good:
        used = 0.0
    # noise that lasts longer than the time before is regarded as that of the IMU
    another_noise = fault.noise_changes and not (lasts_s and fault.is_fault)
    if another_noise:
        used = None
    elif good:
        error = np.inf
        known = {axis: s.avar[0][i] for s in seen.result.sums for i, axis in enumerate(s.axes)}
        if set(known) == set(AXES):
            ratio = np.array([known[axis] for axis in AXES]) / (SIGMA**2 + LSB**2 / 12)
            error = float(np.abs(np.sqrt(ratio) - 1.0).max())
    return Outcome(named, healed, error, used)


def cells(begins: list[str]) -> Iterator[tuple[str, int, int | None]]:
    """Yield the name of each column, the begin of the fault in s, and its duration in s."""
    for begin in begins:
        for lasts in (None, *DURATIONS_S):
            at = 0 if begin == 'boot' else BEGIN_S
            yield f'{begin} {f"{lasts} s" if lasts else "lasting"}', at, lasts


def shares(outcomes: list[Outcome]) -> str:
    """Return the shares of the runs that reached each goal, in percent."""
    columns = zip(*(outcome.flags for outcome in outcomes))
    return ' '.join(
        f'{"-":>3}' if None in flags else f'{100 * np.mean(flags):3.0f}'
        for flags in map(list, columns)
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument('faults', nargs='*', metavar='FAULT', help=', '.join(FAULTS))
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--begins', nargs='+', default=['boot', 'mid'], choices=['boot', 'mid'])
    parser.add_argument('--numbers', action='store_true', help='also print each run')
    options = parser.parse_args()
    columns = list(cells(options.begins))
    print(f'{"":18}' + '  '.join(f'{name:15}' for name, *_ in columns))
    for name in options.faults or FAULTS:
        row = []
        for column, begin, lasts in columns:
            runs = [run(FAULTS[name], begin, lasts, seed) for seed in range(options.seeds)]
            row.append(shares(runs))
            if options.numbers:
                for each in runs:
                    print('   ', column, each)
        print(f'{name:18}' + '  '.join(f'{each:15}' for each in row), flush=True)


if __name__ == '__main__':
    main()
