# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Declaration of command-line options: one by one, or by the fields of a settings class."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple, TypeVar

from ..core.settings import AUTO, ParameterInfo, describe

T = TypeVar('T')


class Settings(NamedTuple):
    """A group of options, one for each field of a settings class that has a help text."""

    title: str  # heading of the group in the help
    kind: type[Any]  # the settings class
    without: Collection[str] = ()  # names of fields that get no option


class Option(NamedTuple):
    """One option, or a positional argument if the name does not begin with a dash."""

    names: tuple[str, ...]
    help: str
    value: str = ''  # placeholder of the value; '' for a switch
    parse: Callable[[str], Any] = str
    default: Any = None
    choices: tuple[str, ...] | None = None
    nargs: str | None = None  # positional argument: '+' if it may be repeated, '?' if optional
    exclusive: bool = False  # at most one exclusive option of a group may be given


class OptionGroup(NamedTuple):
    """Options with a common heading in the help."""

    title: str
    options: tuple[Option, ...]


Declared = Sequence[Option | OptionGroup | Settings]


@dataclass(frozen=True)
class Command:
    """A verb (subcommand) of the command line."""

    description: str  # the first part of the help text of the verb, with examples
    options: Declared
    # runs the verb and returns the exit code
    run: Callable[[argparse.Namespace], int]
    # exit code that not all verbs have -> meaning of the code
    exits: Mapping[int, str] = field(default_factory=dict)


def declare(parser: argparse.ArgumentParser, options: Declared) -> None:
    """Add options, groups of options and settings to a parser."""
    for declared in options:
        if isinstance(declared, Settings):
            add_settings(parser, *declared)
        elif isinstance(declared, OptionGroup):
            group = parser.add_argument_group(declared.title)
            exclusive = group.add_mutually_exclusive_group()
            for option in declared.options:
                _add(exclusive if option.exclusive else group, option)
        else:
            _add(parser, declared)


def _add(parser: argparse._ActionsContainer, option: Option) -> None:
    if not option.value:
        parser.add_argument(*option.names, action='store_true', help=option.help)
        return
    keywords: dict[str, Any] = {} if option.nargs is None else {'nargs': option.nargs}
    default_text = ''
    if option.default:
        is_number = isinstance(option.default, (int, float))
        default_text = f' (default {f"{option.default:.12g}" if is_number else option.default})'
    parser.add_argument(
        *option.names,
        metavar=option.value,
        type=option.parse,
        default=option.default,
        choices=option.choices,
        help=option.help + default_text,
        **keywords,
    )


def terms(text: str) -> dict[str, float]:
    """Parse ``N=0.3,B=7`` to a dict of term -> number; raise ArgumentTypeError for other texts."""
    try:
        pairs = [part.split('=') for part in text.split(',')]
        return {term.strip(): float(value) for term, value in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r}: write terms as N=0.3,B=7') from None


def percent(text: str) -> float:
    """Parse ``5%`` or ``0.05`` to the fraction 0.05; a number above 1 needs the sign ``%``.

    Raises ArgumentTypeError for other texts.
    """
    number, sign, rest = text.partition('%')
    try:
        fraction = float(number) / (100.0 if sign else 1.0)
        if rest or not (sign or fraction <= 1.0):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r}: write a percentage such as 5%') from None
    return fraction


TIME_UNITS = {'': 1.0, 's': 1.0, 'm': 60.0, 'min': 60.0, 'h': 3600.0, 'd': 86400.0}
"""Unit of time on the command line -> length of the unit in s."""


def seconds(text: str) -> float:
    """Parse a time such as ``300``, ``300s``, ``5min`` or ``2h`` to s.

    Raises ArgumentTypeError for other texts.
    """
    number = text.rstrip('smindh')
    try:
        return float(number) * TIME_UNITS[text[len(number) :]]
    except (KeyError, ValueError):
        raise argparse.ArgumentTypeError(
            f'{text!r}: write a time in seconds, or with a unit: 300, 5min, 2h'
        ) from None


def add_settings(
    parser: argparse.ArgumentParser,
    title: str,
    kind: type[Any],
    without: Collection[str] = (),
) -> None:
    """Add a group with an option for every field of a settings class that has a help text.

    A field ``max_bridge`` becomes the option ``--max-bridge``. A boolean field becomes a switch:
    ``--no-NAME`` if it is True by default, else ``--NAME``. The value for a tuple is a list of
    words separated by commas.

    Parameters
    ----------
    parser : ArgumentParser
        The parser.
    title : str
        Heading of the group in the help.
    kind : type
        The settings class.
    without : collection of str
        Names of fields that get no option.
    """
    group = parser.add_argument_group(title)
    infos = describe(kind)
    for setting in fields(kind):
        if setting.name not in infos or setting.name in without:
            continue
        info, default = infos[setting.name], setting.default
        name = setting.name.replace('_', '-')
        help_text = info.doc.rstrip('.').replace('%', '%%')
        # a help text begins in lowercase, unless the first word is a term such as 'N', or 'Imu'
        if help_text[1].islower() and not help_text.startswith('Imu'):
            help_text = help_text[0].lower() + help_text[1:]
        if isinstance(default, bool):
            group.add_argument(
                f'--no-{name}' if default else f'--{name}',
                dest=setting.name,
                action='store_false' if default else 'store_true',
                help=info.off or help_text if default else help_text,
            )
            continue
        unit = f' [{info.unit}]' if info.unit else ''
        joined_default = ','.join(map(str, default)) if isinstance(default, tuple) else default
        plain_default = (
            f'{joined_default:g}' if isinstance(joined_default, float) else joined_default
        )
        default_text = 'auto' if info.auto and default == AUTO else plain_default
        metavar = 'A,B,..' if isinstance(default, tuple) else 'NUMBER'
        if isinstance(default, str):
            metavar = 'TEXT'
        if info.percent and isinstance(default, float):
            metavar, default_text = 'PERCENT', f'{100.0 * default:g}%%'
        choices = tuple(filter(None, info.choices))  # '' is only a default
        if choices:
            metavar = f'{{{",".join(choices)}}}'
        group.add_argument(
            f'--{name}',
            dest=setting.name,
            type=_parser_of(info, default),
            choices=choices or None,
            default=default,
            metavar=metavar,
            help=f'{help_text}{unit}'
            + (f' (default {default_text})' if default not in ('', ()) else ''),
        )


def settings_of(settings_type: type[T], args: argparse.Namespace, **given: Any) -> T:
    """Return a settings object with the parsed arguments; values in ``given`` take precedence.

    Raises AllanError if a value is invalid.
    """
    names = [f.name for f in fields(settings_type)]  # type: ignore[arg-type]
    parsed = {name: getattr(args, name) for name in names if hasattr(args, name)}
    return settings_type(**{**parsed, **given})


def _parser_of(info: ParameterInfo, default: object) -> Callable[[str], Any]:
    """Return the function that parses the text for a setting on the command line."""
    if isinstance(default, tuple):
        return _words
    if info.auto:
        return lambda text: AUTO if text == 'auto' else seconds(text)
    if info.percent:
        return percent
    return seconds if info.unit == 's' else type(default)


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(','))
