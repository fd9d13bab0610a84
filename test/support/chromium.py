# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A real browser, controlled through its debugging pipe, without a driver or a network socket."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')

FLAGS = (
    '--headless',
    '--no-sandbox',
    '--disable-gpu',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--remote-debugging-pipe',
)

READ_FD, WRITE_FD = 3, 4
"""Descriptors from which Chromium reads commands and to which it writes events, each ended by a
zero byte."""

PATIENCE_S = 120.0
"""Limit in s for an answer, far longer than a loaded machine needs."""


def find_chromium() -> str | None:
    """Return the path of Chromium; None if it is not installed."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Chromium:
    """One browser with one page.

    Attributes
    ----------
    complaints : list of str
        Errors and warnings of the page: uncaught exceptions, the console, refused loads.
    requests : list of str
        Every address that was asked for.
    """

    def __init__(self, path: str, folder: Path) -> None:
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self._last = 0
        self._waiting = b''
        child_in, self._out = os.pipe()
        self._in, child_out = os.pipe()
        # above the two descriptor numbers that the child uses
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (child_in, child_out)]

        def place() -> None:
            os.dup2(high[0], READ_FD)
            os.dup2(high[1], WRITE_FD)

        self._process = subprocess.Popen(
            [path, *FLAGS, f'--user-data-dir={folder}', 'about:blank'],
            pass_fds=(READ_FD, WRITE_FD),
            preexec_fn=place,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for fd in (child_in, child_out, *high):
            os.close(fd)
        os.set_blocking(self._in, False)
        self._session = ''
        target = self.call('Target.createTarget', url='about:blank')['targetId']
        attached = self.call('Target.attachToTarget', targetId=target, flatten=True)
        self._session = attached['sessionId']
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.call(f'{domain}.enable')

    def open(self, path: Path, width: int, dark: bool = False) -> None:
        """Load a file into a window of this width in pixels."""
        self.call(
            'Emulation.setDeviceMetricsOverride',
            width=width,
            height=800,
            deviceScaleFactor=1,
            mobile=width < 500,
        )
        features = {
            'prefers-color-scheme': 'dark' if dark else 'light',
            'prefers-reduced-motion': 'reduce',
        }
        wanted = [{'name': name, 'value': value} for name, value in features.items()]
        self.call('Emulation.setEmulatedMedia', features=wanted)
        self.call('Page.navigate', url=path.as_uri())
        self.wait_for('document.readyState === "complete"')

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page."""
        answer = self.call(
            'Runtime.evaluate', expression=expression, returnByValue=True, userGesture=True
        )
        assert 'exceptionDetails' not in answer, answer
        return answer['result'].get('value')

    def wait_for(self, expression: str) -> None:
        """Wait until a JavaScript expression is true in the page."""
        end = time.monotonic() + PATIENCE_S
        while not self.evaluate(expression):
            assert time.monotonic() < end, f'never came true: {expression}'
            time.sleep(0.02)

    def point_at(self, x: float, y: float) -> None:
        """Move the mouse to this position of the page."""
        self.call('Input.dispatchMouseEvent', type='mouseMoved', x=x, y=y)

    def close(self) -> None:
        """End the browser process."""
        self._session = ''
        self.call('Browser.close')
        self._process.wait(PATIENCE_S)
        os.close(self._in)
        os.close(self._out)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the DevTools protocol and return its result."""
        self._last += 1
        message: dict[str, Any] = {'id': self._last, 'method': method, 'params': parameters}
        if self._session:
            message['sessionId'] = self._session
        os.write(self._out, json.dumps(message).encode() + b'\0')
        for said in self._messages():
            if said.get('id') == self._last:
                assert 'error' not in said, said
                result: dict[str, Any] = said['result']
                return result
            self._note(said.get('method', ''), said.get('params', {}))
        raise AssertionError('the browser is gone')

    def _note(self, event: str, of: dict[str, Any]) -> None:
        if event == 'Runtime.exceptionThrown':
            self.complaints.append(str(of['exceptionDetails']))
        elif event == 'Runtime.consoleAPICalled' and of['type'] in ('error', 'warning'):
            self.complaints.append(str(of['args']))
        elif event == 'Log.entryAdded' and of['entry']['level'] in ('error', 'warning'):
            self.complaints.append(of['entry']['text'])
        elif event == 'Network.requestWillBeSent':
            self.requests.append(of['request']['url'])

    def _messages(self) -> Iterator[dict[str, Any]]:
        end = time.monotonic() + PATIENCE_S
        while True:
            whole, zero, rest = self._waiting.partition(b'\0')
            if zero:
                self._waiting = rest
                yield json.loads(whole)
                continue
            assert time.monotonic() < end, 'the browser does not answer'
            try:
                more = os.read(self._in, 1 << 20)
            except BlockingIOError:
                time.sleep(0.005)
                continue
            if not more:
                return
            self._waiting += more
