# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publish 1 kHz over DDS to allan_monitor for a given duration.

The samples are first written to a recording. The sums of the node must equal the sums of its
analysis.
"""

from __future__ import annotations

import json
import os
import signal
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from doc_table import DocTable
from offline_run import offline_sums
from online_nodes import Client, start

from allan_ros.core.imu import ImuBatch
from allan_ros.core.simulate import NoiseTerms, simulate_imu
from allan_ros.io.readers import open_recordings
from allan_ros.io.readers.cdr import encode_imus
from allan_ros.io.writing import write_recording

RATE_HZ = 1000.0
LENGTH_S = 1800.0
ROWS = 10
"""Number of rows of the table."""
GYRO, ACCEL = [NoiseTerms(N=5e-5, B=2e-5)] * 3, [NoiseTerms(N=8e-4, B=3e-4)] * 3

HEADING = (
    'min',
    'sent',
    'received',
    'lost',
    'resident, MB',
    'CPU, % of a core',
    'file handles',
    'threads',
)


def live(length_s: float = LENGTH_S) -> None:
    """Send in real time, write the table, and compare the sums at the end."""
    table = DocTable('soak live', HEADING)
    with tempfile.TemporaryDirectory() as folder:
        truth, checkpoint = Path(folder) / 'truth', Path(folder) / 'imu.json'
        write_recording(truth, simulate_imu(length_s, RATE_HZ, GYRO, ACCEL, start_ns=10**18))
        client = Client()
        monitor = start('monitor', ros=(f'checkpoint.path:={checkpoint}',))
        publisher, sent = client.publisher(), [0]
        thread = threading.Thread(target=_send, args=(publisher, truth, sent), daemon=True)
        began, cpu_s = time.monotonic(), monitor.cpu_s()
        thread.start()
        rows = []
        for _ in range(ROWS):
            at = time.monotonic()
            client.spin(length_s / ROWS)
            now_s = monitor.cpu_s()
            load, cpu_s = (now_s - cpu_s) / (time.monotonic() - at), now_s
            pid = monitor.popen.pid
            minutes = (time.monotonic() - began) / 60.0
            numbers = (minutes, monitor.memory_mb(), 100.0 * load)
            received, lost = (client.value('input', key) for key in ('received', 'lost on the way'))
            handles, threads = (len(os.listdir(f'/proc/{pid}/{x}')) for x in ('fd', 'task'))
            rows.append((*numbers, handles, threads))
            row = (f'{minutes:.0f}', str(sent[0]), received, lost, f'{numbers[1]:.1f}')
            row = (*row, f'{numbers[2]:.1f}', str(handles), str(threads))
            print(' | '.join(row), flush=True)
            table.put(row)
        thread.join()
        client.spin(2.0)
        code = monitor.end(signal.SIGINT)
        held = json.loads(checkpoint.read_text())['sums']
        equal = held == offline_sums(_batches(truth))
        verdict = 'the same, bit for bit' if equal else 'NOT THE SAME'
    minutes, memory, load, *_ = np.array(rows[ROWS // 5 :]).T
    print(
        f'{sent[0]} sent, {client.value("input", "received")} received; sums against the offline '
        f'run of what was sent: {verdict}; exit {code}; '
        f'after the first fifth memory {60 * np.polyfit(minutes, memory, 1)[0]:+.2f} MB an hour, '
        f'CPU {60 * np.polyfit(minutes, load, 1)[0]:+.2f} % of a core an hour'
    )


def _batches(path: Path) -> list[ImuBatch]:
    return list(open_recordings([path])[0].batches())


def _send(publisher: Any, truth: Path, sent: list[int]) -> None:
    """Publish each sample of the recording when it is due."""
    began = time.monotonic()
    for batch in _batches(truth):
        for payload in encode_imus(batch, 'cdr'):
            wait = began + sent[0] / RATE_HZ - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            publisher.publish(bytes(payload))
            sent[0] += 1
