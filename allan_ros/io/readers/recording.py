# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opens any recording of an IMU: bags (also the files of a folder), tables, arrays and PX4 logs.

Each family of formats has a module (`rosbag2`, `tables`, `arrays`, `ulog`), which is imported when
such a recording is opened. All of them return a `Recording`, which yields `ImuBatch` in SI units.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, cast

from ...core.errors import AllanError
from ...core.findings import Finding
from ...core.imu import AXES, SAMPLE_SI, SAMPLE_UNITS, STAMP_UNITS, ImuBatch, sample_factors
from ...core.settings import CheckedSettings, parameter
from ..files import open_regular, read_bounded
from ..signal import TemperatureTrace
from .storage import Storage, damaged, decompress_file, frame_compression, normal_type, translated

BATCH = 32768
"""Number of samples per batch: few enough to fit into the processor cache, and enough to make the
cost per batch negligible."""

Report = Callable[[Finding], None]
"""Function that a reader calls with each finding."""


@dataclass(frozen=True)
class ReadOptions(CheckedSettings):
    """Options for reading a recording: its topic or columns, units, and sample rate."""

    topic: str = parameter(
        '', 'Imu topic of a bag, or instance of a log; needed only if there are several'
    )
    columns: tuple[str, ...] = parameter(
        (),
        'columns of a table: a name for each (- leaves one out), or gx=NAME,gy=NAME,... for '
        'columns picked by their names in the header',
    )
    rate_hz: float = parameter(
        0.0, 'sample rate of a table or array without stamps; 0: not given', unit='Hz', low=0.0
    )
    gyro_unit: str = parameter(
        '',
        'unit of the angular rate; empty: as stated in the recording, else rad/s',
        choices=('', *SAMPLE_UNITS['gyro']),
    )
    accel_unit: str = parameter(
        '',
        'unit of the acceleration; empty: as stated in the recording, else m/s^2',
        choices=('', *SAMPLE_UNITS['accel']),
    )
    stamp_unit: str = parameter(
        's', 'unit of the stamp column of a table or array', choices=tuple(STAMP_UNITS)
    )
    trust_covariance: bool = parameter(
        False, 'treat a sensor as absent wherever covariance[0] is -1 or NaN, even with valid data'
    )

    def in_si(self, batch: ImuBatch) -> ImuBatch:
        """Convert samples from the units of the options to SI."""
        known = self.with_units()
        factors = sample_factors(known.gyro_unit, known.accel_unit)
        if (factors == 1.0).all():
            return batch
        return replace(batch, samples=batch.samples * factors)

    def with_units(self, found: Mapping[str, str] = {}) -> ReadOptions:
        """Return the options with the unit of each sensor filled in.

        The unit is that in ``found`` (sensor -> unit), else that in the options, else SI.
        """
        gyro = found.get('gyro') or self.gyro_unit or SAMPLE_SI['gyro']
        accel = found.get('accel') or self.accel_unit or SAMPLE_SI['accel']
        return replace(self, gyro_unit=gyro, accel_unit=accel)


@dataclass(frozen=True)
class SourceInfo:
    """Source of samples: path as given, topic ('' if none), message type and storage format."""

    path: str
    topic: str
    type: str
    storage: str


def in_batches(whole: ImuBatch) -> Iterator[ImuBatch]:
    """Yield the samples in batches of at most `BATCH` samples, which are views."""
    for first in range(0, len(whole), BATCH):
        yield whole[first : first + BATCH]


