# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stores the values that parameters had before they were set, so that a restart restores them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import AllanError
from ..core.fields import Fields
from ..readers.files import PathLock, expanded, read_json, to_json, write_atomic
from .push_plan import Numbers

SCHEMA = 'allan_ros/former_values/1'


@dataclass(frozen=True)
class Former:
    """The value that a parameter had before it was set, and the values that were sent since then.

    ``found`` is the former value. ``sent`` contains the sent values that the parameter may have
    now: one value, or two values while the node has not accepted the second one. ``sent`` is empty
    if no value was sent.
    """

    found: Numbers
    sent: tuple[Numbers, ...] = ()


def former_values_file(node: str) -> Path:
    """Return the path of the file with the former values of a node, given its full name.

    The name of the file contains the ROS domain. The file is in the folder ``allan_ros`` of
    ``ROS_HOME``, which is ``~/.ros`` by default.
    """
    home = expanded(os.environ.get('ROS_HOME') or '~/.ros')
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    return home / 'allan_ros' / f'former_values_{domain}_{node.strip("/").replace("/", ".")}.json'


class FormerValues:
    """A file with the former values of the parameters of one node.

    A former value is written to the file before its parameter is set, so that the value is not lost
    if this process is killed. The file is locked while it is open. Without the lock, two programs
    could set parameters of the same node, and each would mistake a value from the other program for
    a value from the operator.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self.path = former_values_file(node)
        self._lock = PathLock(self.path)
        self._stored: Mapping[str, Former] = {}

    def open(self) -> Mapping[str, Former]:
        """Lock the file, and return the values that a killed program has left in it.

        Raises AllanError if another program has locked the file, if the file cannot be read or is
        invalid, or if its folder cannot be created or written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise AllanError(
                f'{self.path.parent}: cannot be created ({error.strerror}), so former values '
                'cannot be kept and nothing is set: set ROS_HOME to a writable folder'
            ) from error
        if owner := self._lock.acquire():
            raise AllanError(
                f'{owner} sets parameters of {self._node}, so this node sets none: stop one of them'
            )
        if self.path.exists():
            self._stored = self._read()
        return self._stored

    def store(self, values: Mapping[str, Former]) -> None:
        """Replace the content of the file; remove the file if there are no values.

        Raises AllanError if the file cannot be written or removed.
        """
        if values == self._stored:
            return
        if values:
            parameters = {name: vars(former) for name, former in values.items()}
            document = {'schema': SCHEMA, 'node': self._node, 'parameters': parameters}
            write_atomic(self.path, to_json(document))
        else:
            try:
                self.path.unlink(missing_ok=True)
            except OSError as error:
                raise AllanError(
                    f'{self.path} cannot be removed ({error.strerror}): remove it, or correct the '
                    'permissions of its folder'
                ) from error
        self._stored = dict(values)

    def close(self) -> None:
        """Unlock the file; its content is not changed."""
        self._lock.release()

    def _read(self) -> dict[str, Former]:
        fields = Fields(read_json(self.path), str(self.path))
        fields.schema(SCHEMA)
        parameters = fields.fields('parameters')
        return {name: _former_value(parameters.fields(name)) for name in parameters}


def _former_value(fields: Fields) -> Former:
    found_numbers = fields.numbers('found')
    if not np.isfinite(found_numbers).all():
        raise AllanError(f'{fields.where}.found: finite numbers are expected')
    sent_numbers = fields.table('sent', len(fields.sequence('sent')), len(found_numbers))
    return Former(tuple(found_numbers.tolist()), tuple(map(tuple, sent_numbers.tolist())))
