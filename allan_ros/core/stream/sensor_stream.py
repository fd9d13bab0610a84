# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One lane from raw samples to sums: sieve, stamp filter, clock, motion gate, engine."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..allan.engine import RunningAllan
from ..allan.spectrum import RunningSpectrum, SpectrumSums
from ..allan.sums import AllanSums
from ..errors import AllanError
from ..imu import ImuIdentity
from ..settings import SegmenterSettings
from .cleaning import SampleHoldFilter, SensorPlan, StampFilter
from .health import Counts, Segment, State
from .motion import RELEARNED, StillnessStage
from .timing import LEARN, Block, ClockStage, learn_clock

Floats = NDArray[np.float64]

Stamps = NDArray[np.int64]


Samples = tuple[Stamps, Floats, NDArray[np.bool_]]
"""Stamps (n,), rows (axes, n), and where a clock that was set back starts anew (n,)."""


KEPT_SPANS = 1000
"""How many of the longest segments are listed."""


KEPT_RATES = 8
"""Rates a stream had whose evidence is kept."""


class StreamSums(NamedTuple):
    """What samples at one rate came to: their Allan sums, and their spectrum if asked for."""

    sums: AllanSums
    spectrum: SpectrumSums | None

    def joined(self, other: StreamSums) -> StreamSums:
        """Return both together.

        Raises
        ------
        AllanError
            When they are of different rates.
        """
        spectra = (self.spectrum, other.spectrum)
        both = None if spectra[0] is None or spectra[1] is None else spectra[0] + spectra[1]
        return StreamSums(self.sums + other.sums, both)