class Recording:
    """A recording of an IMU, which can be read any number of times.

    ``messages`` is the number of samples according to the recording; None if it is not known.
    ``read`` yields the samples and reports findings. ``read_temperature`` returns the temperature
    for a frame_id. ``options`` hold the units that were found or assumed. ``axes`` are the axes
    that the recording can contain.
    """

    def __init__(
        self,
        info: SourceInfo,
        messages: int | None,
        read: Callable[[Report], Iterator[ImuBatch]],
        read_temperature: Callable[[str], TemperatureTrace | None] = lambda frame_id: None,
        options: ReadOptions = ReadOptions(),
        axes: tuple[str, ...] = AXES,
    ) -> None:
        self.info = info
        self.axes = axes
        self.messages = messages
        self.options = options.with_units()
        self._read = read
        self._read_temperature = read_temperature
        self._findings: list[Finding] = []

    def batches(self) -> Iterator[ImuBatch]:
        """Yield the samples in order, in batches of about `BATCH` with one frame_id each.

        Raises AllanError when a part of the recording cannot be read.
        """
        self._findings = []
        yield from self._read(self._findings.append)

    def temperature(self, frame_id: str) -> TemperatureTrace | None:
        """Return the temperature of the IMU with this frame_id, or None if it is not recorded.

        This reads the recording once more.
        """
        return self._read_temperature(frame_id)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the recording; complete after `batches` has yielded the last batch."""
        return tuple(self._findings)


# --- opening --------------------------------------------------------------------------------------

METADATA = 'metadata.yaml'

_LFS_MAGIC = b'version https://git-lfs'

_MAGICS = {
    b'\x89MCAP0\r\n': ('bag', 'mcap'),
    b'SQLite format 3\0': ('bag', 'sqlite3'),
    b'#ROSBAG': ('bag', 'ros1'),
    b'\x28\xb5\x2f\xfd': ('bag', ''),  # zstd: a compressed file of a bag
    b'ULog\x01\x12\x35': ('ulog', ''),
    b'PK\x03\x04': ('array', ''),
    b'\x93NUMPY': ('array', ''),
}
"""First bytes of a file -> family of formats, and format of a bag file."""

_FAMILIES = {
    **dict.fromkeys(('.db3', '.mcap', '.bag', '.zstd', '.zst', '.active'), 'bag'),
    **dict.fromkeys(('.npz', '.npy'), 'array'),
    '.ulg': 'ulog',
    **dict.fromkeys(('.csv', '.tsv', '.txt', '.dat'), 'table'),
}
"""Suffix of a file -> family of formats, if the first bytes are unknown."""

_OPENERS = {
    'bag': ('.rosbag2', 'open_bag'),
    'table': ('.tables', 'open_table'),
    'array': ('.arrays', 'open_array'),
    'ulog': ('.ulog', 'open_ulog'),
}
"""Family of formats -> module, and its function that opens a recording."""


def open_recordings(
    paths: Iterable[str | os.PathLike[str]], options: ReadOptions | None = None
) -> list[Recording]:
    """Open each path as one recording; a folder with a bag is one recording.

    Raises AllanError for the first path that cannot be read.
    """
    options = options or ReadOptions()
    return [_open(Path(path), options) for path in paths]


def topics_of(path: str | os.PathLike[str]) -> list[str]:
    """Return the Imu topics of a bag; the list is empty for other formats and unreadable files."""
    place = Path(path)
    try:
        if _family(place) != 'bag':
            return []
        from .rosbag2 import imu_topics

        return imu_topics(place)
    except AllanError:
        return []


def _open(path: Path, options: ReadOptions) -> Recording:
    if path.name == METADATA:
        path = path.parent
    module, opener = _OPENERS[_family(path)]
    return cast(Recording, getattr(import_module(module, __package__), opener)(path, options))


def _family(path: Path) -> str:
    """Return the family of formats of a path: by its first bytes, else by its suffix.

    Raises AllanError when it is unknown.
    """
    if path.is_dir():
        return 'bag'
    family = _by_magic(first_bytes(path))[0] or _FAMILIES.get(path.suffix.lower())
    if family is None:
        raise AllanError(
            f'{path}: not a known type of recording: give a rosbag2 folder, .db3, .mcap, '
            'ROS 1 .bag, .csv, .tsv, .npz, .npy or .ulg'
        )
    return family


def _by_magic(head: bytes) -> tuple[str, str]:
    """Return the family of formats, and the format of a bag file; '' if they are unknown."""
    return next((form for magic, form in _MAGICS.items() if head.startswith(magic)), ('', ''))


def first_bytes(path: Path) -> bytes:
    """Return the first 64 bytes of a file.

    Raises AllanError when it is missing, unreadable, not a regular file, empty, or a Git-LFS
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
    if head.startswith(_LFS_MAGIC):
        raise AllanError(
            f'{path}: is a Git-LFS pointer, not the recording: fetch it with "git lfs pull"'
        )
    return head


# --- the files of a bag ---------------------------------------------------------------------------

METADATA_KEY = 'rosbag2_bagfile_information'

MAX_METADATA = 16 * 2**20
"""Largest size in bytes of metadata.yaml; that of a bag of 50,000 files is smaller."""

SPLITS = ('.db3', '.mcap', '.db3.zstd', '.mcap.zstd', '.db3.lz4', '.mcap.lz4')


class Described(NamedTuple):
    """Number of messages of a topic, and their serialization, as stated in metadata.yaml."""

    messages: int
    encoding: str


