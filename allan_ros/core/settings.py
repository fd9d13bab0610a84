# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings with defaults, units of measurement and ranges, and checks of their values."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from numbers import Integral, Real
from typing import Any, TypeVar

from .errors import AllanError, one_line

T = TypeVar('T')


@dataclass(frozen=True)
class ParameterInfo:
    """Description of one setting.

    ``doc`` is the help text of the setting. ``low`` and ``high`` are the smallest and the largest
    valid value, None for -`MAX_FLOAT` or `MAX_FLOAT`. ``choices`` are the only valid texts; empty
    if all texts are valid. A ``read_only`` setting does not change while a node runs.
    """

    doc: str
    unit: str = ''
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False
    auto: bool = False
    """Whether the text 'auto' may be given instead of a number; it is stored as `AUTO`."""
    percent: bool = False
    """Whether the command line also accepts this fraction as a percentage, such as 20%."""
    off: str = ''
    """Help text of the command-line option that turns the setting off; '' if there is none."""


AUTO = -1.0
"""The number that is stored for the text 'auto'."""


def parameter(default: Any, doc: str, *limits: Any, **info: Any) -> Any:
    """Return a dataclass field with a default and a `ParameterInfo` as its metadata.

    Parameters
    ----------
    default : object
        Default of the setting.
    doc : str
        Help text.
    limits : str, float, float
        Unit, smallest value and largest value, in this order; later items may be omitted.
    info : dict
        Further fields of `ParameterInfo` by name.
    """
    return field(default=default, metadata={'info': ParameterInfo(doc, *limits, **info)})


fixed_parameter = partial(parameter, read_only=True)
"""Function like `parameter`, for a setting that does not change while a node runs."""


def describe(settings: Any) -> dict[str, ParameterInfo]:
    """Return the name and the description of every setting of a settings class or instance."""
    return {f.name: f.metadata['info'] for f in fields(settings) if 'info' in f.metadata}


UNIT_SYSTEMS = ('deg/h', 'SI')
"""Systems of units for the output: units of datasheets, such as deg/h and ug ('deg/h'), or SI."""

LIST = (tuple, list)

EXPECTED: dict[Any, str] = {
    bool: 'True or False',
    Integral: 'a whole number',
    Real: 'a number',
    str: 'a text',
    LIST: 'a list',
}
"""Type of a setting -> name of this type in error messages. The type of a setting is the first
type in this dict of which the default of the setting is an instance."""


def expect(kind: Any, type_name: str = '', /, **values: object) -> None:
    """Raise AllanError for the first keyword argument whose value is not of the type ``kind``.

    ``kind`` is a type or a tuple of types. True and False are valid only if ``kind`` is bool; they
    are not accepted as numbers. ``type_name`` is the name of the expected type in the error
    message. It may be omitted if ``kind`` is a key of `EXPECTED`.
    """
    for name, value in values.items():
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            shown = one_line(repr(value))
            raise AllanError(f'{name} is {shown:.60}: {type_name or EXPECTED[kind]} is expected')


def check_choice(choices: Collection[str], **values: object) -> None:
    """Raise AllanError for the first keyword argument whose value is not one of the choices."""
    for name, value in values.items():
        if not isinstance(value, str) or value not in choices:
            known = ', '.join(choice for choice in choices if choice)
            shown = one_line(repr(value))
            raise AllanError(f'{name} is {shown:.60}: choose one of {known}')


def check_names(given: Iterable[str], known: Sequence[str]) -> None:
    """Raise AllanError for the first name in ``given`` that is not in ``known``.

    The message suggests the most similar known name, or lists all known names if none is similar.
    """
    for name in given:
        if name not in known:
            similar_names = difflib.get_close_matches(str(name), known, 1)
            advice = similar_names[0] if similar_names else ', '.join(known)
            raise AllanError(f'option {name!r} is unknown: use {advice}')


def settings_from(kind: type[T], given: Mapping[str, Any]) -> T:
    """Return a settings object of the class ``kind`` with the given values.

    Raises AllanError for an unknown name or an invalid value.
    """
    check_names(given, [f.name for f in fields(kind)])  # type: ignore[arg-type]
    return kind(**given)


