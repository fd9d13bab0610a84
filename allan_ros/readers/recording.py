# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording of an IMU, the options to read one, and the errors of files that cannot be read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import AllanError, one_line
from ..core.findings import Finding
from ..core.imu import (
    AXES,
    SAMPLE_SI,
    SAMPLE_UNITS,
    STAMP_UNITS,
    ImuBatch,
    sample_factors,
    sensor_of,
)
from ..core.settings import CheckedSettings, parameter
from .files import open_regular

if TYPE_CHECKING:
    from ..core.stream.signal import TemperatureTrace

BATCH = 32768
"""Largest number of samples per batch. Such a batch fits into the processor cache, and is so large
that the overhead for each batch is negligible."""

METADATA = 'metadata.yaml'

MCAP_MAGIC = b'\x89MCAP0\r\n'

BAG_MAGICS = {MCAP_MAGIC: 'mcap', b'SQLite format 3\0': 'sqlite3', b'#ROSBAG': 'ros1'}
"""First bytes of a bag file -> format of the file, which is also the name of the module that reads
the format."""

COMPRESSION_MAGICS = {b'\x28\xb5\x2f\xfd': 'zstd', b'\x04\x22\x4d\x18': 'lz4'}
"""First bytes of compressed data -> name of the compression. A compressed file is opened as a
bag."""

ZIP_MAGIC = b'PK\x03\x04'

BAG_SUFFIXES = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')
"""Suffixes of the files in the folder of a bag."""

MAX_CHUNK_BYTES = 128 * 2**20
"""Largest accepted size of a chunk or record of a file in bytes, compressed or not. By default,
recorders write chunks of about 1 MB."""

MAX_FILE_RATIO = 250
"""Largest accepted size of a decompressed file: this many times its compressed size, plus
`MAX_CHUNK_BYTES`."""

Report = Callable[[Finding], None]
"""Function that a reader calls with each finding."""


@dataclass(frozen=True)
class ReadOptions(CheckedSettings):
    """Options for reading a recording: its topic or columns, units, and sample rate."""

    topic: str = parameter(
        '', 'Imu topic of a bag, or IMU topic of a PX4 log; needed only if there are several topics'
    )
    accel_topic: str = parameter(
        '',
        'second Imu topic of a bag, with the accelerometer, if the first has only the gyro; the '
        'rates may differ',
    )
    columns: tuple[str, ...] = parameter(
        (),
        'columns of a table: a name for each column (- excludes a column), or gx=NAME,gy=NAME,..., '
        'where NAME is the name of the column in the header',
    )
    rate_hz: float = parameter(
        0.0, 'sample rate of a table or array without stamps; 0: not given', unit='Hz', low=0.0
    )
    gyro_unit: str = parameter(
        '',
        'unit of the angular rate if the recording states none; empty: rad/s',
        choices=('', *SAMPLE_UNITS['gyro']),
    )
    accel_unit: str = parameter(
        '',
        'unit of the acceleration if the recording states none; empty: m/s^2',
        choices=('', *SAMPLE_UNITS['accel']),
    )
    gyro_counts: float = parameter(
        1.0,
        'raw counts of the gyro per --gyro-unit (the sensitivity in the datasheet), such as 131 '
        'with --gyro-unit deg/s',
        low=1e-12,
        high=1e12,
    )
    accel_counts: float = parameter(
        1.0,
        'raw counts of the accelerometer per --accel-unit, such as 16384 with --accel-unit g',
        low=1e-12,
        high=1e12,
    )
    stamp_unit: str = parameter(
        '',
        'unit of the stamp column of a table or array; empty: as stated in the name of the column, '
        'else recognized from the stamps',
        choices=('', *STAMP_UNITS),
    )

    def in_si(self, batch: ImuBatch) -> ImuBatch:
        """Return a batch with its samples converted from the units in the options to SI."""
        options = self.with_units()
        counts = np.repeat([self.gyro_counts, self.accel_counts], 3)
        factors = sample_factors(options.gyro_unit, options.accel_unit) / counts
        if (factors == 1.0).all():
            return batch
        return replace(batch, samples=batch.samples * factors)

    def with_units(self, found: Mapping[str, str] = {}) -> ReadOptions:
        """Return the options with a unit for each sensor.

        ``found`` (sensor -> unit) takes precedence over the unit in the options. If neither states
        a unit, the unit is SI.
        """
        gyro = found.get('gyro') or self.gyro_unit or SAMPLE_SI['gyro']
        accel = found.get('accel') or self.accel_unit or SAMPLE_SI['accel']
        return replace(self, gyro_unit=gyro, accel_unit=accel)


@dataclass(frozen=True)
class SourceInfo:
    """Source of samples: path, topic, type and storage format, as a report states them.

    ``topic`` is the name of an array in a ``.npz`` file, and '' if there is none. ``type`` is the
    message type in a bag or log, or 'array' or 'table'.
    """

    path: str
    topic: str
    type: str
    storage: str

    def __post_init__(self) -> None:
        # a file name may contain bytes that cannot be written as text
        object.__setattr__(self, 'path', one_line(self.path))


