# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings dataclasses as command-line options; their fields define all defaults."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from dataclasses import fields
from typing import Any, TypeVar

from ..core.settings import AUTO, describe

T = TypeVar('T')


def add_settings(
    parser: argparse.ArgumentParser,
    title: str,
    settings_type: type[Any],
    without: Collection[str] = (),
) -> None:
    """Add an option for every field of a settings class, in a group of their own.

    A field ``max_bridge`` becomes ``--max-bridge``; one that is true by default becomes a switch
    ``--no-...``; a tuple is given as words joined by commas.

    Parameters
    ----------
    without : collection of str
        Fields that get no option of their own.
    """
    group = parser.add_argument_group(title)
    infos = describe(settings_type)
    for setting in fields(settings_type):
        if setting.name not in infos or setting.name in without:
            continue
        info, default = infos[setting.name], setting.default
        name = setting.name.replace('_', '-')
        words = info.doc.rstrip('.').replace('%', '%%')
        if isinstance(default, bool):
            group.add_argument(
                f'--no-{name}' if default else f'--{name}',
                dest=setting.name,
                action='store_false' if default else 'store_true',
                help=f'{"turn off: " if default else ""}{words}',
            )
            continue
        unit = f' [{info.unit}]' if info.unit else ''
        word = 'auto' if info.auto and default == AUTO else _shown(default)
        shown = f' (default {word})' if default not in ('', ()) else ''
        group.add_argument(
            f'--{name}',
            dest=setting.name,
            type=_words if isinstance(default, tuple) else _number if info.auto else type(default),
            choices=info.choices or None,
            default=default,
            metavar=_metavar(default, info.choices),
            help=f'{words}{unit}{shown}',
        )


def settings_of(settings_type: type[T], args: argparse.Namespace, **given: Any) -> T:
    """Return the settings of the parsed arguments; ``given`` fields take precedence.

    Raises
    ------
    AllanError
        When a value lies outside its range.
    """
    names = [f.name for f in fields(settings_type)]  # type: ignore[arg-type]
    said = {name: getattr(args, name) for name in names if hasattr(args, name)}
    return settings_type(**{**said, **given})


def _number(text: str) -> float:
    return AUTO if text == 'auto' else float(text)


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(','))


def _shown(default: object) -> str:
    if isinstance(default, tuple):
        return ','.join(map(str, default))
    return f'{default:g}' if isinstance(default, float) else str(default)


def _metavar(default: object, choices: tuple[str, ...]) -> str:
    if choices:
        return f'{{{",".join(word for word in choices if word)}}}'
    if isinstance(default, tuple):
        return 'A,B,..'
    return 'TEXT' if isinstance(default, str) else 'NUMBER'
