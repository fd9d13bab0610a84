# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts, segments and state of a stream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal, NamedTuple

State = Literal['waiting', 'learning', 'still', 'moving', 'louder']
"""No sample yet; the rate and the noise floor are learned; data at rest accumulate; the IMU moves;
it is at rest, but its noise became louder."""


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
