# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`ros2 allan`: a command of ros2cli with the verbs of `allan`, and verbs for running nodes.

ros2cli loads this module through an entry point of the package; no other module imports it.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    Base: Any = object
else:
    try:
        from ros2cli.command import CommandExtension as Base
    except ImportError:
        Base = object

NODE_VERBS = {
    'watch': 'show /diagnostics of running nodes as a live table',
    'check': 'without a file: state of the nodes; exit code 0 ok, 3 warning, 4 error, 1 no node',
}
"""Verb that shows running nodes -> help text."""

WITH_VALUE = ('--node', '--seconds', '--web')
"""Options of the verbs in `NODE_VERBS` that can be followed by a value."""


class AllanCommand(Base):  # type: ignore[misc]
    """Measure and watch the noise of IMUs."""

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str) -> None:
        """Declare the verb and the remaining arguments, and list all verbs in the help."""
        from .cli.main import VERBS

        width = max(map(len, (*VERBS, *NODE_VERBS)))
        lines = ['recordings and results:']
        lines += [f'  {name:{width}}  {verb.help}' for name, verb in VERBS.items()]
        lines += ['', 'running nodes:']
        lines += [f'  {name:{width}}  {text}' for name, text in NODE_VERBS.items()]
        lines += ['', 'Options of a verb: ros2 allan VERB --help']
        parser.epilog = '\n'.join(lines)
        parser.formatter_class = argparse.RawDescriptionHelpFormatter
        parser.add_argument('verb', choices=[*VERBS, *NODE_VERBS], metavar='VERB')
        parser.add_argument('arguments', nargs=argparse.REMAINDER, metavar='...')

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
        """Run the verb; return its exit code, or exit with this code if `allan` runs the verb."""
        verb, words = args.verb, list(args.arguments)
        if verb in NODE_VERBS and not _is_for_files(verb, words):
            from .nodes.__main__ import ros_is_missing

            if ros_is_missing(f'ros2 allan {verb}'):
                return 1
            from .nodes import watch

            return watch.main(['--check', *words] if verb == 'check' else words)
        from .cli.main import console

        sys.argv = ['allan', verb, *words]
        console()  # exits with the exit code of the verb
        return 0


def _is_for_files(verb: str, words: list[str]) -> bool:
    """Return whether ``verb`` is a verb of `allan`, and ``words`` name a file or ask for help."""
    from .cli.main import VERBS

    file_names = [
        w for previous, w in zip(['', *words], words) if w[:1] != '-' and previous not in WITH_VALUE
    ]
    return verb in VERBS and bool(file_names or {'-h', '--help'} & {*words})
