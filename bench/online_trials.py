# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trials over real DDS of some minutes each: identical sums, and restarts after kills.

python bench/online_trials.py identity   a bag played at 1x, 50x and full speed: equal sums
python bench/online_trials.py kills      20 kills (SIGKILL) at random moments of one run
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from doc_table import DocTable
from faults_network import TRANSPORT
from offline_run import offline_sums
from online_nodes import RELIABLE, Client, node, start

from allan_ros.core.allan.document import sums_from_document
from allan_ros.core.allan.running import RunningSums
from allan_ros.core.imu import AXES, ImuBatch
from allan_ros.core.simulate import NoiseTerms, simulate_imu
from allan_ros.io.readers import open_recordings
from allan_ros.io.writing import write_recording

GYRO, ACCEL = [NoiseTerms(N=5e-5, B=2e-5)] * 3, [NoiseTerms(N=8e-4, B=3e-4)] * 3
START_NS = 10**18
KILLS = 'kill', 'after', 'samples in the checkpoint', 'lost samples', 'duration'
RESTART_S = 12.0
"""Limit in s for a restart until the first checkpoint on a busy machine."""

BEST_EFFORT = 10
"""Number of passes played to a best-effort subscription."""


def identity(length_s: float = 120.0, rate: float = 200.0) -> None:
    """Compare the sums of a bag with gaps and knocks, played through DDS, with those offline."""
    with tempfile.TemporaryDirectory() as folder:
        bag, checkpoint = Path(folder) / 'bag', Path(folder) / 'sums.json'
        whole = next(simulate_imu(length_s, rate, GYRO, ACCEL, start_ns=START_NS))
        rng = np.random.default_rng(1)
        keep = np.ones(len(whole), bool)
        for at in rng.integers(2000, len(whole) - 2000, 4):
            keep[at : at + 300] = False  # gaps that split the segment
            whole.samples[at + 900 : at + 940] += rng.normal(0.0, 1.0, (40, 6))  # knocks
        keep[rng.integers(0, len(whole), 30)] = False  # lost samples that are interpolated
        batch = ImuBatch(whole.stamps_ns[keep], whole.samples[keep], frame_id='imu')
        write_recording(bag, [batch])
        expected = offline_sums(open_recordings([bag])[0].batches())
        client = Client()
        plays = [('1', RELIABLE), ('50', RELIABLE), ('0', RELIABLE), *[('50', ())] * BEST_EFFORT]
        for speed, ros in plays:
            checkpoint.unlink(missing_ok=True)
            client.statuses.clear()
            with node('accumulator', ros=(*ros, f'checkpoint.path:={checkpoint}')):
                with node('play', str(bag), '--rate', speed) as player:
                    while player.popen.poll() is None:
                        client.spin(0.5)
                client.spin(2.0)
                client.call('/allan_accumulator/save')
                keys = ('received', 'sent before', 'lost on the way')
                received, before, lost = (int(client.value('input', key)) for key in keys)
            document = json.loads(checkpoint.read_text())
            sums, spans = document['sums'], document['segments']
            last = max(span['start_ns'] + round(span['duration_s'] * 1e9) for span in spans)
            unseen = len(batch) - received - lost - before
            tail = int(np.count_nonzero(batch.stamps_ns > last))
            print(
                f'speed {speed:>2}, {"reliable" if ros else "best effort"}: {len(batch)} played, '
                f'{received} received, {lost} said to be lost, {before} sent before the first, '
                f'{unseen} unseen ({tail} after the last that came); '
                f'{len(sums[0]["segments"])} segments, bit-identical: {sums == expected}',
                flush=True,
            )


def kills(count: int = 20, speed: float = 10.0, rate: float = 200.0) -> None:
    """Kill the accumulator repeatedly while a bag plays, and account for every sample."""
    # A process that is killed while it has a lock in the shared memory of Fast DDS 2.14 blocks the
    # other processes permanently, including the player: observed at the 16th of 20 kills.
    os.environ.update(TRANSPORT)
    # reliable, but the player must not wait for acknowledgments of killed nodes
    forgetful = [
        f'qos_overrides./imu/data.publisher.{p}' for p in ('history:=keep_last', 'depth:=5000')
    ]
    rng = random.Random(4)
    pauses = [rng.uniform(0.0, 4.0) for _ in range(count)]
    length_s = (sum(pauses) + RESTART_S * count) * speed
    held = [0]
    with tempfile.TemporaryDirectory() as folder:
        bag, checkpoint = Path(folder) / 'bag', Path(folder) / 'sums.json'
        batches = list(simulate_imu(length_s, rate, GYRO, ACCEL, start_ns=START_NS))
        write_recording(bag, batches)
        ros = (RELIABLE[0], f'checkpoint.path:={checkpoint}', 'checkpoint.period:=0.5')
        accumulator = start('accumulator', ros=ros)
        with node('play', str(bag), '--rate', str(speed), ros=forgetful) as player:
            for pause in [*pauses, 0.0]:
                while _samples(checkpoint) <= held[-1]:
                    if player.popen.poll() is not None:
                        raise SystemExit(f'the recording is too short: {len(held) - 1} kills')
                    time.sleep(0.05)
                time.sleep(pause)
                if len(held) <= count:
                    accumulator.end(signal.SIGKILL)
                    held.append(_samples(checkpoint))
                    accumulator = start('accumulator', ros=ros)
        accumulator.end()
        document = json.loads(checkpoint.read_text())
    # the sums of the surviving segments of the bag in one complete run
    total = sums_from_document(document['sums'][0])
    spans = sorted(document['segments'], key=lambda span: span['start_ns'])
    stamps = np.concatenate([b.stamps_ns for b in batches])
    samples = np.concatenate([b.samples for b in batches])
    starts = np.searchsorted(stamps, [span['start_ns'] for span in spans])
    expected = RunningSums(total.identity, AXES)
    ends, kept = {0: 0}, 0  # number of kept samples -> position of the last of them in the bag
    for first, span in zip(starts, spans):
        rows = slice(first, first + span['samples'])
        expected.update(samples[rows], int(stamps[rows][0]), int(stamps[rows][-1]))
        expected.end_segment()
        kept += span['samples']
        ends[kept] = rows.stop
    table = DocTable('kills', KILLS)
    for number, (pause, in_file) in enumerate(zip(pauses, held[1:]), 1):
        end = ends[in_file]  # a checkpoint that is not a sum of complete segments would be a defect
        lost = int(starts[starts >= end][0]) - end
        cells = f'{pause:.1f} s', str(in_file), str(lost), f'{lost / rate / speed:.1f} s'
        table.put((str(number), *cells))
        print(number, *cells, sep=' | ')
    worst = float(np.max(np.abs(total.sum_sq / expected.sums.sum_sq - 1.0)))
    print(
        f'{total.samples} samples in {total.segment_count} segments of the final sums, '
        f'{document["counts"]["bridged"]} of them interpolated for messages lost on the way; '
        f'counts equal those of the surviving spans: '
        f'{bool(np.array_equal(total.count, expected.sums.count))}; '
        f'largest relative difference of the sums: {worst:.1e}'
    )


def _samples(checkpoint: Path) -> int:
    if not checkpoint.exists():
        return 0
    return int(sums_from_document(json.loads(checkpoint.read_text())['sums'][0]).samples)


if __name__ == '__main__':
    trials = {'identity': identity, 'kills': kills}
    if sys.argv[1:2] and sys.argv[1] in trials:
        trials[sys.argv[1]]()
    else:
        print(__doc__)
