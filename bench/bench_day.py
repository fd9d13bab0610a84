# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated day of a robot, without ROS: list and explain every change of the status.

    python bench/bench_day.py              24 hours at 100 Hz
    python bench/bench_day.py --hours 6    a part of the day

In the first hour, the robot is at rest. In every later hour, it drives for half an hour (drives of
120 s with 60 s of rest between them) and is at rest for half an hour. Each later hour has one
event: a fault, a fan or a restart of the node. The table has a line for each change of the warnings
and errors. A change is unexplained if it occurs neither during an event nor in the 30 s after it.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import time
from dataclasses import replace

import numpy as np
from bench_faults import (
    FAULTS,
    RATE,
    Input,
    Messages,
    messages_of,
    rounded,
    simulated,
    with_fault,
)

HOUR_S, DRIVES_S, DRIVE_S, CYCLE_S = 3600, 1800, 120, 180
"""Durations in s: an hour, the drives at its start, one drive, and a drive with the next rest."""

BEGIN_S, GRACE_S = 2400, 30
"""Time in s at which the fault of an hour begins, and time in s after the fault in which changes of
the status are explained."""

PUBLISH_S = 60
"""Period in s at which the Allan sums are computed."""

HAPPENS = [
    ('nothing', 0),
    ('stuck', 60),
    ('fan', 600),
    ('unit_g', 120),
    ('restart node', 0),
    ('held', 60),
    ('15_percent', 120),
    ('doubled', 300),
    ('every_second_zero', 40),
    ('unit_deg', 300),
    ('restart driving', 0),
    ('clipped', 60),
    ('no_gravity', 60),
    ('stamps_zero', 30),
    ('toggling', 120),
    ('dead_sensor', 60),
    ('fan', 60),
    ('stamps_equal', 30),
    ('dead', 600),
    ('uptime', 300),
    ('spikes', 300),
    ('15_percent', 900),
    ('fan', 900),
    ('stuck', 5),
]
"""Event of each hour, and its duration in s."""


def moving(second: int) -> bool:
    """Return whether the robot drives at a time, in s since the start of the day."""
    hour, at = divmod(second, HOUR_S)
    return hour > 0 and at < DRIVES_S and at % CYCLE_S < DRIVE_S


def driven(x: np.ndarray, first_s: int, rng: np.random.Generator) -> np.ndarray:
    """Return the samples, (n, 6), with the motion and the vibration of the drives added."""
    t = first_s + np.arange(len(x)) / RATE
    drives = np.repeat([moving(int(s)) for s in range(first_s, first_s + len(x) // RATE)], RATE)
    swing = np.sin(2 * np.pi * 0.3 * t)[:, None] * [0.02, 0.03, 0.4, 1.0, 0.5, 0.2]
    vibration = rng.normal(size=x.shape) * ([1e-2] * 3 + [0.3] * 3)
    return np.asarray(x + drives[:, None] * (swing + vibration))


def messages_of_hour(hour: int, bias: np.ndarray, rng: np.random.Generator) -> Messages:
    """Return the messages of an hour, with the fault of this hour."""
    what, lasts = HAPPENS[hour % len(HAPPENS)]
    x = simulated(HOUR_S, rng)
    messages = messages_of(rounded(driven(x - x.mean(axis=0) + bias, hour * HOUR_S, rng)))
    later_s = hour * HOUR_S
    messages = replace(
        messages,
        arrived_s=messages.arrived_s + later_s,
        stamps=messages.stamps + later_s * 10**9,
    )
    if what not in FAULTS:
        return messages
    return with_fault(messages, FAULTS[what], slice(BEGIN_S * RATE, (BEGIN_S + lasts) * RATE), rng)


def day(hours: int) -> None:
    """Simulate the hours of a day, and print the changes of the status."""
    rng = np.random.default_rng(1)
    bias = np.append(rng.normal(size=5) * ([2e-3] * 3 + [0.1] * 2), 9.8)
    live, shown = Input(PUBLISH_S), frozenset[str]()
    restarted_s, unexplained, changes = 0, 0, 0
    named: dict[int, int] = {}
    began = time.process_time()
    for hour in range(hours):
        what, lasts = HAPPENS[hour % len(HAPPENS)]
        fault = FAULTS.get(what)
        names = set(fault.names.split()) if fault is not None else set()
        messages = messages_of_hour(hour, bias, rng)
        live.begin_numbers()
        edges = np.searchsorted(messages.arrived_s, hour * HOUR_S + np.arange(HOUR_S + 1))
        for at, (first, last) in enumerate(itertools.pairwise(edges)):
            second = hour * HOUR_S + at
            if (what, at) in (('restart node', BEGIN_S), ('restart driving', 60)):
                live, restarted_s = Input(PUBLISH_S), second
            health, found = live.status(float(second + 1), messages.part(slice(first, last)))
            severe = frozenset(f.id for f in found if f.severity != 'info')
            happens = fault is not None and BEGIN_S <= at < BEGIN_S + lasts
            if happens and hour not in named and names & {f.id for f in found}:
                named[hour] = at + 1 - BEGIN_S
            if severe == shown:
                continue
            excused = happens or (fault is not None and 0 <= at - BEGIN_S - lasts < GRACE_S)
            excused |= second - restarted_s < GRACE_S
            changes, unexplained = changes + 1, unexplained + (not excused)
            clock = f'{hour:02}:{at // 60:02}:{at % 60:02}'
            text = ', '.join(sorted(severe)) or 'ok'
            cause = what if excused else 'UNEXPLAINED'
            print(f'{clock}  {health.state:16} {text:60} {cause}', flush=True)
            shown = severe
    result = live.stream.result()
    used = sum(s.samples for s in result.sums) / RATE
    print(f'\n{changes} changes, {unexplained} unexplained; {used:.0f} s at rest since the restart')
    for hour, (what, lasts) in enumerate(HAPPENS[:hours]):
        if what in FAULTS:
            after = f'{named[hour]} s' if hour in named else 'never'
            print(f'{hour:02}: {what} for {lasts} s: named after {after}')
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f'{time.process_time() - began:.0f} s CPU, largest memory {peak:.0f} MB')


def main() -> None:
    """Simulate as many hours as requested."""
    formatter = argparse.RawTextHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument('--hours', type=int, default=len(HAPPENS))
    day(parser.parse_args().hours)


if __name__ == '__main__':
    main()
