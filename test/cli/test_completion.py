# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shell completion, run in bash with the code of argcomplete."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from allan_ros.cli import main as cli
from allan_ros.cli.main import VERBS, main
from allan_ros.io.datasheets import sensor_names
from allan_ros.io.exporters import TARGETS

pytest.importorskip('argcomplete')

ASK = """
eval "$(register-python-argcomplete allan)"
ask() {
    COMP_LINE=$1 COMP_POINT=${#1} COMP_TYPE=9 COMPREPLY=()
    _python_argcomplete allan
    printf '%s|' "${COMPREPLY[@]}"
    echo
}
while IFS= read -r line; do ask "$line"; done
"""


def asked(lines: list[str], folder: Path) -> list[list[str]]:
    """Return the completions that bash offers at the end of each line."""
    script = folder / 'allan'
    script.write_text(f'#!{sys.executable}\nfrom allan_ros.cli.main import console\nconsole()\n')
    script.chmod(0o755)
    root = Path(__file__).parents[2]
    environment = {
        **os.environ,
        'PATH': os.pathsep.join(
            [str(folder), str(Path(sys.executable).parent), os.environ['PATH']]
        ),
        'PYTHONPATH': f'{root}{os.pathsep}{os.environ.get("PYTHONPATH", "")}',
    }
    done = subprocess.run(
        ['bash', '-c', ASK],
        input='\n'.join(lines) + '\n',
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.stderr == ''
    return [[w.strip() for w in line.split('|') if w] for line in done.stdout.splitlines()]


@pytest.mark.skipif(shutil.which('bash') is None, reason='no bash')
def test_bash_completes_verbs_options_choices_and_names(tmp_path: Path, recording: Path) -> None:
    verbs, options, methods, sensors, targets, lists = asked(
        [
            'allan ',
            'allan analyze --meth',
            'allan analyze --method ',
            'allan simulate --sensor adis',
            'allan export --to vins',
            'allan analyze --export kalibr,open',
        ],
        tmp_path,
    )
    assert set(VERBS) <= set(verbs) and '--version' in verbs
    assert options == ['--method']
    assert methods == ['likelihood', 'relative', 'paper']
    assert sensors == [name for name in sensor_names() if name.startswith('adis')] != []
    assert targets == [name for name in TARGETS if name.startswith('vins')] != []
    assert lists == ['kalibr,openvins']


def test_topics_are_those_of_the_bag(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    how = ['--preset', 'paper', '--hours', '0.001', '--topic', '/my/imu', '-q']
    assert main(['simulate', str(bag), *how]) == 0
    given = type('Parsed', (), {'inputs': [str(bag)]})()
    assert list(cli._topics(given)) == ['/my/imu']
