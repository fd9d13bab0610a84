# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The decision of a production test about one unit: may it ship, and if not, why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from ..core.check import Check
from ..core.findings import Finding, by_consequence
from .plan import Plan
from .results import SENSOR_FAULTS, UNSUITABLE, WRONG_UNITS, Results


class Decision(IntEnum):
    """Decision about a unit, which is also its exit code."""

    WITHIN = 0
    UNREADABLE = 1
    EXCEEDS = 3
    NOT_JUDGED = 4
    BUG = 70


WORST_FIRST = (
    *(Decision.BUG, Decision.EXCEEDS, Decision.UNREADABLE, Decision.NOT_JUDGED, Decision.WITHIN),
)
"""The decision about a batch is the first of these that occurs."""

DECISION_WORDS = {
    Decision.WITHIN: 'healthy',
    Decision.UNREADABLE: 'error',
    Decision.EXCEEDS: 'failed',
    Decision.NOT_JUDGED: 'not judged',
    Decision.BUG: 'error',
}
"""Decision -> its text in the line of a unit."""

BROKEN = (*SENSOR_FAULTS, 'stuck', 'clipped', 'axis_absent', 'axes_equal')
"""Ids of findings that indicate a broken axis."""

SUSPECT_NOTES = ('spikes',)
"""Ids of notes that make a unit suspect."""

ABOUT_THE_FORMAT = (
    *('unit_assumed', 'stamp_unit_assumed', 'stamps_unit', 'stamps_unusable'),
    *('covariance_ignored', 'sensor_elsewhere'),
)
"""Ids of warnings about the format of a recording, which say nothing about the unit: the limits of
a plan or a datasheet reveal a wrong unit of measurement."""


@dataclass(frozen=True)
class UnitCheck:
    """The decision about a unit, and what it is based on.

    Attributes
    ----------
    decision : Decision
        WITHIN only if every limit is met and no finding makes the unit suspect.
    plan : Plan or None
        The test plan; None if there is none.
    checks : tuple of Check
        All quantities with limits in the plan.
    unchecked : tuple of str
        Measured quantities that the plan does not limit; empty without a plan.
    suspect : tuple of Finding
        Findings because of which the unit does not pass, the most severe first.

    Examples
    --------
    >>> import allan_ros as ar
    >>> from allan_ros.results.plan import plan_from_document
    >>> plan = plan_from_document({
    ...     'schema': 'allan_ros/plan/1', 'rate': {'lower': 60, 'unit': 'Hz'}}, 'demo.yaml')
    >>> results = ar.analyze(ar.simulate(hours=0.1, rate=50))
    >>> check_unit(results, plan).decision.name, check_unit(results).decision.name
    ('EXCEEDS', 'NOT_JUDGED')
    """

    decision: Decision
    plan: Plan | None = None
    checks: tuple[Check, ...] = ()
    unchecked: tuple[str, ...] = ()
    suspect: tuple[Finding, ...] = ()

    def of(self, verdict: str) -> list[Check]:
        """Return the checks with a verdict: 'within', 'exceeds' or 'undecided'."""
        return [check for check in self.checks if check.verdict == verdict]


def check_unit(results: Results, plan: Plan | None = None) -> UnitCheck:
    """Decide about a unit by a plan, and by the datasheet and earlier runs of the results.

    The unit exceeds if a limit is exceeded or an axis is broken. It is not judged if a finding
    makes it or its data suspect, a limit is undecided, or nothing was compared. Without a plan,
    only N must be decided if it has a limit, because B and K often need a longer recording.
    """
    found = by_consequence(results.findings)
    broken = [f for f in found if f.id in BROKEN]
    severe = [f for f in found if f.severity != 'info' or f.id in SUSPECT_NOTES]
    suspect = [f for f in severe if f.id not in ABOUT_THE_FORMAT]
    causes = tuple(dict.fromkeys([*broken, *suspect]))
    checks = plan.checks(results) if plan else ()
    unchecked = tuple(plan.unchecked(results)) if plan else ()
    verdicts = {check.verdict for check in checks}
    # a datasheet is not compared with too few data, or with a wrong unit of measurement
    usable = not results.is_too_short and not any(
        f.id in (*WRONG_UNITS, *UNSUITABLE) for f in found
    )
    compared = {c.verdict for c in results.comparisons} if usable else set()
    is_decided = results.is_decided and bool(checks or results.comparisons)
    if broken or 'exceeds' in verdicts | compared:
        decision = Decision.EXCEEDS
    elif causes or not usable or not is_decided or 'undecided' in verdicts:
        decision = Decision.NOT_JUDGED
    else:
        decision = Decision.WITHIN
    return UnitCheck(decision, plan, checks, unchecked, causes)


def worst(decisions: Sequence[Decision]) -> Decision:
    """Return the decision about a batch.

    >>> worst([Decision.WITHIN, Decision.NOT_JUDGED, Decision.UNREADABLE]).name
    'UNREADABLE'
    """
    return min(decisions, key=WORST_FIRST.index, default=Decision.WITHIN)
