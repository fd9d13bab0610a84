# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping files of filters: which parameters of a running node come from which terms."""

from __future__ import annotations

import math

from ..core.errors import AllanError
from ..core.expression import Expression
from ..core.fields import Fields
from ..core.filter_parameters import FilterMapping, FilterParameter, check_mapping
from .config_files import config_file, config_names, read_yaml

SCHEMA = 'allan_ros/filter/1'

FIELDS = ('sensor', 'axis', 'expression', 'limits', 'unit')


def filter_names() -> list[str]:
    """Return the names of the mappings that come with the package."""
    return config_names('filters')


def load_filter(name: str) -> FilterMapping:
    """Return a mapping by the name of one that comes with the package, or by its path.

    Raises
    ------
    AllanError
        When there is none of that name, or the file is not as it must be.
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
