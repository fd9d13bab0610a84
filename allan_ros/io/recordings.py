# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any recording of an IMU as a stream of `ImuBatch`: the one door to bags, tables and arrays.

Each family is read by a file of its own (`bags`, `tables`, `arrays`), imported only when such a
recording is opened. All stream in constant memory and speak SI.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.batch import ImuBatch
from ..core.errors import AllanError
from ..core.findings import Finding
from ..core.parameters import check, parameter
from .temperature import TemperatureTrace

BATCH = 32768
"""Samples a batch: enough to forget the cost of a batch, few enough to stay in the cache."""

STANDARD_GRAVITY = 9.80665
"""m/s^2 in one g (3rd CGPM, 1901)."""
GYRO_UNITS = {
    'rad/s': 1.0,
    'mrad/s': 1e-3,
    'deg/s': np.pi / 180,
    'mdeg/s': np.pi / 180e3,
    'deg/h': np.pi / 180 / 3600,
}
"""Unit -> its size in rad/s."""
ACCEL_UNITS = {'m/s^2': 1.0, 'g': STANDARD_GRAVITY, 'mg': STANDARD_GRAVITY / 1e3}
"""Unit -> its size in m/s^2."""
STAMP_UNITS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}
"""Unit -> its size in nanoseconds."""

Report = Callable[[Finding], None]
"""Where a reader says what it found on its way."""

_LFS_MAGIC = b'version https://git-lfs'
_MAGICS = (
    (b'\x89MCAP0\r\n', 'bag'),
    (b'SQLite format 3\0', 'bag'),
    (b'#ROSBAG', 'bag'),
    (b'\x28\xb5\x2f\xfd', 'bag'),  # zstd: a file-compressed split
    (b'PK\x03\x04', 'array'),
    (b'\x93NUMPY', 'array'),
)
_FAMILIES = {
    **dict.fromkeys(('.db3', '.mcap', '.bag', '.zstd', '.zst', '.active'), 'bag'),
    **dict.fromkeys(('.npz', '.npy'), 'array'),
    **dict.fromkeys(('.csv', '.tsv', '.txt', '.dat'), 'table'),
}


@dataclass(frozen=True)
class ReadOptions:
    """How to read what the recording itself does not say."""

    topic: str = parameter('', 'the Imu topic of a bag; empty: the only one there is')
    columns: tuple[str, ...] = parameter(
        (), 'names of the columns of a table without a header, - for one to leave out'
    )
    rate_hz: float = parameter(
        0.0, 'sample rate of a table or array without stamps; 0: not given', unit='Hz', low=0.0
    )
    gyro_unit: str = parameter(
        'rad/s', 'unit of the gyro columns of a table or array', choices=tuple(GYRO_UNITS)
    )
    accel_unit: str = parameter(
        'm/s^2', 'unit of the accel columns of a table or array', choices=tuple(ACCEL_UNITS)
    )
    stamp_unit: str = parameter(
        's', 'unit of the stamp column of a table or array', choices=tuple(STAMP_UNITS)
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class SourceInfo:
    """Where samples came from: a path as it was given, and the topic, type and storage inside."""

    path: str
    topic: str
    type: str
    storage: str


class Recording:
    """One recording, ready to be streamed as often as wanted.

    Attributes
    ----------
    info : SourceInfo
    messages : int or None
        How many samples the recording says it holds; None when only reading it can tell.
    """

    def __init__(
        self,
        info: SourceInfo,
        messages: int | None,
        read: Callable[[Report], Iterator[ImuBatch]],
        read_temperature: Callable[[str], TemperatureTrace | None] = lambda frame_id: None,
    ) -> None:
        self.info = info
        self.messages = messages
        self._read = read
        self._read_temperature = read_temperature
        self._findings: list[Finding] = []

    def batches(self) -> Iterator[ImuBatch]:
        """Yield the samples in order, about `BATCH` at a time, one frame_id a batch.

        Raises
        ------
        AllanError
            When the recording turns out to be unreadable on the way.
        """
        self._findings = []
        yield from self._read(self._findings.append)

    def temperature(self, frame_id: str) -> TemperatureTrace | None:
        """Return the temperature of the IMU with that frame_id, if there is one beside it.

        The recording is read once more for it.
        """
        return self._read_temperature(frame_id)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found while reading; complete after the last batch."""
        return tuple(self._findings)


def open_recordings(
    paths: Iterable[str | os.PathLike[str]], options: ReadOptions | None = None
) -> list[Recording]:
    """Open each input as one recording, whatever its form; the splits of a bag are one.

    Raises
    ------
    AllanError
        One line for the first input that cannot be used: what, where, and what to do.
    """
    options = options or ReadOptions()
    return [_open(Path(path), options) for path in paths]


def _open(path: Path, options: ReadOptions) -> Recording:
    if path.name == 'metadata.yaml':
        path = path.parent
    family = 'bag' if path.is_dir() else _family(path)
    if family == 'bag':
        from .bags import open_bag

        return open_bag(path, options)
    if family == 'array':
        from .arrays import open_array

        return open_array(path, options)
    from .tables import open_table

    return open_table(path, options)


def _family(path: Path) -> str:
    """Tell which reader the file is for, by its first bytes rather than by its name."""
    head = first_bytes(path)
    for magic, family in _MAGICS:
        if head.startswith(magic):
            return family
    try:
        return _FAMILIES[path.suffix.lower()]
    except KeyError:
        raise AllanError(
            f'{path}: not a recording this tool knows: give a rosbag2 folder, .db3, .mcap, '
            'ROS 1 .bag, .csv, .tsv, .npz or .npy'
        ) from None


def first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file that is there and holds something of its own.

    Raises
    ------
    AllanError
        When it is missing, unreadable, empty, or a Git-LFS pointer in its stead.
    """
    try:
        with path.open('rb') as file:
            head = file.read(64)
    except FileNotFoundError:
        raise AllanError(f'{path}: no such file or folder: check the path') from None
    except OSError as error:
        raise AllanError(
            f'{path}: cannot be read ({error.strerror}): check its permissions'
        ) from error
    if not head:
        raise AllanError(f'{path}: is empty (0 bytes): record or copy it again')
    if head.startswith(_LFS_MAGIC):
        raise AllanError(
            f'{path}: is a Git-LFS pointer, not the recording: fetch it with "git lfs pull"'
        )
    return head
