# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convert dataclasses to JSON values (`plain`), and read JSON objects strictly (`Fields`).

Documents are not trusted, so the type and the size of every value are checked.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from .errors import AllanError, one_line
from .imu import to_si
from .settings import MAX_FLOAT

T = TypeVar('T')

MAX_INTEGER = 2**62
"""Counts and stamps must be below this number: the sum of two of them fits into 64 bits."""

MAX_TEXT = 100_000
"""Largest number of characters in a text, unless the reader of a key gives a smaller limit."""

MAX_ITEMS = 1_000_000
"""Largest number of items in a list, unless the reader of a key gives a smaller limit."""

Signed = Annotated[float, 'may be negative']
SignedInt = Annotated[int, 'may be negative']
"""A dataclass field of the type `Signed` or `SignedInt` may be negative in a document. The values
of fields of the types float and int must be 0 or above."""

_REQUIRED = object()


def plain(value: Any, names: Mapping[str, str] = {}) -> Any:
    """Convert dataclasses, named tuples, mappings, lists, tuples and arrays to JSON values.

    An object with a method ``document`` becomes the value that this method returns. NaN and
    infinity become None. ``names`` maps the name of a field to its key in the document, for fields
    whose name and key differ.
    """
    if hasattr(value, 'document'):
        value = value.document()
    if dataclasses.is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if hasattr(value, '_asdict'):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {names.get(key, key): plain(item, names) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item, names) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def located(where: str) -> Iterator[None]:
    """Prepend ``where``, such as a file and key, to each `AllanError` from the ``with`` block."""
    try:
        yield
    except AllanError as error:
        raise AllanError(f'{where}: {error}', error.findings) from error


