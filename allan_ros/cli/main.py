# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""`allan`: the offline tool. Each verb is a module that is imported when it is called."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from .. import __version__, keep_to_one_thread
from ..core.errors import AllanError
from .options import words_with_config
from .parser import (
    EXIT_ERROR,
    EXIT_FAULT,
    EXIT_INTERRUPTED,
    EXIT_NO_READER,
    EXIT_USAGE,
    VERBS,
    build_parser,
    command_of,
    complete,
    verb_parser,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code; the only place where an `AllanError` is caught."""
    words = list(sys.argv[1:] if argv is None else argv)
    name = f'allan {words[0]}' if words and words[0] in VERBS else 'allan'
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except AllanError as error:
        return _stopped(f'{name}: {error}', EXIT_ERROR)
    except KeyboardInterrupt:
        return _stopped(f'\n{name}: interrupted, nothing more is written', EXIT_INTERRUPTED)
    except BrokenPipeError:
        # The reader (head, less) has closed the pipe; writing at exit must not fail either.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return EXIT_NO_READER
    except OSError as error:
        return _stopped(f'{name}: {error}: check the path, its rights and the disk', EXIT_ERROR)
    except MemoryError:
        return _stopped(
            f'{name}: not enough memory: use a larger machine or fewer --jobs', EXIT_ERROR
        )
    except Exception as error:
        return _stopped(f'{name}: {_fault_text(error)}', EXIT_FAULT)


def _run(words: Sequence[str]) -> int:
    """Parse the words and run the verb."""
    keep_to_one_thread()
    if not words:
        build_parser().print_help(sys.stderr)
        return EXIT_USAGE
    parser = build_parser(words[0])
    configured = list(words)
    if words[0] in VERBS:
        configured = words_with_config(configured, verb_parser(parser, words[0]), VERBS)
    try:
        args = parser.parse_args(configured)
    except SystemExit:
        sys.stdout.flush()  # a closed pipe raises here, where it is caught
        raise
    args.command_line = shlex.join(['allan', *configured])
    return command_of(args.verb).run(args)


def _fault_text(error: Exception) -> str:
    """Return one line that names an internal error and its place, for a bug report."""
    ours = Path(__file__).parents[1]
    frames = traceback.extract_tb(error.__traceback__)
    inner = [frame for frame in frames if ours in Path(frame.filename).parents]
    where = [f'{Path(f.filename).relative_to(ours)}:{f.lineno}' for f in inner[-2:]]
    return (
        f'a fault of allan_ros {__version__} itself, not of yours: {type(error).__name__}: {error} '
        f'at {" > ".join(where)}; please report this line and the command'
    )


def _stopped(line: str, code: int) -> int:
    print(line, file=sys.stderr)
    return code


def console() -> None:
    """Exit with the code of `main`: the entry point of ``allan``."""
    for stream in (sys.stdout, sys.stderr):
        # a file name may contain characters outside the encoding of the terminal
        stream.reconfigure(errors='backslashreplace')  # type: ignore[union-attr]
    if '_ARGCOMPLETE' in os.environ:
        complete()
    # asked to end, it cleans up as after Ctrl-C
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())


if __name__ == '__main__':
    console()
