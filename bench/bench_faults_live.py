# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The faults of bench_faults.py in real time, published to a monitor over DDS.

    python bench/bench_faults_live.py                  20 cells, 6 at a time, about 25 min
    python bench/bench_faults_live.py --cells 40 --seed 7 --together 5

The cells of the table of bench_faults.py are drawn at random. The line of a cell states the time
in s until a status named the fault, the time in s from the end of the fault to the last time with a
warning, an error or another state than at rest, and the largest error of the published N of an axis
in percent. The limits are the limits of bench_faults.py, and 3 % for N.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from bench_faults import (
    FAULTS,
    HEALED_S,
    LSB,
    NAMED_S,
    RATE,
    RIGHT,
    SIGMA,
    START_NS,
    Course,
    Messages,
    cells,
    has_name,
)
from online_nodes import Client, node

from allan_ros.core.imu import AXES, ImuBatch

FIRST_DOMAIN, DOMAINS = 40, 60
"""First ROS domain that is used, and number of domains. Cells that run together share no domain."""


def shown(client: Client) -> tuple[set[str], list[str], str]:
    """Return the ids of all findings, the texts of all warnings and errors, and the input state."""
    ids, troubles, state = set(), [], ''
    for name, status in client.statuses.items():
        for pair in status.values:
            if pair.key.startswith('finding'):
                ids |= {pair.value, pair.key.removeprefix('finding: ')}
            elif pair.key == 'state' and name.endswith('input'):
                state = pair.value
        if status.level > b'\x00':
            troubles.append(f'{name.rpartition(": ")[2]}: {status.message}')
    return ids, troubles, state


def largest_error(client: Client) -> float:
    """Return the largest deviation of a published N from the truth in percent; NaN without N."""
    found = []
    truths = np.sqrt(SIGMA**2 + LSB**2 / 12) / RATE**0.5
    for axis, truth in zip(AXES, truths):
        text = client.value(axis.replace('_', ' '), 'N [')  # the first value of N is in SI
        if text and text[0].isdigit():
            found.append(float(text) / truth - 1.0)
    return 100.0 * max(map(abs, found), default=float('nan'))


def cell(name: str, at_boot: bool, lasts_s: int | None, seed: int) -> str:
    """Publish messages with a fault to a monitor, and return a line about its statuses."""
    from allan_ros.readers.cdr import encode_imus

    fault = FAULTS[name]
    course = Course.of(fault, at_boot, lasts_s, seed)
    begin_s, end_s, sent = course.begin_s, course.end_s, since_now(course.messages)
    payloads = encode_imus(ImuBatch(sent.stamps, sent.samples), 'cdr')
    names = set(fault.names.split())
    named, ill, said = float('inf'), 0.0, Counter[str]()
    with node('monitor'):
        client = Client()
        publisher = client.publisher()
        start, at, second = time.monotonic(), 0, 0
        while at < len(payloads) or second < course.seconds:
            now = time.monotonic() - start
            while at < len(payloads) and sent.arrived_s[at] <= now:
                publisher.publish(bytes(payloads[at]))
                at += 1
            if now > second:
                second += 1
                ids, troubles, state = shown(client)
                if now > begin_s and names & {*ids, f'state:{state}'}:
                    named = min(named, now - begin_s)
                if troubles or state not in ('', 'at_rest'):
                    ill = now
                if lasts_s and now > end_s + HEALED_S:
                    said.update(troubles or ([state] if state != 'at_rest' else []))
            client.spin(0.02)
        client.spin(2.0)
        error = largest_error(client)
    can_be_named = has_name(fault, at_boot)
    parts = [f'named {named:4.0f} s' if can_be_named else 'named    –  ']
    if lasts_s:
        parts += [f'healed {max(0.0, ill - end_s):4.0f} s', f'N {error:4.1f} %']
    in_time = not can_be_named or named <= NAMED_S + 1.0  # statuses have a period of 1 s
    heals = not lasts_s or (ill <= end_s + HEALED_S and error <= 100.0 * RIGHT)
    left = '; '.join(f'{text} ({count} s)' for text, count in said.most_common(2))
    return '  '.join([*parts, 'ok' if in_time and heals else 'MISSED', left])


def since_now(messages: Messages) -> Messages:
    """Return the messages with their stamps shifted to the present; faulty stamps are kept."""
    shift = time.time_ns() - START_NS
    near = np.abs(messages.stamps - START_NS) < 10**14
    return replace(messages, stamps=messages.stamps + shift * near)


def main() -> None:
    """Run cells in separate processes, and print a line for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument('--cells', type=int, default=20, help='how many cells (default 20)')
    parser.add_argument('--seed', type=int, default=0, help='of the choice and of the noise')
    parser.add_argument('--together', type=int, default=6, help='cells at a time (default 6)')
    parser.add_argument('--one', nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        name, begin, lasts = options.one
        print(cell(name, begin == 'boot', int(lasts) or None, options.seed))
        return
    columns = list(cells(['boot', 'mid']))
    every = [(name, column, boot, lasts) for name in FAULTS for column, boot, lasts in columns]
    drawn = random.Random(options.seed).sample(every, options.cells)

    def in_process(item: tuple[int, tuple[str, str, bool, int | None]]) -> str:
        number, (name, column, boot, lasts) = item
        command = [sys.executable, __file__, '--seed', str(options.seed)]
        command += ['--one', name, 'boot' if boot else 'mid', str(lasts or 0)]
        domain = str(FIRST_DOMAIN + number % DOMAINS)
        run = subprocess.run(
            command,
            env={**os.environ, 'ROS_DOMAIN_ID': domain},
            capture_output=True,
            text=True,
        )
        lines = (run.stdout or run.stderr).strip().splitlines()
        return f'{name:18} {column:12} {lines[-1] if lines else "no output"}'

    with ThreadPoolExecutor(options.together) as pool:
        for line in pool.map(in_process, enumerate(drawn)):
            print(line, flush=True)


if __name__ == '__main__':
    main()
