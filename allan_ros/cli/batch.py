# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Judge a batch of units (IMUs): print a line for each unit, and write a summary of all units."""

from __future__ import annotations

import argparse
import csv
import io
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from ..core.check import Check
from ..core.errors import AllanError, one_line
from ..core.estimate import value_text
from ..core.fields import plain
from ..core.findings import Finding
from ..core.fit.fit_findings import ADVISED_TERMS
from ..core.imu import SENSORS, SI_UNITS, sensor_of, shown_unit
from ..readers.files import open_regular, write_atomic
from ..readers.recording import listed, translated
from ..readers.recording_sums import ReadJob
from ..results.plan import Limits, Plan, load_plan
from ..results.results import Results
from ..results.unit_check import DECISION_WORDS, Decision, UnitCheck, check_unit, worst
from ..view.batch_files import INDEX, SUMMARY
from ..view.finding_text import finding_line
from ..view.result_document import result_document
from ..view.unit_text import unchecked_text, unit_sentences
from ..view.verdict_text import VERDICT_WORDS, verdict_of
from .console import EXIT_ERROR, Console, colored, painted
from .outcomes import BatchItem, Outcome, exit_code_of, fails, names_of, outcomes_of
from .result_lines import LEVEL_COLORS

CHECK_SCHEMA = 'allan_ros/unit_check/1'

UNREAD = (str(int(Decision.UNREADABLE)), str(int(Decision.BUG)))
"""Exit codes of units without results, as they are written in summary.csv."""

MAX_SUMMARY = 100_000_000
"""Largest number of bytes that are read from a summary."""

MOST_NAMED = 10
"""Largest number of units that the line with the totals names for each verdict."""


@dataclass(frozen=True)
class Judged:
    """The decision about one unit, and the texts that are printed about the unit."""

    outcome: Outcome
    decision: Decision
    word: str  # beginning of the printed line: the decision, or the level of the verdict
    sentences: Sequence[str]  # reasons of the decision
    check: UnitCheck | None = None  # None if the unit has no results
    note: str = ''  # which earlier unit has the same samples or serial number; '' if none

    @property
    def name(self) -> str:
        return self.outcome.unit.name

    @property
    def serial(self) -> str:
        """The serial number of the unit; '' if unknown."""
        results = self.outcome.results
        return results.identity.hardware_id if results else self.outcome.unit.jobs[0].hardware_id

    @property
    def reason(self) -> str:
        """The note about a duplicate, if any, and the reasons of the decision as one line."""
        return one_line(' '.join(filter(None, (self.note, *self.sentences))))


class Judge:
    """Judges the units of a batch, and finds units that occur twice.

    Parameters
    ----------
    args : Namespace
        Arguments of the command line.
    plan : Plan or None
        The test plan; None if there is none.
    decides : bool
        Whether the line of a unit begins with the decision about the unit. If False, the line of a
        unit with results begins with the level of its verdict.
    """

    def __init__(self, args: argparse.Namespace, plan: Plan | None, decides: bool) -> None:
        self._args, self._plan, self._decides = args, plan, decides
        # samples or serial number -> name of the first unit that has them
        self._known: dict[object, str] = {}

    def judged(self, outcome: Outcome) -> Judged:
        """Return the decision about the next unit, given the outcome of its analysis."""
        results, units = outcome.results, self._args.units
        if results is None:
            decision = Decision(outcome.code)
            return Judged(outcome, decision, DECISION_WORDS[decision], [outcome.error])
        check = check_unit(results, self._plan)
        note = self._note(outcome.unit.name, results)
        decision = check.decision
        if fails(results, self._args.fail_on):
            decision = Decision.EXCEEDS
        elif note and decision is Decision.WITHIN:
            # of two units with the same samples or serial number, one was probably not measured
            decision = Decision.NOT_JUDGED
        word = DECISION_WORDS[decision]
        if not self._decides:
            word = VERDICT_WORDS[results.level].lower()
        sentences = unit_sentences(check, results, units)
        return Judged(outcome, decision, word, sentences, check, note)

    def _note(self, name: str, results: Results) -> str:
        """Return a text that names an earlier unit with the same samples or serial number, or ''.

        Samples count as the same if their number and all coefficients are equal. Samples are not
        compared if no coefficient has a value other than 0.
        """
        values = [c.value for axis in results.axes.values() for c in axis.fit.noise.values()]
        samples = (results.samples, *values) if any(values) else None
        for key, shared in ((samples, 'the samples'), (results.identity.hardware_id, 'the serial')):
            if key and self._known.setdefault(key, name) != name:
                return f'duplicate: it has {shared} of {self._known[key]};'
        return ''


