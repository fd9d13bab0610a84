# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""`allan`: the offline tool. One module a verb, imported only when its verb is called."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from .. import __version__
from ..core.errors import AllanError
from ..one_thread import keep_to_one_thread
from .console import add_console_options
from .parser import EXIT_USAGE, AllanParser

VERBS = {
    'analyze': 'recordings in, coefficients, curves, plots and a report out',
    'merge': 'add the sums of several runs of one IMU and fit them together',
    'compare': 'runs side by side, or beside a datasheet: which differences are more than chance',
    'sensors': 'datasheets of IMUs: list them, or show one with its sources',
    'export': 'write what was measured as the file a filter reads',
    'inflate': 'what running motors add to the noise of a robot at rest',
    'simulate': 'write a recording of an IMU whose noise is known',
}
"""Verb -> what it does. Each is the module of that name beside this file, which has
``add_arguments(parser)`` and ``run(args) -> int``; one with exit codes of its own has ``EXITS``."""

DESCRIPTION = """
Measure the noise of an IMU by its Allan variance.

  allan analyze my_bag -o results        a recording in, a report out
  allan export results --to openvins     its numbers as the file of a filter
  allan simulate my_bag --preset paper   no recording at hand? this writes one
"""
"""What stands above the list of verbs."""

SHELLS = ('bash', 'zsh', 'fish')
"""Shells whose completion can be set up."""

EXIT_ERROR, EXIT_FAULT, EXIT_INTERRUPTED, EXIT_NO_READER = 1, 70, 130, 141
"""70 is EX_SOFTWARE of sysexits.h; the last two are 128 + SIGINT and 128 + SIGPIPE, as shells
have it."""

EXITS = {
    0: 'done',
    EXIT_ERROR: 'something you can mend: one line on stderr says what and how',
    EXIT_USAGE: 'wrong words on the command line',
    EXIT_FAULT: 'a fault of allan itself: please report the line',
    EXIT_INTERRUPTED: 'interrupted: what was begun is taken back',
}
"""Exit code -> what it means."""


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
        # The reader (head, less) has left. Nothing may be written at exit either.
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


def build_parser(verb: str = '') -> AllanParser:
    """Return the parser of the whole command line, with the options of one verb only.

    The options of a verb need its settings, and these numpy: the others stay empty.
    """
    parser = AllanParser(
        prog='allan',
        usage='allan VERB [options] ...',
        description=DESCRIPTION,
        add_help=False,  # the verbs come first
        epilog='`allan VERB --help` tells more of each.\n\n'
        + _exits_text(EXITS)
        + '\n\nNO_COLOR turns colours off, FORCE_COLOR on; COLUMNS sets the width.',
    )
    verbs = parser.add_subparsers(
        title='verbs', prog='allan', dest='verb', metavar='VERB', required=True
    )
    options = parser.add_argument_group('options')
    options.add_argument('-h', '--help', action='help', help='show this and exit')
    options.add_argument(
        '--version', action='version', version=f'allan_ros {__version__}', help='show it and exit'
    )
    options.add_argument(
        '--completion',
        action=_Completion,
        choices=SHELLS,
        help='print what makes this shell complete verbs, options and names: '
        'eval "$(allan --completion bash)" in ~/.bashrc, or for fish '
        'allan --completion fish | source',
    )
    for name, what in VERBS.items():
        sub = verbs.add_parser(name, help=what)
        if name == verb:
            module = importlib.import_module(f'.{name}', __package__)
            sub.description = module.__doc__
            sub.epilog = _exits_text({**EXITS, **getattr(module, 'EXITS', {})})
            module.add_arguments(sub)
            add_console_options(sub)
            sub.shorten_usage()
    return parser


def _run(words: Sequence[str]) -> int:
    """Parse the words and run the verb."""
    keep_to_one_thread()
    if not words:
        build_parser().print_help(sys.stderr)
        return EXIT_USAGE
    try:
        args = build_parser(words[0]).parse_args(words)
    except SystemExit:
        sys.stdout.flush()  # a reader of --help may have left: told where that is caught
        raise
    args.command_line = shlex.join(['allan', *words])
    code: int = importlib.import_module(f'.{args.verb}', __package__).run(args)
    return code


class _Completion(argparse.Action):
    """Prints the code that sets completion up, and leaves, as --version does."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        _namespace: argparse.Namespace,
        values: object,
        _option: str | None = None,
    ) -> None:
        from .completion import registration

        print(registration(str(values)))
        parser.exit()


def _exits_text(exits: dict[int, str]) -> str:
    return '\n'.join(['exit codes:', *(f'  {code:<4} {what}' for code, what in exits.items())])


def _fault_text(error: Exception) -> str:
    """Return one line that names a fault of ours and the place, for whoever will mend it."""
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
    """Leave the process with the exit code of `main`: the entry point of ``allan``."""
    for stream in (sys.stdout, sys.stderr):
        # a file name may hold what the terminal's encoding does not
        stream.reconfigure(errors='backslashreplace')  # type: ignore[union-attr]
    if '_ARGCOMPLETE' in os.environ:
        from .completion import complete

        complete()
    # asked to end, it cleans up as after Ctrl-C
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())


if __name__ == '__main__':
    console()
