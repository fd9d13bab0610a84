# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parser of the command line: short usage, help with groups, and a guess at what was meant."""

from __future__ import annotations

import argparse
import difflib
import re
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, NoReturn

EXIT_USAGE = 2
"""The words of the command line are wrong; argparse and shells have it so."""

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
"""Similarity (difflib's ratio) above which a word is taken for a slip of another."""


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
        """Refuse here what is not known: the parser of a verb knows better than the one above."""
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
        """Say what is wrong and what may have been meant, and leave with exit code 2."""
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
