# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `allan`: the parser of its verbs (subcommands), and its exit codes.

The module of a verb is imported when the verb is called.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import os
import re
import shlex
import signal
import sys
import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, NoReturn

from .. import __version__, keep_to_one_thread
from ..core.errors import AllanError
from .console import COMMON_OPTIONS, EXIT_ERROR, EXIT_FAULT, fault_text
from .options import Command, declare

GARBAGE_THRESHOLD = 200_000
"""Python collects garbage when the number of objects that can refer to others, such as lists, has
grown by this number. An analysis creates about 100,000 such objects. With the default threshold of
Python, garbage would be collected about 150 times."""

HELP_COLUMN = 26
"""Largest column at which the help texts of options begin."""


class Verb(NamedTuple):
    """Where the `Command` of a verb is defined, and the line of the verb in the list of verbs."""

    module: str  # name of the module in this package
    command: str  # name of the `Command` in the module
    help: str


VERBS = {
    'analyze': Verb(
        'analyze', 'ANALYZE', 'compute coefficients, curves, plots and a report from recordings'
    ),
    'check': Verb('analyze', 'CHECK', 'check IMUs: one line for each IMU, and an exit code'),
    'compare': Verb(
        'compare',
        'COMPARE',
        'list significant differences between recordings, or between recordings and datasheets',
    ),
    'sensors': Verb(
        'export',
        'SENSORS_COMMAND',
        'list the known datasheets of IMUs, or show a datasheet with its sources',
    ),
    'export': Verb(
        'export',
        'EXPORT',
        'write the measured noise to a file for a state estimator or simulator',
    ),
    'inflate': Verb(
        'compare',
        'INFLATE',
        'measure how much running motors increase the noise of a robot at rest',
    ),
    'simulate': Verb('simulate', 'SIMULATE', 'write a recording of an IMU with known noise'),
}
"""Name of a verb -> where its `Command` is defined, and its line in the list of verbs."""

DESCRIPTION = """
Measure the noise of an IMU by its Allan variance.

  allan analyze my_bag -o results        analyze a recording and write a report
  allan check my_bag --sensor mpu-6050   print one line and set the exit code
  allan export results --to openvins     write a file for a state estimator
  allan simulate my_bag --preset paper   write a simulated recording
"""
"""Text above the list of verbs in the help."""

EXIT_USAGE, EXIT_INTERRUPTED, EXIT_NO_READER = 2, 130, 141
"""Exit codes for wrong usage, an interrupt (128 + SIGINT), and a closed pipe (128 + SIGPIPE)."""

EXITS = {
    0: 'done',
    EXIT_ERROR: 'an error that you can fix: one line on stderr states the cause and the remedy',
    EXIT_USAGE: 'wrong usage of the command line',
    EXIT_FAULT: 'a bug in allan: please report the line that contains "internal error"',
    EXIT_INTERRUPTED: 'interrupted: incomplete files are removed',
}
"""Exit code -> meaning of the code, for the help."""


EMPTY = re.compile('(--[a-z-]+=)?')
"""Pattern of an argument without content: '' or, for example, '--plan='. An unset variable of the
shell becomes such an argument, which Python would read as the path of the working directory."""


