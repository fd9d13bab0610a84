# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What there is to say of a stream, from its counts and its sums."""

from __future__ import annotations

import numpy as np

from ..allan.sums import AllanSums
from ..findings import Finding, finding
from ..settings import SegmenterSettings
from .health import StreamHealth
from .timing import RATE_CHANGE

TOLD_BRIDGED_SHARE = 1e-3
"""Interpolated samples below this share are not worth a word."""


BRIDGE_BIAS = 0.75
"""N rises by this times the share of single samples that were interpolated: each neighbour of one
counts 1.5 times, so the variance of a sum grows by 1.5 a lost sample, and N by half of that."""


SHORT_S = 60.0
"""Evidence below a minute does not even show N within a few percent at the 1 s line."""


def stream_findings(
    health: StreamHealth,
    sums: tuple[AllanSums, ...],
    settings: SegmenterSettings,
    relearned: int,
) -> list[Finding]:
    """Return what a user should know of the stream, in the order of a reader's questions."""
    counts = health.counts
    found: list[Finding] = []
    tau0 = sums[0].tau0 if sums else None
    rate = 1.0 / tau0 if tau0 else health.rate_hz
    declared = settings.declared_rate
    if declared and rate and abs(rate / declared - 1.0) > RATE_CHANGE:
        found.append(finding('rate_differs', measured=rate, declared=declared))
    if health.bursty and rate:
        found.append(finding('bursty_stamps', rate=rate))
    changes = counts.cuts['rate change']
    if changes:
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
    if counts.bridged > TOLD_BRIDGED_SHARE * counts.received:
        share = counts.bridged / counts.received
        bias = BRIDGE_BIAS * share
        found.append(finding('bridged', bridged=counts.bridged, share=share, bias=bias))
    if relearned:
        found.append(finding('relearned'))
    if counts.moving and not counts.used and health.rate_hz:
        found.append(finding('never_still', seconds=counts.moving / health.rate_hz))
    elif counts.moving:
        found.append(finding('motion', share=counts.moving / (counts.moving + counts.used)))
    for each in sums:
        found += _sums_findings(each)
    if counts.received and not sums:
        found.append(finding('nothing_left', received=counts.received))
    return found


def _sums_findings(sums: AllanSums) -> list[Finding]:
    found: list[Finding] = []
    if len(sums.count):
        flat = tuple(np.array(sums.axes)[sums.sum_sq[0] == 0.0].tolist())
        if flat:
            found.append(finding('no_noise', flat))
    seconds = sums.elapsed_ns * 1e-9
    if seconds < SHORT_S:
        found.append(finding('short', seconds=seconds))
    return found
