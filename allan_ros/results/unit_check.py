# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decide in a production test whether an IMU passes, and state the reasons if it does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from ..core.check import Check
from ..core.findings import Finding, by_consequence
from .plan import Plan
from .results import SENSOR_FAULTS, UNSUITABLE, WRONG_UNITS, Results


class Decision(IntEnum):
    """Decision about an IMU; its value is the exit code."""

    WITHIN = 0
    UNREADABLE = 1
    EXCEEDS = 3
    NOT_JUDGED = 4
    BUG = 70


DECISIONS_WORST_FIRST = (
    Decision.BUG,
    Decision.EXCEEDS,
    Decision.UNREADABLE,
    Decision.NOT_JUDGED,
    Decision.WITHIN,
)
"""Decisions, the most severe first. The decision about a batch of IMUs is the most severe decision
about one of its IMUs."""

DECISION_WORDS = {
    Decision.WITHIN: 'healthy',
    Decision.UNREADABLE: 'error',
    Decision.EXCEEDS: 'failed',
    Decision.NOT_JUDGED: 'not judged',
    Decision.BUG: 'error',
}
"""Decision -> text for it in the line that is printed for each IMU."""

BROKEN = (*SENSOR_FAULTS, 'stuck', 'clipped', 'axis_absent', 'axes_equal')
"""Ids of findings that indicate a broken axis."""

SUSPECT_NOTES = ('spikes',)
"""Ids of notes (findings of severity info) because of which an IMU is not judged."""

ABOUT_THE_FORMAT = (
    *('unit_assumed', 'stamp_unit_assumed', 'stamps_unit', 'stamps_unusable'),
    *('covariance_ignored', 'sensor_elsewhere'),
)
"""Ids of warnings about the format of a recording, which say nothing about the IMU. If a unit of
measurement was assumed wrongly, the comparison with a plan or a datasheet reveals this."""


@dataclass(frozen=True)
class UnitCheck:
    """The decision about an IMU, and the checks and findings on which it is based.

    Attributes
    ----------
    decision : Decision
        WITHIN only if no limit is exceeded, the required comparisons are decided (`check_unit`),
        and no finding makes the IMU or its data suspect.
    plan : Plan or None
        The test plan; None if there is none.
    checks : tuple of Check
        Comparisons of all quantities that the plan limits; empty without a plan.
    unchecked : tuple of str
        Names of the quantities that the plan does not limit; empty without a plan.
    suspect : tuple of Finding
        Findings because of which the IMU does not pass: first the findings about a broken axis,
        then the other findings, the largest effect on the user first.

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
        """Return the checks with the verdict ``verdict``: 'within', 'exceeds' or 'undecided'."""
        return [check for check in self.checks if check.verdict == verdict]


def check_unit(results: Results, plan: Plan | None = None) -> UnitCheck:
    """Decide whether an IMU passes a plan, its datasheet and the comparison with earlier results.

    The decision is EXCEEDS if a limit is exceeded or an axis is broken. The data are unsuitable if
    there are too few, if they have a wrong unit of measurement, if the sensors are exchanged, or if
    the IMU moved or warmed up. With unsuitable data, only limits of the plan can be exceeded.

    Without an exceeded limit, the decision is NOT_JUDGED if the data are unsuitable, if a finding
    makes the IMU or its data suspect, if a comparison with a limit is undecided, or if nothing was
    compared. Undecided comparisons of terms other than N with a datasheet or earlier results are
    ignored if N is compared, because these terms often need a longer recording.
    """
    findings = by_consequence(results.findings)
    broken_findings = [f for f in findings if f.id in BROKEN]
    severe_findings = [f for f in findings if f.severity != 'info' or f.id in SUSPECT_NOTES]
    suspect_findings = [f for f in severe_findings if f.id not in ABOUT_THE_FORMAT]
    causes = tuple(dict.fromkeys([*broken_findings, *suspect_findings]))
    checks = plan.checks(results) if plan else ()
    unchecked = tuple(plan.unchecked(results)) if plan else ()
    plan_verdicts = {check.verdict for check in checks}
    # with unsuitable data, a comparison with a datasheet or an earlier result means nothing
    is_comparable = not results.is_too_short and not any(
        f.id in (*WRONG_UNITS, *UNSUITABLE) for f in findings
    )
    reference_verdicts = {c.verdict for c in results.comparisons} if is_comparable else set()
    is_decided = results.is_decided and bool(checks or results.comparisons)
    if broken_findings or 'exceeds' in plan_verdicts | reference_verdicts:
        decision = Decision.EXCEEDS
    elif causes or not is_comparable or not is_decided or 'undecided' in plan_verdicts:
        decision = Decision.NOT_JUDGED
    else:
        decision = Decision.WITHIN
    return UnitCheck(decision, plan, checks, unchecked, causes)


def worst(decisions: Sequence[Decision]) -> Decision:
    """Return the decision about a batch: the most severe decision about its IMUs.

    Without IMUs, the result is WITHIN.

    >>> worst([Decision.WITHIN, Decision.NOT_JUDGED, Decision.UNREADABLE]).name
    'UNREADABLE'
    """
    return min(decisions, key=DECISIONS_WORST_FIRST.index, default=Decision.WITHIN)
