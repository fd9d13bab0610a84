# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One target of an export: its entries, its convention, and the form of its file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from .convention import Convention, Entry
from .model import FilterNoise


class Form(Protocol):
    """How the entries of a target become text."""

    def render(self, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return a file with these entries and the header in comments."""

    def merge(self, existing: str, entries: Sequence[Entry], header: Sequence[str]) -> str:
        """Return the user's text with these entries in it and all else unchanged.

        Raises
        ------
        AllanError
            When the form does not support it, or the text does not have this form.
        """


@dataclass(frozen=True)
class Target:
    """A filter, simulator or calibration tool.

    Attributes
    ----------
    file_name : str
        Name of its file in a folder of results.
    convention : Convention
    entries : callable
        From the noise model to the entries.
    form : Form
    notes : tuple of str
        Further facts for the user of this file.
    """

    file_name: str
    convention: Convention
    entries: Callable[[FilterNoise], Iterable[Entry]]
    form: Form
    notes: tuple[str, ...] = ()
