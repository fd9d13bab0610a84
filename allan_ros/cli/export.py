# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write the measured noise as the file of a filter or simulator.

The input is a results.json of `allan analyze` or `allan merge`, or its folder. Without -o or
--merge-into the file goes to the standard output. Warnings about its numbers are in its header and
on stderr.

  allan export --list
  allan export results --to openvins -o kalibr_imu_chain.yaml
  allan export results/results.json --to kalibr --merge-into my_imu.yaml
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

from ..core.errors import AllanError
from ..io.exporters import TARGETS, ExportOptions
from ..io.files import MAX_BYTES, read_bounded
from .console import Console
from .options import Command, add_settings, settings_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this verb."""
    parser.add_argument(
        'results', nargs='?', metavar='RESULTS', help='a results.json, or the folder it is in'
    )
    parser.add_argument(
        '--to', metavar='TARGET', default='', help='filter or tool the file is for; see --list'
    )
    parser.add_argument('--list', action='store_true', help='list the targets, one per line')
    parser.add_argument(
        '-o', '--output', metavar='FILE', help='file to write (default: standard output)'
    )
    parser.add_argument(
        '--merge-into',
        metavar='EXISTING',
        help='your own YAML or JSON file, whose other keys and comments are kept; changed in '
        'place unless -o is given',
    )
    add_settings(parser, 'numbers', ExportOptions)


def run(args: argparse.Namespace) -> int:
    """Read the results, and write or print the file."""
    console = Console.of(args)
    if args.list and console.json:
        console.document({'targets': TARGETS})
        return 0
    if args.list:
        width = max(map(len, TARGETS))
        for name, what in TARGETS.items():
            print(f'{name:{width}}  {what}')
        return 0
    if not args.results or not args.to:
        raise AllanError(
            'give a results.json or its folder, and --to TARGET; --list shows the targets'
        )
    from ..io.documents import RESULTS, file_in, load
    from ..io.exporters import make_export, target_of
    from ..io.files import write_atomic

    target = target_of(args.to)
    options = settings_of(ExportOptions, args)
    results = load(file_in(args.results, RESULTS))
    existing = _text(args.merge_into) if args.merge_into else None
    made = make_export(results, args.to, options, existing)
    where = args.output or args.merge_into
    path = Path(where) if where else None
    if path is not None:
        path = path / target.file_name if path.is_dir() else path
        write_atomic(path, made.text)
    if console.json:
        findings = [asdict(said) for said in made.findings]
        to = {'path': str(path)} if path else {'text': made.text}
        console.document({'target': args.to, **to, 'findings': findings})
    elif path is None:
        sys.stdout.write(made.text)
    for said in made.findings:
        console.say(str(said))
    return 0


def _text(path: str) -> str:
    """Return the text of a user's file, line ends unchanged.

    Raises
    ------
    AllanError
        When it cannot be read, or is not text.
    """
    try:
        return read_bounded(path, MAX_BYTES).decode('utf-8')
    except OSError as error:
        raise AllanError(f'{path}: cannot be read ({error.strerror}): check the path') from error
    except UnicodeDecodeError:
        raise AllanError(f'{path}: is not UTF-8 text: give the YAML or JSON file itself') from None


COMMANDS = {'export': Command(__doc__ or '', add_arguments, run)}
