# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fits a noise model to the Allan sums of one IMU, and publishes or invalidates the model."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ..core.allan.recent import NoiseStep, noise_steps
from ..core.allan.sums import AllanSums
from ..core.check import Check
from ..core.errors import AllanError, one_line
from ..core.findings import Finding, finding
from ..core.imu import SI_UNITS, ImuIdentity, sensor_of
from ..core.stream.drive_recorder import LEAST_DRIVES, Drives
from ..core.stream.drives import DriveErrors
from ..core.stream.transport import faults_of
from ..readers.files import expanded
from ..results.analysis import analyze_sums
from ..results.checkpoint import Total
from ..results.datasheets import load_sensor
from ..results.documents import load
from ..results.motion import with_motion
from ..results.results import Results
from ..view.result_document import result_document
from .diagnostics import (
    FIT_NOTES,
    AxisView,
    axis_status,
    key_values,
    motion_status,
    status_name,
    status_of,
)
from .messages import (
    REPLACED_SHARE,
    BiasPublisher,
    ModelListener,
    Snapshot,
    kinds_of,
    replaced_because,
    replaced_share,
)
from .node import AllanNode, NodePart
from .node_settings import EstimatorSettings, home_of
from .shell import LATCHED, Worker

FIT_SHARE = 0.05
"""Largest share of one CPU core that the fits of one IMU should use. This share and the duration of
a fit determine the pause after the fit, which is at most `LONGEST_WAIT_S`. A fit that the service
requests, or that follows an invalidation, starts without a pause."""

LONGEST_WAIT_S = 20.0
"""Longest pause in s after a fit. After a slow fit, this pause is kept, although fits then use more
than `FIT_SHARE` of a CPU core."""

STALE_PERIODS = 3.0
"""Allan sums are reported as missing if none arrive for this number of publishing periods."""

ALONE_S = 5.0
"""Time in s after which Allan sums are reported as missing if no publisher is discovered."""


