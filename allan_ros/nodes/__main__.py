# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run a node without an installation: ``python -m allan_ros.nodes monitor --ros-args ...``."""

from __future__ import annotations

import sys

EXECUTABLES = ('accumulator', 'estimator', 'monitor', 'relay', 'player', 'watch')


def main() -> int:
    """Run the node that the first argument names."""
    name = sys.argv[1] if len(sys.argv) > 1 else ''
    if name not in EXECUTABLES:
        print(f'usage: python -m allan_ros.nodes {{{",".join(EXECUTABLES)}}} ...', file=sys.stderr)
        return 2
    args = sys.argv[2:]
    if name == 'player':
        from . import player

        return player.main(args)
    if name == 'watch':
        from . import watch

        return watch.main(args)
    from . import monitor

    if name == 'monitor':
        return monitor.main(args)
    run = {
        'accumulator': monitor.accumulator,
        'estimator': monitor.estimator,
        'relay': monitor.relay,
    }
    return run[name](args)


if __name__ == '__main__':
    sys.exit(main())