def run_batch(jobs: Sequence[ReadJob], args: argparse.Namespace) -> int:
    """Analyze each recording, write its files, and print one line for each recording.

    With ``--quiet`` and a folder for the output, no lines of text are printed; ``--json`` always
    prints one JSON object per line. If the command line states a folder for the output, a summary
    of all recordings is written, too. Returns the worst exit code of the recordings. Raises
    AllanError if the folder or the summary cannot be written, or the cluster cannot be used.
    """
    console, codes, units = Console.of(args), [], []
    judge = Judge(args, None, decides=False)
    findings: list[Finding] = []
    _make_output(args)
    for outcome in outcomes_of([BatchItem(n, [job]) for n, job in zip(names_of(jobs), jobs)], args):
        units.append(judged := judge.judged(outcome))
        code = outcome.code
        if outcome.results is not None:
            code = exit_code_of(outcome.results, args.fail_on)
            findings += outcome.results.findings
        codes.append(Decision(code))
        if console.json:
            console.line(_batch_document(outcome, args.units))
        elif not (console.quiet and args.output):
            _print_unit(judged, args)
    for finding in [f for f in findings if f.id == 'sensor_elsewhere'][:1]:
        console.say(finding_line(finding))
    _write_summary(units, codes, args, '')
    return int(worst(codes))


def unread_units(folder: str) -> list[Outcome]:
    """Return the units without results, according to the summary in a folder.

    The list is empty if the folder has no summary. Raises AllanError if the summary cannot be read.
    """
    path = Path(folder) / SUMMARY
    if not path.is_file():
        return []
    errors = (OSError, csv.Error)
    with translated(path, errors, 'remove it, or check again'), open_regular(path) as file:
        rows = list(csv.DictReader(io.StringIO(file.read(MAX_SUMMARY).decode('utf-8', 'replace'))))
    return [
        Outcome(
            BatchItem(row['unit'], [ReadJob(row['unit'], hardware_id=row.get('serial') or '')]),
            error=one_line(
                f'not read when this folder was written: {row.get("reason") or row["unit"]}'
            ),
        )
        for row in rows
        if row.get('unit') and row.get('exit_code') in UNREAD
    ]


def run_check(
    units: Sequence[BatchItem], args: argparse.Namespace, unread: Sequence[Outcome] = ()
) -> int:
    """Print one line for each unit as soon as it is checked, then the totals of several units.

    With ``--quiet`` and a folder for the output, no text is printed. If the command line states a
    folder for the output, the files of each unit and a summary of all units are written, too.
    Returns the worst exit code of the units.

    Parameters
    ----------
    units : sequence of BatchItem
        The units to check.
    args : Namespace
        Arguments of the command line.
    unread : sequence of Outcome
        Units without results, according to the summary in a folder with earlier results.

    Raises
    ------
    AllanError
        When the test plan is invalid, or the folder or the summary cannot be written. Also when the
        only unit has no results because of an error that the user can fix, unless the output is
        JSON.
    """
    console, judged_units = Console.of(args), []
    shows_text = not console.json and not (console.quiet and args.output)
    plan = load_plan(args.plan) if args.plan else None
    judge = Judge(args, plan, decides=True)
    unchecked: dict[str, None] = {}
    n_units = len(units) + len(unread)
    _make_output(args)
    for outcome in chain(outcomes_of(units, args), unread):
        judged_units.append(judged := judge.judged(outcome))
        unchecked |= dict.fromkeys(judged.check.unchecked if judged.check else ())
        if console.json:
            console.line(_check_document(judged))
        elif outcome.results is None and n_units == 1 and outcome.code == EXIT_ERROR:
            raise AllanError(outcome.error)
        elif shows_text:
            _print_unit(judged, args)
            for sentence in judged.sentences if console.verbose else ():
                print(f'  {sentence}')
    code = worst([judged.decision for judged in judged_units])
    names_by_word: dict[str, list[str]] = {}
    for judged in judged_units:
        names_by_word.setdefault(judged.word, []).append(Path(judged.name).name)
    if n_units > 1 and console.json:
        totals = {word: len(named) for word, named in names_by_word.items()}
        console.line({'units': n_units, 'totals': totals, 'exit_code': int(code)})
    elif shows_text:
        if n_units > 1:
            texts = [
                _total(*word_and_names)
                for word_and_names in sorted(names_by_word.items(), key=lambda e: -len(e[1]))
            ]
            print(f'{n_units} units: {", ".join(texts)}')
        if unchecked:
            print(unchecked_text([*unchecked]))
    _write_summary(
        judged_units, [judged.decision for judged in judged_units], args, plan.name if plan else ''
    )
    return int(code)


def _total(word: str, names: Sequence[str]) -> str:
    """Return how many units have a verdict, and their names, as text.

    ``word`` is the word for the verdict, and ``names`` are the names of all units with this
    verdict. Healthy units are counted, but not named.
    """
    if word == DECISION_WORDS[Decision.WITHIN]:
        return f'{len(names)} {word}'
    return one_line(f'{len(names)} {word} ({listed(names, MOST_NAMED)})')


