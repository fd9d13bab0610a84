# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rule that is checked for every target, and the process in which it runs.

The rule: every input gives a valid result or an `AllanError` of one printable line, within
`INPUT_SECONDS` of CPU time and `MEMORY_BYTES`, and only the target's own folder is written to.
"""

from __future__ import annotations

import faulthandler
import importlib
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.strategies import SearchStrategy

from allan_ros.core.errors import AllanError

INPUT_SECONDS = 10.0
"""CPU time in s that one input may take."""

HANG_SECONDS = 120.0
"""Time in s after which an input hangs: the process prints all stacks and ends."""

MEMORY_BYTES = 1 << 30
"""Address space that a target may use in addition to that after its first inputs."""

ROUND = 100
"""Inputs drawn from one seed; the clock is checked after each round."""

LONGEST_LINE = 4000
"""Largest length of an error message, in characters."""

CURRENT = 'ALLAN_FUZZ_CURRENT'
"""Environment variable: file with the current input, in case the process dies."""

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_FORBIDDEN = ['os.system', 'os.exec', 'os.posix_spawn', 'os.link', 'os.chmod', 'subprocess.Popen']
_FORBIDDEN += ['socket.connect', 'socket.bind', 'pickle.find_class']
_CHANGES = ['os.symlink', 'os.rename', 'os.remove', 'os.mkdir', 'os.rmdir', 'os.truncate']
_CHANGES += ['shutil.rmtree']


@dataclass(frozen=True)
class Target:
    """One entry point of the program.

    Attributes
    ----------
    name : str
    inputs : strategy
        Draws the inputs.
    check : callable
        Takes an input and an empty working folder, returns whether the input was accepted (else it
        was rejected in one line), and raises if the rule is broken.
    """

    name: str
    inputs: SearchStrategy[Any]
    check: Callable[[Any, Path], bool]


@dataclass
class Tally:
    """The result of one target."""

    name: str
    inputs: int = 0
    valid: int = 0
    slowest_s: float = 0.0
    memory_bytes: int = 0
    crashes: dict[str, str] = field(default_factory=dict)


class BrokenRule(AssertionError):
    """An input that should have been rejected was accepted, or the error message is invalid."""


@dataclass
class Outcome:
    """The result of one input: valid, unless it is rejected."""

    valid: bool = True


@contextmanager
def refused_or_valid() -> Iterator[Outcome]:
    """Catch an `AllanError` with a valid message; anything else is a crash."""
    outcome = Outcome()
    try:
        yield outcome
    except AllanError as error:
        check_line(str(error))
        outcome.valid = False


def check_line(text: str) -> None:
    """Raise unless the text is one printable line of limited length."""
    if not text or not text.isprintable() or len(text) > LONGEST_LINE:
        raise BrokenRule(f'not a printable line: {text[:200]!r}')


class Watch:
    """Detects, by audit events (PEP 578), forbidden system calls and writes outside a folder.

    Events are checked while ``folder`` is not None; violations are appended to ``seen``.
    """

    def __init__(self) -> None:
        self.folder: str | None = None
        self.seen: list[str] = []
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.folder is None:
            return
        if event in _FORBIDDEN:
            self._refuse(f'{event} {arguments!r:.200}')
        if event == 'open' and arguments[0] is not None and not isinstance(arguments[0], int):
            path, mode, flags = arguments
            writes = set(mode) & set('wax+') if isinstance(mode, str) else (flags or 0) & _WRITES
            if writes and not self._is_ours(path):
                self._refuse(f'open {path!r} to write')
        # names may be relative to a folder that was opened before
        in_folder = any(isinstance(a, int) and a >= 0 for a in arguments[-1:])
        paths = arguments[1:2] if event == 'os.symlink' else arguments[: 1 + ('rename' in event)]
        if event in _CHANGES and not in_folder and not all(map(self._is_ours, paths)):
            self._refuse(f'{event} {arguments!r:.200}')

    def _is_ours(self, path: object) -> bool:
        if not isinstance(path, (str, bytes, os.PathLike)):
            return True  # a descriptor that was opened before
        assert self.folder is not None
        place = os.path.realpath(os.fsdecode(path))
        return place == os.devnull or place.startswith(self.folder)

    def _refuse(self, what: str) -> None:
        self.seen.append(what)
        raise BrokenRule(what)


def run_target(
    target: Target, seconds: float, first_seed: int, watch: Watch | None, shrink: bool = False
) -> Tally:
    """Run a target until the time is over; crashes are distinguished by their location."""
    tally = Tally(target.name)
    scratch = Path(os.path.realpath(tempfile.mkdtemp(prefix='allan_fuzz.')))
    tempfile.tempdir = str(scratch)
    os.environ['HYPOTHESIS_STORAGE_DIRECTORY'] = str(scratch / 'hypothesis')
    warnings.filterwarnings('error', category=RuntimeWarning, module='allan_ros')
    signal.signal(signal.SIGPROF, _too_slow)
    ends = time.monotonic() + seconds
    current = Path(os.environ.get(CURRENT, scratch / 'current'))

    def one(value: Any) -> None:
        text = f'seed {first_seed}, input {value!r}'
        current.write_text(text, 'utf-8', errors='surrogatepass')
        # from a separate thread, which also ends code that waits, or blocks or swallows signals
        faulthandler.dump_traceback_later(HANG_SECONDS, exit=True)
        with tempfile.TemporaryDirectory(dir=scratch) as folder:
            began = time.process_time()
            # repeated, in case the exception is raised where it is caught
            signal.setitimer(signal.ITIMER_PROF, INPUT_SECONDS, 1.0)
            try:
                if watch is not None:
                    watch.folder, watch.seen[:] = str(scratch), []
                valid = target.check(value, Path(folder))
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
                faulthandler.cancel_dump_traceback_later()
                if watch is not None:
                    watch.folder = None
            if watch is not None and watch.seen:
                raise BrokenRule(watch.seen[0])
            tally.inputs += 1
            tally.valid += valid
            took_s = time.process_time() - began
            tally.slowest_s = max(tally.slowest_s, took_s)
            if took_s > INPUT_SECONDS:
                raise BrokenRule('takes too long')  # the exception of the alarm was caught

    warm: int | None = None
    while warm is None or time.monotonic() < ends:
        _round(target, one, first_seed, 5 if warm is None else ROUND, tally, shrink)
        first_seed += 1
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        if warm is None:
            warm = peak
            limit = _address_space() + MEMORY_BYTES
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        tally.memory_bytes = peak - warm
    return tally


def _round(
    target: Target,
    one: Callable[[Any], None],
    number: int,
    inputs: int,
    tally: Tally,
    shrink: bool,
) -> None:
    """Draw some inputs from one seed, and record crashes."""
    drawn: list[Any] = []

    @seed(number)
    @settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        phases=(Phase.generate, Phase.shrink) if shrink else (Phase.generate,),
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
    )
    @given(target.inputs)
    def test(value: Any) -> None:
        drawn[:] = [value]
        one(value)

    try:
        test()
    except Exception as failure:
        error: BaseException = failure
        while nested := getattr(error, 'exceptions', ()):  # of a failure that is not reproducible
            error = nested[0]
        where = f'{_place(error)}: {type(error).__name__}: {error!s:.200}'
        key = where.partition(':')[0] + type(error).__name__
        tally.crashes.setdefault(key, f'{where}\n  seed {number}, input {drawn!r:.2000}')


def _place(error: BaseException) -> str:
    """Return the last line of the package in the traceback."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if '/allan_ros/' in f.filename.replace('\\', '/')] or list(frames)
    return f'{Path(ours[-1].filename).name} line {ours[-1].lineno}'


def _too_slow(*_: object) -> None:
    raise BrokenRule('takes too long')


def _address_space() -> int:
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    return pages * resource.getpagesize()


NAMES = ('mcap', 'folder', 'tables', 'losses', 'hostile', 'imu')


def _load(name: str) -> Target:
    target: Target = importlib.import_module(f'.{name}_target', __package__).TARGET
    return target


TARGETS: dict[str, Callable[[], Target]] = {name: partial(_load, name) for name in NAMES}
"""Name of a target -> function that imports and returns it."""
