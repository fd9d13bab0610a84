# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Read and write files safely: regular files of limited size, atomic writing, and locks.

Configuration files, such as datasheets (``sensors``) and plans for parameters of state estimators
(``filters``), are given by path or by name. A name is looked up in the folder of the user
(``~/.config/allan_ros/<kind>``, or under ``$XDG_CONFIG_HOME``), then in the package.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import os
import re
import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any, BinaryIO, ParamSpec, TypeVar
from uuid import uuid4

import yaml

from ..core.errors import AllanError, one_line

P = ParamSpec('P')
T = TypeVar('T')

PATH = (str, os.PathLike)
"""Types of arguments that are accepted as a path."""

LONGEST_NAME = 255
"""Largest number of bytes in a file name (NAME_MAX of Linux)."""

IDENTITIES = ('frame_id', 'hardware_id')
"""Names of the keyword arguments that identify an IMU. Their values may be longer than the name of
a file."""


def with_checked_paths(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a public function so that it raises AllanError for errors of the operating system.

    The function also raises AllanError for a text argument that cannot be a path, because it
    contains a null character or a name that is too long for a file. Not every version of Python
    reports such an argument. The lengths of the arguments in `IDENTITIES` are not checked. An empty
    text, which Python reads as the path of the working directory, also raises AllanError, unless
    the default of the parameter is a text.
    """
    function_signature = signature(function)

    @wraps(function)
    def checked(*args: P.args, **given: P.kwargs) -> T:
        arguments: dict[str, Any] = dict(given)  # also the options of ``**options``
        with contextlib.suppress(TypeError):  # for wrong arguments, the call below raises TypeError
            arguments |= function_signature.bind(*args, **given).arguments
        for name, value in arguments.items():
            parameter = function_signature.parameters.get(name)
            may_be_empty = parameter is None or isinstance(parameter.default, str)
            for text in value if isinstance(value, (tuple, list)) else (value,):
                if not isinstance(text, PATH):
                    continue
                if text == '' and not may_be_empty:
                    raise AllanError(f'{name} is an empty text: give a path or a name')
                shown_text, parts = f'{one_line(repr(text)):.60}', str(text).split('/')
                if '\0' in str(text):
                    raise AllanError(f'{shown_text} has a null character: give a name without it')
                longest = max(len(part.encode(errors='replace')) for part in parts)
                if longest > LONGEST_NAME and name not in IDENTITIES:
                    raise AllanError(f'{shown_text}: File name too long: check the path')
        try:
            return function(*args, **given)
        except OSError as error:
            where = one_line(str(error.filename or function.__name__))
            raise AllanError(
                f'{where:.80}: {error.strerror or error}: check the path, its permissions and the '
                'disk'
            ) from error

    return checked


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading bytes; symbolic links are followed.

    Raises AllanError when the path is a folder, FIFO, device or socket, and OSError when the file
    is missing or unreadable.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):  # opening a device can already have an effect
        raise _not_regular(path)
    flags = os.O_RDONLY | getattr(os, 'O_NONBLOCK', 0) | getattr(os, 'O_BINARY', 0)
    file = os.fdopen(os.open(path, flags), 'rb')
    # the file may have been replaced after the first check
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise _not_regular(path)
    return file


def read_bounded(path: str | os.PathLike[str], limit: int) -> bytes:
    """Read a regular file of at most ``limit`` bytes.

    Raises AllanError when the path is not a regular file, or the file is larger, and OSError when
    the file is missing or unreadable.
    """
    with open_regular(path) as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise AllanError(
            f'{os.fspath(path)}: is larger than {limit} bytes, and therefore not a file of the '
            'expected kind: check the path'
        )
    return data


def read_text(path: str | os.PathLike[str], limit: int) -> str:
    """Read a regular UTF-8 file of at most ``limit`` bytes, without changing its line ends.

    Raises AllanError when the file cannot be read, is larger than ``limit``, or is not UTF-8.
    """
    try:
        return read_bounded(path, limit).decode('utf-8')
    except OSError as error:
        reason = str(error.strerror).lower()
    except UnicodeDecodeError as error:
        reason = f'it is not UTF-8 text: {error.reason} at byte {error.start}'
    raise AllanError(f'{os.fspath(path)}: cannot be read ({reason}): check the path')


def _not_regular(path: str | os.PathLike[str]) -> AllanError:
    return AllanError(
        f'{os.fspath(path)}: is a folder, FIFO, device or socket: give a regular file'
    )


def write_atomic(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file so that its path never contains an incomplete file, even after a crash.

    The content is written to a temporary file in the same folder, which is synced to the disk and
    then renamed. Raises AllanError when the file cannot be written.
    """
    write_together(Path(path).parent, {Path(path).name: content})


def write_together(
    folder: Path, contents: Mapping[str, str | bytes], remove: Iterable[str] = ()
) -> None:
    """Write several files of one folder; no file is replaced before all contents are on the disk.

    Parameters
    ----------
    folder : Path
        The folder, which must exist.
    contents : mapping of str to str or bytes
        Name -> content of each file, in the order in which the files are replaced.
    remove : iterable of str
        Names of files that are removed before the others are replaced.

    Raises
    ------
    AllanError
        When a path is a folder, FIFO, device or socket, ``folder`` is missing or not writable, or
        the disk is full. An error before the first file is removed or replaced leaves all files
        unchanged.
    """
    drafts: dict[Path, Path] = {}
    path = folder
    try:
        try:
            for name, content in contents.items():
                path = folder / name
                check_replaceable(path)
                drafts[path] = path.with_name(f'.{name}.{uuid4().hex}.part')
                with drafts[path].open('xb') as file:
                    # a file name in the text may not be UTF-8
                    text = (
                        content.encode(errors='backslashreplace')
                        if isinstance(content, str)
                        else content
                    )
                    file.write(text)
                    file.flush()
                    os.fsync(file.fileno())
            for name in remove:
                path = folder / name
                check_replaceable(path)
                path.unlink(missing_ok=True)
            for path, draft in drafts.items():
                draft.replace(path)
        finally:
            for draft in drafts.values():
                draft.unlink(missing_ok=True)
        if os.name == 'posix':  # sync the folder, so that the new names survive a power failure
            handle = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
    except OSError as error:
        raise unwritable(path, error) from error


def check_replaceable(path: Path) -> None:
    """Raise AllanError if the path is a folder, FIFO, device or socket; it may be missing.

    Raises OSError if the type of the file cannot be determined.
    """
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise _not_regular(path)


def unwritable(path: Path, error: OSError) -> AllanError:
    """Return the error for a path that cannot be written."""
    return AllanError(
        f'{path}: cannot be written ({error.strerror}): check the folder, its permissions '
        'and the space left'
    )


MAX_BYTES = 16 * 2**20
"""Largest accepted size of a JSON document in bytes. Most documents of this package are far
smaller."""


def to_json(document: Mapping[str, Any]) -> str:
    """Return a document as JSON text; raises ValueError if it contains NaN or infinity.

    Bytes of a file name that are not UTF-8 are written as text, such as ``\\xff``.
    """
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + '\n'
    if text.isascii():
        return text
    return SURROGATE.sub(lambda found: f'\\\\x{ord(found[0]) & 0xFF:02x}', text)


SURROGATE = re.compile('[\ud800-\udfff]')
"""Characters by which Python represents bytes of a file name that are not UTF-8 (PEP 383)."""


def parse_json(text: str, where: str) -> object:
    """Parse a JSON text; ``where`` is the name of the text in error messages.

    Raises AllanError if the text is too long, invalid or nested too deeply, or contains the words
    NaN or Infinity as numbers, an integer of more than 20 characters, or the escape sequence of an
    unpaired surrogate.
    """
    if len(text) > MAX_BYTES:
        raise AllanError(
            f'{where}: has more than {MAX_BYTES} bytes: it is not a document of allan_ros'
        )
    try:
        document: object = json.loads(text, parse_constant=_reject_constant, parse_int=_integer)
        if '\\ud' in text.lower():  # an unpaired surrogate cannot be written as UTF-8
            json.dumps(document, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise AllanError(f'{where}: is not JSON ({error}): create the file again') from None
    return document


def read_json(path: str | os.PathLike[str]) -> object:
    """Read a JSON file that contains an object or a list.

    Raises AllanError if the file cannot be read, is too large or is invalid.
    """
    with contextlib.suppress(OSError), open_regular(path) as file:
        if (head := file.read(64).lstrip()) and head[:1] not in b'{[':
            raise AllanError(
                f'{os.fspath(path)}: is not a JSON document; `allan analyze` reads recordings, and '
                'writes results.json and sums.json with -o'
            )
    return parse_json(read_text(path, MAX_BYTES), str(path))


def _reject_constant(name: str) -> object:
    raise ValueError(f'{name} is not a number')


def _integer(digits: str) -> int:
    if len(digits) > 20:  # Python needs minutes to read an integer with a million digits
        raise ValueError(f'an integer of {len(digits)} digits')
    return int(digits)


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    def fetch_flow_collection_start(self, token: Any) -> None:
        if self.flow_level >= 50:  # the time to read increases with the square of the depth
            raise yaml.YAMLError('more than 50 nested brackets')
        super().fetch_flow_collection_start(token)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        # nested merge keys are copied, so a short file could fill the memory
        if any(key.tag == 'tag:yaml.org,2002:merge' for key, _ in node.value):
            raise yaml.YAMLError('it has a merge key "<<", which is not supported')


# YAML 1.1 reads 1e-4 as a string because it has no decimal point. Users mean a number, as in JSON.
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?[0-9]+[eE][-+]?[0-9]+$'), list('-+0123456789')
)


def parse_yaml(text: str) -> Any:
    """Parse a YAML or JSON text; raise yaml.YAMLError if it is invalid or not supported."""
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        line = text.count('\n', 0, error.position) + 1
        raise yaml.YAMLError(f'line {line} has a character that YAML does not allow') from error
    try:
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = ', '.join(filter(None, (error.context, error.problem)))
        raise yaml.YAMLError(f'line {mark.line + 1}: {reason}') from error
    except RecursionError:
        raise yaml.YAMLError('it is nested too deeply') from None
    except (ValueError, ArithmeticError, LookupError, AttributeError) as error:  # an invalid date
        raise yaml.YAMLError(str(error)) from error
    finally:
        loader.dispose()


def expanded(path: str | Path) -> Path:
    """Return a path in which the home folder replaces ``~`` at its start.

    Unlike `Path.expanduser`, this function raises no error if the user or the home folder does not
    exist: the path is then returned unchanged.

    >>> expanded('~nobody-has-this-name/x.yaml').name
    'x.yaml'
    """
    return Path(os.path.expanduser(path))


def read_yaml(path: Path, limit: int = 100_000) -> Any:
    """Read a YAML or JSON file of at most ``limit`` bytes.

    Raises AllanError if the file cannot be read, is larger, or is invalid.
    """
    try:
        return parse_yaml(read_text(path, limit))
    except yaml.YAMLError as error:
        reason = ' '.join(str(error).split())
        raise AllanError(f'{path}: is not YAML ({reason[:120]}): correct the file') from error


def config_names(kind: str) -> list[str]:
    """Return the sorted names, without suffix, of all .yaml configuration files of a kind.

    ``kind`` is the name of the folders with such files: 'sensors' or 'filters'.
    """
    return sorted({path.stem for folder in config_folders(kind) for path in folder.glob('*.yaml')})


def config_file(kind: str, name: str, description: str) -> Path:
    """Return the path of a configuration file, given its name or path.

    Parameters
    ----------
    kind : str
        Name of the folder with such files: 'sensors' or 'filters'.
    name : str
        Name of the file without suffix, or path of a .yaml or .yml file. In a name, capital letters
        and punctuation do not matter. A path is not checked.
    description : str
        Word for such a file in error messages, such as 'datasheet'.

    Raises
    ------
    AllanError
        When the name is unknown or ambiguous. The message suggests similar names, or lists some
        names if none is similar.
    """
    path = Path(name)
    if path.suffix.lower() in ('.yaml', '.yml'):
        return expanded(path)
    if path.name == name:
        equal_names = [
            known for known in config_names(kind) if _simplified(known) == _simplified(name)
        ]
        # for example, the given name is mpu-6050, and the only known name like it is mpu6050
        for stem in (name.lower(), *(equal_names if len(equal_names) == 1 else ())):
            for folder in config_folders(kind):
                file = folder / f'{stem}.yaml'
                if os.path.isfile(file):  # unlike `Path.is_file`, it never raises an error
                    return file
    raise AllanError(
        f'no {description} {name!r}: {_suggestion(name.lower(), config_names(kind))}, '
        'or give the path of a .yaml file'
    )


def config_folders(kind: str) -> list[Path]:
    """Return the existing folders that may contain configuration files of a kind, in search order.

    The folder of the user (XDG Base Directory, 0.8) comes first. The folders ``config/<kind>`` of
    the source code and of the installed package follow.
    """
    home = os.environ.get('XDG_CONFIG_HOME') or expanded('~/.config')
    this_file = Path(__file__).resolve()
    folders = [Path(home) / 'allan_ros' / kind, this_file.parents[2] / 'config' / kind]
    folders += [parent / 'share' / 'allan_ros' / 'config' / kind for parent in this_file.parents]
    return [folder for folder in folders if os.path.isdir(folder)]


NEAREST, LISTED_NAMES = 3, 8
"""Largest number of similar names that a message about an unknown name suggests, and number of
names that the message lists if no name is similar."""


def _suggestion(name: str, names: Sequence[str]) -> str:
    start = _simplified(name)
    known_names = {_simplified(known): known for known in names}
    similar = [known for key, known in known_names.items() if start and key.startswith(start)]
    # Other digits mean another sensor, so a similar name must contain all given digits in order.
    digits = '.*'.join(re.findall(r'\d', name))
    close_keys = difflib.get_close_matches(start, known_names, NEAREST, 0.8)
    similar = similar or [known_names[key] for key in close_keys if re.search(digits, key)]
    if similar:
        return f'did you mean {" or ".join(similar[:NEAREST])}'
    rest_text = f' (and {len(names) - LISTED_NAMES} more)' if len(names) > LISTED_NAMES else ''
    return f'choose one of {", ".join(names[:LISTED_NAMES])}{rest_text}'


def _simplified(name: str) -> str:
    return re.sub(r'[\W_]', '', name.lower())


class PathLock:
    """A lock that permits one process at a time to write the file at a path.

    The file may be missing. A hidden file next to the file is locked, because each writing replaces
    the file itself. On Windows, and on file systems without locks, several processes can acquire
    the lock.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock_file = path.with_name(f'.{path.name}.lock')
        self._handle: int | None = None

    def acquire(self) -> str:
        """Try to acquire the lock; return '' on success, otherwise the name of its owner.

        Raises AllanError if the lock file cannot be created or opened, or is not a regular file.
        """
        while self._handle is None:
            handle = self._open_lock_file()
            if not _try_to_lock(handle):
                os.lseek(handle, 0, os.SEEK_SET)
                owner = os.read(handle, 20).decode(errors='replace').strip()  # process number
                os.close(handle)
                return f'process {owner}' if owner.isdigit() else 'another process'
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), os.stat(self._lock_file)):
                    self._handle = handle
            if self._handle is None:
                os.close(handle)  # another process removed the lock file before it was locked here
                continue
            # on a full disk, the lock file does not contain the process number
            with contextlib.suppress(OSError):
                self._lock_file.write_text(f'{os.getpid()}\n')
        return ''

    def release(self) -> None:
        """Release the lock, if it was acquired, and remove the lock file."""
        handle, self._handle = self._handle, None
        if handle is not None:
            with contextlib.suppress(OSError):
                self._lock_file.unlink()
            os.close(handle)

    def _open_lock_file(self) -> int:
        # a file that is open for writing would prevent remounting the file system read-only
        flags = os.O_CREAT | os.O_RDONLY
        for name in ('O_NOFOLLOW', 'O_NONBLOCK', 'O_CLOEXEC'):  # opening a FIFO must not block
            flags |= getattr(os, name, 0)
        try:
            handle = os.open(self._lock_file, flags, 0o644)
        except OSError as error:
            raise unwritable(self._path, error) from error
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise AllanError(
                f'{self._lock_file}: is not a regular file and cannot be a lock: remove it'
            )
        return handle


def _try_to_lock(handle: int) -> bool:
    """Lock an open file; return False if it is locked through another handle.

    Windows and some file systems have no such locks; on these, the result is always True.
    """
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        pass
    return True
