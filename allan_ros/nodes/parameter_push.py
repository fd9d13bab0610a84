# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sets parameters of another node, such as a state estimator, from the noise model.

The values are rows of an export target. A wrong value can make a state estimator diverge and a
robot fall. A value is therefore set only under the conditions below.

Conditions
----------
- The export target is in `PUSHED_TARGETS`: its convention was verified in the code of a state
  estimator.
- The value is a noise density, and the state estimator estimates the bias. Or the value is a gain
  (`GAINS`), the gain in the node is too small for the errors in motion, and these errors were
  measured in drives of this robot.
- No axis of the input has a fault.
- The 95 % interval of the value is narrow (`SETTLED_RATIO`).
- The value and the found value differ by at most the factor ``push.max_factor``. The found value is
  the value that the parameter had before this node set it.
- The found value has been written to the disk (`FormerValues`).

Restoring
---------
The found values are set again when the noise model is invalidated, an axis of the input has a
fault, ``push.enabled`` becomes false, this node ends, or this node starts after it was killed.

The present value of a parameter is read before each change, if the other node answers. If an
operator or another node has changed a parameter after this node set it, this node does not set it
any more until it is restarted. A value of the noise model that the other node refuses is usually
not sent again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from ..core.errors import AllanError, one_line
from ..core.estimate import Estimate
from ..core.imu import AXES, SENSORS
from ..core.stream.transport import faults_of
from ..export import Row, target_rows
from ..results.results import Results
from ..view.finding_text import explained
from .diagnostics import key_values, status_name
from .former_values import Former, FormerValues
from .node import AllanNode, NodePart
from .node_settings import SETTLED_RATIO, PushSettings
from .push_plan import GAINS_WAIT, Numbers, Proposal, PushPlan, load_push_plan, text_of

ANSWER_S = 5.0
"""Longest time in s to wait for an answer of the other node. Without an answer, the next update
tries again."""

RETRY_S = 1.0
"""Period in s at which an update is tried again, until there are values to set and the other node
is available."""

CLOSING_S = 0.5
"""Longest time in s of each of the two attempts to restore values while this node ends."""

LONGEST_REASON = 200
"""Largest number of shown characters of the reason that a node gives for a refusal."""

KILLED = 'the program that had set it was killed'
"""Reason for restoring values that the file of `FormerValues` contains when the node starts."""

Requests = Generator[list[Any], list[Any], None]
"""Generator that yields futures of requests to the other node, and receives the answers."""


@dataclass
class Held:
    """The known values of one parameter of the node ``push.node``; () means no value."""

    now: Numbers  # value when the parameter was last read or set
    found: Numbers = ()  # value that the parameter had before it was set
    sent: tuple[Numbers, ...] = ()  # values sent to the node; the parameter may have any of them
    refused: Numbers = ()  # latest value that the node has refused
    origin: str = ''  # text that states how the present value was computed
    changed_by_others: bool = False  # if True, the parameter is not set any more


