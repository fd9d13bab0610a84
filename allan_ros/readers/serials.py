# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Find the serial numbers of IMUs in file names, in tables, or in the metadata of bags."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..core.errors import AllanError, one_line
from ..core.imu import MAX_NAME
from .files import MAX_BYTES, open_regular, read_yaml
from .recording import METADATA, translated

LONGEST_LINE = 100_000
"""Number of bytes after which a line of a table is regarded as ended."""

RULES = 'name:PATTERN, column:NAME or metadata:KEY'


class SerialRule:
    """A rule that states where the serial number of an IMU is found.

    Parameters
    ----------
    text : str
        One of three forms. ``name:PATTERN`` is the part of the file name that matches the regular
        expression PATTERN, or its first group if it has groups. ``column:NAME`` is the value in
        the first row of a .csv or .tsv table with commas, semicolons or tabs, or the first value in
        an array of an ``.npz`` file. ``metadata:KEY`` is a value of the custom data in the metadata
        of a rosbag2.

    Raises
    ------
    AllanError
        When ``text`` has none of these forms, or PATTERN is not a regular expression.

    Examples
    --------
    >>> SerialRule('name:SN([0-9]+)').serial_of('lot7/SN0042_rest.mcap')
    '0042'
    """

    def __init__(self, text: str) -> None:
        self._kind, _, self._what = text.partition(':')
        if self._kind not in ('name', 'column', 'metadata') or not self._what:
            raise AllanError(f'--serial-from {text!r:.60}: give {RULES}')
        if self._kind == 'name':
            try:
                self._pattern = re.compile(self._what)
            except re.error as error:
                raise AllanError(
                    f'--serial-from {text!r:.60} is not a regular expression ({error}): correct it'
                ) from error

    def serial_of(self, path: str) -> str:
        """Return the serial number of the IMU whose recording is at ``path``.

        Raises AllanError if there is no serial number, if it has more than `MAX_NAME` characters,
        or if a needed file is missing or cannot be read: a .csv, .tsv or .npz file for
        ``column:NAME``, the metadata.yaml of a rosbag2 for ``metadata:KEY``.
        """
        file_path = Path(path)
        if self._kind == 'name':
            match = self._pattern.search(file_path.name)
            stated_serial = match[1] if match and match.re.groups else match[0] if match else None
        elif self._kind == 'metadata':
            stated_serial = _custom_data(file_path).get(self._what)
        else:
            stated_serial = _first_value(file_path, self._what)
        serial = one_line(str(stated_serial)).strip() if stated_serial is not None else ''
        if len(serial) > MAX_NAME:
            raise AllanError(
                f'{path}: the serial number {serial!r:.40} has more than {MAX_NAME} characters; '
                'correct --serial-from'
            )
        if not serial:
            problems = {
                'name': 'the pattern does not match the file name',
                'metadata': f'the bag has no custom data {self._what!r:.40}',
                'column': f'it has no column {self._what!r:.40} with a value',
            }
            raise AllanError(
                f'{path}: no serial number: {problems[self._kind]}; correct --serial-from'
            )
        return serial


def _custom_data(path: Path) -> Mapping[str, Any]:
    """Return the custom data in the metadata of a rosbag2; empty if the metadata contain none.

    ``path`` is the folder of the rosbag2, or a file in this folder. Raises AllanError if the folder
    contains no metadata.yaml, or if this file is invalid or cannot be read.
    """
    folder = path if os.path.isdir(path) else path.parent
    file = folder / METADATA
    if not os.path.isfile(file):  # unlike `Path.is_file`, it raises no error without permission
        raise AllanError(f'{path}: no {METADATA}: a serial from metadata needs a rosbag2 folder')
    document = read_yaml(file, MAX_BYTES)
    information = document.get('rosbag2_bagfile_information') if isinstance(document, dict) else {}
    data = information.get('custom_data') if isinstance(information, dict) else {}
    return data if isinstance(data, dict) else {}


def _first_value(path: Path, name: str) -> object:
    """Return the value in the first row of the column or array ``name``; None if there is none."""
    if path.suffix.lower() == '.npz':
        from .arrays import array_in

        values_of_array = array_in(path, name).reshape(-1)
        return values_of_array[0] if len(values_of_array) else None
    if path.suffix.lower() not in ('.csv', '.tsv'):
        raise AllanError(f'{path}: a serial from a column needs a table or an .npz file')
    remedy = 'check the path and the table'
    with translated(path, (OSError,), remedy), open_regular(path) as file:
        lines: list[str] = []
        while len(lines) < 2 and (line := file.readline(LONGEST_LINE)):
            text = line.decode('utf-8-sig', 'replace').strip()
            lines += [text] if text and not text.startswith('#') else []
    if len(lines) < 2:
        return None
    delimiter = max(',;\t', key=lines[0].count)
    with translated(path, (csv.Error,), remedy):
        names, values = (next(csv.reader([line], delimiter=delimiter)) for line in lines)
    first_row = dict(zip((column.strip() for column in names), values))
    return first_row.get(name)