class BagFiles(NamedTuple):
    """The files of one bag in order, and the topics that metadata.yaml states.

    ``described`` maps (topic name, type) to `Described`; it is None without metadata.yaml.
    """

    path: Path
    files: tuple[Path, ...]
    described: dict[tuple[str, str], Described] | None = None


def bag_files(path: Path) -> BagFiles:
    """Return the files of a bag, which is a folder (with or without metadata.yaml) or one file.

    Raises AllanError when the folder contains no bag, or one of its files is missing or not a
    regular file.
    """
    if not path.is_dir():
        return BagFiles(path, (path,))
    with translated(path, (OSError,), 'check its permissions'):
        bag = _described(path) if os.path.lexists(path / METADATA) else BagFiles(path, ())
        if not bag.files:
            splits = [child for child in path.iterdir() if child.name.endswith(SPLITS)]
            bag = bag._replace(files=tuple(sorted(splits, key=_natural)))
        if not bag.files:
            raise _no_bag_in(path)
        for file in bag.files:
            first_bytes(file)
        return bag


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts file names by the numbers in them: 10 comes after 9."""
    parts = re.split(r'(\d+)', path.name)
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts]


def _no_bag_in(path: Path) -> AllanError:
    inside = sorted(
        child.name
        for child in path.iterdir()
        if child.suffix == '.bag' or (child / METADATA).is_file()
    )
    if inside:
        shown = ', '.join(inside[:5]) + (' ...' if len(inside) > 5 else '')
        return AllanError(
            f'{path}: is a folder of {len(inside)} recordings ({shown}): give each of them'
        )
    return AllanError(
        f'{path}: no bag in this folder (no {METADATA}, .db3 or .mcap): give the folder that '
        'ros2 bag recorded'
    )


def _described(path: Path) -> BagFiles:
    """Return the files and topics that metadata.yaml in the folder ``path`` states."""
    import yaml

    from ..files import parse_yaml

    first_bytes(path / METADATA)
    remedy = f'restore {METADATA}, or remove it to read the .db3 or .mcap files without it'
    described: dict[tuple[str, str], Described] = {}
    # all exceptions that unexpected content can cause
    errors = (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError, OSError)
    with translated(path / METADATA, errors, remedy):
        text = read_bounded(path / METADATA, MAX_METADATA).decode()
        info: dict[str, Any] = parse_yaml(text)[METADATA_KEY]
        # in older bags, the file names include the folder
        files = [path / PurePosixPath(name).name for name in info.get('relative_file_paths') or []]
        for entry in info.get('topics_with_message_count') or []:
            topic, count = entry['topic_metadata'], entry['message_count']
            names = [topic['name'], topic['type'], topic['serialization_format']]
            if not all(isinstance(name, str) and name.isprintable() for name in names):
                raise ValueError('the name of a topic is not a printable text')
            if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count < 2**63:
                raise ValueError(f'message_count of {names[0]} is not a number of messages')
            key = (names[0], normal_type(names[1]))
            count += described[key].messages if key in described else 0
            described[key] = Described(count, names[2])
    if missing := [file.name for file in files if not file.exists()]:
        raise AllanError(
            f'{path}: {len(missing)} of the {len(files)} files that {METADATA} names are missing '
            f'({missing[0]}): copy the whole folder'
        )
    return BagFiles(path, tuple(files), described)


@contextmanager
def open_storage(path: Path) -> Iterator[tuple[Storage, str]]:
    """Open a bag file, decompressed if necessary, and return it with its format.

    The format is 'mcap', 'sqlite3' or 'ros1'. Raises AllanError when the file is missing, damaged,
    or not a bag.
    """
    from .mcap import McapStorage
    from .ros1 import Ros1Storage
    from .sqlite3 import open_sqlite3

    openers: dict[str, Callable[[Path, Path], AbstractContextManager[Storage]]] = {
        'mcap': McapStorage.open,
        'sqlite3': open_sqlite3,
        'ros1': Ros1Storage.open,
    }
    compression = frame_compression(first_bytes(path))
    with ExitStack() as stack:
        plain = path
        if compression:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='allan_ros.'))
            plain = Path(folder, path.stem)
            decompress_file(path, compression, plain)
        form = _by_magic(first_bytes(plain))[1]
        if not form:
            raise damaged(path, 'it is not a bag', 'give a rosbag2 .db3 or .mcap, or a ROS 1 .bag')
        yield stack.enter_context(openers[form](plain, path)), form