def in_batches(whole: ImuBatch) -> Iterator[ImuBatch]:
    """Yield the samples in batches of at most `BATCH` samples, which are views of ``whole``."""
    for first in range(0, len(whole), BATCH):
        yield whole[first : first + BATCH]


@dataclass(eq=False)
class Recording:
    """A recording of an IMU, which can be read any number of times.

    Attributes
    ----------
    info : SourceInfo
        Where the samples come from.
    messages : int or None
        Number of samples that the recording states, including the samples of ``accel``; None if
        it states no number.
    read : callable
        Function that yields the samples in batches, and calls its argument with each finding.
    temperature : callable
        Function that returns the temperature over time of the IMU with a given frame_id, or None if
        the temperature is not recorded, or may be from another IMU. Call this function after the
        samples have been read.
    options : ReadOptions
        The options, with the units that were found or assumed.
    axes : tuple of str
        Axes that the recording can contain.
    close : callable
        Function that closes the file; the next reading opens the file again.
    accel : Recording or None
        Recording of the accelerometer if this sensor has a separate topic; None otherwise.
    other_topics : sequence of str
        Other Imu topics of the bag, the topic with the longest common namespace first.
    findings : tuple of Finding
        Findings of the reader, complete after all samples have been read.
    """

    info: SourceInfo
    messages: int | None
    read: Callable[[Report], Iterator[ImuBatch]]
    temperature: Callable[[str], TemperatureTrace | None] = lambda frame_id: None
    options: ReadOptions = ReadOptions()
    axes: tuple[str, ...] = AXES
    close: Callable[[], None] = lambda: None
    accel: Recording | None = None
    other_topics: Sequence[str] = ()
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        self.options = self.options.with_units()

    def batches(self) -> Iterator[ImuBatch]:
        """Yield the samples in order, in batches of at most `BATCH` samples with one frame_id each.

        Raises AllanError when the recording cannot be read. A truncated or partly damaged recording
        may be read in part; `findings` then state the damage.
        """
        findings: list[Finding] = []
        for batch in self.read(findings.append):
            self.findings = tuple(findings)
            yield batch
        self.findings = tuple(findings)

    @property
    def sensor(self) -> str:
        """The only sensor in `axes`, 'gyro' or 'accel'; '' if there are axes of both sensors."""
        first_sensor, *other_sensors = dict.fromkeys(map(sensor_of, self.axes))
        return '' if other_sensors else first_sensor


# --- errors and limits ---------------------------------------------------------------------------


def damaged(path: Path, reason: object, remedy: str) -> AllanError:
    """Return the error for a file that cannot be read.

    Parameters
    ----------
    path : Path
        The file.
    reason : object
        The exception or text that states the cause; only its first 160 characters are used.
    remedy : str
        What the user should do.
    """
    reason_text = ' '.join(str(reason).split())[:160] or type(reason).__name__
    return AllanError(f'{path}: cannot be read ({reason_text}): {remedy}')


@contextmanager
def translated(path: Path, errors: tuple[type[Exception], ...], remedy: str) -> Iterator[None]:
    """Convert exceptions of the types ``errors`` in a with block to AllanErrors (see `damaged`)."""
    try:
        yield
    except AllanError:
        raise
    except errors as error:
        raise damaged(path, error, remedy) from error


def optional_package(module: str, purpose: str) -> Any:
    """Import and return a module; if it is missing, raise AllanError with the install command."""
    try:
        return import_module(module)
    except ImportError:
        package = module.split('.')[0]
        # on Ubuntu, pip cannot install into the system (PEP 668)
        apt_hint = f' or "apt install python3-{package}"' if package in ('lz4', 'zstandard') else ''
        raise AllanError(
            f'{purpose} needs the Python package {package!r}: "pip install {package}"{apt_hint}'
        ) from None


MOST_LISTED = 10
"""Largest number of columns or topics that a message names; the others are counted."""


def listed(names: Sequence[str], most: int = MOST_LISTED) -> str:
    """Return the first ``most`` names and the number of further names, if any, as text."""
    text = ', '.join(names[:most])
    n_more = len(names) - most
    return f'{text} and {n_more} more' if n_more > 0 else text


def first_bytes(path: Path) -> bytes:
    """Return the first 64 bytes of a file, or all bytes of a shorter file.

    Raises AllanError when the file is missing, unreadable, not regular, empty, or a Git-LFS
    pointer.
    """
    try:
        with open_regular(path) as file:
            head = file.read(64)
    except FileNotFoundError:
        raise AllanError(f'{path}: no such file or folder: check the path') from None
    except OSError as error:
        raise AllanError(
            f'{path}: cannot be read ({error.strerror}): check its permissions'
        ) from error
    if not head:
        raise AllanError(f'{path}: is empty (0 bytes): record or copy it again')
    if head.startswith(b'version https://git-lfs'):
        raise AllanError(
            f'{path}: is a Git-LFS pointer, not the recording: fetch it with "git lfs pull"'
        )
    return head
