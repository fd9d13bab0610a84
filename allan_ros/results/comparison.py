# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare recordings with each other and with datasheets, also with motors off and motors on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.check import FAMILY_ERROR, Check, differences, worst_verdict
from ..core.errors import AllanError, one_line
from ..core.estimate import significant
from ..core.fields import plain
from ..core.filters.noise_parameters import shortest_horizon
from ..core.imu import sensor_of
from .datasheets import Datasheet, sheet_to_document
from .documents import results_to_document
from .measured import against_measured
from .results import Results

SCHEMA = 'allan_ros/comparison/2'


@dataclass(frozen=True)
class RunComparison:
    """Comparison of several recordings with the first recording, and with datasheets.

    If `allan_ros.compare` returned the comparison, ``str(comparison)`` has a sentence for each
    recording except the first, and for each comparison with a datasheet. If ``within`` is not 0, a
    further sentence for each recording except the first states whether this recording is equal to
    the first. The text begins with sentences about recordings that have wrong units or do not show
    the noise at rest, if any.

    Attributes
    ----------
    runs : mapping of label to Results
        Results of each recording. Control characters in the labels are escaped.
    differences : mapping of label to tuple of Check
        Comparisons with the first recording, for each of the other recordings.
    checked : tuple of (label, Results)
        Results compared with a datasheet; one pair for each recording and each datasheet.
    family_error : float
        Largest probability of at least one significant difference if all recordings have equal
        noise.
    within : float
        Fraction by which coefficients may differ and still be called equal; 0 for no such test.
    """

    runs: Mapping[str, Results]
    differences: Mapping[str, tuple[Check, ...]]
    checked: tuple[tuple[str, Results], ...] = ()
    family_error: float = FAMILY_ERROR
    within: float = 0.0

    @property
    def first(self) -> str:
        """Label of the recording with which the others are compared."""
        return next(iter(self.runs))

    @property
    def equivalent(self) -> bool:
        """Whether the recordings have the same coefficients up to the fraction ``within``.

        N of all compared axes must be shown to be the same. The test may be undecided for other
        terms, but must not show a difference.
        """
        outcomes = (
            (d.quantity, d.equivalence(self.within))
            for checks in self.differences.values()
            for d in checks
            if d.tau is None
        )
        return all(r == 'same' or (r == 'undecided' and term != 'N') for term, r in outcomes)

    @property
    def differs(self) -> bool:
        """Whether any difference is significant, or a limit of a datasheet is exceeded.

        If ``within`` is not 0, the test whether the recordings are `equivalent` replaces the test
        whether a difference is significant.
        """
        if any(worst_verdict(results.datasheet_checks) == 'exceeds' for _, results in self.checked):
            return True
        if self.within:
            return not self.equivalent
        return any(significant_of(checks) for checks in self.differences.values())


def significant_of(checks: Iterable[Check]) -> list[Check]:
    """Return the significant differences of two recordings."""
    return [d for d in checks if d.significant]


def compare_runs(
    runs: Mapping[str, Results],
    datasheets: Sequence[Datasheet] = (),
    margin: float = 0.0,
    within: float = 0.0,
) -> RunComparison:
    """Compare each recording with the first recording, and every recording with each datasheet.

    Parameters
    ----------
    runs : mapping of label to Results
        Results of each recording, at least one.
    datasheets : sequence of Datasheet
        Datasheets with which every recording is compared.
    margin : float
        A limit of a datasheet is exceeded if the complete 95 % interval of a coefficient lies above
        limit * (1 + margin).
    within : float
        Fraction by which coefficients may differ and still be called equal; 0 for no such test.

    Returns
    -------
    RunComparison
        ``differences`` are the comparisons with the first recording, and ``checked`` are the
        results compared with the datasheets.

    Raises
    ------
    AllanError
        When a recording has no axis in common with the first recording, or when ``margin`` is below
        0 or not finite and there is a datasheet.
    """
    runs = {one_line(label): results for label, results in runs.items()}
    (first, reference), *others = runs.items()
    for label, other_results in others:
        if not set(reference.axes) & set(other_results.axes):
            raise AllanError(
                f'no common axis: {label} has {", ".join(other_results.axes)}, '
                f'{first} has {", ".join(reference.axes)}'
            )
    checks_of_others = differences(
        (first, reference.measured, other_results.measured) for _, other_results in others
    )
    checked = (
        (label, results.against_datasheet(sheet, margin))
        for sheet in datasheets
        for label, results in runs.items()
    )
    return RunComparison(
        runs,
        {label: checks for (label, _), checks in zip(others, checks_of_others)},
        tuple(checked),
        within=within,
    )


