# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two connected tap interfaces, with random packet loss.

    python bench/lossy_link.py FIRST SECOND FILE

FILE contains the percentage and may be rewritten at any time. Needs root. (Where the kernel has
``tc netem``, it does the same.)
"""

from __future__ import annotations

import fcntl
import os
import random
import select
import struct
import sys
from pathlib import Path

TUNSETIFF = 0x400454CA
TAP, WITHOUT_HEADER = 0x0002, 0x1000
"""Flags of linux/if_tun.h: Ethernet frames without a prefix."""
LONGEST_FRAME = 65536


def open_tap(name: str) -> int:
    """Return the file descriptor of a new tap interface."""
    handle = os.open('/dev/net/tun', os.O_RDWR)
    fcntl.ioctl(handle, TUNSETIFF, struct.pack('16sH', name.encode(), TAP | WITHOUT_HEADER))
    return handle


def main(first: str, second: str, file: Path) -> None:
    """Forward frames until the process is killed."""
    a, b = open_tap(first), open_tap(second)
    print('ready', flush=True)
    other, rng = {a: b, b: a}, random.Random(1)
    while True:
        for handle in select.select([a, b], [], [])[0]:
            frame = os.read(handle, LONGEST_FRAME)
            if rng.random() * 100.0 < float(file.read_text() or 0):
                continue
            try:
                os.write(other[handle], frame)
            except OSError:  # that interface is down
                continue


if __name__ == '__main__':
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
