# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Process a simulated month of one IMU as fast as possible, with the code of the node and `allan`.

The samples are white noise of a known N and a random walk of a known K on each axis, with drives,
knocks, gaps and other events of a robot. Once per simulated hour the sums are checkpointed and read
back; every twelve hours they are fitted.
"""

from __future__ import annotations

import gc
import json
import logging
import re
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from doc_table import DocTable

from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.simulate import LEVEL
from allan_ros.core.stream.health import Counts
from allan_ros.core.stream.pipeline import Accumulation, ImuStream
from allan_ros.io.checkpoint import Checkpoint
from allan_ros.io.documents import sums_file_from_document, sums_file_to_document
from allan_ros.io.files import read_json
from allan_ros.io.recorded import Provenance
from allan_ros.io.results import analyze_sums

RATE_HZ = 200.0
DAYS = 30
HOUR_S = 3600
N = np.array([5e-5] * 3 + [8e-4] * 3)
K = np.array([5e-7] * 3 + [1e-5] * 3)
"""White noise and random walk in rad/s/sqrt(Hz), rad/s^2/sqrt(Hz), m/s^2/sqrt(Hz) and
m/s^3/sqrt(Hz)."""
START_NS = 1_700_000_000 * 10**9
FIT_EVERY_H = 12

HEADING = (
    'day',
    'samples',
    'used',
    'segments',
    'resident, MB',
    'checkpoint, kB',
    'write and read back, s',
    'one fit, s',
    'CPU from batch to sums, us/sample',
    'N found / true, worst axis',
)
SHOWN_DAYS = (1, 2, 3, 5, 10, 15, 20, 25, 30)


@dataclass
class Robot:
    """Simulates one hour after another of a continuous recording."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(30))
    walk: np.ndarray = field(default_factory=lambda: np.zeros(6))
    clock_ns: int = START_NS

    def hour(self) -> Iterator[ImuBatch]:
        """Yield the batches of the next hour: a drive, knocks, gaps, NaN, a clock set back."""
        rng, tau0 = self.rng, 1.0 / RATE_HZ
        for _ in range(HOUR_S // 100):
            n = int(100 * RATE_HZ)
            steps = rng.standard_normal((n, 6)) * (K * np.sqrt(tau0))
            steps[0] += self.walk
            samples = np.cumsum(steps, axis=0)
            self.walk = samples[-1].copy()
            samples += rng.standard_normal((n, 6)) * (N / np.sqrt(tau0)) + np.array(LEVEL)
            stamps = self.clock_ns + np.arange(n) * round(1e9 * tau0)
            self.clock_ns += n * round(1e9 * tau0)
            yield self._disturbed(stamps, samples)

    def _disturbed(self, stamps: np.ndarray, samples: np.ndarray) -> ImuBatch:
        """Return the samples of 100 s with disturbances; comments state how often each occurs."""
        rng, n = self.rng, len(stamps)
        keep = np.ones(n, bool)
        if rng.random() < 1 / 36:  # a drive of half a minute, once an hour
            samples[: n // 3, :3] += rng.normal(0.0, 0.3, 3)
            samples[: n // 3] += rng.normal(0.0, [0.05] * 3 + [0.8] * 3, (n // 3, 6))
        if rng.random() < 1 / 18:  # a knock, twice an hour
            at = rng.integers(0, n - 40)
            samples[at : at + 40] += rng.normal(0.0, 1.0, (40, 6))
        if rng.random() < 0.25:  # single samples lost, nine times an hour
            keep[rng.integers(1, n, 2)] = False
        if rng.random() < 1 / 72:  # a gap of up to 10 s, twelve times a day
            at = rng.integers(1, n // 2)
            keep[at : at + rng.integers(10, 2000)] = False
        if rng.random() < 1 / 216:  # 20 samples that are not numbers, four times a day
            at = rng.integers(0, n - 20)
            samples[at : at + 20] = np.nan
        if rng.random() < 1 / 864:  # the clock is set back by 2 s, once a day
            self.clock_ns -= 2 * 10**9
        return ImuBatch(stamps[keep], samples[keep], frame_id='imu_link')


def resident_mb() -> float:
    """Return the resident memory of this process in MB."""
    gc.collect()
    found = re.search(r'VmRSS:\s+(\d+)', Path('/proc/self/status').read_text())
    return int(found[1]) / 1024 if found else float('nan')


def month() -> None:
    """Run the month, write the table, and print the growth of memory and time."""
    table = DocTable('soak month', HEADING)
    robot, accumulator = Robot(), ImuStream()
    began, way_s, sent = time.monotonic(), 0.0, 0
    days, memory = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'imu.json'
        checkpoint = Checkpoint(path, logging.getLogger('soak'))
        for day in range(1, DAYS + 1):
            save_s: list[float] = []
            fit_s: list[float] = []
            day_way_s, day_sent = 0.0, 0
            for hour in range(24):
                for batch in robot.hour():
                    at = time.process_time()
                    accumulator.update(batch)
                    day_way_s += time.process_time() - at
                    day_sent += len(batch)
                known = accumulator.result()
                _account(known.health.counts)
                save_s.append(_save_and_read(checkpoint, path, known))
                if hour % FIT_EVERY_H == FIT_EVERY_H - 1:
                    at = time.process_time()
                    results = analyze_sums(known.sums, Provenance(findings=known.findings))
                    fit_s.append(time.process_time() - at)
            way_s, sent = way_s + day_way_s, sent + day_sent
            ratios = [results.axes[a].fit.noise['N'].value / N[i] for i, a in enumerate(AXES)]
            memory.append(resident_mb())
            days.append(day)
            row = (
                str(day),
                str(sent),
                str(known.health.counts.used),
                str(known.sums[0].segment_count),
                f'{memory[-1]:.1f}',
                f'{path.stat().st_size / 1e3:.0f}',
                f'{np.median(save_s):.2f}',
                f'{np.median(fit_s):.2f}',
                f'{1e6 * day_way_s / day_sent:.3f}',
                f'{max(ratios, key=lambda r: abs(r - 1.0)):.5f}',
            )
            print(' | '.join(row), flush=True)
            if day in SHOWN_DAYS:
                table.put(row)
        checkpoint.close()
    slope = np.polyfit(days[2:], memory[2:], 1)[0]
    print(
        f'{sent} samples in {time.monotonic() - began:.0f} s, {way_s:.0f} s of CPU from batch to '
        f'sums; memory {slope:+.3f} MB a day from day 3 on'
    )
    print(known.health.counts)
    for axis, result in results.axes.items():
        print(axis, {t: (v.value, v.ci95) for t, v in result.fit.noise.items()})
    for found in results.findings:
        print(found)


def _account(counts: Counts) -> None:
    """Raise unless every sample is used or counted with a reason."""
    c = counts
    dropped = c.skipped + c.not_finite + c.duplicate + c.backward + c.untimed + c.moving + c.stuck
    if c.received + c.bridged != c.used + dropped:
        raise SystemExit(f'samples are unaccounted for: {c}')


def _save_and_read(checkpoint: Checkpoint, path: Path, known: Accumulation) -> float:
    """Write the sums as the node does, read them back, compare, and return the CPU time."""
    at = time.process_time()
    provenance = Provenance((), known.segments, known.findings, known.health.counts)
    total = checkpoint.total(known.sums, provenance)
    if not checkpoint.save(total):
        raise SystemExit(f'not saved: {checkpoint.findings}')
    read, _ = sums_file_from_document(read_json(path), str(path))
    took = time.process_time() - at
    written = sums_file_to_document(*total)['sums']
    if sums_file_to_document(read, Provenance())['sums'] != json.loads(json.dumps(written)):
        raise SystemExit('the checkpoint does not read as what was written')
    return took
