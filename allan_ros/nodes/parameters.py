# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings dataclasses as ROS parameters: declared from them, checked by them."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
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
from ..core.settings import ParameterInfo, describe

T = TypeVar('T')

MAX_INTEGER = 2**63 - 1
"""ROS integer parameters are int64."""


class ParameterGroup(Generic[T]):
    """The settings of one group, held equal to the node's parameters ``<prefix>.<field>``.

    ``value`` is always a checked settings object: a bad value is refused with the settings'
    own message, at start by an exception and at run time by the result of the service.

    Raises
    ------
    AllanError
        When the values given at start do not make valid settings.
    rclpy.exceptions.ParameterException
        When one has the wrong type or lies outside its range.
    """

    def __init__(self, node: Node, prefix: str, settings_type: type[T]) -> None:
        self.prefix = prefix
        self.value = settings_type()
        given = {
            f.name: _from_ros(_declare(node, prefix, f.name, info, getattr(self.value, f.name)))
            for f in fields(settings_type)  # type: ignore[arg-type]
            if (info := describe(settings_type).get(f.name)) is not None
        }
        self.value = settings_type(**given)
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take over the parameters of this group, all or none."""
        start = f'{self.prefix}.'
        ours = {
            p.name[len(start) :]: _from_ros(p.value) for p in parameters if p.name.startswith(start)
        }
        try:
            self.value = replace(self.value, **ours)  # type: ignore[type-var]
        except AllanError as error:
            return SetParametersResult(successful=False, reason=str(error))
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


def _from_ros(value: Any) -> Any:
    return tuple(value) if isinstance(value, (list, tuple)) else value


def _declare(node: Node, prefix: str, name: str, info: ParameterInfo, default: Any) -> Any:
    full = f'{prefix}.{name}'
    return node.declare_parameter(full, to_ros(default), descriptor(info, default)).value