def _print_unit(unit: Judged, args: argparse.Namespace) -> None:
    """Print the verdict, name, serial number, reasons and N of a unit as one line.

    For a unit without results, the line contains the verdict and the error.
    """
    text = unit.reason
    if unit.outcome.results is not None:
        serial = f', serial {unit.serial}' if unit.serial else ''
        numbers = ', '.join(_noise_texts(unit.outcome.results, args.units))
        text = f'{unit.name}{serial}: {text.rstrip(".")}; {numbers}'.rstrip('; ')
    line = one_line(f'{unit.word}: {text}')
    color = next(
        (LEVEL_COLORS[k] for k, w in VERDICT_WORDS.items() if w.lower() == unit.word), '1;31'
    )
    print(painted(line, unit.word, color, colored(sys.stdout)), flush=True)


def _noise_texts(results: Results, units: str) -> Iterator[str]:
    """Yield a text for each sensor: N of its axes."""
    for sensor in SENSORS:
        unit = shown_unit(sensor, 'N', units)
        noise = [a.fit.noise for axis, a in results.axes.items() if sensor_of(axis) == sensor]
        if noise:
            yield f'{sensor} N {" ".join(value_text(t["N"], unit) for t in noise)} {unit.name}'


def _make_output(args: argparse.Namespace) -> None:
    """Create the folder for the output, if the command line states one."""
    if args.output:
        from ..view.result_files import made_folder

        made_folder(Path(args.output))


def _write_summary(
    units: Sequence[Judged], codes: Sequence[Decision], args: argparse.Namespace, plan: str
) -> None:
    """Write the summary of all units to the folder for the output, if there is such a folder.

    ``codes`` are the exit codes of the units, and ``plan`` is the name of the test plan or ''.
    """
    if not args.output:
        return
    from ..view.batch_files import UnitRow, index_html, summary_csv
    from ..view.result_files import REPORT

    rows = []
    for judged, code in zip(units, codes):
        results = judged.outcome.results
        report = f'{judged.outcome.unit.folder}/{REPORT}' if results else ''
        name, details = one_line(judged.name), (judged.check, report, int(code))
        rows.append(UnitRow(name, judged.serial, judged.word, judged.reason, results, *details))
    folder = Path(args.output)
    write_atomic(folder / SUMMARY, summary_csv(rows, args.units))
    write_atomic(folder / INDEX, index_html(rows, plan))
    Console.of(args).say(f'written to {args.output}: one folder for each unit, {SUMMARY}, {INDEX}')


def _check_document(judged: Judged) -> dict[str, Any]:
    """Return the decision about one unit, its coefficients and its limits as a JSON object."""
    unit, results = judged.outcome.unit, judged.outcome.results
    document: dict[str, Any] = {
        'schema': CHECK_SCHEMA,
        'name': unit.name,
        'path': unit.path,
        'serial': judged.serial,
        'exit_code': int(judged.decision),
        'level': 'error',
        'summary': one_line(judged.sentences[0]),
    }
    if results is None or judged.check is None:
        return document
    levels = {Decision.EXCEEDS: 'failed', Decision.NOT_JUDGED: 'unknown'}
    units = {sensor: SI_UNITS[sensor] for sensor in SENSORS}
    return document | {
        'level': levels.get(judged.decision, results.level),
        'reasons': [one_line(text) for text in judged.sentences],
        'next_steps': list(verdict_of(results).next_steps),
        'note': judged.note,
        'hours': results.duration_s / 3600.0,
        'rate_hz': results.rate_hz,
        'axes': {
            axis: {
                term: {
                    **result.fit.noise[term].document(),
                    'unit': units[sensor_of(axis)][term],
                }
                for term in ADVISED_TERMS
            }
            for axis, result in results.axes.items()
        },
        'limits': [
            _limit_document(check, plan.limits_of(check))
            for plan in (judged.check.plan,)
            if plan is not None
            for check in judged.check.checks
        ],
        'unchecked': list(judged.check.unchecked),
    }


def _limit_document(check: Check, limits: Limits) -> dict[str, Any]:
    """Return a quantity, its limits and the verdict as a JSON object.

    The numbers are in the unit of measurement that the plan states for the quantity.
    """
    measured = check.measured.times(1.0 / limits.scale)
    lower, upper = (
        None if end is None else end / limits.scale for end in (limits.lower, limits.upper)
    )
    return {
        'axis': check.axis,
        'quantity': check.quantity,
        **measured.document(),
        'lower': lower,
        'upper': upper,
        'unit': limits.unit,
        'verdict': check.verdict,
        'note': check.note,
    }


def _batch_document(outcome: Outcome, units: str) -> dict[str, object]:
    if outcome.results is None:
        return {'path': outcome.unit.path, 'name': outcome.unit.name, 'error': outcome.error}
    verdict = plain(verdict_of(outcome.results, units))
    results = result_document(outcome.results, units, curves=False)
    path_and_name = {'path': outcome.unit.path, 'name': outcome.unit.name}
    return {**path_and_name, 'verdict': verdict, 'results': results}
