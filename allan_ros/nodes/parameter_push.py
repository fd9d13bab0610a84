# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sets parameters of another node, such as a filter, from the noise model.

The values are rows of an export target. A wrong value can make a filter diverge and a robot fall,
so a value is set only if

- its target is in `TARGETS`: the convention of its rows was verified in the code of a filter;
- it is a noise density of a filter that estimates the bias, not a gain (see `GAINS`);
- the input has no fault;
- its 95 % interval is narrow (`SETTLED_RATIO`);
- it differs from the value that was found by at most ``push.max_factor``.

When the noise model is invalidated, the input has a fault, ``push.enabled`` becomes false, or this
node ends, the values that were found are set again. The node uses the parameter services of the
other node. Before each update it reads the present values, also to notice a restart of the node. A
value that the node refuses is not sent again. A parameter that an operator or another node has
changed is left as it is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from ..core.errors import AllanError
from ..core.fields import Fields
from ..core.imu import AXES, SENSORS
from ..core.stream.transport import faults_of
from ..export import ExportOptions, Row, target_rows
from ..readers.files import config_file, read_yaml
from ..results.results import Results
from .diagnostics import key_values, status_name
from .node import AllanNode, Part
from .settings import SETTLED_RATIO, PushSettings

SCHEMA = 'allan_ros/push/1'

GAINS = ('imu_filter_madgwick',)  # gain in rad/s, zeta in rad/s^2
"""Export targets whose rows are gains of a filter without a state for the bias. A gain has to cover
the noise in motion. Computed from the noise and the bias at rest, it increases the tilt error in
motion two to four times. So gains are shown in the status, but not set."""

TARGETS = (*GAINS, 'kalibr', 'fast_lio')  # kalibr: densities N and K, fast_lio: N^2 f and K^2 f
"""Export targets that ``push.filter`` may name. `docs/targets.md` names the code that shows the
convention of each."""

GAINS_NOT_SET = (
    'nothing is set: the gain has to cover the noise in motion, which is not measured, and a gain '
    'from the noise at rest makes the tilt worse in motion. Keep the gain that works while the '
    'robot moves, and start without push.node and push.filter'
)
"""Message of the status for a plan of `GAINS`: what is missing, and what to do."""

ANSWER_S = 5.0
"""Time in s to wait for an answer of the node; without one, the next update tries again."""

RETRY_S = 1.0
"""Period in s at which an update is retried until values and node are available."""

CHANGE = 0.1
"""A value is set again when it has changed by more than this fraction."""

Numbers = tuple[float, ...]
"""Value of a parameter: one number for a double, several for an array of doubles."""


@dataclass(frozen=True)
class PushPlan:
    """Which rows of which export target are set, and as which parameters."""

    target: str
    names: Mapping[str, str]  # name of a row -> name of the parameter; empty for all rows
    options: ExportOptions

    @property
    def has_gains(self) -> bool:
        """Whether the values are gains, which are not set."""
        return self.target in GAINS


def load_plan(name: str) -> PushPlan:
    """Read a plan, given its name in ``config/filters`` or the path of its .yaml file.

    Raises AllanError if the name is unknown or the file is invalid.
    """
    path = config_file('filters', name, 'plan for push.filter')
    fields = Fields(read_yaml(path), str(path))
    fields.schema(SCHEMA)
    fields.only('schema', 'target', 'estimates_bias', 'horizon', 'parameters')
    target = fields.choice('target', TARGETS)
    estimates_bias = 'estimates_bias' in fields and fields.value('estimates_bias')
    if target not in GAINS and not estimates_bias:
        raise AllanError(
            f'{path}: the numbers of {target} do not cover the gyro bias. If the node estimates '
            'the bias, state estimates_bias: true'
        )
    names = fields.fields('parameters') if 'parameters' in fields else None
    horizon = fields.number('horizon') if 'horizon' in fields else None
    return PushPlan(
        target,
        {} if names is None else {row: names.text(row) for row in names},
        ExportOptions() if horizon is None else ExportOptions(horizon=horizon),
    )


