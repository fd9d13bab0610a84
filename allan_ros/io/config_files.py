# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small YAML files of settings: those that come with the package, and the user's own.

A file is found by its name in the user's folder (``~/.config/allan_ros/<kind>``, or under
``$XDG_CONFIG_HOME``), then among those of the package; or it is given by its path.
"""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.filters.mapping import Expression, FilterMapping, FilterParameter, check_mapping
from .files import parse_yaml, read_bounded

MAX_BYTES = 100_000
"""Largest size of such a file in bytes."""


NEAREST = 3
"""How many names that resemble an unknown one are offered."""


LISTED = 8
"""How many names are listed where none resembles it."""


def read_yaml(path: Path) -> Any:
    """Return the content of a small YAML (or JSON) file.

    Raises
    ------
    AllanError
        When it cannot be read or parsed, or is over 100 kB.
    """
    try:
        return parse_yaml(read_bounded(path, MAX_BYTES).decode('utf-8'))
    except OSError as error:
        raise AllanError(f'{path}: cannot be read ({error.strerror}): check the path') from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        where = ' '.join(str(error).split())
        raise AllanError(f'{path}: is not YAML ({where[:120]}): correct it there') from error


def config_names(kind: str) -> list[str]:
    """Return the names of the files of a kind: the package's and the user's own."""
    return sorted({path.stem for folder in config_folders(kind) for path in folder.glob('*.yaml')})


def config_file(kind: str, name: str, called: str) -> Path:
    """Return the file of that name, or the path that was given.

    Raises
    ------
    AllanError
        When there is none of that name; ``called`` names the kind of file in the message.
    """
    path = Path(name)
    if path.suffix.lower() in ('.yaml', '.yml'):
        return path.expanduser()
    if path.name == name:
        for folder in config_folders(kind):
            found = folder / f'{name.lower()}.yaml'
            if found.is_file():
                return found
    raise AllanError(
        f'no {called} {name!r}: {_suggestion(name.lower(), config_names(kind))}, '
        'or give the path of a .yaml file'
    )


def config_folders(kind: str) -> list[Path]:
    """Return the search path of a kind of files; the first match wins.

    The user's own folder, then ``config/<kind>`` of the checkout or of the installed package.
    """
    here = Path(__file__).resolve()
    checkout = here.parents[2] / 'config' / kind
    installed = [parent / 'share' / 'allan_ros' / 'config' / kind for parent in here.parents]
    return [folder for folder in (user_folder(kind), checkout, *installed) if folder.is_dir()]


def user_folder(kind: str) -> Path:
    """Return where the user's own files of a kind are looked for (XDG Base Directory, 0.8)."""
    home = os.environ.get('XDG_CONFIG_HOME') or Path('~/.config').expanduser()
    return Path(home) / 'allan_ros' / kind


def _suggestion(name: str, names: Sequence[str]) -> str:
    """Return the names that resemble the unknown one, else some of the known names."""
    near = difflib.get_close_matches(name, names, NEAREST)
    near = near or [known for known in names if name in known][:NEAREST]
    if near:
        return f'did you mean {" or ".join(near)}'
    more = f' (and {len(names) - LISTED} more)' if len(names) > LISTED else ''
    return f'choose one of {", ".join(names[:LISTED])}{more}'


SCHEMA = 'allan_ros/filter/1'


FIELDS = ('sensor', 'axis', 'expression', 'limits', 'unit')


def load_filter(name: str) -> FilterMapping:
    """Return a mapping by the name of one that comes with the package, or by its path.

    Raises
    ------
    AllanError
        When there is none of that name, or the file is invalid.
    """
    path = config_file('filters', name, 'filter mapping')
    fields = Fields(read_yaml(path), str(path))
    fields.schema(SCHEMA)
    parameters = fields.fields('parameters')
    constants = fields.fields('constants') if 'constants' in fields else None
    mapping = FilterMapping(
        fields.text('name'),
        tuple(_parameter(key, parameters.fields(key)) for key in parameters),
        {} if constants is None else {key: constants.number(key) for key in constants},
        fields.number('horizon') if 'horizon' in fields else FilterMapping.horizon,
    )
    try:
        check_mapping(mapping)
    except AllanError as error:
        raise AllanError(f'{path}: {error}') from error
    if not mapping.parameters:
        raise AllanError(f'{path}: names no parameter')
    return mapping


def _parameter(name: str, fields: Fields) -> FilterParameter:
    for key in fields:
        if key not in FIELDS:
            raise AllanError(f'{fields.where}: {key!r} is unknown, use {", ".join(FIELDS)}')
    limits = (-math.inf, math.inf)
    if 'limits' in fields:
        limits = fields.interval('limits')
    try:
        expression = Expression(fields.text('expression'))
    except AllanError as error:
        raise AllanError(f'{fields.where}: {error}') from error
    return FilterParameter(
        name, fields.text('sensor'), expression, fields.text('axis', 'worst'), limits
    )
