# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long runs: growth of memory and time, losses, and stability of the results.

    python bench/bench_soak.py month       a month at 200 Hz as fast as it goes, 10 to 25 min
    python bench/bench_soak.py live        30 min at 1 kHz through DDS into allan_monitor
    python bench/bench_soak.py live 600    the same for 600 s

Both write their table into bench/results.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from soak_live import LENGTH_S, live
from soak_month import month


def main() -> None:
    """Run the requested test, by default both."""
    wanted = sys.argv[1] if len(sys.argv) > 1 else 'both'
    if wanted in ('month', 'both'):
        month()
    if wanted in ('live', 'both'):
        live(float(sys.argv[2]) if len(sys.argv) > 2 else LENGTH_S)


if __name__ == '__main__':
    main()
