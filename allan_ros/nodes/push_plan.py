# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Defines which parameters of another node are set to which numbers, and when they are not set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.stream.drive_recorder import LEAST_DRIVE_S, LEAST_DRIVES, LEAST_STOP_S, LONGEST_DRIVE_S
from ..export import ExportOptions
from ..readers.files import config_file, read_yaml

SCHEMA = 'allan_ros/push/1'

# Only the gain (in rad/s) is set, because zeta has no effect without a magnetometer.
GAINS = {'imu_filter_madgwick': ('gain',)}
"""Export target -> its rows that are gains of a state estimator without a bias state. A gain has to
cover the errors of the gyro in motion. Without a factor in motion, the gain is shown in the status,
but not set."""

RAISE_RATIO = 2.0
"""The gain in a node is raised if the gain that covers the errors of the gyro in motion is more
than `RAISE_RATIO` times as large. It is never set below the found gain: a large gain may be needed
for other reasons, such as fast convergence, and a lower gain makes the tilt worse at rest."""

PUSHED_TARGETS = (*GAINS, 'kalibr', 'fast_lio')
"""Export targets that ``push.filter`` may name: gains, densities N and K (kalibr), and N^2 f and
K^2 f (fast_lio). `docs/targets.md` names the code that shows the convention of each target."""

GAINS_WAIT = (
    'the gain has to cover the errors in motion, which are not measured yet: drive at least '
    f'{LEAST_DRIVES} times for {LEAST_DRIVE_S:g} to {LONGEST_DRIVE_S:g} s between rests of at '
    f'least {LEAST_STOP_S:g} s (status "in motion")'
)
"""Message of the status while no gain can be set: what is missing, and what to do."""

CHANGE = 0.1
"""A value is set again only if it has changed by more than this fraction."""

Numbers = tuple[float, ...]
"""Value of a parameter: one number for a double, several numbers for an array of doubles."""


@dataclass(frozen=True)
class PushPlan:
    """The rows of an export target, and the parameters that are set to the values of these rows."""

    target: str
    names: Mapping[str, str]  # name of a row -> name of the parameter; see `rows`
    options: ExportOptions

    @property
    def has_gains(self) -> bool:
        """Whether the values are gains."""
        return self.target in GAINS

    @property
    def rows(self) -> Mapping[str, str]:
        """Name of a row -> name of its parameter; if empty, parameters are named like rows."""
        return {row: self.names.get(row, row) for row in GAINS.get(self.target, self.names)}


def load_push_plan(name: str) -> PushPlan:
    """Read a plan, given its name, as in ``config/filters``, or the path of its .yaml file.

    Raises AllanError if the name is unknown, or the file is invalid or cannot be read.
    """
    path = config_file('filters', name, 'plan for push.filter')
    fields = Fields(read_yaml(path), str(path))
    fields.schema(SCHEMA)
    fields.allow_only('schema', 'target', 'estimates_bias', 'horizon', 'parameters')
    target = fields.choice('target', PUSHED_TARGETS)
    estimates_bias = 'estimates_bias' in fields and fields.value('estimates_bias')
    if target not in GAINS and not estimates_bias:
        raise AllanError(
            f'{path}: the numbers of {target} do not cover the gyro bias. If the node estimates '
            'the bias, state estimates_bias: true'
        )
    names = fields.fields('parameters') if 'parameters' in fields else None
    horizon = fields.number('horizon') if 'horizon' in fields else None
    return PushPlan(
        target,
        {} if names is None else {row: names.text(row) for row in names},
        ExportOptions() if horizon is None else ExportOptions(horizon=horizon),
    )


@dataclass(frozen=True)
class Proposal:
    """A proposed value of the parameter ``name``: one number, or three numbers.

    ``interval`` is the 95 % interval of the value, and ``origin`` states how it was computed.
    """

    name: str
    values: Numbers
    interval: tuple[float, float]
    origin: str
    is_gain: bool = False

    def differs(self, other: Numbers) -> bool:
        """Return whether a number differs from the number in ``other`` by more than `CHANGE`.

        `CHANGE` is a fraction of the number in ``other``. Values of different lengths differ.
        """
        if len(other) != len(self.values):
            return True
        return not all(abs(v - c) <= CHANGE * abs(c) for v, c in zip(self.values, other))

    def keeps(self, found: Numbers) -> str:
        """Return why the gain ``found``, which the node had before, is kept.

        Returns '' if there is no such reason.
        """
        if not self.is_gain or len(found) != 1 or not self.values[0] <= RAISE_RATIO * found[0]:
            return ''
        return (
            f'is {found[0]:.4g} in the node and covers the errors of the gyro in motion, for which '
            f'{self.values[0]:.4g} is enough'
        )

    def refusal(self, found: Numbers, factor: float) -> str:
        """Return why this proposal must not replace ``found``, the value that the node had before.

        ``factor`` is the largest allowed ratio of the two values. Returns '' if the proposal may
        replace ``found``.
        """
        if len(found) != len(self.values):
            return f'has {len(found)} numbers in the node, but the model gives {len(self.values)}'
        for value, present in zip(self.values, found):
            if not (0.0 < present < math.inf and 0.0 < value < math.inf):
                return (
                    f'is {present:.4g} in the node and is not changed; the model gives {value:.4g}'
                )
            if not 1.0 / factor <= value / present <= factor:
                larger, smaller = max(value, present), min(value, present)
                return (
                    f'{value:.4g} is {larger / smaller:.3g} times '
                    f'{"above" if value > present else "below"} the {present:.4g} that was found, '
                    'so it is not set: check the filter, or raise push.max_factor'
                )
        return ''


def text_of(values: Numbers) -> str:
    """Return the value of a parameter as text."""
    return ' '.join(f'{value:.4g}' for value in values)
