# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parser of the command line: short usage, help with groups, and suggestions for misspelled
words."""

from __future__ import annotations

import argparse
import difflib
import importlib
import re
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, NoReturn

from .. import __version__
from .console import add_console_options

EXIT_USAGE = 2
"""Exit code for a wrong command line, as in argparse and shells."""

HELP_COLUMN = 26
"""Where the explanations of options begin."""

NUMBERS: dict[str | int | None, str] = {
    '+': '{0} [{0} ...]',
    '*': '[{0} ...]',
    '?': '[{0}]',
    None: '{0}',
}
"""``nargs`` of a positional argument -> how the usage shows it."""

CLOSE = 0.6
"""Similarity (difflib's ratio) above which a word counts as a misspelling of another."""

VERBS = {
    'analyze': 'recordings in, coefficients, curves, plots and a report out',
    'check': 'check one IMU: one line of output and an exit code',
    'merge': 'add the sums of several runs of one IMU and fit them together',
    'compare': 'compare runs, or runs with a datasheet: which differences are significant',
    'sensors': 'datasheets of IMUs: list them, or show one with its sources',
    'export': 'write the measured noise as the file of a filter or simulator',
    'fit': 'fit an Allan curve of another tool, and check values published with it',
    'inflate': 'what running motors add to the noise of a robot at rest',
    'simulate': 'write a recording of an IMU whose noise is known',
}
"""Verb -> what it does. Each is the module of that name in this package, with
``add_arguments(parser)`` and ``run(args) -> int``; ``EXITS`` lists exit codes of its own."""

DESCRIPTION = """
Measure the noise of an IMU by its Allan variance.

  allan analyze my_bag -o results        a recording in, a report out
  allan check my_bag --sensor mpu-6050   one line and an exit code
  allan export results --to openvins     its numbers as the file of a filter
  allan simulate my_bag --preset paper   no recording at hand? this writes one
"""
"""Description above the list of verbs."""

SHELLS = ('bash', 'zsh', 'fish')
"""Shells whose completion can be set up."""

EXIT_ERROR, EXIT_FAULT, EXIT_INTERRUPTED, EXIT_NO_READER = 1, 70, 130, 141
"""70 is EX_SOFTWARE of sysexits.h; the last two are 128 + SIGINT and 128 + SIGPIPE, as in
shells."""

EXITS = {
    0: 'done',
    EXIT_ERROR: 'an error you can fix: stderr has one line with the cause and the remedy',
    EXIT_USAGE: 'wrong usage of the command line',
    EXIT_FAULT: 'a bug in allan: please report the line',
    EXIT_INTERRUPTED: 'interrupted: incomplete files are removed',
}
"""Exit code -> what it means."""


class AllanParser(argparse.ArgumentParser):
    """An argparse parser whose errors are two lines: the usage, and what is wrong with a hint."""

    def __init__(self, **given: Any) -> None:
        given.setdefault('formatter_class', HelpFormatter)
        super().__init__(**given)

    def shorten_usage(self) -> None:
        """Leave the options out of the usage; the help lists them. Call it when all are added."""
        arguments = [
            NUMBERS.get(action.nargs, '{0}').format(action.metavar or action.dest)
            for action in self._get_positional_actions()
        ]
        self.usage = ' '.join(['%(prog)s', '[options]', *map(str, arguments)])

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Report unknown arguments here, with the usage of the verb instead of the main usage."""
        words: list[str] = []
        for word in sys.argv[1:] if args is None else args:
            if words and word.startswith('-,'):  # --columns -,t,gx: a value, not an option
                words[-1] += f'={word}'
            else:
                words.append(word)
        known, unknown = super().parse_known_args(words, namespace)
        if unknown:
            self.error(f'unrecognized arguments: {" ".join(unknown)}')
        return known or argparse.Namespace(), unknown

    def error(self, message: str) -> NoReturn:
        """Print the error with a suggestion, and exit with code 2."""
        self.print_usage(sys.stderr)
        meant = self._meant(message)
        hint = f'; did you mean {meant}?' if meant else f'; see `{self.prog} --help`'
        self.exit(EXIT_USAGE, f'{self.prog}: {message}{hint}\n')

    def _meant(self, message: str) -> str:
        """Return the option or choice most like a wrong one in the message; '' for none."""
        wrong = re.search(r"invalid choice: '([^']*)'|unrecognized arguments: ([^\s=]*)", message)
        if wrong is None:
            return ''
        choices = [str(c) for action in self._actions for c in action.choices or ()]
        known = [*self._option_string_actions, *choices]
        close = difflib.get_close_matches(wrong[1] or wrong[2], known, 1, CLOSE)
        return close[0] if close else ''


class HelpFormatter(argparse.HelpFormatter):
    """Fills the paragraphs of descriptions, keeps their indented lines as they are."""

    def __init__(self, prog: str, **given: Any) -> None:
        super().__init__(prog, **{**given, 'max_help_position': HELP_COLUMN})

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return '\n\n'.join(
            paragraph if '\n  ' in f'\n{paragraph}' else textwrap.fill(paragraph, width)
            for paragraph in text.strip('\n').split('\n\n')
        )


def build_parser(verb: str = '') -> AllanParser:
    """Return the parser of the whole command line, with the options of one verb only.

    Other verbs get no options, because their settings would import numpy.
    """
    parser = AllanParser(
        prog='allan',
        usage='allan VERB [options] ...',
        description=DESCRIPTION,
        add_help=False,  # the verbs come first
        epilog='`allan VERB --help` shows the options of a verb.\n\n'
        + _exits_text(EXITS)
        + '\n\nNO_COLOR turns colours off, FORCE_COLOR on; COLUMNS sets the width. allan.toml, or '
        '[tool.allan] of pyproject.toml, in the current folder sets defaults of options.',
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
    options.add_argument(
        '--completion',
        action=_Completion,
        choices=SHELLS,
        help='print a script that completes verbs, options and names in this shell: '
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


def verb_parser(parser: AllanParser, verb: str) -> argparse.ArgumentParser:
    """Return the parser of one verb within that of the whole command line."""
    (verbs,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    found: argparse.ArgumentParser = verbs.choices[verb]
    return found


class _Completion(argparse.Action):
    """Prints the completion script and exits, as --version does."""

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
