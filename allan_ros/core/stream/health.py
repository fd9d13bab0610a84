# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts, segments, state and findings of a stream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..imu import SENSORS, STANDARD_GRAVITY, sensor_of
from ..settings import SegmenterSettings

State = Literal['waiting', 'learning', 'still', 'moving', 'louder']
"""No sample yet; the rate and the noise floor are learned; data at rest accumulate; the IMU moves;
it is at rest, but its noise became louder."""

RATE_CHANGE = 0.02
"""Relative change of the sample period that means another rate."""

REPORTED_BRIDGED_SHARE = 1e-3
"""Least share of interpolated samples that is reported."""

LOUDER_SHARE = 0.5
"""Axes with this share of the largest increase of noise are named."""

SHORT_S = 60.0
"""Less than a minute of data does not even give N within a few percent."""

LEAST_SPIKES, LEAST_SPIKE_SHARE = 3, 1e-6
"""Fewest isolated spikes, and their least share of the samples, that are reported: white noise has
less than 1e-7."""

LARGEST_N, LARGEST_REST_RATE = 3e-3, 0.2
"""Angle random walk in rad/s/sqrt(Hz) (10 deg/sqrt(h)) and mean rate at rest in rad/s (11 deg/s)
that gyros do not reach."""

G_BAND = 0.15
"""Relative tolerance within which a mean acceleration is gravity."""

WEIGHTLESS = 0.05
"""Mean acceleration, as a fraction of that of gravity in any unit, below which it was removed."""


@dataclass
class Counts:
    """What happened to the samples since the start of a stream.

    Where the sensors have different rates all but ``received`` and ``skipped`` are counted per
    sensor stream. received + bridged = used + skipped + not_finite + duplicate + backward +
    untimed + moving + stuck + louder + those still buffered.

    Attributes
    ----------
    received, used : int
        Samples received, and samples in the sums (interpolated ones included).
    skipped : int
        Left out at the start (warm-up).
    not_finite, duplicate, backward : int
        Dropped: NaN or inf; stamp and values of the sample before; a stamp before the latest.
    untimed : int
        Dropped because a thousand stamps in a row were equal.
    lost : int
        Samples that are missing according to the stamps.
    bridged : int
        Lost ones that were interpolated.
    moving, stuck : int
        Dropped because the IMU moved, or an axis showed one value.
    saturated : int
        Of the moving ones, those at the end of the measurement range.
    louder : int
        Dropped because the noise at rest was much louder than the noise floor.
    spikes : int
        Values that were isolated spikes and were replaced, counted per axis.
    cuts : Counter
        Reason -> how many times the data were split.
    """

    received: int = 0
    used: int = 0
    skipped: int = 0
    not_finite: int = 0
    duplicate: int = 0
    backward: int = 0
    untimed: int = 0
    lost: int = 0
    bridged: int = 0
    moving: int = 0
    stuck: int = 0
    saturated: int = 0
    louder: int = 0
    spikes: int = 0
    cuts: Counter[str] = field(default_factory=Counter)

    def add(self, other: Counts) -> None:
        """Add the counts of another sensor stream."""
        for f in fields(self):
            if f.name != 'cuts':
                setattr(self, f.name, getattr(self, f.name) + getattr(other, f.name))
        self.cuts.update(other.cuts)


class Segment(NamedTuple):
    """A stretch of samples without a gap.

    Attributes
    ----------
    start_ns : int
        Stamp of its first sample.
    samples : int
    duration_s : float
    cut : str
        Why it does not follow the previous one, as in ``Counts.cuts``; '' for the first.
    """

    start_ns: int
    samples: int
    duration_s: float
    cut: str = ''


@dataclass(frozen=True)
class StreamHealth:
    """State and counts of a stream.

    Attributes
    ----------
    counts : Counts
        A copy; later samples do not change it.
    state : State
    rate_hz : float or None
        From the working period of the stamps; None before it is learned.
    bursty : bool
        Whether stamps come in bursts.
    first_ns, last_ns : int or None
        First and latest stamp of the present frame.
    stamps : str
        Which stamps are used: 'header' or 'record'.
    frame_id : str
        Of the latest sample.
    evidence_frame_id : str
        Of the sums with the longest time.
    frame_changes : int
        How often a sample had another frame_id than the one before.
    discarded : int
        How often sums were discarded since the start, because they were taken in motion: results
        computed from earlier sums are void.
    loudest : mapping of axis to float
        How many times louder than its floor an axis became at rest; empty if none did.
    """

    counts: Counts
    state: State = 'waiting'
    rate_hz: float | None = None
    bursty: bool = False
    first_ns: int | None = None
    last_ns: int | None = None
    stamps: str = 'header'
    frame_id: str = ''
    evidence_frame_id: str = ''
    frame_changes: int = 0
    discarded: int = 0
    loudest: Mapping[str, float] = field(default_factory=dict)

    @property
    def still_share(self) -> float | None:
        """Share of the samples that were at rest; None before any was classified."""
        c = self.counts
        judged = c.used + c.moving + c.stuck + c.louder
        return c.used / judged if judged else None


