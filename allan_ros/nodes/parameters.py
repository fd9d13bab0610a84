# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings dataclasses as ROS parameters: declared from them and checked by them."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..core.errors import AllanError
from ..core.settings import CheckedSettings, ParameterInfo, describe
from .settings import GROUPS

T = TypeVar('T', bound=CheckedSettings)

MAX_INTEGER = 2**63 - 1
"""ROS integer parameters are int64."""

RCLPY_PARAMETERS = ('use_sim_time', 'start_type_description_service')
"""Parameters that rclpy itself declares, in addition to ``qos_overrides.*``."""


class ParameterGroup(Generic[T]):
    """The settings of one group; ``value`` equals the node's parameters ``<prefix>.<field>``."""

    def __init__(self, prefix: str, value: T) -> None:
        self.prefix = prefix
        self.value = value

    def changed(self, parameters: list[Parameter]) -> T:
        """Return the settings with the parameters of this group replaced.

        Raises
        ------
        AllanError
            When they do not make valid settings.
        """
        start = f'{self.prefix}.'
        given = {p.name[len(start) :]: p.value for p in parameters if p.name.startswith(start)}
        if not given:
            return self.value
        made: T = replace(self.value, **{k: _from_ros(v) for k, v in given.items()})  # type: ignore[type-var]
        return made


class Parameters:
    """The checked parameters of a node.

    A value that makes no valid settings is refused with the settings' own message: at start by an
    exception, at run time by the result of the service. A set of parameters that is set atomically
    is taken over as a whole or not at all, also where it spans several groups.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._groups: list[ParameterGroup[Any]] = []
        node.add_on_set_parameters_callback(self._on_set)

    def group(self, prefix: str, settings_type: type[T]) -> ParameterGroup[T]:
        """Declare the parameters of one group and return its settings.

        Raises
        ------
        AllanError
            When the values given at start do not make valid settings.
        rclpy.exceptions.ParameterException
            When a value has the wrong type or lies outside its range.
        """
        defaults = settings_type()
        info = describe(settings_type)
        given = {
            f.name: _from_ros(_declare(self._node, prefix, f.name, info[f.name], default))
            for f in fields(settings_type)  # type: ignore[arg-type]
            if f.name in info
            for default in [getattr(defaults, f.name)]
        }
        group = ParameterGroup(prefix, settings_type(**given))
        self._groups.append(group)
        return group

    def unknown(self) -> list[str]:
        """Return a line for each parameter given at start that no allan_ros node declares."""
        known = [f'{prefix}.{name}' for prefix, made in GROUPS.items() for name in describe(made)]
        given: dict[str, Any] = getattr(self._node, '_parameter_overrides', {})
        return [
            f'parameter {name!r} is unknown{_suggestion(name, known)}'
            for name in given
            if name not in known
            and name not in RCLPY_PARAMETERS
            and not name.startswith('qos_overrides.')
        ]

    def changes(self) -> list[str]:
        """Return ``name=value`` for each parameter that differs from its default."""
        found = []
        for group in self._groups:
            defaults = type(group.value)()
            for name in describe(defaults):
                value = getattr(group.value, name)
                if value != getattr(defaults, name):
                    found.append(f'{group.prefix}.{name}={to_ros(value)}')
        return found

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take over all parameters or none."""
        try:
            changed = [(group, group.changed(parameters)) for group in self._groups]
        except AllanError as error:
            return SetParametersResult(successful=False, reason=str(error))
        for p in parameters:  # rclpy itself refuses this one after us
            if p.name == 'use_sim_time' and p.type_ != Parameter.Type.BOOL:
                return SetParametersResult(successful=False, reason='use_sim_time must be a bool')
        for group, value in changed:
            group.value = value
        return SetParametersResult(successful=True)


def descriptor(info: ParameterInfo, default: Any) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows of a setting."""
    unit = f' [{info.unit}]' if info.unit else ''
    choices = f'one of {", ".join(info.choices)}' if info.choices else ''
    described = ParameterDescriptor(
        description=f'{info.doc}{unit}', additional_constraints=choices, read_only=info.read_only
    )
    bounded = info.low is not None or info.high is not None
    if isinstance(default, bool) or not bounded:
        return described
    if isinstance(default, int):
        low = -MAX_INTEGER if info.low is None else int(info.low)
        high = MAX_INTEGER if info.high is None else int(info.high)
        described.integer_range = [IntegerRange(from_value=low, to_value=high)]
    elif isinstance(default, float):
        low_f = -sys.float_info.max if info.low is None else float(info.low)
        high_f = sys.float_info.max if info.high is None else float(info.high)
        described.floating_point_range = [FloatingPointRange(from_value=low_f, to_value=high_f)]
    return described


def to_ros(value: Any) -> Any:
    """Return the value as a ROS parameter holds it (tuples are lists)."""
    return list(value) if isinstance(value, tuple) else value


def _suggestion(name: str, known: list[str]) -> str:
    """Return '; did you mean ...?' with the known names that resemble the name, or ''."""
    ends = [full for full in known if full.endswith(f'.{name}')]
    starts = [f'{name}.path', f'{name}.enabled', f'{name}.node']
    found = [*ends, *(full for full in starts if full in known)]
    found = found or get_close_matches(name, known, 1, 0.7)
    return f'; did you mean {" or ".join(dict.fromkeys(found))}?' if found else ''


def _from_ros(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, tuple)) else value


def _declare(node: Node, prefix: str, name: str, info: ParameterInfo, default: Any) -> Any:
    full = f'{prefix}.{name}'
    return node.declare_parameter(full, to_ros(default), descriptor(info, default)).value
