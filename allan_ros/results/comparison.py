# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compare recordings with each other, with datasheets, and with motors off and on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.check import FAMILY_ERROR, Check, differences, worst_verdict
from ..core.errors import AllanError, one_line
from ..core.fields import plain
from ..core.filters.reductions import shortest_horizon
from ..core.imu import sensor_of
from ..core.number_text import significant
from .datasheets import Datasheet, sheet_to_document
from .documents import results_to_document
from .measured import against_measured
from .results import Results

SCHEMA = 'allan_ros/comparison/2'


@dataclass(frozen=True)
class RunComparison:
    """Comparison of several recordings with the first recording, and with datasheets.

    Its text has a sentence for each recording but the first, and for each comparison with a
    datasheet.

    Attributes
    ----------
    runs : mapping of label to Results
        Results of each recording. Control characters in the labels are escaped.
    differences : mapping of label to tuple of Check
        Comparisons of each recording but the first with the first recording.
    checked : tuple of (label, Results)
        Results of each recording, compared with each datasheet.
    family_error : float
        Probability of any significant difference if all recordings have equal noise.
    within : float
        Fraction up to which coefficients are tested for equality; 0 for no such test.
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
        """Whether N of all axes is the same up to ``within``, and no other term differs by more."""
        results = (
            (d.quantity, d.equivalence(self.within))
            for checks in self.differences.values()
            for d in checks
            if d.tau is None
        )
        return all(r == 'same' or (r == 'undecided' and term != 'N') for term, r in results)

    @property
    def differs(self) -> bool:
        """Whether any difference is significant, or a limit of a datasheet is exceeded.

        If ``within`` is not 0, the recordings must be `equivalent` instead of without a significant
        difference.
        """
        if any(worst_verdict(one.datasheet_checks) == 'exceeds' for _, one in self.checked):
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
        Results of each recording.
    datasheets : sequence of Datasheet
        Datasheets with which every recording is compared.
    margin : float
        A limit of a datasheet is exceeded if the complete 95 % interval of a coefficient lies above
        limit * (1 + margin).
    within : float
        Fraction up to which coefficients are tested for equality; 0 for no such test.

    Raises
    ------
    AllanError
        When a recording has no axis in common with the first recording.
    """
    runs = {one_line(label): results for label, results in runs.items()}
    (first, known), *others = runs.items()
    for label, other in others:
        if not set(known.axes) & set(other.axes):
            raise AllanError(
                f'no common axis: {label} has {", ".join(other.axes)}, '
                f'{first} has {", ".join(known.axes)}'
            )
    found = differences((first, known.measured, other.measured) for _, other in others)
    checked = (
        (label, results.against_datasheet(sheet, margin))
        for sheet in datasheets
        for label, results in runs.items()
    )
    return RunComparison(
        runs,
        {label: changes for (label, _), changes in zip(others, found)},
        tuple(checked),
        within=within,
    )


def comparison_document(comparison: RunComparison) -> dict[str, Any]:
    """Return the comparison as a JSON object of the schema ``allan_ros/comparison/2``, in SI."""
    within = comparison.within

    def document(check: Check) -> dict[str, Any]:
        tested = {'equivalence': check.equivalence(within)} if within else {}
        return {**plain(check), **tested}

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
    """Ratio of the noise of an IMU at rest with motors on to its noise with motors off.

    Attributes
    ----------
    axes : mapping of axis to term to Check
        N and K for a state estimator with motors on, compared with N and K with motors off
        (``limit``). Both cover the growth of the integrated error up to ``horizon``.
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
        """Largest factor by which motors increase N, of all axes."""
        return max(axis['N'].factor for axis in self.axes.values())

    @property
    def option(self) -> str:
        """Largest factor by which motors increase N, for each sensor.

        It is written as the value of the option ``--inflate`` of ``allan export``.
        """
        factors = {sensor_of(name): 1.0 for name in self.axes}
        for name, axis in self.axes.items():
            factors[sensor_of(name)] = max(factors[sensor_of(name)], axis['N'].factor)
        return ','.join(f'{sensor}={significant(f, 3)}' for sensor, f in factors.items())

    def ratios(self, axis: str) -> list[Check]:
        """Return the ratios of the Allan deviations of an axis, one for each averaging time."""
        (checks,) = self.comparison.differences.values()
        return [d for d in checks if d.axis == axis and d.tau is not None]


def use_of(check: Check) -> float:
    """Return the value for a state estimator: the larger of the values with motors off and on."""
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