@dataclass(frozen=True)
class Proposal:
    """A proposed value of a parameter: one number, or three."""

    name: str
    values: Numbers
    interval: tuple[float, float]
    origin: str

    def differs(self, other: Numbers) -> bool:
        """Return whether any number differs from the other one by more than `CHANGE`."""
        if len(other) != len(self.values):
            return True
        return not all(abs(v - c) <= CHANGE * abs(c) for v, c in zip(self.values, other))

    def refusal(self, found: Numbers, factor: float) -> str:
        """Return why the value must not replace the one that was found; '' if it may."""
        if len(found) != len(self.values):
            return f'has {len(found)} numbers in the node, the model gives {len(self.values)}'
        for value, before in zip(self.values, found):
            if not before or not value > 0.0:
                return f'is {before:.4g} in the node and stays so; the model gives {value:.4g}'
            ratio = value / before
            if not 1.0 / factor <= ratio <= factor:
                how = (
                    f'{1.0 / ratio:.3g} times below' if ratio < 1.0 else f'{ratio:.3g} times above'
                )
                return (
                    f'{value:.4g} is {how} the {before:.4g} that was found, so it is not set: '
                    'check the filter, or raise push.max_factor'
                )
        return ''


@dataclass
class Held:
    """What is known of one parameter of the node; a value is empty if there is none."""

    now: Numbers  # when it was last read or set
    found: Numbers = ()  # before this node set it
    sent: Numbers = ()  # sent last, perhaps without an answer
    refused: Numbers = ()  # refused last by the node
    origin: str = ''  # how the present value was computed
    left: bool = False  # whether someone else has changed it


