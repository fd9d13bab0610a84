# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What makes a target: its entries, the convention they follow, and the form of its file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ...core.findings import Finding

if TYPE_CHECKING:
    from .model import FilterNoise

Value = float | str | list[float] | list[list[float]]
"""What a file can hold under a key."""


@dataclass(frozen=True)
class Entry:
    """One key of a file.

    Attributes
    ----------
    path : tuple of str
        The key, after the keys it stands below.
    value : Value
    words : str
        Where the number comes from: unit, formula, axis, interval. '' for what is no measurement.
    is_limit : bool
        Whether a 95 % upper limit went into it.
    keep : bool
        Leave alone what the user's own file says here: it is no measurement.
    findings : tuple of Finding
        What the user should know of it.
    """

    path: tuple[str, ...]
    value: Value
    words: str = ''
    is_limit: bool = False
    keep: bool = False
    findings: tuple[Finding, ...] = ()

    @property
    def key(self) -> str:
        """The last word of the path."""
        return self.path[-1]


class Form(Protocol):
    """How the entries of a target become text."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file of these entries, its header in comments."""

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return the user's text with these entries in it and all else as it was.

        Raises
        ------
        AllanError
            When the form has no way to, or the text is not of this form.
        """


@dataclass(frozen=True)
class Target:
    """One filter or calibration tool.

    Attributes
    ----------
    file_name : str
        What its file is called in a folder of results.
    convention : str
        What its code takes the numbers for, and where that stands.
    entries : callable
        From the noise model to the entries.
    form : Form
    three : bool
        Whether the file takes three numbers a sensor.
    rate_hz : float or None
        The filter's own rate; None where it steps with the samples.
    exact : bool
        Whether `ExportOptions.exact` means anything to it.
    notes : tuple of str
        What a user of this file should know besides.
    """

    file_name: str
    convention: str
    entries: Callable[[FilterNoise], Iterable[Entry]]
    form: Form
    three: bool = False
    rate_hz: float | None = None
    exact: bool = False
    notes: tuple[str, ...] = ()
