# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the tool tells a user to know or do: worded once here, shown alike everywhere.

A `Finding` is a cause and a remedy. The catalogue below is the only place where one is worded;
the log, `/diagnostics`, `results.json` and the report show the same sentence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal['info', 'warning', 'error']


@dataclass(frozen=True)
class Finding:
    """One thing a user should know, and what to do about it."""

    id: str
    severity: Severity
    message: str
    remedy: str
    axes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f'{", ".join(self.axes)}: ' if self.axes else ''
        return f'{where}{self.message}; {self.remedy}'


@dataclass(frozen=True)
class Wording:
    """The words of one kind of finding; ``message`` and ``remedy`` are `str.format` templates."""

    severity: Severity
    message: str
    remedy: str


CATALOGUE: dict[str, Wording] = {}
"""id -> its words; filled by `_word` below."""


def _word(id: str, severity: Severity, message: str, remedy: str) -> None:
    CATALOGUE[id] = Wording(severity, message, remedy)


def finding(id: str, axes: tuple[str, ...] = (), **values: object) -> Finding:
    """Return the finding of that id with its numbers filled in.

    Raises
    ------
    KeyError
        When the id is not in the catalogue, or a value its words need is missing.
    """
    words = CATALOGUE[id]
    return Finding(
        id, words.severity, words.message.format(**values), words.remedy.format(**values), axes
    )


# --- the stream: what the segmenter dropped, repaired or refused ---------------------------------
_word(
    'stamps_unusable',
    'warning',
    'header stamps are {what}; record time is used instead',
    'let the driver fill header.stamp, or pass --stamps record to say that this is meant',
)
_word(
    'rate_differs',
    'warning',
    'the stamps say {measured:.4g} Hz, {declared:.4g} Hz was declared',
    'the stamps are believed; correct the declared rate or the clock of the driver',
)

# --- the recording: what the readers could not read to the end -----------------------------------
_word(
    'table_cut',
    'warning',
    '{path}: line {line}, the last, is cut off and left out',
    'nothing to do unless more is missing; compare with the original',
)
_word(
    'bag_cut',
    'warning',
    '{path}: is cut off after {read} of {size} bytes (the recorder was not stopped cleanly); '
    'what is whole was read',
    'stop the recorder with Ctrl-C and wait for it to end; "mcap recover" mends the file itself',
)

# --- the fit: methods 'paper' and 'relative' -----------------------------------------------------
_word(
    'too_few_points',
    'warning',
    'the curve has {points} points, five terms need at least {needed}',
    'record longer: an hour or more shows most terms',
)
_word(
    'negative_coefficient',
    'warning',
    'plain least squares makes {terms} negative, which no noise can be: the scatter of the long '
    'averaging times outweighs that term',
    'use the default method gls, which keeps terms from going below zero and gives limits',
)
_word(
    'overlap_gain',
    'info',
    'the same fit on overlapping groups gives {values}; its standard errors are {gains} times '
    'smaller',
    'method gls uses the overlapping groups and how they are correlated',
)
