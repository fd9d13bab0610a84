# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One trial of a fault: its losses, the messages published, and the recovery."""

from __future__ import annotations

import json
import math
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from offline_run import offline_sums
from online_nodes import Client, Process, start
from still_stream import Stream, healthy

from allan_ros.core.allan.document import sums_from_document
from allan_ros.core.imu import ImuBatch

HEALTHY_S = 12.0
"""Static data before a fault in s: rate and noise floor are known, and sums exist."""
AFTER_S = 5.0
"""Duration of a trial in s after static data grow again."""
PATIENCE_S = 90.0
LEVELS = {b'\0': 'OK', b'\1': 'WARN', b'\2': 'ERROR', b'\3': 'STALE'}


@dataclass(frozen=True)
class Row:
    """The effect of one fault: a row of the table."""

    fault: str
    lost: str
    message: str
    delay: str
    recovered: str
    exits: str

    @property
    def cells(self) -> tuple[str, ...]:
        """Cells in the order of the heading."""
        return self.fault, self.lost, self.message, self.delay, self.recovered, self.exits


REASONS = {
    'lost': 'missing by the stamps',
    'not_finite': 'not finite',
    'duplicate': 'duplicate',
    'backward': 'stamped backward',
    'untimed': 'without a time',
    'moving': 'moving',
    'stuck': 'stuck',
    'bridged': 'interpolated',
}
"""Count in the checkpoint -> name in the table."""

HEADING = (
    'fault',
    'lost',
    'message',
    'message after',
    'data again after',
    'exit',
)


FAULTS: dict[str, tuple[Callable[[Client, Path], Row], str]] = {}
"""Name on the command line -> function, and its requirement: '', 'root' or 'network' (root and
network namespaces).
"""


def fault(
    needs: str = '',
) -> Callable[[Callable[[Client, Path], Row]], Callable[[Client, Path], Row]]:
    """Register a function in `FAULTS` by its name."""

    def enter(function: Callable[[Client, Path], Row]) -> Callable[[Client, Path], Row]:
        FAULTS[function.__name__] = function, needs
        return function

    return enter


class DiagnosticsLog:
    """Records diagnostics messages, and the times at which static data grow.

    Parameters
    ----------
    client : Client
    ending : str
        End of the name of the status of the input, which reports the static data.

    Attributes
    ----------
    messages : list of (time in s, level and message)
        Every new message that is not OK. Messages that differ only in numbers are recorded once.
    grew : list of float
        Times at which the static data had grown.
    """

    def __init__(self, client: Client, ending: str = 'input') -> None:
        self.client, self.ending = client, ending
        self.messages: list[tuple[float, str]] = []
        self.grew: list[float] = []
        self._evidence = 0.0
        self._latest: dict[str, str] = {}
        client.on_status = self._record

    def _record(self, status: Any) -> None:
        now = time.monotonic()
        values = {v.key: v.value for v in status.values}
        if status.name.endswith(self.ending):
            evidence = float(values['evidence [s]'])
            if evidence > self._evidence and not status.message.startswith('moving'):
                self.grew.append(now)
            self._evidence = evidence
        words = re.sub(r'\(and \d+ more\)|[\d.%]+', '', status.message)
        if status.level == b'\0' or self._latest.get(status.name) == words:
            if status.level == b'\0':
                self._latest.pop(status.name, None)
            return
        self._latest[status.name] = words
        self.messages.append((now, f'{LEVELS[status.level]}: {status.message}'))
        print(f'{now:9.1f} {status.name}: {self.messages[-1][1]}', file=sys.stderr, flush=True)

    def first_since(self, time_s: float) -> tuple[float, str]:
        """Return time and text of the first message after a time; NaN and '' without one."""
        return next((each for each in self.messages if each[0] >= time_s), (math.nan, ''))

    def static_data_grew_since(self, time_s: float) -> float:
        """Return the time at which static data first grew after a time; NaN if they did not."""
        return next((at for at in self.grew if at > time_s), math.nan)

    def until(self, holds: Callable[[], bool], patience_s: float = PATIENCE_S) -> float:
        """Wait until a condition is true and return the time; NaN if it never is."""
        end = time.monotonic() + patience_s
        while not holds():
            if time.monotonic() > end:
                return math.nan
            self.client.spin(0.05)
        return time.monotonic()


