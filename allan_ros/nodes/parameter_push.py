# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sets parameters of another node, such as a filter, from the noise model.

It uses the parameter services of that node. Before each update it reads the present values: to
store the original values, to skip values that are already correct, and to notice a restart of the
node. If the node rejects a value, its reason is reported and the value is not sent again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ..core.errors import AllanError
from ..core.filters.mapping import FilterMapping, Proposal, narrow_enough, propose
from ..io.results import Results
from ..io.user_files import load_filter
from .diagnostics import key_values, status_name
from .node import AllanNode, Part
from .settings import PushSettings

ANSWER_S = 5.0
"""Time in s to wait for an answer of the node; without one, the next update tries again."""

RETRY_S = 1.0
"""Period in s at which an update is retried until values and node are available."""


class ParameterPush(Part):
    """Sets parameters of the node ``push.node`` whenever the noise model has changed enough.

    It declares the parameters ``push.*`` of its ``owner``, and creates the service ``~/restore``.
    If ``push.node`` is empty, nothing is set. Raises AllanError if the mapping cannot be read.
    """

    def __init__(self, owner: AllanNode) -> None:
        self._owner, self._log = owner, owner.get_logger()
        self._settings = owner.parameters.group('push', PushSettings)
        self.node = target = self._settings.value.node
        self._mapping = load_filter(self._settings.value.filter) if target else None
        self._results: Results | None = None
        self._former: dict[str, ParameterValue] = {}
        self._current: dict[str, ParameterValue] = {}
        self._refused: dict[str, Proposal] = {}
        self._notes: dict[str, str] = {}
        self._calls: list[Any] = []  # futures of the answers that `_on_answers` processes
        self._on_answers: Callable[[list[Any]], None] = list.clear
        self._called_at = self._due_at = 0.0
        owner.create_service(Trigger, '~/restore', self._on_restore)
        if target:
            # answers must be received while ~/restore waits for them
            group = ReentrantCallbackGroup()
            self._set = owner.create_client(
                SetParameters, f'{target}/set_parameters', callback_group=group
            )
            # created last: a node that answers it has also discovered the other client
            self._get = owner.create_client(
                GetParameters, f'{target}/get_parameters', callback_group=group
            )

    def offer(self, results: Results) -> None:
        """Use the latest noise model; results without axes mean that it is withdrawn."""
        if not results.axes or self._results is None:
            self._due_at = 0.0  # use the first model, and the first after a withdrawal, at once
        self._results = results if results.axes else None

    def tick(self, now: float) -> None:
        """Process answers of the node, and start an update if it is due."""
        if self._calls:
            if all(future.done() for future in self._calls):
                calls, self._calls = self._calls, []
                self._on_answers([future.result() for future in calls])
            elif now - self._called_at > ANSWER_S:
                self._cancel_calls()
                self._note('', f'{self.node} did not answer within {ANSWER_S:g} s')
            return
        settings = self._settings.value
        if self._mapping is None or self._results is None:
            return
        if not settings.enabled or now < self._due_at:
            return
        self._due_at = now + RETRY_S
        ready = self._proposals(self._mapping, self._results, settings)
        if not ready:
            return
        if not (self._get.service_is_ready() and self._set.service_is_ready()):
            self._note('', f'{self.node} is not running: start it, or correct push.node')
            return
        self._due_at = now + settings.period
        self._notes.pop('', None)
        # one by one: if one of several is not declared, a node returns no value at all
        requests = [GetParameters.Request(names=[proposal.name]) for proposal in ready]
        self._call(self._get, requests, partial(self._on_read, ready))

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the status of the parameters; no status without ``push.node``."""
        if self._mapping is None:
            return []
        enabled = self._settings.value.enabled
        problems = [f'{name}: {note}' if name else note for name, note in self._notes.items()]
        refused = bool(self._refused) or '' in self._notes
        done = f'set {", ".join(self._former)}' if self._former else 'nothing set yet'
        former = {f'former {name}': value for name, value in self._former.items()}
        shown = {**self._current, **former}
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if refused and enabled else DiagnosticStatus.OK,
            name=status_name(self._owner, f'parameters of {self.node}'),
            message='; '.join([done if enabled else 'off: push.enabled is false', *problems]),
            values=key_values((name, _numbers(value)) for name, value in shown.items()),
        )
        return [status]

    # --- setting ----------------------------------------------------------------------------------

    def _proposals(
        self, mapping: FilterMapping, results: Results, settings: PushSettings
    ) -> list[Proposal]:
        """Return the values that can be set; for each other value, store the reason as a note."""
        fits = {name: axis.fit for name, axis in results.axes.items()}
        known = fits, results.rate_hz, mapping.constants, mapping.horizon
        made = []
        for parameter in mapping.parameters:
            try:
                made.append(propose(parameter, *known))
            except AllanError as error:
                self._note(parameter.name, str(error))
        ready, waiting = narrow_enough(made, settings.ratio)
        for name, why in waiting.items():
            self._note(name, why)
        refused = ((p, self._refused.get(p.name)) for p in ready)
        return [p for p, r in refused if r is None or p.differs(r.values, settings.change)]

    def _call(self, client: Client, requests: list[Any], then: Callable[[list[Any]], None]) -> None:
        """Send the requests; `tick` passes all answers to ``then``, or stops after `ANSWER_S`."""
        self._calls = [client.call_async(request) for request in requests]
        self._on_answers, self._called_at = then, time.monotonic()

    def _cancel_calls(self) -> None:
        for future in self._calls:
            future.cancel()
        self._calls = []

    def _on_read(self, proposals: list[Proposal], answers: list[Any]) -> None:
        """Store the present values of the node, and set those that differ from the proposals."""
        wanted = []
        for proposal, answer in zip(proposals, answers):
            name, value = proposal.name, next(iter(answer.values), ParameterValue())
            if self._has_right_type(proposal, value):
                self._current[name] = value
                self._notes.pop(name, None)
                if proposal.differs(_numbers(value), self._settings.value.change):
                    wanted.append(proposal)
        if wanted:
            messages = [_message(p, self._current[p.name]) for p in wanted]
            request = SetParameters.Request(parameters=messages)
            self._call(self._set, [request], partial(self._on_set, wanted))

    def _has_right_type(self, proposal: Proposal, value: ParameterValue) -> bool:
        """Return whether the parameter has the type of the proposal; if not, store a note."""
        kind, wanted = 'a double', ParameterType.PARAMETER_DOUBLE
        if len(proposal.values) > 1:
            kind, wanted = 'an array of doubles', ParameterType.PARAMETER_DOUBLE_ARRAY
        if value.type == wanted:
            return True
        unset = value.type == ParameterType.PARAMETER_NOT_SET
        what = 'not declared' if unset else 'of another type'
        self._refused[proposal.name] = proposal
        self._note(proposal.name, f'is {what} in {self.node}: the mapping sets {kind}')
        return False

    def _on_set(self, wanted: list[Proposal], answers: list[Any]) -> None:
        """Store and log which values the node has accepted or rejected."""
        for proposal, result in zip(wanted, answers[0].results):
            name, value = proposal.name, _text(proposal.values)
            if not result.successful:
                self._refused[name] = proposal
                self._note(name, f'{self.node} refused {value}: {result.reason or "no reason"}')
                continue
            self._refused.pop(name, None)
            before = self._current[name]
            self._former.setdefault(name, before)
            self._current[name] = _message(proposal, before).value
            limited = ', clamped to its limit' if proposal.limited else ''
            self._log.info(
                f'{name} of {self.node}: {_text(_numbers(before))} -> {value}{limited} '
                f'(95 %: {proposal.low:.3g} to {proposal.high:.3g})'
            )

    def _note(self, name: str, note: str) -> None:
        """Store a message about a parameter ('' for the node), and log it if it is new."""
        if self._notes.get(name) != note:
            self._log.info(f'{name}: {note}' if name else note)
        self._notes[name] = note

    # --- restoring --------------------------------------------------------------------------------

    async def _on_restore(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Set the original values again, and set push.enabled to false."""
        if self._mapping is not None:
            off = Parameter('push.enabled', Parameter.Type.BOOL, False)
            self._owner.set_parameters([off])
        self._cancel_calls()
        former = dict(self._former)
        if not former:
            response.message = 'nothing was set, so there is nothing to restore'
            return response
        if not self._set.service_is_ready():
            response.message = f'{self.node} is not running: nothing was restored'
            return response
        wanted = [ParameterMessage(name=name, value=value) for name, value in former.items()]
        request = SetParameters.Request(parameters=wanted)
        self._call(self._set, [request], list.clear)
        answer = await self._calls[0]
        if answer is None:  # canceled by `tick`
            response.message = f'{self.node} did not answer within {ANSWER_S:g} s'
            return response
        failed = [
            f'{name}: {result.reason or "refused"}'
            for name, result in zip(former, answer.results)
            if not result.successful
        ]
        response.success = not failed
        restored = ', '.join(f'{name} = {_text(_numbers(v))}' for name, v in former.items())
        response.message = '; '.join(failed) or f'restored {restored}'
        if not failed:
            for values in (self._former, self._current, self._refused, self._notes):
                values.clear()
        self._log.info(response.message)
        return response


def _numbers(value: ParameterValue) -> tuple[float, ...]:
    """Return the numbers of a parameter that is a double or an array of doubles."""
    array = value.type == ParameterType.PARAMETER_DOUBLE_ARRAY
    return tuple(value.double_array_value) if array else (value.double_value,)


def _message(proposal: Proposal, current: ParameterValue) -> ParameterMessage:
    """Return the proposed parameter; its type is that of the current value."""
    value = ParameterValue(type=current.type)
    if current.type == ParameterType.PARAMETER_DOUBLE_ARRAY:
        value.double_array_value = list(proposal.values)
    else:
        (value.double_value,) = proposal.values
    return ParameterMessage(name=proposal.name, value=value)


def _text(values: tuple[float, ...]) -> str:
    return ' '.join(f'{value:.4g}' for value in values)