class ImuEstimate(NodePart):
    """Fits the Allan sums of one IMU when they have grown enough, and publishes the noise model.

    If more than `REPLACED_SHARE` of the samples are removed from the Allan sums, an existing model
    is invalidated: a noise model without axes is published, the statuses show a warning instead of
    the coefficients, and the sums are fitted again as soon as there are any. Each of the
    ``listeners`` is called with the noise model and the present bias at rest when a model is
    published, and again when new sums arrive while there is a model. ``worker`` runs the fits, and
    ``label`` is the label of the IMU. Raises AllanError if the file in the parameter
    ``estimator.sensor`` or ``estimator.baseline`` cannot be read or is invalid.
    """

    def __init__(
        self,
        node: AllanNode,
        label: str,
        worker: Worker,
        listeners: Sequence[ModelListener] = (),
    ) -> None:
        self._node, self._label = node, label
        self._settings = settings = node.parameters.group('estimator', EstimatorSettings)
        self._worker, self._listeners = worker, listeners
        sensor, path = settings.value.sensor, settings.value.baseline
        self._datasheet = load_sensor(sensor) if sensor else None
        path = path and str(expanded(path))
        self._baselines = {path: load(path)} if path else {}
        self._snapshot: Snapshot | None = None
        self._results: Results | None = None
        self._fitted: tuple[AllanSums, ...] = ()
        self._failed: Finding | None = None
        self._invalidated: Finding | None = None
        self._faults: tuple[Finding, ...] = ()
        self._fitting: Future[Fitted] | None = None
        # drives from which the present factors in motion were computed
        self._driven: tuple[DriveErrors, ...] = ()
        self._outdated = False  # whether the sums of the running fit have been replaced
        self._fit_ended = self._next_fit = 0.0
        # results, margin and checks of the latest comparison
        self._compared: tuple[Results | None, float, tuple[Check, ...]] = None, 0.0, ()
        self._steps: dict[str, NoiseStep] = {}
        home = home_of(label)
        self._publisher = node.create_publisher(String, f'{home}noise_model', LATCHED)
        self._bias = BiasPublisher(node, home)
        node.create_service(Trigger, f'{home}fit', self._on_fit)

    def process(self, snapshot: Snapshot) -> None:
        """Process a new snapshot, and start a fit if it is due (see `_fit_if_due`)."""
        self._snapshot = snapshot
        former_faults, self._faults = self._faults, snapshot.faults
        lost_share = replaced_share(self._fitted, snapshot.sums)
        if lost_share > REPLACED_SHARE:
            self._invalidate(lost_share, replaced_because(self._fitted, snapshot))
        window = self._settings.value.recent_window
        self._steps = {a: step for s in snapshot.sums for a, step in noise_steps(s, window).items()}
        self._bias.update(snapshot)
        if self._results is not None:
            if kinds_of(former_faults) != kinds_of(self._faults):
                self._publish(self._results)
            else:
                self._tell(self._with_faults(self._results))
        self._fit_if_due()

    def tick(self, now: float) -> None:
        """Publish the results of a finished fit, or report the error with which it failed.

        If the Allan sums were replaced during the fit, its results and its error are ignored, and
        the new sums are fitted if they contain samples.
        """
        if self._fitting is None or not self._fitting.done():
            return
        fitting, self._fitting = self._fitting, None
        if self._outdated:
            self._outdated = False
            self._fit_if_due()
            return
        try:
            fitted = fitting.result()
        except Exception as error:
            self._fail(error)
            return
        self._failed = self._invalidated = None
        self._next_fit = now + min(fitted.took * (1.0 / FIT_SHARE - 1.0), LONGEST_WAIT_S)
        if fitted.sums_were_fitted:
            self._fit_ended = now
        self._results = fitted.results
        self._publish(fitted.results)

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return a status for each axis and, after the first drive, one for the errors in motion.

        Before the first snapshot, no status is returned.
        """
        if self._snapshot is None:
            return []
        latest = self._snapshot
        measured_axes = [(axis, s, s.identity) for s in latest.sums for axis in s.axes]
        connected_imu = ImuIdentity(latest.frame_id, latest.hardware_id)
        waiting_axes = [(axis, None, connected_imu) for axis in latest.axes]
        statuses = [
            self._axis_status(now, axis, sums, imu)
            for axis, sums, imu in measured_axes or waiting_axes
        ]
        if latest.drives.errors or latest.drives.unused:
            name = status_name(self._node, self._label, 'in motion')
            imu_name = one_line(latest.hardware_id or latest.frame_id)
            results, limit = self._results, self._settings.value.motion_limit
            statuses.append(motion_status(name, imu_name, latest.drives, results, limit))
        return statuses

    def _comparisons(self, margin: float) -> tuple[Check, ...]:
        """Return the checks of the results against the datasheet and the baseline.

        The checks are cached until the results or the margin change. Without results, there are no
        checks.
        """
        results = self._results
        if results is None:
            return ()
        if self._compared[0] is not results or self._compared[1] != margin:
            if self._datasheet is not None:
                results = results.against_datasheet(self._datasheet, margin)
            results = replace(results, baselines=self._baselines, margin=margin)
            self._compared = self._results, margin, results.comparisons
        return self._compared[2]

    def _axis_status(
        self, now: float, axis: str, sums: AllanSums | None, imu: ImuIdentity
    ) -> DiagnosticStatus:
        margin, results = self._settings.value.margin, self._results
        fit = results.axes.get(axis) if results else None
        fit_notes = (
            [f for f in results.findings if f.id in FIT_NOTES and axis in f.axes] if results else []
        )
        view = AxisView(
            axis=axis,
            sums=sums,
            result=fit,
            method=results.method if results else '',
            fit_age_s=now - self._fit_ended if fit else None,
            problems=(
                *faults_of(self._faults, axis),
                *(f for f in (self._failed, self._invalidated) if f is not None),
            ),
            comparisons=tuple(c for c in self._comparisons(margin) if c.axis == axis),
            margin=margin,
            step=self._steps.get(axis),
            noted=tuple(fit_notes),
        )
        name = status_name(self._node, self._label, imu.frame_id, axis.replace('_', ' '))
        status = axis_status(name, one_line(imu.hardware_id or imu.frame_id), view)
        unit = SI_UNITS[sensor_of(axis)]['B']
        status.values = [*status.values, *key_values(self._bias.values(axis, unit))]
        return status

    # --- fitting ----------------------------------------------------------------------------------

    def _fit_if_due(self) -> None:
        """Start a fit if the sums have changed enough, no fit is running, and the pause has ended.

        If the sums have not changed enough since the fit of the present model, but there are new
        drives, only the factors in motion are computed.
        """
        if self._snapshot is None or self._fitting is not None:
            return
        if time.monotonic() < self._next_fit:
            return
        drives = self._snapshot.drives
        if self._has_changed(self._snapshot.sums):
            self._start(self._snapshot.total, drives)
        elif self._results is not None and self._are_new(drives):
            self._driven = drives.errors
            self._fitting = self._worker.submit(partial(_drive_factors, self._results, drives))

    def _has_changed(self, sums: tuple[AllanSums, ...]) -> bool:
        """Return whether the number of samples of a sensor has changed enough since the last fit.

        The number must have grown by the fraction ``estimator.growth``, or decreased, but not to 0.
        """
        growth = 1.0 + self._settings.value.growth
        fitted_samples = {s.axes: s.samples for s in self._fitted}

        def is_changed(sensor_sums: AllanSums) -> bool:
            samples, fitted = sensor_sums.samples, fitted_samples.get(sensor_sums.axes, 0)
            return samples > 0 and not fitted <= samples < growth * fitted

        return any(map(is_changed, sums))

    def _are_new(self, drives: Drives) -> bool:
        """Return whether the drives differ from the drives of the latest computation of factors.

        The start times of the drives are compared. Fewer than `LEAST_DRIVES` drives do not count as
        new.
        """
        starts, former_starts = (
            [drive.start for drive in errors] for errors in (drives.errors, self._driven)
        )
        return len(starts) >= LEAST_DRIVES and starts != former_starts

    def _start(self, total: Total, drives: Drives) -> None:
        self._fitted, self._outdated, self._driven = total[0], False, drives.errors
        method = self._settings.value.method
        self._fitting = self._worker.submit(partial(_fit, total, method, drives))

    def _fail(self, error: Exception) -> None:
        if not isinstance(error, AllanError):
            self._node.get_logger().error(''.join(traceback.format_exception(error)))
        reason = str(error) if isinstance(error, AllanError) else repr(error)
        self._failed = finding('fit_failed', reason=reason.rstrip('.'))
        self._node.get_logger().error(str(self._failed), throttle_duration_sec=60.0)

    def _invalidate(self, lost_share: float, cause: str) -> None:
        """Invalidate the noise model, if there is one.

        ``lost_share`` is the share of its samples that was removed, and ``cause`` states why.
        """
        self._outdated = self._fitting is not None
        self._fitted, self._failed, self._next_fit = (), None, 0.0
        results, self._results = self._results, None
        if results is None:
            return
        self._invalidated = finding('model_invalidated', lost=lost_share, cause=cause)
        self._node.get_logger().warning(str(self._invalidated))
        without_axes = replace(
            results, axes={}, samples=0, duration_s=0.0, segments=0, datasheet=None
        )
        self._publish(replace(without_axes, findings=(self._invalidated,)))

    def _publish(self, results: Results) -> None:
        self._bias.set_results(results if results.axes else None)
        # the bias is updated first, because listeners receive it together with the model
        if self._snapshot is not None:
            self._bias.update(self._snapshot)
        results = self._with_faults(results)
        document = result_document(results, curves=False)
        text = json.dumps(document, separators=(',', ':'), allow_nan=False)
        self._publisher.publish(String(data=text))
        self._tell(results)

    def _tell(self, results: Results) -> None:
        for listener in self._listeners:
            listener(results, self._bias.at_rest())

    def _with_faults(self, results: Results) -> Results:
        return replace(results, findings=(*self._faults, *results.findings))

    def _on_fit(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._snapshot is None or not self._snapshot.sums:
            response.message = 'there are no sums yet'
        elif self._fitting is not None:
            response.message = 'a fit is in progress; its result is published on noise_model'
        else:
            self._start(self._snapshot.total, self._snapshot.drives)
            response.success = True
            response.message = 'fitting; the result is published on noise_model'
        return response


class SumsInput(NodePart):
    """Subscribes to the Allan sums of an accumulator; passes readable snapshots to ``listener``."""

    def __init__(self, node: AllanNode, listener: Callable[[Snapshot], None]) -> None:
        self._node, self._listener = node, listener
        self._last = time.monotonic()
        self._problem = ''
        self._subscription = node.create_subscription(String, 'sums', self._on_sums, LATCHED)

    @property
    def topic(self) -> str:
        """Full name of the topic of the sums."""
        return str(self._subscription.topic_name)

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return a status that reports missing or unreadable sums."""
        age_s = now - self._last
        longest_age_s = STALE_PERIODS * self._node.publish.value.sums_period
        if not self._node.count_publishers(self.topic):
            longest_age_s = min(longest_age_s, ALONE_S)
        no_sums = finding('no_sums', topic=self.topic, seconds=age_s)
        findings = [no_sums] if age_s > longest_age_s else []
        pairs: list[tuple[str, object]] = [('topic', self.topic), ('sums age [s]', age_s)]
        text = f'sums arrive on {self.topic}'
        status = status_of(status_name(self._node, 'sums'), findings, text, pairs)
        if self._problem:
            status.level, status.message = DiagnosticStatus.ERROR, self._problem
        return [status]

    def _on_sums(self, message: String) -> None:
        self._last = time.monotonic()
        try:
            self._listener(Snapshot.from_json(message.data))
        except AllanError as error:
            self._problem = f'the received sums cannot be read: {error}'
            self._node.get_logger().warning(self._problem, throttle_duration_sec=60.0)
        except Exception as error:  # an invalid document must not end the node
            self._problem = f'the received sums cannot be used: {one_line(repr(error))}'
            self._node.fault('sums', error)
        else:
            self._problem = ''


class Fitted(NamedTuple):
    """Results, the CPU time of their computation, and whether the sums were fitted."""

    results: Results
    took: float  # CPU time of the computation in s
    sums_were_fitted: bool  # False if only the factors in motion were computed again


def _fit(total: Total, method: str, drives: Drives) -> Fitted:
    start_s = time.thread_time()
    results = with_motion(analyze_sums(*total, method), drives)
    return Fitted(results, time.thread_time() - start_s, True)


def _drive_factors(results: Results, drives: Drives) -> Fitted:
    start_s = time.thread_time()
    return Fitted(with_motion(results, drives), time.thread_time() - start_s, False)