class Trial:
    """A node that receives a stream with a fault in the middle.

    Parameters
    ----------
    client : Client
    folder : Path
        Folder of the checkpoint.
    ros : sequence of str
        Parameters of the node.
    name : str
        Name of the node.
    stream : callable
        Creates the stream.
    label : str
        Label of the IMU, if the node watches several.
    **how
        To `start`.

    Attributes
    ----------
    began, ended : float
        When the fault began and ended.
    """

    def __init__(
        self,
        client: Client,
        folder: Path,
        ros: Sequence[str] = (),
        name: str = 'monitor',
        stream: Callable[[], Stream] = Stream,
        label: str = '',
        **how: Any,
    ) -> None:
        self.log = DiagnosticsLog(client, f'{label} input' if label else 'input')
        self.checkpoint = folder / f'{label or "imu"}.json'
        self._name, self._how = name, how
        self._ros = (f'checkpoint.path:={folder if label else self.checkpoint}', *ros)
        self.watched = self.start()
        self.stream = stream()
        self.stream.begin()
        if math.isnan(self.log.until(self._healthy)):
            raise SystemExit(f'{name} does not get healthy')
        self.began = self.ended = time.monotonic()

    def start(self) -> Process:
        """Start the node, or restart it after it was killed."""
        self.watched = start(self._name, ros=self._ros, **self._how)
        return self.watched

    def spin(self, seconds: float) -> None:
        """Wait."""
        self.log.client.spin(seconds)

    @contextmanager
    def fault(self, seconds: float = 0.0) -> Iterator[None]:
        """Record when the fault begins and ends.

        The fault is injected by the body of the block and lasts this long after it.
        """
        self.began = time.monotonic()
        yield
        self.spin(seconds)
        self.ended = time.monotonic()

    def faulty(self, change: Callable[[ImuBatch], ImuBatch], seconds: float) -> None:
        """Send changed samples for a duration."""
        with self.fault():
            self.stream.change = change
            self.spin(seconds)
            self.stream.change = healthy

    def row(self, fault: str, note: str = '', same: bool = True) -> Row:
        """Wait for recovery, end all processes, and return the row.

        Parameters
        ----------
        fault, note : str
            Name of the fault, and a note about the lost samples.
        same : bool
            Whether the sums are compared with an offline run of the sent samples.
        """
        self.log.until(lambda: not math.isnan(self.log.static_data_grew_since(self.ended)))
        grows = self.log.static_data_grew_since(self.ended)
        self.spin(AFTER_S)
        shown_s, words = self.log.first_since(self.began)
        self.stream.end()
        self.spin(1.5)
        code = self.watched.end(signal.SIGINT)
        words = words.replace(f'{self.checkpoint.parent}/', '')
        return Row(
            fault,
            '; '.join(x for x in (self._lost(same), note) if x),
            words or 'nothing',
            f'{shown_s - self.began:.1f} s' if words else '-',
            'never' if math.isnan(grows) else f'{grows - self.ended:.1f} s',
            str(code),
        )

    def _healthy(self) -> bool:
        evidence = self.log.client.value(self.log.ending, 'evidence')
        return evidence not in ('', 'unknown') and float(evidence) >= HEALTHY_S

    def _lost(self, same: bool) -> str:
        """Return which samples are missing from the sums, the reasons, and whether the sums are
        correct.
        """
        document = json.loads(self.checkpoint.read_text())
        counts = document['counts']
        held = max(sums_from_document(each).samples for each in document['sums'])
        kept = held - counts['bridged']
        made = self.stream.made
        reasons = [f'{counts[key]} {words}' for key, words in REASONS.items() if counts.get(key)]
        text = f'{made - kept} of {made}' + (f' ({", ".join(reasons)})' if reasons else '')
        if not same:
            return text
        equal = document['sums'] == offline_sums(self.stream.truth)
        verdict = 'the same, bit for bit' if equal else 'NOT THE SAME'
        return f'{text}; sums against the offline run: {verdict}'
