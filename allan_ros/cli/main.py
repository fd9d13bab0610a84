# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`allan`: the offline tool. One module a verb, imported only when its verb is called."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from .. import __version__
from ..core.errors import AllanError
from ..one_thread import keep_to_one_thread

VERBS = {
    'analyze': 'recordings in, coefficients, curves, plots and a report out',
    'merge': 'add the sums of several runs of one IMU and fit them together',
    'export': 'write what was measured as the file a filter reads',
    'simulate': 'write a recording of an IMU whose noise is known',
}
"""Verb -> what it does. Each is the module of that name beside this file, which has
``add_arguments(parser)`` and ``run(args) -> int``."""

EXIT_ERROR = 1
"""Something the user can mend: one line on stderr says what."""

EXIT_INTERRUPTED = 130
"""128 + SIGINT, as shells have it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code; the only place where an `AllanError` is caught."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] not in VERBS:
        top = _top_parser()
        top.parse_args(words)
        top.print_usage(sys.stderr)
        return 2
    keep_to_one_thread()
    verb = importlib.import_module(f'.{words[0]}', __package__)
    parser = argparse.ArgumentParser(
        prog=f'allan {words[0]}',
        description=verb.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verb.add_arguments(parser)
    args = parser.parse_args(words[1:])
    try:
        code: int = verb.run(args)
        sys.stdout.flush()
        return code
    except AllanError as error:
        print(f'allan {words[0]}: {error}', file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print(f'\nallan {words[0]}: interrupted, nothing more is written', file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader (head, less) has left. Nothing may be written at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_ERROR


def _top_parser() -> argparse.ArgumentParser:
    verbs = '\n'.join(f'  {name:10} {what}' for name, what in VERBS.items())
    parser = argparse.ArgumentParser(
        prog='allan',
        description='Measure the noise of an IMU by its Allan variance.',
        epilog=f'verbs:\n{verbs}\n\n`allan VERB --help` tells more of each.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action='version', version=f'allan_ros {__version__}')
    parser.add_argument('verb', choices=VERBS, metavar='VERB', help='what to do: see below')
    return parser


def console() -> None:
    """Leave the process with the exit code of `main`: the entry point of ``allan``."""
    sys.exit(main())


if __name__ == '__main__':
    console()
