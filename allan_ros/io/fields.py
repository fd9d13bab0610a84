# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`Fields`: read a JSON object strictly, and say where what is wrong stands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import AllanError

_REQUIRED = object()


class Fields:
    """The fields of one JSON object; every getter raises `AllanError` naming the place."""

    def __init__(self, document: object, where: str) -> None:
        if not isinstance(document, dict):
            raise AllanError(f'{where}: a JSON object is expected, not {_shown(document)}')
        self._document: dict[str, Any] = document
        self.where = where

    def __iter__(self) -> Iterator[str]:
        return iter(self._document)

    def __contains__(self, key: str) -> bool:
        return key in self._document

    def schema(self, expected: str) -> None:
        """Refuse a document of another kind or version."""
        found = self._document.get('schema')
        if found != expected:
            raise AllanError(
                f'{self.where}: schema is {_shown(found)}, this version reads {expected!r}: '
                'give a file that it wrote'
            )

    def text(self, key: str, default: object = _REQUIRED) -> str:
        return str(self._get(key, str, 'a text', default))

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        value = self.text(key)
        if value not in choices:
            raise self._wrong(key, value, f'one of {", ".join(choices)}')
        return value

    def integer(self, key: str, default: object = _REQUIRED) -> int:
        return int(self._get(key, int, 'an integer', default))

    def number(self, key: str) -> float:
        return self._number(key, self._get(key, (int, float), 'a number'))

    def optional_number(self, key: str) -> float | None:
        return None if self._document.get(key) is None else self.number(key)

    def interval(self, key: str) -> tuple[float, float]:
        values = self.sequence(key)
        if len(values) != 2:
            raise self._wrong(key, values, 'a pair of numbers')
        return self._number(key, values[0]), self._number(key, values[1])

    def optional_interval(self, key: str) -> tuple[float, float] | None:
        return None if self._document.get(key) is None else self.interval(key)

    def numbers(self, key: str) -> NDArray[np.float64]:
        """Return a list of numbers as an array, null as NaN."""
        return np.array(
            [math.nan if v is None else self._number(key, v) for v in self.sequence(key)], float
        )

    def sequence(self, key: str) -> Sequence[Any]:
        found: Sequence[Any] = self._get(key, list, 'a list')
        return found

    def mapping(self, key: str) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self._get(key, dict, 'an object')
        return found

    def holds_object(self, key: str) -> bool:
        return isinstance(self._document.get(key), dict)

    def fields(self, key: str) -> Fields:
        return Fields(self.mapping(key), f'{self.where}.{key}')

    def optional_fields(self, key: str) -> Fields | None:
        return None if self._document.get(key) is None else self.fields(key)

    def each(self, key: str) -> Iterator[Fields]:
        for i, item in enumerate(self.sequence(key)):
            yield Fields(item, f'{self.where}.{key}[{i}]')

    def _get(
        self,
        key: str,
        kind: type | tuple[type, ...],
        expected: str,
        default: object = _REQUIRED,
    ) -> Any:
        value = self._document.get(key, default)
        if value is _REQUIRED:
            raise AllanError(f'{self.where}: {key} is missing')
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self._wrong(key, value, expected)
        return value

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._wrong(key, value, 'a number')
        try:
            number = float(value)
        except OverflowError:  # JSON integers have no bound
            number = math.inf
        if not math.isfinite(number):
            raise self._wrong(key, value, 'a finite number')
        return number

    def _wrong(self, key: str, value: object, expected: str) -> AllanError:
        return AllanError(f'{self.where}.{key} is {_shown(value)}: {expected} is expected')


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f'{text[:37]}...'
