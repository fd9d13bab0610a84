# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run the commands whose output is quoted in README and docs, and write the new output.

usage: quoted_output.py [--check] [PAGE ...]

A comment with a command precedes the fenced block that quotes the output of the command:

    <!-- $ allan analyze my_bag | head -5 -->

The commands of a page run one after the other in a temporary folder. A command without a block
prepares later commands.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMAND = re.compile(r'<!-- \$ (?P<command>.+?) -->\n(?:```\w*\n(?P<output>.*?)```\n)?', re.DOTALL)


def quoting_pages() -> list[Path]:
    """Return the paths of the pages that quote the output of commands."""
    pages = [ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))]
    return [page for page in pages if COMMAND.search(page.read_text(encoding='utf-8'))]


def with_new_output(text: str) -> str:
    """Return the text of a page with the current output of its commands.

    Raises
    ------
    subprocess.CalledProcessError
        When a command fails.
    """
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as tools:
        # `allan` in the PATH may be missing, or may be another version than this source code.
        allan, python = Path(tools, 'allan'), str(Path(sys.executable).parent)
        allan.write_text(
            f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m allan_ros.cli.main "$@"\n'
        )
        allan.chmod(0o755)
        environment = {
            **os.environ,
            'PATH': os.pathsep.join([tools, python, os.environ.get('PATH', '')]),
            'PYTHONPATH': os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')]),
            'COLUMNS': '100',
            'NO_COLOR': '1',
        }

        def rerun(match: re.Match[str]) -> str:
            done = subprocess.run(
                ['bash', '-euo', 'pipefail', '-c', match['command']],
                cwd=folder,
                env=environment,
                capture_output=True,
                text=True,
                check=True,
            )
            if match['output'] is None:
                return match[0]
            start = match.start('output') - match.start()
            return f'{match[0][:start]}{done.stdout}```\n'

        return COMMAND.sub(rerun, text)


def main() -> int:
    """Rewrite the pages, or check them; return 1 if a checked page is stale."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--check', action='store_true', help='change nothing; exit 1 if stale')
    parser.add_argument('pages', nargs='*', type=Path)
    options = parser.parse_args()
    stale = 0
    for page in options.pages or quoting_pages():
        text = page.read_text(encoding='utf-8')
        new = with_new_output(text)
        if new != text:
            stale = 1
            print(f'{page}: {"stale: run `make docs`" if options.check else "rewritten"}')
            if not options.check:
                page.write_text(new, encoding='utf-8')
    return stale if options.check else 0


if __name__ == '__main__':
    sys.exit(main())
