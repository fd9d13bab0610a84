# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes: checked parameters, one timer, diagnostics, and protected callbacks."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..core.errors import AllanError
from ..core.findings import Finding, finding
from ..core.settings import CheckedSettings, ParameterInfo, describe
from ..readers.files import write_atomic
from ..view.finding_text import finding_line
from .diagnostics import metrics_text, status_name, status_of
from .node_settings import GROUPS, PublishSettings
from .shell import STEADY_CLOCK

T = TypeVar('T', bound=CheckedSettings)

TICK_S = 0.25
"""Period in s of the timer that polls the parts of a node. Tasks with shorter periods are done at
each tick. A shorter period costs CPU time, because rclpy builds its wait set at each wake."""

METRICS_S = 5.0
"""Period in s at which the metrics file is written."""

FAULT_SHOWN_S = 60.0
"""Time in s for which an internal error stays on `/diagnostics` after its last occurrence."""

RCLPY_PARAMETERS = ('use_sim_time', 'start_type_description_service')
"""Parameters, besides ``qos_overrides.*``, that rclpy itself declares."""


class ParameterGroup(Generic[T]):
    """One group of ROS parameters, such as ``input``.

    ``value`` is a settings object with the present values of the parameters ``<prefix>.<field>``.
    """

    def __init__(self, prefix: str, value: T) -> None:
        self.prefix, self.value = prefix, value

    def changed(self, parameters: Sequence[Parameter]) -> T:
        """Return the settings with new values of the parameters that belong to this group.

        Raises AllanError if a value is invalid.
        """
        name_start = f'{self.prefix}.'
        own_parameters = [p for p in parameters if p.name.startswith(name_start)]
        if not own_parameters:
            return self.value
        new_values = {p.name[len(name_start) :]: _from_ros(p.value) for p in own_parameters}
        new_settings: T = replace(self.value, **new_values)  # type: ignore[type-var]
        return new_settings


class Parameters:
    """The checked parameters of a node.

    An invalid value is rejected with a reason: at the start by an exception, later by the answer of
    the service. Parameters of one atomic request, even of several groups, are either all accepted
    or all rejected.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._groups: dict[str, ParameterGroup[Any]] = {}
        node.add_on_set_parameters_callback(self._on_set)

    def group(
        self, prefix: str, settings_type: type[T], names: Collection[str] = ()
    ) -> ParameterGroup[T]:
        """Return a group, and declare ``<prefix>.<field>`` for each field that is not declared yet.

        If ``names`` are given, only the fields with these names are declared; undeclared fields
        have their defaults. Raises AllanError if a value given at start is invalid or has the wrong
        type, and ParameterException (rclpy) if a value is outside its range.
        """
        # The group is removed during the declarations. rclpy calls `_on_set` for each declaration,
        # but a value may be invalid before the other values are declared.
        group = self._groups.pop(prefix, ParameterGroup(prefix, settings_type()))
        declared_values = {}
        for name, info in describe(settings_type).items():
            full_name = f'{prefix}.{name}'
            if self._node.has_parameter(full_name) or (names and name not in names):
                continue
            default = getattr(group.value, name)
            value = to_ros(default)
            try:
                declared = self._node.declare_parameter(full_name, value, descriptor(info, default))
            except InvalidParameterTypeException as error:
                given_value = self._node._parameter_overrides[full_name].value
                raise AllanError(
                    f'parameter {full_name} is {given_value!r}: give a value such as {value!r}'
                ) from error
            declared_values[name] = _from_ros(declared.value)
        group.value = replace(group.value, **declared_values)
        self._groups[prefix] = group
        return group

    def unknown(self) -> list[str]:
        """Return a warning for each parameter given at start that no node of allan_ros declares."""
        known_names = [
            f'{prefix}.{name}'
            for prefix, settings_type in GROUPS.items()
            for name in describe(settings_type)
        ]
        given_values: dict[str, Any] = getattr(self._node, '_parameter_overrides', {})
        return [
            f'parameter {name!r} is unknown and ignored{_suggestion(name, known_names)}'
            for name in given_values
            if name not in (*known_names, *RCLPY_PARAMETERS)
            and not name.startswith('qos_overrides.')
        ]

    def changes(self) -> list[str]:
        """Return ``name=value`` for each parameter that differs from its default."""
        return [
            f'{group.prefix}.{f.name}={to_ros(value)}'
            for group in self._groups.values()
            for f in fields(group.value)
            if (value := getattr(group.value, f.name)) != f.default
        ]

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept all parameters of a request, or none."""
        try:
            changed = [(group, group.changed(parameters)) for group in self._groups.values()]
        except AllanError as error:
            return SetParametersResult(successful=False, reason=str(error))
        # rclpy itself checks use_sim_time only after this callback
        for p in parameters:
            if p.name == 'use_sim_time' and p.type_ != Parameter.Type.BOOL:
                return SetParametersResult(successful=False, reason='use_sim_time must be a bool')
        for group, value in changed:
            group.value = value
        return SetParametersResult(successful=True)


