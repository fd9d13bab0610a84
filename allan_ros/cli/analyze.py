# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the noise of an IMU from its recordings.

An input is a rosbag2 folder, .mcap, .db3, ROS 1 .bag, .csv, .tsv, .npz or .npy. Several inputs are
runs of the same IMU: their evidence adds up.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..core.errors import AllanError
from ..core.settings import SegmenterSettings
from .options import add_settings, settings_of
from .outcome import OutcomeSettings, Run, add_runs, check_exports, finish
from .progress import Progress

if TYPE_CHECKING:
    from ..io.envelope import SignalEnvelope
    from ..io.recordings import Recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb; defaults are those of the settings classes."""
    from ..io.recordings import ReadOptions

    parser.add_argument('inputs', nargs='+', metavar='INPUT', help='a recording')
    parser.add_argument(
        '-o', '--output', metavar='DIR', help='folder for results, plots and report (default: none)'
    )
    parser.add_argument(
        '--rate',
        type=float,
        default=0.0,
        metavar='HZ',
        help='sample rate: checked against the stamps, or believed where there are none',
    )
    parser.add_argument(
        '--hardware-id',
        default='',
        metavar='TEXT',
        help='which piece this is; only sums with the same one add up',
    )
    add_settings(parser, 'result', OutcomeSettings)
    add_settings(parser, 'evidence', SegmenterSettings, without=['declared_rate'])
    add_settings(parser, 'reading', ReadOptions, without=['rate_hz'])


def run(args: argparse.Namespace) -> int:
    """Read, accumulate, fit, show and write."""
    from ..io.envelope import SignalEnvelope
    from ..io.recordings import ReadOptions, open_recordings

    check_exports(args)
    reading = settings_of(ReadOptions, args, rate_hz=args.rate)
    evidence = settings_of(SegmenterSettings, args, declared_rate=args.rate)
    settings = {**asdict(evidence), **asdict(reading), 'hardware_id': args.hardware_id}
    recordings = open_recordings(args.inputs, reading)
    signals = [SignalEnvelope() for _ in recordings]
    runs = [
        accumulate(recording, evidence, settings, signal)
        for recording, signal in zip(recordings, signals)
    ]
    return finish(add_runs(runs), args, signals)


def accumulate(
    recording: Recording,
    evidence: SegmenterSettings,
    settings: Mapping[str, Any],
    signal: SignalEnvelope,
) -> Run:
    """Return the sums of one recording, reading it once from end to end.

    Raises
    ------
    AllanError
        When it cannot be read, or holds no evidence at all.
    """
    from ..core.accumulator import ImuAccumulator
    from ..io.results import Provenance

    accumulator = ImuAccumulator(evidence, settings['hardware_id'])
    path = recording.info.path
    with Progress(path, recording.messages) as progress:
        for batch in recording.batches():
            accumulator.update(batch)
            signal.update(batch)
            progress.advance(len(batch))
    accumulator.end()
    known = accumulator.result()
    findings = (*recording.findings, *known.findings)
    if not known.sums:
        why = '; '.join(str(finding) for finding in findings) or 'it has no samples'
        raise AllanError(f'{path}: no evidence among {known.health.counts.received} samples: {why}')
    return Run(
        path,
        known.sums,
        Provenance((recording.info,), known.spans, findings, known.health.counts, settings),
    )