def comparison_document(comparison: RunComparison) -> dict[str, Any]:
    """Return the comparison as a JSON object of the schema ``allan_ros/comparison/2``, in SI."""
    within = comparison.within

    def document(check: Check) -> dict[str, Any]:
        equivalence = {'equivalence': check.equivalence(within)} if within else {}
        return {**plain(check), **equivalence}

    return {
        'schema': SCHEMA,
        'family_error': comparison.family_error,
        'within': within or None,
        'differs': comparison.differs,
        'runs': [
            {'label': label, 'results': results_to_document(results, curves=False)}
            for label, results in comparison.runs.items()
        ],
        'pairs': [
            {'first': comparison.first, 'second': label, 'differences': [*map(document, checks)]}
            for label, checks in comparison.differences.items()
        ],
        'datasheets': [
            {
                'run': label,
                **sheet_to_document(results.datasheet, results.datasheet_checks, results.margin),
                'measured': plain(against_measured(results.datasheet, results)),
            }
            for label, results in comparison.checked
            if results.datasheet is not None
        ],
    }


REST, RUNNING = 'at rest', 'at rest, motors on'
"""Labels of the recordings with motors off and on."""


@dataclass(frozen=True)
class Inflation:
    """Ratio of the noise with motors on to the noise with motors off, of an IMU at rest.

    Attributes
    ----------
    axes : mapping of axis to term to Check
        Comparison of N and K with motors on (`Check.measured`) with N and K with motors off
        (`Check.limit`). These N and K are parameters of a state estimator: they cover the growth of
        its error up to ``horizon``.
    comparison : RunComparison
        Comparison of the recording with motors on with the recording with motors off. It contains
        the ratios of the Allan deviations with their intervals.
    horizon : float
        Longest time in s for which the state estimator integrates without a correction.
    """

    axes: Mapping[str, Mapping[str, Check]]
    comparison: RunComparison
    horizon: float

    @property
    def factor(self) -> float:
        """Largest factor over all axes by which motors increase N; at least 1."""
        return max(axis['N'].factor for axis in self.axes.values())

    @property
    def option(self) -> str:
        """Value of the option ``--inflate`` of ``allan export``, such as 'gyro=2.10,accel=3.40'.

        Each factor is the largest factor by which motors increase N on an axis of the sensor, and
        at least 1.
        """
        factors = {sensor_of(name): 1.0 for name in self.axes}
        for name, axis in self.axes.items():
            factors[sensor_of(name)] = max(factors[sensor_of(name)], axis['N'].factor)
        return ','.join(f'{sensor}={significant(f, 3)}' for sensor, f in factors.items())

    def ratios(self, axis: str) -> list[Check]:
        """Return the ratio of the Allan deviations of an axis for each compared averaging time.

        Each ratio is the Allan deviation with motors on, divided by the Allan deviation with motors
        off.
        """
        (checks,) = self.comparison.differences.values()
        return [d for d in checks if d.axis == axis and d.tau is not None]


def use_of(check: Check) -> float:
    """Return N or K for a state estimator: the larger of the values with motors off and on."""
    return max(check.limit, check.measured.value or 0.0)


def inflation_document(inflation: Inflation) -> dict[str, Any]:
    """Return an `Inflation` as a JSON object of the schema ``allan_ros/inflation/2``, in SI."""
    return {
        'schema': 'allan_ros/inflation/2',
        'horizon_s': [shortest_horizon(inflation.horizon), inflation.horizon],
        'factor': inflation.factor,
        'inflate': inflation.option,
        'axes': {
            name: {
                **{
                    term: {
                        'rest': c.limit,
                        'running': c.measured.value,
                        'factor': c.factor,
                        'use': use_of(c),
                    }
                    for term, c in axis.items()
                },
                'deviation': [
                    {'tau_s': d.tau, 'ratio': plain(d.ratio.value), 'ci95': plain(d.ratio.ci95)}
                    for d in inflation.ratios(name)
                ],
            }
            for name, axis in inflation.axes.items()
        },
    }
