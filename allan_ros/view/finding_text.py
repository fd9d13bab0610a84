# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The texts of findings, from the templates in ``findings.md``.

The message of a finding states the cause with its numbers, and the remedy states the next step.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pkgutil import get_data
from typing import Any, NamedTuple

from ..core.errors import AllanError, one_line
from ..core.estimate import Estimate, duration_text, prefixed, significant
from ..core.findings import QUANTITIES, Finding, Several, unit_term
from ..core.imu import shown_unit

FIELD = re.compile(r'\{(\w+)(?::([^{}]*))?\}')
"""A template field ``{name}`` or ``{name:format}``. The format is a format specification of Python,
``duration`` for a time in s, one of `QUANTITIES` with the number of digits (3 by default), or
``singular|plural``. The singular is used if the value is 1."""

OPTIONAL = re.compile(r'\[\[(.*?)\]\]')
"""A part of a template in double brackets, which is omitted if one of its fields has no value."""


class Words(NamedTuple):
    """The templates of one finding, and the explanation of the finding in the documentation."""

    section: str
    message: str
    remedy: str
    explanation: str


class Texts(NamedTuple):
    """Message and remedy of a finding, with its numbers filled in."""

    message: str
    remedy: str


@cache
def words() -> dict[str, Words]:
    """Return id -> templates of each finding in ``findings.md``, in the order of the file."""
    text = (get_data(__package__, 'findings.md') or b'').decode()
    return dict(_entries(re.sub(r'(?s)<!--.*?-->', '', text)))


def _entries(text: str) -> Iterator[tuple[str, Words]]:
    for section in re.split(r'(?m)^## ', text)[1:]:
        title, *entries = re.split(r'(?m)^### ', section)
        for entry in entries:
            id, _, body = entry.partition('\n')
            message_and_remedy, _, explanation = body.strip().partition('\n\n')
            lines = message_and_remedy.split('\n')
            message = ' '.join(line for line in lines if not line.startswith('> '))
            remedy = ' '.join(line[2:] for line in lines if line.startswith('> '))
            yield id.strip(), Words(title.strip(), message, remedy, explanation.strip())


def texts_of(finding: Finding, units: str = 'deg/h', spelled: Callable[[str], str] = str) -> Texts:
    """Return the message and the remedy of a finding, with its numbers filled in.

    ``units`` is 'deg/h' or 'SI'. ``spelled`` is a function that returns the spelling of a unit of
    measurement, such as `pretty_unit`. If the finding has texts from a document (`Finding.stated`),
    these texts are returned unchanged.

    Examples
    --------
    >>> from allan_ros.core.findings import finding
    >>> texts_of(finding('gaps', lost=1, splits=1)).message
    '1 sample is missing; 1 gap splits the recording.'
    """
    if finding.stated is not None:
        return Texts(*finding.stated)
    templates = words()[finding.id]
    return Texts(
        *(
            _filled(each, finding.values, units, spelled)
            for each in (templates.message, templates.remedy)
        )
    )


def finding_line(finding: Finding, units: str = 'deg/h') -> str:
    """Return the axes, the message and the remedy of a finding as one line."""
    axes_text = f'{", ".join(finding.axes)}: ' if finding.axes else ''
    return axes_text + ' '.join(texts_of(finding, units))


def finding_document(finding: Finding, units: str = 'deg/h') -> dict[str, Any]:
    """Return a finding as a JSON object.

    Its texts use ``units``, which is 'deg/h' or 'SI', unless the finding has texts from a document
    (`Finding.stated`). Its values are not converted.
    """
    return {**finding.document(), **texts_of(finding, units)._asdict()}


def explained(error: AllanError) -> AllanError:
    """Return an error whose message also contains the texts of the findings of ``error``.

    An error without findings is returned unchanged.
    """
    if not error.findings:
        return error
    return AllanError(' '.join([str(error), *map(finding_line, error.findings)]))