class AllanParser(argparse.ArgumentParser):
    """An argparse parser that prints a usage error in two lines: the usage, and the error."""

    def __init__(self, **given: Any) -> None:
        given.setdefault('formatter_class', HelpFormatter)
        super().__init__(**given)

    def shorten_usage(self) -> None:
        """Shorten the usage text to '[options]' and the positional arguments.

        This method must be called after all arguments have been added.
        """
        forms: dict[Any, str] = {'+': '{0} [{0} ...]', '?': '[{0}]'}
        arguments = (
            forms.get(action.nargs, '{0}').format(action.metavar)
            for action in self._get_positional_actions()
        )
        self.usage = f'%(prog)s [options] {" ".join(arguments)}'

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse the arguments; if an argument is unknown, print the usage of this parser and exit.

        argparse itself would print the usage of the main parser, not the usage of the verb.
        """
        parsed, unknown_arguments = super().parse_known_args(args, namespace)
        if unknown_arguments:
            self.error(f'unrecognized arguments: {" ".join(unknown_arguments)}')
        return parsed or argparse.Namespace(), unknown_arguments

    def error(self, message: str) -> NoReturn:
        """Print the usage and the error, and exit with code 2."""
        self.print_usage(sys.stderr)
        self.exit(EXIT_USAGE, f'{self.prog}: {message}; see `{self.prog} --help`\n')


class HelpFormatter(argparse.HelpFormatter):
    """Help formatter that wraps a paragraph of the description unless it has an indented line."""

    def __init__(self, prog: str, **given: Any) -> None:
        super().__init__(prog, **{**given, 'max_help_position': HELP_COLUMN})

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return '\n\n'.join(
            paragraph if '\n  ' in f'\n{paragraph}' else textwrap.fill(paragraph, width)
            for paragraph in text.strip('\n').split('\n\n')
        )


def build_parser(verb: str = '') -> AllanParser:
    """Return the parser of the command line with the options of one verb.

    The options of other verbs are not declared, because declaring them would import numpy.
    """
    parser = AllanParser(
        prog='allan',
        usage='allan VERB [options] ...',
        description=DESCRIPTION,
        add_help=False,  # --help is added below, so that the verbs come first
        epilog='`allan VERB --help` shows the options of a verb.\n\n'
        + _exits_text(EXITS)
        + '\n\nEnvironment variables: NO_COLOR turns colors off, FORCE_COLOR turns colors on, '
        'COLUMNS sets the width.',
    )
    verbs = parser.add_subparsers(
        title='verbs', prog='allan', dest='verb', metavar='VERB', required=True
    )
    options = parser.add_argument_group('options')
    options.add_argument('-h', '--help', action='help', help='show this help and exit')
    options.add_argument(
        '--version',
        action='version',
        version=f'allan_ros {__version__}',
        help='show the version and exit',
    )
    for name, entry in VERBS.items():
        verb_parser = verbs.add_parser(name, help=entry.help)
        if name == verb:
            command = command_of(name)
            verb_parser.description = command.description
            verb_parser.epilog = _exits_text({**EXITS, **command.exits})
            declare(verb_parser, (*command.options, *COMMON_OPTIONS))
            verb_parser.shorten_usage()
    return parser


def command_of(verb: str) -> Command:
    """Import the module of a verb, and return its command."""
    module = importlib.import_module(f'.{VERBS[verb].module}', __package__)
    command: Command = getattr(module, VERBS[verb].command)
    return command


def _exits_text(exits: dict[int, str]) -> str:
    lines = (f'  {code:<4} {exits[code]}' for code in sorted(exits))
    return '\n'.join(['exit codes:', *lines])


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code; errors during the run are printed to stderr.

    If the program that reads the output closes the pipe, nothing more is printed. ``argv`` are the
    words after the name of the program, by default from ``sys.argv``. Raises SystemExit for an
    unknown or invalid argument, and after ``--help`` or ``--version``.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    name = f'allan {words[0]}' if words and words[0] in VERBS else 'allan'
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except AllanError as error:
        from ..view.finding_text import explained

        return _print_error(f'{name}: {explained(error)}', EXIT_ERROR)
    except KeyboardInterrupt:
        if argv is None and hasattr(signal, 'pthread_sigmask'):
            # If an import was interrupted, Python sends SIGINT to itself at exit, and returns the
            # exit code only if SIGINT is blocked. Windows has no pthread_sigmask.
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        return _print_error(f'\n{name}: interrupted, nothing more is written', EXIT_INTERRUPTED)
    except BrokenPipeError:
        # The program that reads the output, such as head or less, has closed the pipe. Further
        # output is discarded, so that the flush at exit does not fail.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return EXIT_NO_READER
    except OSError as error:
        return _print_error(
            f'{name}: {error}: check the path, its permissions and the disk', EXIT_ERROR
        )
    except ModuleNotFoundError as error:
        if (error.name or '').split('.')[0] == __package__.split('.')[0]:
            return _print_error(f'{name}: {fault_text(error)}', EXIT_FAULT)
        return _print_error(
            f'{name}: needs the Python package {error.name}, which is not installed: install it '
            'with pip or apt',
            EXIT_ERROR,
        )
    except MemoryError:
        return _print_error(
            f'{name}: not enough memory: use fewer --jobs or a larger machine', EXIT_ERROR
        )
    except Exception as error:
        return _print_error(f'{name}: {fault_text(error)}', EXIT_FAULT)


def _run(words: Sequence[str]) -> int:
    """Parse the arguments and run the verb; return the exit code.

    Without arguments, print the help and return `EXIT_USAGE`. Raises AllanError if an argument of
    the verb or the value of an option is an empty text.
    """
    keep_to_one_thread()
    if not words:
        build_parser().print_help(sys.stderr)
        return EXIT_USAGE
    parser = build_parser(words[0])
    try:
        args = parser.parse_args(words)
    except SystemExit:
        sys.stdout.flush()  # if the pipe is closed, the exception is raised here, inside of `main`
        raise
    args.command_line = shlex.join(['allan', *words])
    for previous_word, word in pairwise(words):
        if EMPTY.fullmatch(word):
            name = word.rstrip('=') or f'the argument after {previous_word}'
            raise AllanError(
                f'{name} is empty: give a path or a value; is the shell variable for it set?'
            )
    return command_of(args.verb).run(args)


def _print_error(line: str, code: int) -> int:
    print(line, file=sys.stderr)
    return code


def console() -> None:
    """Run `main` and exit with its exit code; this is the entry point of ``allan``."""
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:  # the parent process has closed the stream
            setattr(sys, name, open(os.devnull, 'w'))  # noqa: SIM115
        # a file name may contain characters that the encoding of the terminal lacks
        getattr(sys, name).reconfigure(errors='backslashreplace')
    # handle SIGTERM like Ctrl-C
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    gc.set_threshold(GARBAGE_THRESHOLD)
    code = main()
    gc.freeze()  # the garbage collection at exit would examine all objects of numpy and scipy
    sys.exit(code)


if __name__ == '__main__':
    console()
