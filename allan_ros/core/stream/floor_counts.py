# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counts what becomes of the samples; decisions about the noise floor change it afterwards."""

from __future__ import annotations

from collections import Counter
from typing import Literal

from .health import Counts

Fate = Literal['used', 'moving', 'stuck', 'noise_decreased', 'shocks', 'replaced']
"""A field of `Counts`. 'used' are the samples that are passed on to the sums."""


Excluded = Literal['noise_decreased', 'noise_increased']
"""A field of `Counts` for samples at rest at another noise floor."""


class FloorCounts:
    """Counts samples for a stream, and separately at the present noise floor and in its last block.

    The counts of another noise floor may be set aside. While the present floor is only tried,
    samples that are passed on to its sums are counted as excluded. ``total`` is changed in place.
    """

    def __init__(self, total: Counts) -> None:
        self.total = total
        self._floor: Counter[str] = Counter()  # since the present noise floor was learned
        self._other: Counter[str] | None = None  # the same of the floor that was set aside
        self._tried = False  # whether the present floor is only tried
        self._excluded: Excluded = 'noise_decreased'  # what the samples of the tried floor are
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
        """Whether the tried floor has more samples at rest than the floor that was set aside."""
        return self._tried and self._floor['used'] > (self._other or self._floor)['used']

    def discard(self, reason: Literal['moving', 'stuck']) -> None:
        """Count the samples at the present floor as not at rest: their sums are discarded.

        Unless it is only tried, the counts that were set aside are forgotten, too.
        """
        self.move(self._used, reason, self._floor['used'])
        self.forget_decrease()
        self._forget_shocks()
        if not self._tried:
            self._other = None

    def set_aside(self, excluded: Excluded) -> None:
        """Begin the counts of a tried floor; an earlier attempt remains excluded."""
        if not self._tried:
            self._other, self._floor = self._floor, Counter()
        else:
            self._forget_shocks()
        self._tried, self._excluded = True, excluded

    def resume(self) -> None:
        """Continue the counts that were set aside; those of the present floor are excluded."""
        assert self._other is not None
        if self._tried:
            self._forget_shocks()
            self._floor, self._other, self._tried = self._other, None, False
            return
        self.move('used', self._excluded, self._floor['used'])
        self.move('moving', 'used', self._other['used'])
        self._count_shocks(self._floor, -1)
        self._count_shocks(self._other, 1)
        self._floor, self._other = self._other, self._floor

    def accept(self) -> None:
        """Count the samples of the tried floor as used, and those that were set aside as moving."""
        assert self._other is not None
        self.move(self._excluded, 'used', self._floor['used'])
        self.move('used', 'moving', self._other['used'])
        self._count_shocks(self._other, -1)
        self._tried = False
        for counts in (self._floor, self._other):
            self.move('noise_decreased', 'moving', counts['noise_decreased'])
            counts['noise_decreased'] = 0

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
        return self._excluded if self._tried else 'used'

    def _add(self, fate: str, number: int) -> None:
        self._floor[fate] += number
        field = self._used if fate == 'used' else fate
        setattr(self.total, field, getattr(self.total, field) + number)

    def _count_shocks(self, counts: Counter[str], times: int) -> None:
        self.total.shocks += times * counts['shocks']
        self.total.replaced += times * counts['replaced']

    def _forget_shocks(self) -> None:
        """Begin the counts of a noise floor, without the shocks so far."""
        self._count_shocks(self._floor, -1)
        self._floor = Counter()
