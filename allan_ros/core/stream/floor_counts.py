# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts what becomes of the samples; decisions about the noise floor change it afterwards."""

from __future__ import annotations

from collections import Counter
from typing import Literal

from .health import Counts

Fate = Literal['used', 'moving', 'stuck', 'noise_decreased', 'shocks', 'replaced']
"""A field of `Counts`. 'used' are the samples that are passed on to the sums."""


class FloorCounts:
    """Counts samples for a stream, and separately at the present noise floor and in its last block.

    While the sums of an earlier noise floor are set aside, samples that are passed on to other sums
    are counted as 'noise_decreased'. ``total`` is changed in place.
    """

    def __init__(self, total: Counts) -> None:
        self.total = total
        self._floor: Counter[str] = Counter()  # since the present noise floor was learned
        self._aside: Counter[str] | None = None  # the same of the floor that was set aside
        self._block: Counter[str] = Counter()  # since the last block of windows began
        self._carried = 0  # samples of earlier blocks whose fate is not known yet

    def begin_block(self, undecided: int) -> None:
        """Begin a block of windows; some samples before it are still undecided."""
        self._block, self._carried = Counter(), undecided

    def add(self, fate: Fate, number: int) -> None:
        """Count samples, the earliest undecided ones first, or shocks."""
        carried = 0 if fate in ('shocks', 'replaced') else min(number, self._carried)
        self._carried -= carried
        self._add(fate, number)
        self._block[fate] += number - carried

    def remove(self, fate: Fate, number: int) -> None:
        """Count samples of the present floor no longer."""
        self._add(fate, -number)

    def remove_block(self) -> None:
        """Count the last block no longer, because its windows are classified again."""
        for fate, number in self._block.items():
            self._add(fate, -number)
        self._block.clear()

    def move(self, source: str, target: str, number: int) -> None:
        """Count samples as another field of `Counts`."""
        setattr(self.total, source, getattr(self.total, source) - number)
        setattr(self.total, target, getattr(self.total, target) + number)

    @property
    def lasts_longer(self) -> bool:
        """Whether the present floor has more samples at rest than the floor that was set aside."""
        return self._aside is not None and self._floor['used'] > self._aside['used']

    def discard(self, reason: Literal['moving', 'stuck']) -> None:
        """Count the samples at the present floor as not at rest: their sums are discarded."""
        self.move(self._used, reason, self._floor['used'])
        self._forget()

    def set_aside(self) -> None:
        """Begin the counts of decreased noise; an earlier attempt remains 'noise_decreased'."""
        if self._aside is None:
            self._aside, self._floor = self._floor, Counter()
        else:
            self._forget_shocks()

    def resume(self) -> None:
        """Continue the counts that were set aside; the others remain 'noise_decreased'."""
        assert self._aside is not None
        self._forget_shocks()
        self._floor, self._aside = self._aside, None

    def accept(self) -> None:
        """Count the present samples as used, and those that were set aside as moving."""
        assert self._aside is not None
        self.move('noise_decreased', 'used', self._floor['used'])
        present, self._floor, self._aside = self._floor, self._aside, None
        present['noise_decreased'] += self._floor['noise_decreased']
        self.move('used', 'moving', self._floor['used'])
        self._forget_shocks()
        self._floor = present
        self.forget_decrease()

    def forget_decrease(self) -> None:
        """Count decreased noise as motion: the noise floor was learned in motion."""
        self.move('noise_decreased', 'moving', self._floor['noise_decreased'])
        self._floor['noise_decreased'] = 0

    @property
    def decreased(self) -> int:
        """Number of samples that were dropped because the noise was below the present floor."""
        return self._floor['noise_decreased']

    @property
    def _used(self) -> str:
        """The field of `Counts` for samples that are passed on."""
        return 'used' if self._aside is None else 'noise_decreased'

    def _add(self, fate: str, number: int) -> None:
        self._floor[fate] += number
        field = self._used if fate == 'used' else fate
        setattr(self.total, field, getattr(self.total, field) + number)

    def _forget(self) -> None:
        self.forget_decrease()
        self._forget_shocks()

    def _forget_shocks(self) -> None:
        """Begin the counts of a noise floor, without the shocks so far."""
        self.total.shocks -= self._floor['shocks']
        self.total.replaced -= self._floor['replaced']
        self._floor = Counter()
