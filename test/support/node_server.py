# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start nodes by forking a process that has imported numpy, scipy and most of the package.

This saves most of the CPU time of a start. rclpy is not imported before the fork: its LTTng library
starts threads when it is loaded and cancels them at exit, which crashes where they do not run.

`NodeServer` runs this file. Each line of standard input is a request in JSON, answered by a line:
``{"arguments", "environment", "log"}`` starts ``allan_ros.nodes`` and gives its process id; a
process id gives the exit code, or null while it runs. All are killed at the end of the input, and
also when the server itself is killed.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

PATIENCE_S = 240.0
"""Limit for any event of a node, long enough for a loaded machine."""

PR_SET_PDEATHSIG = 1
"""Request to Linux: send this process a signal when its parent dies (linux/prctl.h)."""


class NodeServer:
    """Starts the server process and sends requests to it."""

    def __init__(self, repository: Path) -> None:
        path = os.pathsep.join([str(repository), os.environ.get('PYTHONPATH', '')])
        self._process = subprocess.Popen(
            [sys.executable, '-c', f'import runpy; runpy.run_path({__file__!r}, None, "__main__")'],
            env={**os.environ, 'PYTHONPATH': path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C must not end it before the nodes
        )

    def ask(self, request: Any) -> Any:
        """Send a request and return the answer."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(json.dumps(request) + '\n')
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """End the server and all its processes."""
        self._process.communicate()

    def kill(self) -> None:
        """Kill the server, as the system does when memory runs out."""
        self._process.kill()
        self._process.communicate()


class NodeProcess:
    """One node in its own process."""

    def __init__(
        self, server: NodeServer, arguments: Iterable[str], environment: dict[str, str], log: Path
    ) -> None:
        self._server, self._log, self._code = server, log, None
        log.touch()
        self.arguments = [*arguments]
        request = {'arguments': self.arguments, 'environment': environment, 'log': str(log)}
        self.pid: int = server.ask(request)

    @property
    def output(self) -> str:
        return self._log.read_text(errors='replace')

    def poll(self) -> int | None:
        """Return the exit code, None while it runs; -n after signal n."""
        if self._code is None:
            self._code = self._server.ask(self.pid)
        return self._code

    def wait(self) -> int:
        """Return the exit code once it has ended."""
        deadline = time.monotonic() + PATIENCE_S
        while (code := self.poll()) is None:
            assert time.monotonic() < deadline, f'{self.arguments} still runs: {self.output}'
            time.sleep(0.01)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def stop(self, *signals: int) -> int:
        """Send signals (SIGTERM by default), one after the other, and return the exit code."""
        for number in signals or (signal.SIGTERM,):
            self.send_signal(number)
        return self.wait()


def serve() -> dict[str, Any]:
    """Answer requests. In a forked process, return the request that this process has to execute."""
    running, server = set(), os.getpid()
    for line in sys.stdin:
        request = json.loads(line)
        if isinstance(request, dict):
            answer: int | None = os.fork()
            if answer == 0:
                _end_with(server)
                return request
            running.add(answer)
        else:
            ended, status = os.waitpid(request, os.WNOHANG)
            answer = os.waitstatus_to_exitcode(status) if ended else None
            running -= {ended}
        print(json.dumps(answer), flush=True)
    for pid in running:
        os.kill(pid, signal.SIGKILL)
    raise SystemExit


def _end_with(server: int) -> None:
    """Let Linux kill this process together with its parent, which is the server."""
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != server:  # the server died before the request
        os._exit(1)


if __name__ == '__main__':
    # the first limits the threads of numpy
    main = importlib.import_module('allan_ros.nodes.__main__').main
    for name in ('api.analysis', 'core.check', 'results.checkpoint'):
        importlib.import_module(f'allan_ros.{name}')
    request = serve()
    os.environ.clear()
    os.environ.update(request['environment'])
    sys.path[:0] = request['environment'].get('PYTHONPATH', '').split(os.pathsep)
    with open(os.devnull) as nothing, open(request['log'], 'wb') as log:
        os.dup2(nothing.fileno(), 0)
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    sys.argv[1:] = request['arguments']
    sys.exit(main())
