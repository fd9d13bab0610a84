# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arithmetic of a configuration file: numbers, names, + - * / **, sqrt, abs, max; never `eval`."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from .errors import AllanError

MAX_LENGTH = 200
"""Characters of an expression: no formula of a filter needs more."""

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {'sqrt': math.sqrt, 'abs': abs, 'max': max}


class Expression:
    """One formula, checked when it is made.

    >>> Expression('sqrt(3/4) * N / sqrt(h)').value({'N': 2.0, 'h': 3.0})
    1.0

    Parameters
    ----------
    text : str

    Raises
    ------
    AllanError
        When it is too long, or holds anything but arithmetic.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > MAX_LENGTH:
            raise AllanError(f'an expression has {len(text)} characters: at most {MAX_LENGTH}')
        try:
            self._root = ast.parse(text.strip(), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise AllanError(f'{text!r} is no expression: write it as in 2 * N**2 * f') from error
        names: set[str] = set()
        self._check(self._root, names)
        self.names = frozenset(names)

    def value(self, values: Mapping[str, float]) -> float:
        """Return its value.

        Raises
        ------
        AllanError
            When a name has no value, or the result is no finite number.
        """
        missing = sorted(self.names - values.keys())
        if missing:
            raise AllanError(
                f'{self.text!r} names {missing[0]}: there are {", ".join(sorted(values))}'
            )
        try:
            result = self._evaluate(self._root, values)
        except (ArithmeticError, ValueError) as error:
            raise AllanError(f'{self.text!r} has no value ({error})') from error
        if isinstance(result, complex) or not math.isfinite(result):
            raise AllanError(f'{self.text!r} has no finite value')
        return float(result)

    def _check(self, node: ast.expr, names: set[str]) -> None:
        """Refuse whatever is not arithmetic, and collect the names."""
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return
        if isinstance(node, ast.Name):
            names.add(node.id)
            return
        if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            self._check(node.left, names)
            self._check(node.right, names)
            return
        if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
            self._check(node.operand, names)
            return
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in _FUNCTIONS
            and node.args
            and not node.keywords
        ):
            for argument in node.args:
                self._check(argument, names)
            return
        raise AllanError(
            f'{self.text!r} holds {ast.unparse(node)!r}: use numbers, names, + - * / ** and '
            f'{", ".join(_FUNCTIONS)} only'
        )

    def _evaluate(self, node: ast.expr, values: Mapping[str, float]) -> Any:
        if isinstance(node, ast.Constant):
            return float(node.value)  # type: ignore[arg-type]  # checked to be a number
        if isinstance(node, ast.Name):
            return values[node.id]
        if isinstance(node, ast.BinOp):
            left, right = self._evaluate(node.left, values), self._evaluate(node.right, values)
            return _BINARY[type(node.op)](left, right)
        if isinstance(node, ast.UnaryOp):
            return _UNARY[type(node.op)](self._evaluate(node.operand, values))
        assert isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        arguments = [self._evaluate(argument, values) for argument in node.args]
        try:
            return _FUNCTIONS[node.func.id](*arguments)
        except TypeError as error:  # sqrt of two numbers, max of one
            raise ValueError(str(error)) from error