def _filled(
    template: str, values: Mapping[str, Any], units: str, spelled: Callable[[str], str]
) -> str:
    """Return the text of a template in which the values replace the fields."""

    def optional(part: re.Match[str]) -> str:
        names = [name for name, _ in FIELD.findall(part[1])]
        return '' if any(values.get(name) is None for name in names) else part[1]

    def inserted(field: re.Match[str]) -> str:
        name, spec = field[1], field[2] or ''
        value = values[name]
        if '|' in spec:
            singular, plural = spec.split('|')
            return singular if value == 1 else plural
        return _text_of(value if isinstance(value, Several) else [value], spec, units, spelled)

    return FIELD.sub(inserted, OPTIONAL.sub(optional, template))


def _text_of(values: Sequence[Any], spec: str, units: str, spelled: Callable[[str], str]) -> str:
    """Return one value as text, or several values as a list or a range.

    A list keeps the order of the values, so that the lists of a frequency and of its alias agree.
    """
    if all(isinstance(value, Estimate) for value in values):
        return _quantities_text(values, int(spec.lstrip('QNBKRsignal') or 3), units, spelled)
    if isinstance(values[0], tuple):
        return ', '.join(f'{q.name} {_text_of([q], spec, units, spelled)}' for q in values[0])
    distinct_texts = dict.fromkeys(_plain_text(value, spec) for value in values)
    if (
        1 < len(distinct_texts) <= MOST_VALUES
        and ' ' not in ''.join(distinct_texts)
        and max(values) > APART * min(values)
    ):
        *others, last = distinct_texts
        return f'{", ".join(others)} and {last}'
    texts = [_plain_text(value, spec) for value in (min(values), max(values))]
    low, high = texts if len(values) > 1 else (texts[0], texts[0])
    number, _, unit = low.partition(' ')
    if low == high:
        return low
    return f'{number if high.endswith(f" {unit}") else low} to {high}'


def _plain_text(value: Any, spec: str) -> str:
    if value is None or isinstance(value, str):
        return one_line(value or '')
    if spec == 'duration':
        return duration_text(value)
    if spec.rstrip('0123456789') in QUANTITIES:
        spec = '.3g'
    return format(value, spec).replace('%', ' %')


def _quantities_text(
    quantities: Sequence[Estimate], digits: int, units: str, spelled: Callable[[str], str]
) -> str:
    """Return quantities of one kind as a range with its interval.

    An example is '2.0 to 3.0 ug (1.5 to 4.1)'. If no value is known, the text states the largest
    upper limit, such as '< 3.0 deg/h'.
    """
    values_si = [q.value for q in quantities if q.value is not None]
    intervals = [q.ci95 for q in quantities if q.ci95 is not None]
    limits = [q.upper95 for q in quantities if q.upper95 is not None]
    first, largest_size = quantities[0], max(map(abs, values_si or limits), default=0.0)
    unit = prefixed(shown_unit(first.axis, unit_term(first.name), units), largest_size)
    if first.name == 'signal' and unit.name == 'deg/h' and largest_size * unit.factor >= FAST_DEG_H:
        unit = shown_unit(first.axis, 'signal', units)

    def text(value: float) -> str:
        return significant(value * unit.factor, digits)

    if not values_si:
        return f'< {text(largest_size)} {spelled(unit.name)}'
    values = dict.fromkeys(text(value) for value in (min(values_si), max(values_si)))
    interval = ''
    if intervals:
        lowest, highest = min(low for low, _ in intervals), max(high for _, high in intervals)
        interval = f' ({text(lowest)} to {text(highest)})'
    return f'{" to ".join(values)} {spelled(unit.name)}{interval}'


MOST_VALUES, APART = 3, 1.1
"""Several numbers are written as a range. Up to `MOST_VALUES` different numbers without a unit are
listed instead if the largest is more than `APART` times the smallest, because a range could be
misread, for example as a band of frequencies."""

FAST_DEG_H = 36.0
"""Size in deg/h from which an angular rate of the signal, unlike biases and noise, is printed in
deg/s instead of deg/h."""
