# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values for the parameters of a running filter, computed from the noise of its sensor.

The value of a parameter is an arithmetic expression of the noise coefficients. Its interval is the
range of the expression over the 95 % intervals of the coefficients. A value is used only if this
interval is narrow enough.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from ..errors import AllanError
from ..fit.model import TERMS, AxisFit
from ..imu import AXES, SENSORS
from .noise_parameters import RULES, axis_level, reduce_axis
from .reductions import Horizons

MAX_LENGTH = 200
"""Longest expression accepted, in characters."""

_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}

Ends = tuple[float, float, float]
"""Lower end of the interval, value, upper end."""

Formula = Callable[[Mapping[str, float]], Any]

_FUNCTIONS: dict[str, Callable[..., Any]] = {'sqrt': math.sqrt, 'abs': abs, 'max': max}


class Expression:
    """An arithmetic expression of named values, with + - * / **, sqrt, abs and max.

    Anything else raises `AllanError`.

    >>> Expression('sqrt(3/4) * N / sqrt(h)').value({'N': 2.0, 'h': 3.0})
    1.0
    """

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > MAX_LENGTH:
            raise AllanError(
                f'an expression has {len(text)} characters: at most {MAX_LENGTH} are allowed'
            )
        try:
            root = ast.parse(text.strip(), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise AllanError(
                f'{text!r} is not an expression: write it like 2 * N**2 * f'
            ) from error
        names: set[str] = set()
        self._formula = self._compiled(root, names)
        self.names = frozenset(names)

    def value(self, values: Mapping[str, float]) -> float:
        """Return the value of the expression for the values of its names.

        Raises
        ------
        AllanError
            If a name has no value, or the result is not a finite real number.
        """
        missing = sorted(self.names - values.keys())
        if missing:
            raise AllanError(
                f'{self.text!r} contains {missing[0]}, which is unknown: use '
                f'{", ".join(sorted(values))}'
            )
        try:
            result = self._formula(values)
        except (ArithmeticError, ValueError, TypeError) as error:  # TypeError: sqrt of two numbers
            raise AllanError(f'{self.text!r} has no value ({error})') from error
        if isinstance(result, complex) or not math.isfinite(result):
            raise AllanError(f'{self.text!r} has no finite value')
        return float(result)

    def _compiled(self, node: ast.expr, names: set[str]) -> Formula:
        """Return a function that evaluates a syntax tree; add the names in it to ``names``."""
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            number = float(node.value)  # type: ignore[arg-type]  # checked to be a number
            return lambda values: number
        if isinstance(node, ast.Name):
            names.add(node.id)
            return operator.itemgetter(node.id)
        call: Callable[..., Any] | None = None
        arguments: list[ast.expr] = []
        if isinstance(node, ast.BinOp):
            call, arguments = _OPERATORS.get(type(node.op)), [node.left, node.right]
        elif isinstance(node, ast.UnaryOp):
            call, arguments = _OPERATORS.get(type(node.op)), [node.operand]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            call, arguments = _FUNCTIONS.get(node.func.id), node.args
        if call is None or not arguments:
            raise AllanError(
                f'{self.text!r} contains {ast.unparse(node)!r}: use numbers, names, + - * / ** and '
                f'{", ".join(_FUNCTIONS)} only'
            )
        function, parts = call, [self._compiled(argument, names) for argument in arguments]
        return lambda values: function(*(part(values) for part in parts))


RATE = 'f'
"""Name of the sample rate in Hz in expressions."""


@dataclass(frozen=True)
class FilterParameter:
    """One noise parameter of a filter, and how it is computed."""

    name: str  # name of the ROS parameter
    sensor: str  # 'gyro' or 'accel'
    # formula of the coefficients Q, N, B, K, R of one axis in SI, the rate f in Hz, and constants;
    # in an expression with K, both N and K are those of the model reduced to a random walk
    expression: Expression
    rule: str = 'worst'  # one of `RULES`; with 'each' the parameter is an array of three numbers
    limits: tuple[float, float] = (-math.inf, math.inf)  # accepted range; values are clamped to it


@dataclass(frozen=True)
class FilterMapping:
    """The noise parameters of one kind of filter, as expressions of the noise coefficients.

    ``constants`` are named values for the expressions. ``horizon`` is the longest time in s that
    the filter integrates without a correction.
    """

    name: str  # name of the kind of filter
    parameters: tuple[FilterParameter, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    horizon: float = 30.0


@dataclass(frozen=True)
class Proposal:
    """A proposed value of a filter parameter, with its 95 % interval."""

    name: str  # name of the parameter
    values: tuple[float, ...]  # one value, or three with the rule 'each'
    low: float  # lower end of the interval; of three axes, of the widest interval
    high: float  # upper end of the same interval
    limited: bool = False  # whether a value was clamped to the limits of the parameter

    @property
    def ratio(self) -> float:
        """Ratio of the upper to the lower end of the interval; infinite if the lower end is 0."""
        return self.high / self.low if self.low > 0.0 else math.inf

    def differs(self, current: Sequence[float], change: float) -> bool:
        """Return whether any value differs from the current one by more than a fraction of it.

        ``change`` is this fraction. The result is True if the number of values differs, or a
        current value is NaN.
        """
        if len(current) != len(self.values):
            return True
        return not all(abs(v - c) <= change * abs(c) for v, c in zip(self.values, current))


def propose(
    parameter: FilterParameter,
    axes: Mapping[str, AxisFit],
    rate: float,
    constants: Mapping[str, float],
    horizon: float = 30.0,
) -> Proposal:
    """Return the proposed value of a parameter for the noise of an IMU.

    For a coefficient that is not resolved, the 95 % upper limit is used; its interval begins at 0.

    ``axes`` maps axis names to fits, ``rate`` is the sample rate f in Hz, and ``constants`` maps
    the other names in the expression to values. ``horizon`` is the longest time in s that the
    filter integrates without a correction.

    Raises
    ------
    AllanError
        If the sensor is absent, a coefficient has neither a value nor a limit, or the expression
        has no finite value.
    """
    names = AXES[SENSORS[parameter.sensor]]
    if any(name not in axes for name in names):
        raise AllanError(f'{parameter.name}: the noise model has no {parameter.sensor}')
    used = sorted(parameter.expression.names & set(TERMS))
    known = {RATE: rate, **constants}
    ends = [_axis_ends(name, axes[name], used, Horizons.up_to(horizon)) for name in names]
    by_rule = _by_rule(ends, used, parameter.rule)
    triples = [_evaluate(parameter, terms, known) for terms in by_rule]
    low_limit, high_limit = parameter.limits
    values = tuple(min(max(value, low_limit), high_limit) for _, value, _ in triples)
    limited = any(value != triple[1] for value, triple in zip(values, triples))
    low, _, high = max(triples, key=lambda t: t[2] / t[0] if t[0] > 0.0 else math.inf)
    return Proposal(parameter.name, values, low, high, limited)


def narrow_enough(
    proposals: Sequence[Proposal], ratio: float
) -> tuple[list[Proposal], dict[str, str]]:
    """Return the proposals that are accurate enough, and parameter name -> reason for the others.

    ``ratio`` is the largest accepted ratio of the upper to the lower end of the interval.
    """
    ready = [p for p in proposals if p.ratio <= ratio]
    reasons = {
        p.name: f'between {p.low:.3g} and {p.high:.3g}: it will be set when this interval is '
        f'within a factor of {ratio:g}'
        for p in proposals
        if p.ratio > ratio
    }
    return ready, reasons


def _axis_ends(
    axis: str, fit: AxisFit, terms: Sequence[str], horizons: Horizons
) -> dict[str, Ends]:
    """Return lower end, value and upper end of each of the given terms of one axis."""
    reduced = reduce_axis(axis, fit, 'walk', horizons).levels if 'K' in terms else {}
    levels = {term: reduced.get(term) or axis_level(axis, fit, term) for term in terms}
    return {t: (level.interval[0], level.value, level.interval[1]) for t, level in levels.items()}


def _by_rule(
    axes: Sequence[dict[str, Ends]], terms: Sequence[str], rule: str
) -> list[dict[str, Ends]]:
    """Combine the values and interval ends of the axes, or keep those of each axis ('each')."""
    if rule == 'each':
        return list(axes)
    if rule == 'worst':
        return [{term: max((one[term] for one in axes), key=lambda e: e[1]) for term in terms}]
    return [{term: _mean([one[term] for one in axes]) for term in terms}]


def _mean(ends: Sequence[Ends]) -> Ends:
    low, value, high = (math.sqrt(sum(v * v for v in e) / len(ends)) for e in zip(*ends))
    return low, value, high


def _evaluate(
    parameter: FilterParameter, terms: Mapping[str, Ends], known: Mapping[str, float]
) -> Ends:
    """Return lower end, value and upper end of the expression of a parameter.

    The ends are the extremes over all combinations of the ends of ``terms``. They are exact if the
    expression is monotonic in each term. ``known`` contains the values of all other names.
    """
    evaluate = parameter.expression.value
    value = evaluate({**known, **{term: v for term, (_, v, _) in terms.items()}})
    try:
        corners = [
            evaluate({**known, **dict(zip(terms, corner))})
            for corner in product(*((low, high) for low, _, high in terms.values()))
        ]
    except AllanError:  # no finite value at an end, because the interval of a term is unknown
        return 0.0, value, math.inf
    return min(corners), value, max(corners)


def check_mapping(mapping: FilterMapping) -> None:
    """Check the horizon of a mapping, and sensor, rule, limits and names of each parameter.

    Raises
    ------
    AllanError
        If one of them is invalid; the message names the parameter.
    """
    Horizons.up_to(mapping.horizon)
    for p in mapping.parameters:
        if p.sensor not in SENSORS:
            raise AllanError(
                f'{p.name}: sensor is {p.sensor!r}: choose one of {", ".join(SENSORS)}'
            )
        if p.rule not in RULES:
            raise AllanError(f'{p.name}: axis is {p.rule!r}: choose one of {", ".join(RULES)}')
        if not p.limits[0] < p.limits[1]:
            raise AllanError(f'{p.name}: limits are {list(p.limits)}: give the lower one first')
        unknown = sorted(p.expression.names - {*TERMS, RATE, *mapping.constants})
        if unknown:
            raise AllanError(
                f'{p.name}: {p.expression.text!r} contains {unknown[0]}, which is unknown: use '
                f'{", ".join((*TERMS, RATE, *mapping.constants))}'
            )