def descriptor(info: ParameterInfo, default: Any) -> ParameterDescriptor:
    """Return the description and range of a parameter, as ``ros2 param describe`` shows them."""
    unit = f' [{info.unit}]' if info.unit else ''
    choices = f'one of {", ".join(info.choices)}' if info.choices else ''
    described = ParameterDescriptor(
        description=f'{info.doc}{unit}', additional_constraints=choices, read_only=info.read_only
    )
    if info.low is None or info.high is None:
        return described
    if isinstance(default, int):
        low, high = int(info.low), int(info.high)
        described.integer_range = [IntegerRange(from_value=low, to_value=high)]
    else:
        limits = {'from_value': float(info.low), 'to_value': float(info.high)}
        described.floating_point_range = [FloatingPointRange(**limits)]
    return described


def to_ros(value: Any) -> Any:
    """Return a value in the type that rclpy uses for a parameter: a tuple becomes a list."""
    return list(value) if isinstance(value, tuple) else value


def _from_ros(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, tuple)) else value


def _suggestion(name: str, known_names: list[str]) -> str:
    """Return '; did you mean ...?' with known parameters that have a similar name, or ''."""
    same_field = [full_name for full_name in known_names if full_name.endswith(f'.{name}')]
    group_switches = [f'{name}.{field}' for field in ('path', 'enabled', 'node')]
    candidates = [
        *same_field,
        *(full_name for full_name in group_switches if full_name in known_names),
    ]
    candidates = candidates or get_close_matches(name, known_names, 1, 0.7)
    return f'; did you mean {" or ".join(dict.fromkeys(candidates))}?' if candidates else ''


class Periodic:
    """Decides when a periodic task is due. ``period`` returns the period in s, which may change.

    One ROS timer that polls several `Periodic` objects takes a third of the CPU time of separate
    ROS timers.
    """

    def __init__(self, period: Callable[[], float]) -> None:
        self._period, self._last = period, time.monotonic()

    def due(self, now: float) -> bool:
        """Return whether the task is due at the time ``now`` of the monotonic clock, in s."""
        if now - self._last < self._period():
            return False
        # If the call is more than one period late, the missed periods are skipped.
        self._last = max(self._last + self._period(), now - self._period())
        return True


class NodePart:
    """One part of a node, such as the input, the estimate or the relay of one IMU."""

    def tick(self, now: float) -> None:
        """Run the tasks that are due; ``now`` is the time of the monotonic clock in s."""

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the diagnostic statuses of this part."""
        return []

    def close(self) -> None:
        """Finish the work before the node is destroyed."""


class AllanNode(Node):
    """A node that consists of parts, such as the inputs of several IMUs.

    An unexpected exception in a running part is logged with its traceback, once for each type and
    place, and reported as ERROR on `/diagnostics`; the node and its other parts continue.
    ``options`` are passed to `rclpy.node.Node`.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.parameters = Parameters(self)
        self.publish = self.parameters.group('publish', PublishSettings)
        self._parts: Sequence[NodePart] = ()
        self._faults: dict[tuple[str, str], tuple[float, Finding]] = {}
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._diagnostics_due = Periodic(lambda: self.publish.value.diagnostics_period)
        self.metrics_file = ''
        self._metrics_due = Periodic(lambda: METRICS_S)

    def begin(self, parts: Sequence[NodePart], purpose: str) -> None:
        """Start a timer that polls the parts, and log the ``purpose`` of the node."""
        self._parts = parts
        settings = ', '.join(self.parameters.changes()) or 'all defaults'
        self.get_logger().info(f'{purpose}; settings: {settings}')
        for line in self.parameters.unknown():
            self.get_logger().warning(line)
        self.create_timer(TICK_S, self._tick, clock=STEADY_CLOCK)

    def close(self) -> None:
        """Close all parts of the node."""
        for part in reversed(self._parts):
            try:
                part.close()
            except Exception as error:  # other parts must still write their checkpoints
                self.fault('close', error)

    def fault(self, where: str, error: Exception) -> None:
        """Report an unexpected exception on `/diagnostics`, and log it.

        Repeated exceptions of one type at the same place (``where``) are logged once.
        """
        found = finding('internal_error', where=where, error=repr(error))
        kind = where, type(error).__name__
        if kind not in self._faults:
            self.get_logger().error(
                f'{finding_line(found)}\n{"".join(traceback.format_exception(error))}'
            )
        self._faults[kind] = time.monotonic(), found

    def _tick(self) -> None:
        now = time.monotonic()
        for part in self._parts:
            try:
                part.tick(now)
            except Exception as error:
                self.fault(type(part).__name__, error)
        if self._diagnostics_due.due(now):
            self._publish_diagnostics(now)

    def _publish_diagnostics(self, now: float) -> None:
        """Publish the statuses of all parts and recent internal errors; write metrics if due."""
        statuses: list[DiagnosticStatus] = []
        for part in self._parts:
            try:
                statuses += part.statuses(now)
            except Exception as error:
                self.fault(f'{type(part).__name__} diagnostics', error)
        faults = list(self._faults.values())  # a copy, because another thread may add a fault
        if recent_faults := [f for time_s, f in faults if now - time_s <= FAULT_SHOWN_S]:
            statuses.append(status_of(status_name(self, 'node'), recent_faults, '', ()))
        if self.metrics_file and self._metrics_due.due(now):
            try:
                write_atomic(self.metrics_file, metrics_text(statuses))
            except AllanError as error:
                self.get_logger().warning(str(error), throttle_duration_sec=60.0)
        message = DiagnosticArray(status=statuses)
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