def stream_findings(
    health: StreamHealth, sums: tuple[AllanSums, ...], settings: SegmenterSettings
) -> list[Finding]:
    """Return the findings about a stream and its sums."""
    counts = health.counts
    found: list[Finding] = []
    rate = 1.0 / sums[0].tau0 if sums and sums[0].tau0 else health.rate_hz
    declared = settings.declared_rate
    if declared and rate and abs(rate / declared - 1.0) > RATE_CHANGE:
        found.append(finding('rate_differs', measured=rate, declared=declared))
    if health.bursty and rate:
        found.append(finding('bursty_stamps', rate=rate))
    if changes := counts.cuts['rate change']:
        found.append(finding('rate_changed', times=changes, rate=health.rate_hz or 0.0))
    for name, count in (
        ('not_finite', counts.not_finite),
        ('duplicates', counts.duplicate),
        ('backward_stamps', counts.backward),
        ('clock_jumps', counts.cuts['clock jump']),
        ('stuck', counts.stuck),
        ('saturated', counts.saturated),
    ):
        if count:
            found.append(finding(name, count=count))
    if counts.cuts['gap']:
        found.append(finding('gaps', lost=counts.lost, cuts=counts.cuts['gap']))
    if counts.bridged > REPORTED_BRIDGED_SHARE * counts.received:
        share = counts.bridged / counts.received
        found.append(finding('bridged', bridged=counts.bridged, share=share))
    if counts.spikes >= max(LEAST_SPIKES, LEAST_SPIKE_SHARE * counts.used):
        found.append(finding('spikes', count=counts.spikes, share=counts.spikes / counts.used))
    if health.discarded:
        found.append(finding('relearned'))
    if counts.louder and health.rate_hz and health.loudest:
        ratio = max(health.loudest.values())
        axes = tuple(axis for axis, r in health.loudest.items() if r > LOUDER_SHARE * ratio)
        seconds = counts.louder / health.rate_hz
        found.append(finding('noise_louder', axes, ratio=ratio, seconds=seconds))
    if counts.moving and not counts.used and health.rate_hz:
        found.append(finding('never_still', seconds=counts.moving / health.rate_hz))
    elif counts.moving:
        judged = counts.moving + counts.louder + counts.used
        found.append(finding('motion', share=counts.moving / judged))
    for each in sums:
        flat = tuple(np.array(each.axes)[each.sum_sq[0] == 0.0].tolist()) if len(each.m) else ()
        if flat:
            found.append(finding('no_noise', flat))
        found += _unit_findings(each)
    if counts.received and not sums:
        found.append(finding('nothing_left', received=counts.received))
    return found


def sums_findings(sums: AllanSums) -> list[Finding]:
    """Return the findings on the sums of all recordings."""
    seconds = sums.elapsed_ns * 1e-9
    return [finding('short', seconds=seconds)] if seconds < SHORT_S else []


def _unit_findings(sums: AllanSums) -> list[Finding]:
    """Return a finding for each sensor whose values at rest are impossible in SI units."""
    if not sums.tau0 or not sums.history.recordings:
        return []
    mean = _mean_at_rest(sums)
    short = sums.m * sums.tau0 <= 1.0
    found: list[Finding] = []
    for sensor, place in SENSORS.items():
        own = [i for i, axis in enumerate(sums.axes) if sensor_of(axis) == sensor]
        axes = tuple(sums.axes[i] for i in own)
        if sensor == 'gyro' and own:
            rate = float(np.abs(mean[own]).max())
            tau = sums.m[short, None] * sums.tau0
            level = np.sqrt(sums.avar[short][:, own] * tau)
            n = float(np.median(level.min(axis=0))) if len(tau) else 0.0
            if n > LARGEST_N or rate > LARGEST_REST_RATE:
                found.append(finding('gyro_unit', axes, n=n, rate=rate))
        elif len(own) == place.stop - place.start:
            norm = float(np.linalg.norm(mean[own]))
            unit = gravity_unit(norm)
            if unit is None:
                found.append(finding('accel_scale', axes, norm=norm))
            elif unit != 'm/s^2':
                found.append(finding('accel_unit', axes, norm=norm, unit=unit))
    return found


def gravity_unit(norm: float) -> str | None:
    """Return the unit in which a mean acceleration is that of gravity.

    Returns
    -------
    str or None
        'm/s^2' also where gravity was removed; None for no usual unit.
    """
    for unit, gravity in (('m/s^2', STANDARD_GRAVITY), ('g', 1.0), ('mg', 1000.0)):
        if abs(norm / gravity - 1.0) < G_BAND:
            return unit
    return 'm/s^2' if norm < WEIGHTLESS else None


def _mean_at_rest(sums: AllanSums) -> NDArray[np.float64]:
    """Return the mean of each axis over the samples that count, (axes,)."""
    total, number = np.zeros(len(sums.axes)), 0
    for recording in sums.history.recordings:
        samples = recording.cell_samples
        total += samples @ recording.cell_means + samples.sum() * recording.reference
        number += int(samples.sum())
    return np.asarray(total / max(number, 1))