class CheckedSettings:
    """Base class of settings dataclasses; checks all values when an object is created.

    Raises AllanError unless every value has a type like its default (`EXPECTED`), lies in its range
    and is one of its choices. The text 'auto', which some settings accept, is stored as the number
    -1 (`AUTO`).
    """

    def __post_init__(self) -> None:
        defaults = {f.name: f.default for f in fields(self)}  # type: ignore[arg-type]
        hints = {f.name: f.type for f in fields(self)}  # type: ignore[arg-type]
        for name, info in describe(self).items():
            value = getattr(self, name)
            if info.choices:
                check_choice(info.choices, **{name: value})
            if info.auto and isinstance(value, str) and value == 'auto':
                object.__setattr__(self, name, AUTO)
                continue
            kind = next(kind for kind in EXPECTED if isinstance(defaults[name], kind))
            expect(kind, **{name: value})
            if hints[name] == 'tuple[str, ...]':
                for each in value:
                    expect(str, **{name: each})
            if isinstance(value, Real) and not isinstance(value, bool):
                check_range(info.low, info.high, info.unit, **{name: value})


SLOWEST_HZ = 1e-6
"""Smallest accepted sample rate in Hz: one sample in 11.6 days."""


MAX_FLOAT = 1e150
"""Largest magnitude of a number in a document or of a setting: its square is a finite float64."""


def check_range(low: float | None, high: float | None, unit: str = '', /, **values: object) -> None:
    """Raise AllanError for the first keyword argument whose value is no number or out of range.

    Parameters
    ----------
    low, high : float or None
        Smallest and largest valid value; None for -`MAX_FLOAT` or `MAX_FLOAT`. NaN and infinity
        are never valid.
    unit : str
        Unit of the limits, for the error message.
    values : object
        Name -> value to check.
    """
    for name, value in values.items():
        expect(Real, **{name: value})
        least = -MAX_FLOAT if low is None else low
        most = MAX_FLOAT if high is None else high
        if not least <= value <= most:  # type: ignore[operator]
            limits = 'be finite'
            if low is not None:
                limits = (
                    f'be at least {low:g}' if high is None else f'lie between {low:g} and {high:g}'
                )
            raise AllanError(f'{name} is {value!s:.40}: it must {limits} {unit}'.rstrip())


@dataclass(frozen=True)
class SegmenterSettings(CheckedSettings):
    """Settings that determine how a recording is split into segments without gaps or motion."""

    stamps: str = fixed_parameter(
        'header',
        'Sample times: header uses the header stamps, or the record times if the stamps are zero, '
        'mostly equal or in no order; record uses the record times if the source has record times.',
        choices=('header', 'record'),
    )
    declared_rate: float = fixed_parameter(
        0.0,
        'Expected sample rate: it is compared with the stamps, and used if the stamps are missing '
        'or bursty; 0: unknown.',
        'Hz',
        0.0,
        1e6,
    )
    max_bridge: int = fixed_parameter(
        3,
        'Longest gap of lost samples that is interpolated; a longer gap splits the data.',
        'samples',
        0,
        100,
    )
    motion_gate: bool = fixed_parameter(
        True,
        'Use only data at rest; false uses all data, for an IMU that is known to be at rest.',
        off='use all data; for an IMU that is known to be at rest',
    )
    motion_ratio: float = fixed_parameter(
        3.0,
        'Standard deviation of a short window, relative to the noise floor, above which the IMU is '
        'considered moving.',
        low=1.5,
        high=100.0,
    )
    rate_limit: float = fixed_parameter(
        0.0087,
        'Change of the mean angular rate above which the IMU is considered turning (0.5 deg/s).',
        'rad/s',
        1e-5,
        10.0,
    )
    skip: float = fixed_parameter(
        AUTO,
        'Time excluded at the start. auto (-1) excludes only data before a lasting change of the '
        'white noise; 0 uses all data.',
        's',
        AUTO,
        1e6,
        auto=True,
    )


def check_rate(rate: object) -> None:
    """Raise AllanError unless a sample rate in Hz is 0 (unknown) or a plausible number."""
    expect(Real, rate=rate)
    if rate != 0.0:
        check_range(SLOWEST_HZ, 1e6, 'Hz', rate=rate)
