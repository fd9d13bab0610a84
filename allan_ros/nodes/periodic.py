# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When something is due, for the one steady timer of a node that looks after everything."""

from __future__ import annotations

from collections.abc import Callable


class Periodic:
    """Comes due once a period; the period may change while it runs.

    One timer that asks several of these costs a third of as many timers in the executor.
    """

    def __init__(self, period: Callable[[], float], now: float) -> None:
        self._period = period
        self._last = now

    def due(self, now: float) -> bool:
        """Return whether a period has passed since it last was due (steady clock, s)."""
        if now - self._last < self._period():
            return False
        # late by less than a period: keep the beat; by more: start it anew
        self._last = max(self._last + self._period(), now - self._period())
        return True
