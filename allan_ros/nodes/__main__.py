# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run a node without an installation: ``python -m allan_ros.nodes monitor --ros-args ...``."""

from __future__ import annotations

import sys
from importlib import import_module

EXECUTABLES = {
    'accumulator': ('monitor', 'accumulator'),
    'estimator': ('monitor', 'estimator'),
    'monitor': ('monitor', 'main'),
    'relay': ('monitor', 'relay'),
    'player': ('player', 'main'),
    'watch': ('watch', 'main'),
}
"""Command line argument -> module, and the function in it that runs the node."""


def main() -> int:
    """Run the node that the first argument names."""
    if sys.argv[1:2] == [] or sys.argv[1] not in EXECUTABLES:
        print(f'usage: python -m allan_ros.nodes {{{",".join(EXECUTABLES)}}} ...', file=sys.stderr)
        return 2
    module, function = EXECUTABLES[sys.argv[1]]
    code: int = getattr(import_module(f'.{module}', __package__), function)(sys.argv[2:])
    return code


if __name__ == '__main__':
    sys.exit(main())
