# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inject faults into running nodes over real DDS; measure losses, messages and recovery.

    python bench/bench_faults.py                     all, about 25 min
    python bench/bench_faults.py nan_burst unplugged these

The rows are written into bench/results.md. Each fault runs in its own process.
Faults of the network and of a full disk need root (network namespaces, tmpfs); without root they
are skipped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import faults_machine  # noqa: F401
import faults_network
import faults_nodes  # noqa: F401
import faults_stream  # noqa: F401
from doc_table import DocTable
from fault_harness import FAULTS, HEADING, Row
from online_nodes import Client

RESULT = 'ALLAN_ROS_FAULT_ROW '
"""Prefix of the line in which the process of a fault prints its row."""


def run_here(name: str) -> None:
    """Run one fault in this process."""
    with tempfile.TemporaryDirectory() as folder:
        row = FAULTS[name][0](Client(), Path(folder))
    print(RESULT + json.dumps(asdict(row)), flush=True)
    os._exit(0)  # end without destroying contexts and threads of a publisher


def run(name: str) -> Row | None:
    """Run one fault in its own process; return None if it does not finish."""
    command, env = [sys.executable, __file__, '--here', name], dict(os.environ)
    if FAULTS[name][1] == 'network':
        command, env = [*faults_network.INSIDE, *command], env | faults_network.TRANSPORT
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, env=env)
    found = [x for x in ended.stdout.splitlines() if x.startswith(RESULT)]
    return Row(**json.loads(found[0].removeprefix(RESULT))) if found else None


def main() -> int:
    """Run the named faults, by default all; return 1 if one failed."""
    if sys.argv[1:2] == ['--here']:
        run_here(sys.argv[2])
    names = sys.argv[1:] or [n for n in FAULTS if os.geteuid() == 0 or not FAULTS[n][1]]
    table, wrong = DocTable('faults', HEADING), []
    with faults_network.namespaces(any(FAULTS[n][1] == 'network' for n in names)):
        for name in names:
            print(f'== {name}', file=sys.stderr, flush=True)
            row = run(name)
            if row is None:
                wrong.append(name)
                continue
            print(' | '.join(row.cells), flush=True)
            table.put(row.cells)
            silent = row.message == 'nothing' and not row.lost.startswith('0 of')
            if row.exits.strip('0, ') or silent or row.recovered == 'never':
                wrong.append(name)
    print(f'{len(names)} faults, {len(wrong)} with something wrong: {", ".join(wrong) or "-"}')
    return bool(wrong)


if __name__ == '__main__':
    sys.exit(main())