class ParameterPush(NodePart):
    """Sets parameters of the node ``push.node`` when the noise model has changed enough.

    The parameters ``push.*`` are declared in the node ``owner``. Without ``push.node``, nothing is
    set. Raises AllanError if the file of ``push.filter`` cannot be read or is invalid.
    """

    def __init__(self, owner: AllanNode) -> None:
        self._owner, self._log = owner, owner.get_logger()
        self._settings = owner.parameters.group('push', PushSettings)
        self.node = target = self._settings.value.node
        self._plan = load_push_plan(self._settings.value.filter) if target else None
        self._results: Results | None = None
        self._bias: Mapping[str, Estimate] = {}
        self._gains: tuple[Row, ...] = ()  # gains that are shown, but not set
        self._invalid = 'there is no noise model'  # why no value may be set, or ''
        self._reason = ''  # value of `_refusal` at the last update
        self._held: dict[str, Held] = {}
        # name of a parameter, or '' for the node -> note: (whether it is a warning, text)
        self._notes: dict[str, tuple[bool, str]] = {}
        self._requests: Requests | None = None  # the generator that waits for `_answers`
        self._answers: list[Any] = []  # futures of the answers
        self._asked_at = self._due_at = 0.0
        self._former: FormerValues | None = None  # None until the file with former values is open
        # whether an earlier program was killed, and the values that it replaced must be restored
        self._must_restore = False
        if target:
            self._set = owner.create_client(SetParameters, f'{target}/set_parameters')
            # created last: a node that answers this client has also discovered the client above
            self._get = owner.create_client(GetParameters, f'{target}/get_parameters')

    def offer(self, results: Results, bias: Mapping[str, Estimate]) -> None:
        """Use the latest noise model and bias at rest.

        Results without axes mean that the model is invalidated.
        """
        # if a fault has no axes, data are missing, but the noise model is still valid
        faults = [fault for fault in faults_of(results.findings) if fault.axes]
        self._results, self._bias = results, bias
        self._invalid = '' if results.axes else 'the noise model was invalidated'
        if faults:
            self._invalid = str(faults[0])

    @property
    def _refusal(self) -> str:
        """Why no value may be set and former values are restored; '' if values may be set."""
        if self._must_restore:
            return KILLED
        return self._invalid if self._settings.value.enabled else 'push.enabled is false'

    def tick(self, now: float) -> None:
        """Process answers of the node, and start an update if it is due."""
        if self._requests is not None:
            if all(future.done() for future in self._answers):
                self._resume(self._requests, [future.result() for future in self._answers])
            elif now - self._asked_at > ANSWER_S:
                self._cancel()
                self._note('', f'{self.node} did not answer within {ANSWER_S:g} s')
            return
        if self._refusal != self._reason:
            self._reason, self._due_at = self._refusal, 0.0  # an update is due at once
        if self._plan is None or now < self._due_at:
            return
        self._due_at = now + RETRY_S
        if self._former is None:
            self._open(now)
            return
        if self._reason and self._found_values():
            if self._is_running():
                self._resume(self._restoring(self._reason))
        elif not self._reason and self._results is not None:
            proposals = self._proposals(self._plan, self._results)
            if proposals and self._is_running():
                self._due_at = now + self._settings.value.period
                self._resume(self._setting(proposals))

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return the status of the parameters; no status without ``push.node``."""
        if self._plan is None:
            return []
        enabled = self._settings.value.enabled
        # if push.enabled is false, notes about single parameters do not apply
        notes = {n: note for n, (_, note) in self._notes.items() if enabled or not n}
        problems = [f'{name}: {note}' if name else note for name, note in notes.items()]
        changes, pairs = [], {}
        for name, held in self._held.items():
            pairs[name] = text_of(held.now)
            if held.found:
                pairs[f'former {name}'] = text_of(held.found)
                pairs[f'origin of {name}'] = held.origin
                if held.now != held.found:
                    changes.append(f'{name} = {text_of(held.now)} (was {text_of(held.found)})')
        changes_text = f'set {", ".join(changes)}' if changes else 'nothing set yet'
        has_warning = any(warning for warning, _ in self._notes.values())
        for row in self._gains:
            pairs[f'{row.name} at rest, not set [{row.unit}]'] = text_of(row.values)
            pairs[f'origin of {row.name}'] = row.words
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if has_warning and enabled else DiagnosticStatus.OK,
            name=status_name(self._owner, f'parameters of {self.node}'),
            message='; '.join(
                [changes_text if enabled else 'off: push.enabled is false', *problems]
            ),
            values=key_values(pairs.items()),
        )
        return [status]

    def close(self) -> None:
        """Restore the former values of the parameters that this node has set, and stop.

        If the other node offers its services but does not answer, the former values are sent
        although the present values could not be read. The file of `FormerValues` keeps values that
        do not arrive.
        """
        self._cancel()
        self._plan = None
        if self._found_values() and self._set.service_is_ready():
            executor = SingleThreadedExecutor(context=self._owner.context)
            executor.add_node(self._owner)
            self._resume(self._restoring('this node ends'))
            self._finish(executor)
            if found := self._found_values():
                self._answers = self._write(found)
                self._finish(executor)
            executor.remove_node(self._owner)
        if self._former is not None:
            self._former.close()

    def _finish(self, executor: SingleThreadedExecutor) -> None:
        """Wait for answers and send the requests that follow, for at most `CLOSING_S`."""
        deadline = time.monotonic() + CLOSING_S
        while not all(future.done() for future in self._answers):
            if (remaining_s := deadline - time.monotonic()) <= 0.0:
                self._cancel()
                break
            executor.spin_once(timeout_sec=remaining_s)
            if self._requests is not None and all(future.done() for future in self._answers):
                self._resume(self._requests, [future.result() for future in self._answers])

    # --- requests ---------------------------------------------------------------------------------

    def _resume(self, requests: Requests, answers: list[Any] | None = None) -> None:
        """Continue the generator ``requests`` with answers, until it yields new futures or ends."""
        self._requests, self._answers = None, []  # cleared first, because the generator may raise
        with suppress(StopIteration):
            self._answers = next(requests) if answers is None else requests.send(answers)
            self._requests, self._asked_at = requests, time.monotonic()

    def _cancel(self) -> None:
        for future in self._answers:
            future.cancel()
        self._requests, self._answers = None, []

    def _is_running(self) -> bool:
        """Return whether the other node offers its parameter services; if not, store a note."""
        if self._get.service_is_ready() and self._set.service_is_ready():
            self._notes.pop('', None)
            return True
        former_texts = ', '.join(
            f'{n} = {text_of(values)}' for n, values in self._found_values().items()
        )
        restore_text = f'; {former_texts} will be restored' if former_texts else ''
        self._note('', f'{self.node} is not running: start it, or correct push.node{restore_text}')
        return False

    def _read(self, names: Sequence[str]) -> list[Any]:
        """Request the present value of each parameter; return a future for each parameter.

        Each parameter has a separate request: if a request names several parameters, and one of
        them is not declared, a node returns no value at all.
        """
        requests = (GetParameters.Request(names=[name]) for name in names)
        return [self._get.call_async(request) for request in requests]

    def _write(self, values: Mapping[str, Numbers]) -> list[Any]:
        """Send one request that sets all parameters in ``values``; return its future in a list."""
        messages = [_message(name, numbers) for name, numbers in values.items()]
        return [self._set.call_async(SetParameters.Request(parameters=messages))]

    # --- setting ----------------------------------------------------------------------------------

    def _rows(self, plan: PushPlan, results: Results) -> tuple[Row, ...]:
        """Return the rows of the export target of a plan, computed from the noise model.

        If it is known by which factors the noise is larger in motion, the rows contain these
        factors. If the state estimator has no bias state, its gain also covers the bias of the gyro
        at rest, unless ``push.debiased`` is true. Raises AllanError if the noise model cannot be
        exported, or if this bias is needed and not known yet.
        """
        options = replace(plan.options, motion=results.motion is not None)
        bias: dict[str, float] = {}
        if plan.has_gains and not self._settings.value.debiased:
            if not all(axis in self._bias for axis in AXES[SENSORS['gyro']]):
                raise AllanError('the bias of the gyro at rest is not known yet')
            bias = {axis: estimate.largest for axis, estimate in self._bias.items()}
        return target_rows(results, plan.target, options, bias)

    def _proposals(self, plan: PushPlan, results: Results) -> list[Proposal]:
        """Return the values that can be set; notes state why other values cannot be set."""
        self._gains = ()
        try:
            rows = self._rows(plan, results)
        except AllanError as error:
            self._note(
                '', f'the noise model is not complete yet: {explained(error)}', warning=False
            )
            return []
        if plan.has_gains and results.motion is None:
            self._gains = tuple(row for row in rows if row.name in plan.rows)
            self._note('', GAINS_WAIT)
            return []
        parameter_names = plan.rows
        for missing in parameter_names.keys() - {row.name for row in rows}:
            self._note(parameter_names[missing], f'{plan.target} has no number {missing}')
        proposals = []
        for row in rows:
            name = parameter_names.get(row.name, '') if parameter_names else row.name
            low, high = row.interval
            if name and row.ratio > SETTLED_RATIO:
                is_bounded = row.ratio < math.inf
                interval = f'{low:.3g} to {high:.3g}' if is_bounded else 'not known yet'
                condition = (
                    f'the value is set when its ends are within a factor of {SETTLED_RATIO:g}'
                )
                self._note(name, f'the 95 % interval is {interval}; {condition}', warning=False)
            elif name:
                proposal = Proposal(name, row.values, row.interval, row.words, plan.has_gains)
                held = self._held.get(name)
                if held is None or (not held.changed_by_others and proposal.differs(held.refused)):
                    proposals.append(proposal)
        return proposals

    def _setting(self, proposals: list[Proposal]) -> Requests:
        """Read the parameters of the other node, and set proposals that differ and are allowed."""
        answers = yield self._read([proposal.name for proposal in proposals])
        if self._refusal:  # since the request was sent, it may have become forbidden to set values
            return
        accepted_proposals: list[Proposal] = []
        for proposal, answer in zip(proposals, answers):
            name, values = proposal.name, self._numbers_of(proposal.name, answer.values)
            if values is None:
                continue
            held = self._held.setdefault(name, Held(values))
            if held.found and values not in (held.found, *held.sent):
                self._leave(name, values)
                continue
            held.now = values
            found = held.found or values
            if keep_reason := proposal.keeps(found):
                self._note(name, keep_reason, warning=False)
                continue
            refusal = proposal.refusal(found, self._settings.value.max_factor)
            if refusal:
                self._note(name, refusal, warning=any(found))
                continue
            self._notes.pop(name, None)
            if proposal.differs(values):
                held.sent = (proposal.values,) if values == found else (values, proposal.values)
                held.found = found
                accepted_proposals.append(proposal)
        if not accepted_proposals:
            return
        if not self._store():
            self._forget_unsent()
            return
        (answer,) = yield self._write({p.name: p.values for p in accepted_proposals})
        for proposal, result in zip(accepted_proposals, answer.results):
            name, value, held = proposal.name, text_of(proposal.values), self._held[proposal.name]
            if not result.successful:
                held.refused = proposal.values
                self._note(name, f'{self.node} refused {value}: {_reason_of(result)}')
                continue
            low, high = proposal.interval
            self._log.info(
                f'{name} of {self.node}: {text_of(held.now)} -> {value} '
                f'(95 %: {low:.3g} to {high:.3g}; {proposal.origin})'
            )
            held.now, held.refused, held.origin = proposal.values, (), proposal.origin
            held.sent = (proposal.values,)
        self._forget_unsent()
        self._store()

    def _numbers_of(self, name: str, values: Sequence[ParameterValue]) -> Numbers | None:
        """Return the value in an answer: a double, or an array of doubles.

        Returns None, and stores a note, if the value has another type.
        """
        value = values[0] if values else ParameterValue()
        if value.type == ParameterType.PARAMETER_DOUBLE:
            return (value.double_value,)
        if value.type == ParameterType.PARAMETER_DOUBLE_ARRAY:
            return tuple(value.double_array_value)
        is_undeclared = value.type == ParameterType.PARAMETER_NOT_SET
        problem = 'not declared' if is_undeclared else 'of another type'
        self._note(name, f'is {problem} in {self.node}: only doubles can be set')
        return None

    def _note(self, name: str, note: str, warning: bool = True) -> None:
        """Store a note about a parameter, or about the node if ``name`` is ''.

        The note is logged, unless a note of the same severity is stored for this parameter.
        """
        if name not in self._notes or self._notes[name][0] != warning:
            self._log.info(f'{name}: {note}' if name else note)
        self._notes[name] = warning, note

    # --- restoring --------------------------------------------------------------------------------

    def _open(self, now: float) -> None:
        """Open the file with former values; if this fails, `tick` tries again."""
        former = FormerValues(self.node)
        try:
            stored = former.open()
        except AllanError as error:
            former.close()
            self._note('', str(error))
            return
        self._notes.pop('', None)
        self._former, self._due_at = former, now
        self._held = {n: Held(f.sent[-1], f.found, f.sent) for n, f in stored.items() if f.sent}
        self._must_restore = bool(self._held)

    def _store(self) -> bool:
        """Write the former values to the file, and return whether this was possible."""
        values = {n: Former(h.found, h.sent) for n, h in self._held.items() if h.found}
        try:
            if self._former is not None:
                self._former.store(values)
        except AllanError as error:
            self._note('', f'nothing is set, because the former values cannot be kept: {error}')
            return False
        return True

    def _forget_unsent(self) -> None:
        """Forget the stored former value of each parameter whose present value is equal to it."""
        for held in self._held.values():
            if held.now == held.found:
                held.found = ()

    def _found_values(self) -> dict[str, Numbers]:
        """Return parameter -> former value for each parameter that may have been set."""
        return {name: known.found for name, known in self._held.items() if known.found}

    def _restoring(self, reason: str) -> Requests:
        """Restore the former value of each parameter that no other program has changed."""
        found, former_values = self._found_values(), {}
        answers = yield self._read([*found])
        for name, answer in zip(found, answers):
            values = self._numbers_of(name, answer.values)
            held = self._held[name]
            if values in held.sent:
                former_values[name] = found[name]
            # there is nothing to restore, for example after a restart of the other node
            elif values in (None, held.found) or self._must_restore:
                del self._held[name]
            else:
                self._leave(name, values)
        refusals = {}
        if former_values:
            (answer,) = yield self._write(former_values)
            results = zip(former_values, answer.results)
            refusals = {n: _reason_of(result) for n, result in results if not result.successful}
            restored_values = {
                n: text_of(values) for n, values in former_values.items() if n not in refusals
            }
            restored_text = ', '.join(
                f'{name} = {value}' for name, value in restored_values.items()
            )
            if restored_values:
                self._note('', f'restored {restored_text}, because {reason}')
            for name in restored_values:
                del self._held[name]
        for name, refusal in refusals.items():
            self._note(
                name, f'{self.node} refused the former {text_of(former_values[name])}: {refusal}'
            )
        self._notes = {n: note for n, note in self._notes.items() if not n or n in self._held}
        self._must_restore = self._must_restore and bool(refusals)
        self._store()

    def _leave(self, name: str, values: Numbers) -> None:
        """Stop setting a parameter that another program has changed, and store a note about it."""
        self._held[name] = Held(values, changed_by_others=True)
        self._note(
            name, f'was changed to {text_of(values)} by someone else, and is not set any more'
        )


def _message(name: str, values: Numbers) -> ParameterMessage:
    value = list(values) if len(values) > 1 else values[0]
    return Parameter(name, value=value).to_parameter_msg()


def _reason_of(result: Any) -> str:
    """Return the reason that a node gives for a refusal, shortened and safe to print."""
    reason = one_line(result.reason)
    shortened = f'{reason[:LONGEST_REASON]} ...' if len(reason) > LONGEST_REASON else reason
    return shortened or 'no reason'