class SensorStream:
    """Feeds the engine with the evidence of the axes that tick together.

    Attributes
    ----------
    counts : Counts
        What became of the samples of this lane.
    relearned : int
        How often evidence was thrown away because it had been gathered in motion.
    """

    def __init__(
        self,
        plan: SensorPlan,
        identity: ImuIdentity,
        settings: SegmenterSettings,
        with_spectrum: bool = False,
    ) -> None:
        self.plan = plan
        self.counts = Counts()
        self._former: list[StreamSums] = []  # one of each rate the stream had
        self.relearned = 0
        self._identity = identity
        self._settings = settings
        self._with_spectrum = with_spectrum
        self._sieve = SampleHoldFilter(plan)
        self._filter = StampFilter(len(plan.axes), self.counts)
        self._start(_nothing(len(plan.axes)))

    def _start(self, waiting: Samples) -> None:
        """Begin to learn a rate, with the samples that wait."""
        self._learning = waiting
        self._clock: ClockStage | None = None
        self._gate: StillnessStage | None = None
        self._renew_engine()

    def _renew_engine(self) -> None:
        self._engine = RunningAllan(self._identity, self.plan.axes)
        self._spectrum = RunningSpectrum(self.plan.axes) if self._with_spectrum else None
        self._spans: list[tuple[int, int, Segment]] = []
        self._span_count = 0
        self._span_start = self._span_end = 0
        self._span_cut = ''

    @property
    def state(self) -> State:
        """Where the lane stands."""
        if self._clock is None:
            return 'learning' if len(self._learning[0]) else 'waiting'
        if self._gate is None:
            return 'still'
        if self._gate.learning:
            return 'learning'
        return 'moving' if self._gate.moving else 'still'

    @property
    def clock(self) -> tuple[float, bool] | None:
        """Working period in ns and whether stamps are bursty; None before they are learned."""
        if self._clock is None:
            return None
        return self._clock.clock.period_ns, self._clock.clock.bursty

    @property
    def sums(self) -> AllanSums:
        """Sums at the present rate."""
        return self._engine.sums

    @property
    def evidence(self) -> StreamSums:
        """Sums and spectrum at the present rate."""
        return StreamSums(self.sums, None if self._spectrum is None else self._spectrum.sums)

    def evidence_by_rate(self) -> list[StreamSums]:
        """Return the evidence at each rate there was: a rate that comes back goes on."""
        present = self.evidence
        if not present.sums.samples:
            return self._former
        for i, former in enumerate(self._former):
            try:
                joined = former.joined(present)
            except AllanError:  # another rate
                continue
            return [*self._former[:i], joined, *self._former[i + 1 :]]
        return [*self._former, present]

    @property
    def spans(self) -> list[Segment]:
        """The longest closed segments at the present rate, in order of time."""
        return sorted(span for _, _, span in self._spans)

    def feed(self, stamps: Stamps, rows: Floats) -> None:
        """Take samples of the six-axis stream: stamps (n,) in ns, rows (6, n)."""
        own = self._filter.feed(*self._sieve.pick(stamps, rows))
        if self._clock is not None:
            self._advance(self._clock.feed(*own))
            return
        a, b = self._learning, own
        self._learning = (
            np.concatenate([a[0], b[0]]),
            np.concatenate([a[1], b[1]], axis=1),
            np.concatenate([a[2], b[2]]),
        )
        if len(self._learning[0]) >= LEARN:
            self._learn()

    def flush(self) -> None:
        """Judge all that waits, and close the segment: no more samples come."""
        while True:
            if self._clock is None:
                self._learn()
            if self._clock is None:
                break
            runs = self._clock.flush()
            self._pass_on(runs)
            if not self._clock.rate_changed:
                break
            self._change_rate()
        if self._gate is not None:
            for run in self._gate.flush():
                self._accumulate(run)
        self._close_segment()

    def _learn(self) -> None:
        """Learn the clock from the first samples, then take them all."""
        clock = learn_clock(self._learning[0][:LEARN])
        if clock is None:
            # stamps that stand still time nothing; kept, they would fill the memory
            self.counts.untimed += len(self._learning[0])
            self._learning = _nothing(len(self.plan.axes))
            return
        settings = self._settings
        waiting = self._learning
        self._learning = _nothing(len(self.plan.axes))
        axes = self.plan.axes
        self._clock = ClockStage(clock, len(axes), settings.max_bridge, self.counts)
        if settings.motion_gate:
            self._gate = StillnessStage(
                clock.period_ns, axes, self.counts, settings.motion_ratio, settings.rate_limit
            )
        self._advance(self._clock.feed(*waiting))

    def _advance(self, runs: list[Block]) -> None:
        self._pass_on(runs)
        if self._clock is not None and self._clock.rate_changed:
            self._change_rate()
            if len(self._learning[0]) >= LEARN:
                self._learn()

    def _change_rate(self) -> None:
        """Put the sums of the former rate by, and start to learn the new one."""
        assert self._clock is not None
        if self._gate is not None:
            for run in self._gate.flush():
                self._accumulate(run)
        self._close_segment()
        self.counts.cuts['rate change'] += 1
        by_rate = sorted(self.evidence_by_rate(), key=lambda each: -each.sums.elapsed_ns)
        self._former = by_rate[:KEPT_RATES]
        stamps, rows = self._clock.waiting
        self._start((stamps.copy(), rows.copy(), np.zeros(len(stamps), bool)))

    def _pass_on(self, runs: list[Block]) -> None:
        for run in runs if self._gate is None else self._gate.feed(runs):
            self._accumulate(run)

    def _accumulate(self, run: Block) -> None:
        if run.cut == RELEARNED:
            self.counts.moving += self._engine.sums.samples
            self.counts.used -= self._engine.sums.samples
            self.relearned += 1
            self._renew_engine()
        elif run.cut:
            self._close_segment()
        if not len(run.stamps):
            return
        if not self._engine.open_samples:
            self._span_start, self._span_cut = int(run.stamps[0]), run.cut
        self._span_end = int(run.stamps[-1])
        self.counts.used += len(run.stamps)
        self._engine.update(run.rows.T, int(run.stamps[0]), self._span_end)
        if self._spectrum is not None:
            self._spectrum.update(run.rows)

    def _close_segment(self) -> None:
        samples = self._engine.open_samples
        if not samples:
            return
        length = (self._span_end - self._span_start) * 1e-9
        span = Segment(self._span_start, samples, length, self._span_cut)
        heapq.heappush(self._spans, (samples, self._span_count, span))
        if len(self._spans) > KEPT_SPANS:
            heapq.heappop(self._spans)
        self._span_count += 1
        self._engine.end_segment()
        if self._spectrum is not None:
            self._spectrum.end_segment()


def _nothing(axes: int) -> Samples:
    return np.empty(0, np.int64), np.empty((axes, 0)), np.empty(0, bool)
