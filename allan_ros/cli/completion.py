# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shell completion with argcomplete, imported only for a completion request."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ..core.errors import AllanError

RECORDINGS = ('.mcap', '.db3', '.bag', '.csv', '.tsv', '.npz', '.npy')
"""Suffixes of the files that `analyze` reads."""

DOCUMENTS = ('.json',)
"""Suffix of what `merge` and `export` read."""

INPUTS = {'allan merge': DOCUMENTS, 'allan compare': (*DOCUMENTS, *RECORDINGS)}
"""Verb -> suffixes of its inputs, where they are not recordings."""


def registration(shell: str) -> str:
    """Return the code that a shell evaluates to complete ``allan``.

    Raises
    ------
    AllanError
        When argcomplete is not installed.
    """
    try:
        from argcomplete import shellcode
    except ImportError as error:
        raise AllanError(
            '--completion needs argcomplete: pip install argcomplete, or apt install '
            'python3-argcomplete'
        ) from error
    code: str = shellcode(['allan'], shell='fish' if shell == 'fish' else 'bash')
    if shell == 'zsh' and 'compdef' not in code:  # argcomplete before 3.0 supports bash only
        code = f'autoload -U bashcompinit\nbashcompinit\n{code}'
    return code


def complete() -> None:
    """Answer a completion request and exit; return if argcomplete is not installed."""
    try:
        import argcomplete
    except ImportError:
        return
    from .parser import VERBS, build_parser

    words = os.environ.get('COMP_LINE', '').split()
    parser = build_parser(next((word for word in words if word in VERBS), ''))
    _attach(parser)
    argcomplete.autocomplete(parser)


def _attach(parser: argparse.ArgumentParser) -> None:
    """Attach a completer to every argument without choices."""
    from argcomplete.completers import FilesCompleter

    completers: dict[str, Any] = {
        'inputs': FilesCompleter(INPUTS.get(parser.prog, RECORDINGS)),
        'results': FilesCompleter(DOCUMENTS),
        'baseline': FilesCompleter(DOCUMENTS),
        'sensor': _quiet(_sensors),
        'name': _quiet(_sensors),
        'to': _quiet(_targets),
        'export': _quiet(_target_lists),
        'topic': _quiet(_topics),
    }
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _attach(sub)
        elif action.dest in completers and not action.choices:
            action.completer = completers[action.dest]  # type: ignore[attr-defined]


def _quiet(words: Callable[..., Iterable[str]]) -> Callable[..., list[str]]:
    """Return a completer that offers nothing when the words cannot be determined."""

    def completer(**asked: Any) -> list[str]:
        try:
            return list(words(**asked))
        except (AllanError, OSError):
            return []

    return completer


def _sensors(**_: Any) -> Iterable[str]:
    from ..io.datasheets import sensor_names

    return sensor_names()


def _targets(**_: Any) -> Iterable[str]:
    from ..io.exporters import TARGETS

    return TARGETS


def _target_lists(prefix: str, **_: Any) -> Iterable[str]:
    """Return the targets that are not yet in ``kalibr,openvins,...``."""
    given, comma, _last = prefix.rpartition(',')
    return (f'{given}{comma}{t}' for t in _targets() if t not in given.split(','))


def _topics(parsed_args: argparse.Namespace, **_: Any) -> Iterable[str]:
    """Return the Imu topics of the bags that are named already, or all topics of them."""
    from ..io.readers.folder import bag_files, open_storage
    from ..io.readers.message_fields import IMU_TYPE

    topics = []
    for path in getattr(parsed_args, 'inputs', None) or ():
        with open_storage(bag_files(Path(path)).files[0]) as (storage, _compression):
            topics += storage.topics
    imus = {topic.name for topic in topics if topic.type == IMU_TYPE}
    return sorted(imus or {topic.name for topic in topics})
