# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare measured coefficients with the limits of a datasheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ..core.compare import Comparison, Verdict, compare
from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.findings import Finding, finding
from ..core.fit import TERMS, Coefficient
from ..core.imu import SI_UNITS, sensor_of
from .datasheets import SEEN, Datasheet, Limit, Source
from .format import interval_text, shown_unit, significant, value_text

VERDICTS: tuple[Verdict, ...] = ('beyond', 'open', 'within')
"""The worst first."""

VERDICT_TEXT: dict[Verdict, str] = {
    'within': 'within',
    'open': 'not settled',
    'beyond': 'beyond',
}
"""Verdict -> its text in tables; 'open' means that the interval contains the limit."""


@dataclass(frozen=True)
class LimitCheck:
    """One coefficient of one axis, and the limit it was compared with."""

    axis: str
    term: str
    limit: Limit
    verdict: Verdict


@dataclass(frozen=True)
class DatasheetComparison:
    """All coefficients that a datasheet has a limit for.

    Attributes
    ----------
    datasheet : Datasheet
    margin : float
        Fraction by which a complete 95 % interval must lie above a limit to be beyond it.
    held : tuple of LimitCheck
        By axis, then term.
    """

    datasheet: Datasheet
    margin: float
    held: tuple[LimitCheck, ...]

    @property
    def verdict(self) -> Verdict | None:
        """The worst verdict; None where nothing could be compared."""
        verdicts = {held.verdict for held in self.held}
        return next((verdict for verdict in VERDICTS if verdict in verdicts), None)

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The coefficients with a limit, in the form of the comparison with an earlier run."""
        name = self.datasheet.name
        return tuple(Comparison(name, h.axis, h.term, h.limit.value, h.verdict) for h in self.held)

    def of(self, axis: str, term: str) -> LimitCheck | None:
        """Return the limit that a coefficient was compared with, if any."""
        return next((h for h in self.held if (h.axis, h.term) == (axis, term)), None)


def against_datasheet(
    noise: Mapping[str, Mapping[str, Coefficient]], datasheet: Datasheet, margin: float
) -> DatasheetComparison:
    """Return the comparison of axis -> term -> Coefficient with a datasheet."""
    reference = datasheet.reference()
    return DatasheetComparison(
        datasheet,
        margin,
        tuple(
            LimitCheck(c.axis, c.term, datasheet.limits[c.axis][c.term], c.verdict)
            for axis, terms in noise.items()
            for c in compare(axis, terms, reference, margin)
        ),
    )


def datasheet_findings(
    noise: Mapping[str, Mapping[str, Coefficient]], comparison: DatasheetComparison
) -> tuple[Finding, ...]:
    """Return a finding for each coefficient that is beyond its limit."""
    return tuple(
        beyond_limit(
            held.axis,
            held.term,
            noise[held.axis][held.term],
            held.limit.value,
            comparison.datasheet.name,
            comparison.margin,
            (held.axis,),
        )
        for held in comparison.held
        if held.verdict == 'beyond'
    )


def beyond_limit(
    axis: str,
    term: str,
    coefficient: Coefficient,
    limit: float,
    reference: str,
    margin: float,
    axes: tuple[str, ...] = (),
) -> Finding:
    """Return the finding that a coefficient lies above a limit (SI) of a reference."""
    unit = shown_unit(axis, term, 'datasheet')
    return finding(
        'beyond_limit',
        axes,
        term=term,
        value=f'{value_text(coefficient, unit)} {unit.name}',
        interval=interval_text(coefficient, unit),
        limit=f'{significant(limit * unit.factor, 3)} {unit.name}',
        reference=reference,
        margin=margin,
    )


def comparison_to_document(comparison: DatasheetComparison) -> dict[str, Any]:
    """Return the comparison as the object ``datasheet`` of results.json."""
    sheet = comparison.datasheet
    axes: dict[str, dict[str, Any]] = {}
    for held in comparison.held:
        limit = asdict(held.limit)
        axes.setdefault(held.axis, {})[held.term] = {
            'limit': limit.pop('value'),
            'unit': SI_UNITS[sensor_of(held.axis)][held.term],
            **limit,
            'verdict': held.verdict,
        }
    return {
        'name': sheet.name,
        'maker': sheet.maker,
        'remark': sheet.remark,
        'margin': comparison.margin,
        'verdict': comparison.verdict,
        'sources': {key: asdict(source) for key, source in sheet.sources.items()},
        'axes': axes,
    }


def comparison_from_document(fields: Fields) -> DatasheetComparison:
    """Return the comparison of an object of `comparison_to_document`.

    Raises
    ------
    AllanError
        Naming the field that is missing or wrong.
    """
    sources = fields.fields('sources')
    axes = fields.fields('axes')
    held = tuple(
        LimitCheck(axis, term, _limit(of_term), of_term.choice('verdict', VERDICTS))  # type: ignore[arg-type]
        for axis in axes
        for of_axis in [axes.fields(axis)]
        for term in of_axis
        for of_term in [of_axis.fields(_known(of_axis, term))]
    )
    limits: dict[str, dict[str, Limit]] = {}
    for h in held:
        limits.setdefault(h.axis, {})[h.term] = h.limit
    sheet = Datasheet(
        fields.text('name'),
        fields.text('maker'),
        {key: _source(sources.fields(key)) for key in sources},
        limits,
        {},
        {},
        fields.text('remark'),
    )
    return DatasheetComparison(sheet, fields.number('margin'), held)


def _known(fields: Fields, term: str) -> str:
    if term not in TERMS:
        raise AllanError(f'{fields.where}: {term!r} is unknown, use {", ".join(TERMS)}')
    return term


def _limit(fields: Fields) -> Limit:
    texts = (fields.text(key) for key in ('stated', 'note', 'condition', 'source'))
    return Limit(fields.number('limit'), *texts)


def _source(fields: Fields) -> Source:
    title, revision, url, via = (fields.text(key) for key in ('title', 'revision', 'url', 'via'))
    return Source(title, revision, url, fields.choice('seen', ('', *SEEN)), via)
