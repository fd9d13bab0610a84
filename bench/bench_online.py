# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of the nodes with real DDS: CPU time per message, messages lost in bursts, memory.

    python bench/bench_online.py             CPU and bursts, about 5 min
    python bench/bench_online.py memory 600  memory during 600 s at 4 kHz

The CPU time is compared with the CPU time of a subscriber that does nothing, in the same run and on
the same topic. A busy machine therefore changes the ratio little. The monitor is measured between
two fits.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from online_nodes import EMPTY_SUBSCRIBER, Client, Process, node

from allan_ros.core.noise import Model
from allan_ros.core.simulator import simulate_imu
from allan_ros.readers.cdr import encode_imus

RATES_HZ = (200, 1000, 4000)
SETTLE_S = 5.0
"""Time in s between the first fit of the monitor and the measurement."""
LONGEST_S = 600.0
"""Duration in s of the simulated recording, which is longer than a measurement."""
MEASURE_S = 20.0
ONE_FIT = ('estimator.growth:=10.0', 'publish.sums_period:=15.0')
"""Parameters that delay the second fit until after the measurement."""
BURST, BURST_PERIOD_S, BURSTS = 400, 0.2, 150
PATIENCE_S = 30.0
"""Longest time in s to wait until the statuses count all messages."""


def costs(client: Client, rate: int) -> list[float]:
    """Return the CPU time in us per message of empty subscriber, accumulator and monitor."""
    client.spin(2.0)  # receive the remaining messages of earlier nodes
    client.statuses.clear()
    empty = Process('-c', EMPTY_SUBSCRIBER)
    with (
        node('accumulator') as accumulator,
        node('monitor', ros=ONE_FIT) as monitor,
        node('play', '--simulate', str(LONGEST_S), '--frequency', str(rate), '--wait', '3'),
    ):
        while not client.message('gyro z').startswith('N '):
            client.spin(0.5)
        watched, age, cost = (empty, accumulator, monitor), 0.0, [0.0]
        while age < MEASURE_S:  # repeat if a fit ran during the measurement
            client.spin(SETTLE_S)
            before, began = [n.cpu_s() for n in watched], time.monotonic()
            client.spin(MEASURE_S)
            messages = rate * (time.monotonic() - began)
            cost = [(n.cpu_s() - b) / messages * 1e6 for n, b in zip(watched, before)]
            age = float(client.value('gyro z', 'fit age') or 0.0)
    empty.end()
    return cost


def cpu(client: Client) -> None:
    """Print the CPU time per message of accumulator, monitor and empty subscriber at each rate."""
    print('CPU per message in microseconds, and its ratio to the empty subscriber')
    print(f'{"":>8} {"empty":>8} {"accumulator":>12} {"ratio":>6} {"monitor":>8} {"ratio":>6}')
    for rate in RATES_HZ:
        cost = costs(client, rate)
        print(
            f'{rate:>5} Hz {cost[0]:8.1f} {cost[1]:12.1f} {cost[1] / cost[0]:6.2f} '
            f'{cost[2]:8.1f} {cost[2] / cost[0]:6.2f}',
            flush=True,
        )


def memory_after(client: Client, seconds: float, rate: int) -> float:
    """Return the memory of the monitor in MB after a number of seconds with messages."""
    with node('monitor') as monitor, node('play', '--simulate', '600', '--frequency', str(rate)):
        while not int(client.value('input', 'received') or 0):
            client.spin(0.2)
        client.spin(seconds)
        return monitor.memory_mb()


def bursts(client: Client) -> None:
    """Print how many messages of bursts of 400 the monitor receives and loses with default QoS."""
    terms = [Model.of(N=5e-5)] * 3
    client.spin(2.0)
    client.statuses.clear()
    with node('monitor'):
        publisher = client.publisher()
        sent = 0
        for batch in simulate_imu(BURST * BURSTS / 2000.0, 2000.0, terms, terms):
            payloads = encode_imus(batch, 'cdr')
            for first in range(0, len(payloads), BURST):
                due = time.monotonic() + BURST_PERIOD_S
                for payload in payloads[first : first + BURST]:
                    publisher.publish(bytes(payload))
                    sent += 1
                client.spin(due - time.monotonic())
        client.spin(1.0)
        publisher.publish(bytes(payloads[-1]))  # its sequence number reveals lost messages
        sent += 1
        counts = accounted(client, sent)
    shown = ', '.join(f'{count} {key}' for key, count in counts.items())
    print(f'bursts of {BURST} at 2 kHz mean: {sent} sent, {shown}')


def accounted(client: Client, sent: int) -> dict[str, int]:
    """Return the counts in the input status once their sum is ``sent``, or after `PATIENCE_S`."""
    keys = ('received', 'lost on the way', 'sent before')
    counts: dict[str, int] = {}
    end = time.monotonic() + PATIENCE_S
    while sum(counts.values()) < sent and time.monotonic() < end:
        client.spin(1.0)
        counts = {key: int(client.value('input', key) or 0) for key in keys}
    return counts


def memory(seconds: float) -> None:
    """Print the memory of the monitor while it receives messages at 4 kHz."""
    client = Client()
    length = str(seconds + 10.0)
    with node('monitor') as monitor, node('play', '--simulate', length, '--frequency', '4000'):
        for _ in range(10):
            client.spin(seconds / 10)
            received = client.value('input', 'received')
            lost = client.value('input', 'lost on the way')
            print(f'{received:>9} messages, {lost} lost: {monitor.memory_mb():6.1f} MB', flush=True)


if __name__ == '__main__':
    if sys.argv[1:2] == ['memory']:
        memory(float(sys.argv[2]))
    else:
        shared = Client()
        cpu(shared)
        bursts(shared)
