# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sentences about an IMU in a production test: decision, limits that are not met, findings."""

from __future__ import annotations

from collections.abc import Sequence

from ..core.check import Check
from ..core.estimate import LIMIT_DIGITS, NOTHING_KNOWN, Estimate, significant
from ..core.findings import grouped
from ..core.imu import AXES, SENSORS, sensor_of
from ..results.plan import Limits, Plan
from ..results.results import WRONG_UNITS, Results
from ..results.unit_check import BROKEN, UnitCheck
from .finding_text import texts_of
from .verdict_text import finding_text, verdict_of

SHOWN_CHECKS, SHOWN_FINDINGS = 4, 2
"""Largest number of quantities with one verdict, and largest number of findings besides a broken
axis or a wrong unit, in the line about an IMU."""


def limits_text(limits: Limits) -> str:
    """Return limits as text, in the unit of measurement that the plan states.

    >>> limits_text(Limits(0.0, 1e-2, '%', 1e-2)), limits_text(Limits(9.5, None, 'm/s^2'))
    ('0 to 1 %', 'at least 9.5 m/s^2')
    """
    low, high = (
        None if end is None else f'{end / limits.scale:.6g}' for end in (limits.lower, limits.upper)
    )
    unit = f' {limits.unit}' if limits.unit else ''
    if low is None or high is None:
        return f'at most {high}{unit}' if low is None else f'at least {low}{unit}'
    return f'{low} to {high}{unit}'


def measured_text(measured: Estimate, limits: Limits) -> str:
    """Return a measured quantity as text in the unit of the limits, such as '< 3.20 deg/h'.

    The text is '-' if the quantity is not resolved and has no upper limit.
    """
    number = _number_text(measured, limits)
    return f'{number} {limits.unit}' if limits.unit and number != NOTHING_KNOWN else number


def _number_text(measured: Estimate, limits: Limits) -> str:
    """Return a measured number as text in the unit of the limits, without this unit."""
    sign, value = '', measured.value if measured.resolved else None
    if value is None:
        sign, value = '< ', measured.upper95
    if value is None:
        return NOTHING_KNOWN
    return f'{sign}{significant(value / limits.scale, LIMIT_DIGITS)}'


def name_of(checks: Sequence[Check]) -> str:
    """Return the name of the compared quantity: 'gyro x, y N', 'gyro N' (all axes), or 'rate'."""
    axes = [check.axis for check in checks if check.axis]
    quantity = checks[0].quantity.replace('_', ' ')
    if not axes:
        return quantity
    sensor = sensor_of(axes[0])
    letters = '' if len(axes) == len(AXES[SENSORS[sensor]]) else ', '.join(a[-1] for a in axes)
    return ' '.join(filter(None, (sensor, letters, quantity)))


def checks_text(checks: Sequence[Check], plan: Plan) -> str:
    """Return measured quantities as text, each with its limits in the plan.

    Axes of one sensor with equal limits and notes are named together. At most `SHOWN_CHECKS` such
    groups are named; the others are counted.
    """
    groups: dict[tuple[str, str, Limits, str], list[Check]] = {}
    for check in checks:
        sensor = sensor_of(check.axis) if check.axis else ''
        key = (sensor, check.quantity, plan.limits_of(check), check.note)
        groups.setdefault(key, []).append(check)
    texts = []
    for (_, _, limits, note), group in groups.items():
        values = ', '.join(_number_text(check.measured, limits) for check in group)
        if len(group) == 1:
            values = measured_text(group[0].measured, limits)
        reason = f', because {note}' if note else ''
        value_text = 'is unknown' if not values.strip('-, ') else values
        texts.append(f'{name_of(group)} {value_text}{reason} (limit {limits_text(limits)})')
    remaining = [f'{len(texts) - SHOWN_CHECKS} more'] if len(texts) > SHOWN_CHECKS else []
    return '; '.join([*texts[:SHOWN_CHECKS], *remaining])


def unit_sentences(check: UnitCheck, results: Results, units: str) -> list[str]:
    """Return sentences with the reasons for the decision about an IMU, the most important first.

    ``units`` is 'deg/h' or 'SI'.
    """
    suspect_findings = [each for each in grouped(check.suspect) if each.id != 'exceeds_limit']
    # a broken axis or a wrong unit of measurement is the cause of other findings and comes first
    causes = [
        each for each in suspect_findings if each.id in (*BROKEN, *WRONG_UNITS, 'accel_scale')
    ]
    sentences = [finding_text(each, results, units) for each in causes[:1]]
    plan = check.plan
    exceeded, undecided_checks = check.of('exceeds'), check.of('undecided')
    if plan and exceeded:
        sentences.append(f'Beyond {plan.name}: {checks_text(exceeded, plan)}.')
    is_compared = results.comparisons or not plan
    if is_compared:
        summary = verdict_of(results, units).summary
        sentences += [summary] if summary not in sentences else []
    for i, each in enumerate(suspect_findings[:SHOWN_FINDINGS]):
        if not any(texts_of(each, units).message in sentence for sentence in sentences):
            sentences.append(finding_text(each, results, units))
        if i == 0:
            sentences.append(texts_of(each, units).remedy)
    if n_omitted := len(suspect_findings[SHOWN_FINDINGS:]):
        sentences.append(f'{n_omitted} more finding{"s" * (n_omitted > 1)}.')
    if plan and undecided_checks:
        sentences.append(f'Not decided by {plan.name}: {checks_text(undecided_checks, plan)}.')
    if plan and not exceeded and not undecided_checks:
        sentences.append(f'All limits of {plan.name} are met ({len(check.checks)}).')
    return sentences


def unchecked_text(names: Sequence[str]) -> str:
    """Return a text that names the quantities without limits in a plan; '' if there are none."""
    return f'unchecked (the plan has no limit): {", ".join(names)}' if names else ''