class Fields:
    """One JSON object, whose values are checked when they are read.

    Every method that reads a value raises AllanError if the value is of another type or out of
    range. A missing value also raises AllanError, unless the docstring of the method states another
    result. The message of the error states the position of the value in the document.

    Parameters
    ----------
    document : object
        The parsed JSON value; AllanError is raised if it is not an object.
    where : str
        Name of the document, or position of the object in a document, for error messages.
    names : mapping of str to str
        Name of a dataclass field -> its key in the document, for fields whose name and key differ.
    """

    def __init__(
        self,
        document: object,
        where: str,
        names: Mapping[str, str] = {},
    ) -> None:
        if not isinstance(document, dict):
            raise AllanError(
                f'{where}: keys with values (a JSON object or a YAML mapping) are expected, not '
                f'{_shown(document)}'
            )
        self._document: dict[str, Any] = document
        self._names = names
        self.where = where

    def __iter__(self) -> Iterator[str]:
        return iter(self._document)

    def __contains__(self, key: str) -> bool:
        return key in self._document

    def schema(self, expected: str) -> None:
        """Raise AllanError unless the key ``schema`` has the expected value."""
        found = self._document.get('schema')
        if found != expected:
            raise AllanError(
                f'{self.where}: schema is {_shown(found)}, but this version reads {expected!r}: '
                'give a file that this version wrote'
            )

    def allow_only(self, *known_keys: str) -> None:
        """Raise AllanError if the object has a key that is not one of ``known_keys``."""
        for key in self:
            if key not in known_keys:
                known = ', '.join(known_keys)
                raise AllanError(f'{self.where}: {key!r:.40} is unknown, use {known}')

    def text(self, key: str, default: object = _REQUIRED, longest: int = MAX_TEXT) -> str:
        """Return the text under a key, of at most ``longest`` characters.

        If the key is missing, the result is ``default``, a text; AllanError is raised without a
        default.
        """
        value = str(self._get(key, str, 'a text', default))
        if len(value) > longest:
            raise self._wrong(key, value, f'a text of at most {longest} characters')
        return value

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """Return the text under a key, which must be one of the choices."""
        value = self.text(key)
        if value not in choices:
            raise self._wrong(key, value, f'one of {", ".join(choices)}')
        return value

    def integer(self, key: str, least: int = -MAX_INTEGER) -> int:
        """Return the whole number under a key, from ``least`` to `MAX_INTEGER` - 1."""
        value = int(self._get(key, int, 'a whole number'))
        if not least <= value < MAX_INTEGER:
            raise self._wrong(key, value, f'a whole number from {least} to {MAX_INTEGER}')
        return value

    def number(self, key: str, least: float = -MAX_FLOAT) -> float:
        """Return the number under a key, from ``least`` to `MAX_FLOAT`."""
        value = self._number(key, self._get(key, (int, float), 'a number'))
        if value < least:
            raise self._wrong(key, value, f'a number of at least {least:g}')
        return value

    def quantity(self, unit: str) -> float:
        """Return this object, ``{"value": ..., "unit": ...}``, converted to the SI unit ``unit``.

        Raises AllanError if the stated unit cannot be converted to ``unit``.
        """
        value, stated = self.number('value'), self.text('unit')
        with located(self.where):
            return to_si(value, stated, unit)

    def numbers(self, key: str) -> NDArray[np.float64]:
        """Return the list of numbers under a key as an array, (n,), in which NaN replaces null."""
        return np.array(
            [math.nan if v is None else self._number(key, v) for v in self.sequence(key)], float
        )

    def integers(self, key: str, n: int) -> NDArray[np.int64]:
        """Return the list under a key, ``n`` whole numbers of 0 or above, as an array, (n,)."""
        values = self.sequence(key, n)
        if len(values) != n or not all(type(v) is int and 0 <= v < MAX_INTEGER for v in values):
            raise self._wrong(key, values, f'a list of {n} whole numbers, 0 or above,')
        return np.array(values, np.int64)

    def table(
        self, key: str, rows: int, columns: int, least: float = -MAX_FLOAT
    ) -> NDArray[np.float64]:
        """Return the list of lists under a key as an array of finite numbers, (rows, columns).

        ``least`` is the smallest valid number.
        """
        list_of_rows = self.sequence(key, rows)
        is_regular = len(list_of_rows) == rows and all(
            isinstance(row, list)
            and len(row) == columns
            and all(type(x) in (int, float) and least <= x <= MAX_FLOAT for x in row)
            for row in list_of_rows
        )
        if not is_regular:
            range_text = ' of 0 or above' if least == 0.0 else ''
            expected = f'a table of {rows} x {columns} finite numbers{range_text}'
            raise self._wrong(key, list_of_rows, expected)
        return np.array(list_of_rows, float).reshape(rows, columns)

    def sequence(self, key: str, most: int = MAX_ITEMS) -> Sequence[Any]:
        """Return the list under a key, of at most ``most`` items; the caller checks the items."""
        items: Sequence[Any] = self._get(key, list, 'a list')
        if len(items) > most:
            raise AllanError(
                f'{self.where}.{key} has {len(items)} items: at most {most} are expected'
            )
        return items

    def value(self, key: str) -> object:
        """Return the value of a key, of any type; the caller checks the value."""
        return self._get(key, object, 'a value')

    def fields(self, key: str) -> Fields:
        """Return the JSON object under a key."""
        return Fields(self._get(key, dict, 'an object'), f'{self.where}.{key}', self._names)

    def optional_fields(self, key: str) -> Fields | None:
        """Return the JSON object under a key; None if it is null or missing."""
        return None if self._document.get(key) is None else self.fields(key)

    def each(self, key: str, most: int = MAX_ITEMS) -> Iterator[Fields]:
        """Yield the JSON objects in the list under a key, which has at most ``most`` items."""
        for i, item in enumerate(self.sequence(key, most)):
            yield Fields(item, f'{self.where}.{key}[{i}]', self._names)

    def record(self, kind: type[T], **known: Any) -> T:
        """Return a dataclass or named tuple of type ``kind`` with the values of this object.

        If ``kind`` has a method ``from_document``, the result of this method is returned.
        Otherwise, the value of each field is read as the annotated type of the field. Its key is
        the name of the field or, if there is no such key, the key that ``names`` of this object
        states for the field. Fields in ``known`` get the values given there. Keys of fields for
        which ``kind`` itself states a default value may be missing.
        """
        if (from_document := getattr(kind, 'from_document', None)) is not None:
            result: T = from_document(self)
            return result
        defaults = getattr(kind, '_field_defaults', vars(kind))
        for name, hint in _hints(kind).items():  # type: ignore[arg-type]
            key = name if name in self else self._names.get(name, name)
            if name not in known and (key in self or name not in defaults):
                known[name] = self.typed(key, hint)
        return kind(**known)

    def typed(self, key: str, hint: Any) -> Any:
        """Return the value of a key, converted to the type annotation ``hint``.

        Possible types are str, bool, int, float, `Signed`, `SignedInt`, Literal, a pair of floats,
        an array, a mapping of names to floats, a dataclass, a named tuple, and a tuple of strings,
        of tuples of floats, or of dataclasses. Each type may be combined with None, which is the
        result for null and for a missing key.
        """
        may_be_negative = get_origin(hint) is Annotated
        hint = get_args(hint)[0] if may_be_negative else hint
        origin, args = get_origin(hint), get_args(hint)
        least = -MAX_FLOAT if may_be_negative else 0.0
        if type(None) in args:
            return None if self._document.get(key) is None else self.typed(key, args[0])
        if origin is Literal:
            return self.choice(key, args)
        if origin is Mapping:
            numbers = self.fields(key)
            return {name: numbers.number(name, -MAX_FLOAT) for name in numbers._document}
        # the origin of the annotation NDArray[...] is NDArray from numpy 2.5 on, np.ndarray before
        if origin in (np.ndarray, NDArray):
            is_whole = np.int64 in (args[-1], *get_args(args[-1]))
            return self.integers(key, len(self.sequence(key))) if is_whole else self.numbers(key)
        if args[1:] == (Ellipsis,) and args[0] is str:
            texts = self.sequence(key)
            if not all(isinstance(text, str) for text in texts):
                raise self._wrong(key, texts, 'a list of texts')
            return tuple(texts)
        if args[1:] == (Ellipsis,) and get_origin(args[0]) is tuple:
            n = len(get_args(args[0]))
            return tuple(self._tuple(key, values, n) for values in self.sequence(key))
        if args[1:] == (Ellipsis,):
            return tuple(fields.record(args[0]) for fields in self.each(key))
        if origin is tuple:
            return self._tuple(key, self.sequence(key), 2)
        if hint is str:
            return one_line(self.text(key))
        if hint is bool:
            flag = self._get(key, object, 'true or false')
            if not isinstance(flag, bool):
                raise self._wrong(key, flag, 'true or false')
            return flag
        if hint is int:
            return self.integer(key, least=max(int(least), -MAX_INTEGER))
        if hint is float:
            return self.number(key, least)
        fields = self.fields(key)
        return hint.from_document(fields, signed=True) if may_be_negative else fields.record(hint)

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
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not object):
            raise self._wrong(key, value, expected)
        return value

    def _tuple(self, key: str, values: object, n: int) -> tuple[float, ...]:
        if not isinstance(values, list) or len(values) != n:
            raise self._wrong(key, values, 'a pair of numbers' if n == 2 else f'{n} numbers')
        return tuple(self._number(key, value) for value in values)

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._wrong(key, value, 'a number')
        try:
            number = float(value)
        except OverflowError:  # an integer in JSON may be too large for a float
            number = math.inf
        if not -MAX_FLOAT <= number <= MAX_FLOAT:
            raise self._wrong(key, value, f'a number from {-MAX_FLOAT:g} to {MAX_FLOAT:g}')
        return number

    def _wrong(self, key: str, value: object, expected: str) -> AllanError:
        return AllanError(f'{self.where}.{key} is {_shown(value)}: {expected} is expected')


@lru_cache(maxsize=100)
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _shown(value: object) -> str:
    if isinstance(value, (dict, list)):
        return f'a {type(value).__name__} of length {len(value)}'
    if isinstance(value, float) and math.isinf(value):
        return 'a number beyond 1.8e308'
    text = repr(value if not isinstance(value, str) else value[:40])
    return text if len(text) <= 40 else f'{text[:37]}...'