class ParameterPush(Part):
    """Sets parameters of the node ``push.node`` whenever the noise model has changed enough.

    It declares the parameters ``push.*`` of its ``owner``. Without ``push.node``, nothing is set.
    Raises AllanError if the plan cannot be read.
    """

    def __init__(self, owner: AllanNode) -> None:
        self._owner, self._log = owner, owner.get_logger()
        self._settings = owner.parameters.group('push', PushSettings)
        self.node = target = self._settings.value.node
        self._plan = load_plan(self._settings.value.filter) if target else None
        self._results: Results | None = None
        self._bias: Mapping[str, float] = {}
        self._gains: tuple[Row, ...] = ()  # that are shown, but not set
        self._invalid = 'there is no noise model'  # why no value may be set, or ''
        self._reason = ''  # the same at the last update
        self._held: dict[str, Held] = {}
        self._notes: dict[str, tuple[bool, str]] = {}  # '' or parameter -> warning, text
        self._calls: list[Any] = []  # futures of the answers that `_on_answers` processes
        self._on_answers: Callable[[list[Any]], object] = list.clear
        self._called_at = self._due_at = 0.0
        if self._plan is not None and self._plan.has_gains:
            self._log.warning(GAINS_NOT_SET)
        if target:
            self._set = owner.create_client(SetParameters, f'{target}/set_parameters')
            # created last: a node that answers it has also discovered the other client
            self._get = owner.create_client(GetParameters, f'{target}/get_parameters')

    def offer(self, results: Results, bias: Mapping[str, float]) -> None:
        """Use the latest noise model and bias at rest (axis -> largest value in SI).

        Results without axes mean that the model is invalidated.
        """
        # without data, the model is still valid
        faults = [fault for fault in faults_of(results.findings) if fault.axes]
        self._results, self._bias = results, bias
        self._invalid = '' if results.axes else 'the noise model was invalidated'
        if faults:
            self._invalid = str(faults[0])

    @property
    def _refusal(self) -> str:
        """Why no value may be set, and values that were set are restored; '' if they may."""
        return self._invalid if self._settings.value.enabled else 'push.enabled is false'

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
        settings, reason = self._settings.value, self._refusal
        if reason != self._reason:
            self._reason, self._due_at = reason, 0.0  # at once
        if self._plan is None or now < self._due_at:
            return
        self._due_at = now + RETRY_S
        if self._plan.has_gains:
            self._update_gains(self._plan, now)
            return
        if reason and not self._found():
            return
        ready = []
        if self._results is not None and not reason:
            ready = self._proposals(self._plan, self._results, settings)
        if not (ready or reason):
            return
        if not (self._get.service_is_ready() and self._set.service_is_ready()):
            self._note('', f'{self.node} is not running: start it, or correct push.node')
            return
        self._notes.pop('', None)
        if reason:
            self._call(self._set, [self._restoration()], partial(self._on_restored, reason))
            return
        self._due_at = now + settings.period
        # one by one: if one of several is not declared, a node returns no value at all
        requests = [GetParameters.Request(names=[proposal.name]) for proposal in ready]
        self._call(self._get, requests, partial(self._on_read, ready))

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the status of the parameters; no status without ``push.node``."""
        if self._plan is None:
            return []
        enabled = self._settings.value.enabled
        # what was said of a parameter does not hold while none is set
        notes = {n: note for n, (_, note) in self._notes.items() if enabled or not n}
        problems = [f'{name}: {note}' if name else note for name, note in notes.items()]
        done, pairs = [], {}
        for name, held in self._held.items():
            pairs[name] = _text(held.now)
            if held.found:
                pairs[f'former {name}'], pairs[f'origin of {name}'] = _text(held.found), held.origin
                if held.now != held.found:
                    done.append(f'{name} = {_text(held.now)} (was {_text(held.found)})')
        said = f'set {", ".join(done)}' if done else 'nothing set yet'
        warned = any(warning for warning, _ in self._notes.values())
        if self._plan.has_gains:
            said, warned = GAINS_NOT_SET, True
            for row in self._gains:
                pairs[f'{row.name} at rest, not set [{row.unit}]'] = _text(row.values)
                pairs[f'origin of {row.name}'] = row.words
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if warned and enabled else DiagnosticStatus.OK,
            name=status_name(self._owner, f'parameters of {self.node}'),
            message='; '.join([said if enabled else 'off: push.enabled is false', *problems]),
            values=key_values(pairs.items()),
        )
        return [status]

    def close(self) -> None:
        """Restore the values that were found: nothing would undo the others after this node."""
        self._cancel_calls()
        self._plan = None
        if not (self._found() and self._set.service_is_ready()):
            return
        answer = self._set.call_async(self._restoration())
        executor = SingleThreadedExecutor(context=self._owner.context)
        executor.add_node(self._owner)
        executor.spin_until_future_complete(answer, RETRY_S)
        executor.remove_node(self._owner)
        if answer.done():
            self._on_restored('this node ends', [answer.result()])

    # --- setting ----------------------------------------------------------------------------------

    def _update_gains(self, plan: PushPlan, now: float) -> None:
        """Compute the gains that cover the noise and, unless it is removed, the bias at rest."""
        settings, results, self._gains = self._settings.value, self._results, ()
        known = settings.debiased or all(axis in self._bias for axis in AXES[SENSORS['gyro']])
        if results is None or self._refusal or not known:
            return
        self._due_at = now + settings.period
        with suppress(AllanError):  # a coefficient is not known yet
            bias = {} if settings.debiased else self._bias
            self._gains = target_rows(results, plan.target, plan.options, bias)

    def _proposals(
        self, plan: PushPlan, results: Results, settings: PushSettings
    ) -> list[Proposal]:
        """Return the values that can be set; for each other value, store the reason as a note."""
        try:
            rows = target_rows(results, plan.target, plan.options)
        except AllanError as error:
            self._note('', str(error), warning=False)
            return []
        for missing in plan.names.keys() - {row.name for row in rows}:
            self._note(plan.names[missing], f'{plan.target} has no number {missing}')
        ready = []
        for row in rows:
            name = plan.names.get(row.name, '') if plan.names else row.name
            low, high = row.interval
            if name and row.ratio > SETTLED_RATIO:
                why = (
                    f'between {low:.3g} and {high:.3g}: it will be set when this interval is '
                    f'within a factor of {SETTLED_RATIO:g}'
                )
                self._note(name, why, warning=False)
            elif name:
                proposal = Proposal(name, row.values, row.interval, row.words)
                held = self._held.get(name)
                if held is None or (not held.left and proposal.differs(held.refused)):
                    ready.append(proposal)
        return ready

    def _call(
        self, client: Client, requests: list[Any], then: Callable[[list[Any]], object]
    ) -> None:
        """Send the requests; `tick` passes all answers to ``then``, or stops after `ANSWER_S`."""
        self._calls = [client.call_async(request) for request in requests]
        self._on_answers, self._called_at = then, time.monotonic()

    def _cancel_calls(self) -> None:
        for future in self._calls:
            future.cancel()
        self._calls = []

    def _on_read(self, proposals: list[Proposal], answers: list[Any]) -> None:
        """Store the present values of the node, and set those that differ from the proposals."""
        if self._refusal:  # since the question was asked
            return
        wanted, settings = [], self._settings.value
        for proposal, answer in zip(proposals, answers):
            name, values = proposal.name, self._numbers_of(proposal, answer.values)
            if values is None:
                continue
            held = self._held.setdefault(name, Held(values))
            if held.found and values not in (held.now, held.found, held.sent):
                self._held[name] = Held(values, left=True)
                self._note(name, f'was changed to {_text(values)}, and is left so')
                continue
            held.now = values
            found = held.found or values
            if refusal := proposal.refusal(found, settings.max_factor):
                self._note(name, refusal, warning=any(found))
                continue
            self._notes.pop(name, None)
            if proposal.differs(values):
                held.found, held.sent = found, proposal.values  # the answer may be lost
                wanted.append(proposal)
        if wanted:
            messages = [_message(p.name, p.values) for p in wanted]
            request = SetParameters.Request(parameters=messages)
            self._call(self._set, [request], partial(self._on_set, wanted))

    def _numbers_of(self, proposal: Proposal, values: Sequence[ParameterValue]) -> Numbers | None:
        """Return the value in an answer; None, with a note, if it has not the proposal's type."""
        several = len(proposal.values) > 1
        kind, wanted = 'a double', ParameterType.PARAMETER_DOUBLE
        if several:
            kind, wanted = 'an array of doubles', ParameterType.PARAMETER_DOUBLE_ARRAY
        value = values[0] if values else ParameterValue()
        if value.type == wanted:
            return tuple(value.double_array_value) if several else (value.double_value,)
        unset = value.type == ParameterType.PARAMETER_NOT_SET
        what = 'not declared' if unset else 'of another type'
        self._note(proposal.name, f'is {what} in {self.node}: {kind} would be set')
        return None

    def _on_set(self, wanted: list[Proposal], answers: list[Any]) -> None:
        """Store and log which values the node has accepted or refused."""
        for proposal, result in zip(wanted, answers[0].results):
            name, value, held = proposal.name, _text(proposal.values), self._held[proposal.name]
            if not result.successful:
                held.refused = proposal.values
                if held.now == held.found:
                    held.found = ()
                self._note(name, f'{self.node} refused {value}: {result.reason or "no reason"}')
                continue
            low, high = proposal.interval
            self._log.info(
                f'{name} of {self.node}: {_text(held.now)} -> {value} '
                f'(95 %: {low:.3g} to {high:.3g}; {proposal.origin})'
            )
            held.now, held.refused, held.origin = proposal.values, (), proposal.origin

    def _note(self, name: str, note: str, warning: bool = True) -> None:
        """Store a message about a parameter ('' for the node), and log the first of its kind."""
        if name not in self._notes or self._notes[name][0] != warning:
            self._log.info(f'{name}: {note}' if name else note)
        self._notes[name] = warning, note

    # --- restoring --------------------------------------------------------------------------------

    def _found(self) -> dict[str, Numbers]:
        """Return the value that was found of each parameter that has been set."""
        return {name: held.found for name, held in self._held.items() if held.found}

    def _restoration(self) -> Any:
        """Return a request that sets all values that were found."""
        parameters = [_message(name, values) for name, values in self._found().items()]
        return SetParameters.Request(parameters=parameters)

    def _on_restored(self, reason: str, answers: list[Any]) -> None:
        """Forget the parameters if all were restored; else store a note."""
        found = self._found()
        failed = [
            f'{name}: {result.reason or "refused"}'
            for name, result in zip(found, answers[0].results)
            if not result.successful
        ]
        values = (f'{name} = {_text(values)}' for name, values in found.items())
        said = f'restored {", ".join(values)}, because {reason}'
        if not failed:
            self._held = {name: held for name, held in self._held.items() if held.left}
            self._notes = {name: self._notes[name] for name in self._held}
        self._note('', '; '.join(failed) or said)


def _message(name: str, values: Numbers) -> ParameterMessage:
    value = list(values) if len(values) > 1 else values[0]
    return Parameter(name, value=value).to_parameter_msg()


def _text(values: Numbers) -> str:
    return ' '.join(f'{value:.4g}' for value in values)
