# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized Imu messages with arbitrary bytes: the decoder, the patch of the relay, and the
stream."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from allan_ros.core.stream.pipeline import ImuStream
from allan_ros.readers.cdr import CovariancePatch, MalformedMessage, decode_imus, frame_id_of

from .damage import any_bytes, floats, texts
from .reading import BrokenRule, check_line, payloads

VARIANCES = {'gyro': (1.0, 2.0, 3.0), 'accel': (4.0, 5.0, 6.0)}
REPEATS = (1, 1, 1, 30, 700, 1100)
"""How often a message is repeated: sometimes often enough to learn the clock."""


@st.composite
def _message(draw: Any) -> bytes:
    """Draw a well-formed message with unusual values."""
    order = draw(st.sampled_from('<>'))
    frame = draw(texts).encode('utf-8', 'surrogatepass') + draw(st.sampled_from([b'\0', b'']))
    stamp = struct.pack(
        f'{order}iI',
        draw(st.integers(-(2**31), 2**31 - 1)),
        draw(st.integers(0, 2**32 - 1)),
    )
    head = stamp + struct.pack(f'{order}I', len(frame)) + frame
    head += bytes(-len(head) % 8)
    numbers = draw(st.lists(floats, min_size=37, max_size=37) | st.just([0.0] * 37))
    return b''.join([bytes([0, order == '<', 0, 0]), head, struct.pack(f'{order}37d', *numbers)])


any_message = any_bytes(payloads('cdr', 2)) | _message()
"""Valid, damaged and arbitrary messages."""


@st.composite
def _stream(draw: Any) -> list[bytes]:
    """Draw some messages, each repeated with stamps that advance."""
    out: list[bytes] = []
    for _ in range(draw(st.integers(1, 5))):
        message, times = draw(any_message), draw(st.sampled_from(REPEATS))
        if times > 1 and len(message) >= 12 and message[1] < 2:
            form = '<iI' if message[1] else '>iI'
            advance = draw(st.sampled_from([5_000_000, 0, 10**9, -1]))
            for i in range(times):
                stamp = divmod(1_700_000_000 * 10**9 + i * advance, 10**9)
                out.append(message[:4] + struct.pack(form, *stamp) + message[12:])
        else:
            out += [message] * times
    return out


def check(stream: list[bytes], folder: Path) -> bool:
    """Decode, patch and accumulate; return whether all were Imu messages."""
    del folder
    patch = CovariancePatch(VARIANCES)
    accumulator = ImuStream()
    good = []
    for payload in stream:
        try:
            patched = patch.patch(payload)
            frame_id_of(payload)
            if len(patched) != len(payload):
                raise BrokenRule('a patched message has another length')
        except MalformedMessage as error:
            check_line(str(error))
        try:
            decode_imus([payload], 'cdr')
            good.append(payload)
        except MalformedMessage as error:
            check_line(str(error))
        try:
            decode_imus([payload], 'ros1')
        except MalformedMessage as error:
            check_line(str(error))
    decoded = decode_imus(good, 'cdr')
    for batch in decoded.batches(decoded.stamps_ns):
        accumulator.update(batch)
    for found in accumulator.result().findings:
        check_line(str(found))
    return len(good) == len(stream)


INPUTS = _stream()
