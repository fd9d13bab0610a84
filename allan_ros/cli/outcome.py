# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `analyze` and `merge` have in common: adding runs of one IMU, fitting, showing, writing."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..core.compare import MARGIN
from ..core.errors import AllanError
from ..core.fit import METHODS
from ..core.settings import check, parameter
from .console import Console
from .options import settings_of

if TYPE_CHECKING:
    from ..core.allan.spectrum import SpectrumSums
    from ..core.allan.sums import AllanSums
    from ..io.results import Provenance, Results
    from ..io.signal import SignalEnvelope, TemperatureTrace


@dataclass(frozen=True)
class OutcomeSettings:
    """How the sums are fitted and shown."""

    method: str = parameter(
        'gls',
        'How the curve is fitted: generalised least squares with intervals, least squares with '
        'relative weights, or as the paper did.',
        choices=tuple(METHODS),
    )
    units: str = parameter(
        'datasheet', 'Units shown: those of datasheets, or SI.', choices=('datasheet', 'si')
    )
    export: tuple[str, ...] = parameter(
        (),
        'Files for filters to write besides: kalibr, openvins, px4 ... (`allan export --list` '
        'tells all, `allan export` sets more).',
    )
    sensor: str = parameter(
        '',
        'Datasheet to compare with: a name that `allan sensors` lists, or the path of a .yaml '
        'file.',
    )
    baseline: str = parameter(
        '', 'results.json of an earlier run of this IMU, to hold this one against in the report.'
    )
    margin: float = parameter(
        MARGIN,
        'Fraction by which a whole interval must lie above what the datasheet states, or the '
        'earlier run allowed.',
        low=0.0,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class RecordingSums:
    """The sums of one run with their name and provenance."""

    name: str
    sums: tuple[AllanSums, ...]
    provenance: Provenance


def add_runs(runs: Iterable[RecordingSums]) -> RecordingSums:
    """Return all runs as one.

    Raises
    ------
    AllanError
        Naming the first run that is not of the same IMU as the ones before, and what differs; or
        one that was given twice.
    """
    first, *others = runs
    sums = {s.axes: s for s in first.sums}
    provenance = first.provenance
    for run in others:
        if {s.axes for s in run.sums} != set(sums):
            raise AllanError(
                f'{run.name} has {_axes_text(run.sums)} where {first.name} has '
                f'{_axes_text(first.sums)}: analyse them apart'
            )
        try:
            added = {s.axes: sums[s.axes] + s for s in run.sums}
        except AllanError as error:
            raise AllanError(f'{run.name} does not go with {first.name}: {error}') from error
        if any(_share_a_segment(sums[s.axes], s) for s in run.sums):
            raise AllanError(
                f'{run.name} holds samples that a run before it holds too: give each run once, '
                'or they count twice'
            )
        sums, provenance = added, provenance + run.provenance
    return RecordingSums(first.name, tuple(sums.values()), provenance)


def check_outcome(args: argparse.Namespace) -> None:
    """Refuse what cannot be shown or written, before hours of recordings are read.

    Raises
    ------
    AllanError
        When a target of ``--export``, the datasheet, the earlier run or the style of the pictures
        is unknown, there is no folder to write to, or a number is out of its range.
    """
    from ..io.datasheets import load_sensor
    from ..io.exporters import target_of
    from ..io.plot_style import PictureSettings, load_style

    settings_of(OutcomeSettings, args)
    if args.sensor:
        load_sensor(args.sensor)
    _former(args)
    load_style(settings_of(PictureSettings, args).plot_style)
    for name in args.export:
        target_of(name)
    for option, given in (('--export', args.export), ('--baseline', args.baseline)):
        if given and not args.output:
            raise AllanError(f'{option} writes into the folder of -o: give one')


def finish(
    run: RecordingSums,
    args: argparse.Namespace,
    signals: Sequence[SignalEnvelope] = (),
    spectra: Sequence[SpectrumSums] = (),
    temperatures: Sequence[TemperatureTrace | None] = (),
) -> int:
    """Fit the run, write its files where ``--output`` says, and show what was found.

    Returns
    -------
    int
        Exit code: 1 where nothing could be computed, else 0.
    """
    from ..io.datasheets import load_sensor
    from ..io.plot_style import PictureSettings
    from ..io.results import analyse_sums

    console = Console.of(args)
    with console.timed(f'fitted by {args.method}'):
        results = analyse_sums(run.sums, run.provenance, args.method)
    if args.sensor:
        results = results.held_against(load_sensor(args.sensor), args.margin)
    written = ''
    if args.output:
        from ..io.result_files import write_result_files

        with console.timed('drawn and written'):
            results, paths = write_result_files(
                args.output,
                results,
                run.sums,
                signals,
                spectra,
                temperatures,
                _former(args),
                args.margin,
                args.command_line,
                args.units,
                args.export,
                settings_of(PictureSettings, args),
            )
        written = f'written to {args.output}: {", ".join(sorted(path.name for path in paths))}'
    if console.json:
        from ..io.documents import results_to_document

        console.document(results_to_document(results))
        console.findings(results.findings)
        if written:
            console.say(written)
    elif not (console.quiet and written):
        from .tables import print_results

        print_results(results, args.units)
        if written:
            print(f'\n{written}')
    known = (c for axis in results.axes.values() for c in axis.fit.noise.values())
    return 0 if any(c.value is not None for c in known) else 1


def _former(args: argparse.Namespace) -> dict[str, Results]:
    """Return the earlier run by its name, where one was given.

    Raises
    ------
    AllanError
        When it cannot be read, or is no results.json.
    """
    if not args.baseline:
        return {}
    from ..io.comparison import labels_of
    from ..io.documents import results_from_document
    from ..io.text import read_json

    (label,) = labels_of([args.baseline])
    return {label: results_from_document(read_json(args.baseline), args.baseline)}


def _share_a_segment(a: AllanSums, b: AllanSums) -> bool:
    """Tell whether a segment of one is in the other too: no two have the same noise."""
    return any(
        one.order == other.order and (one.phase == other.phase).all()
        for one in a.segments
        for other in b.segments
        if one.samples > 1
    )


def _axes_text(sums: Sequence[AllanSums]) -> str:
    return ' and apart '.join(', '.join(s.axes) for s in sums)
