# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a node that turns one IMU's sums into coefficients: when to fit, what to publish."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ..core.allan.recent import Change, RecentCurve, RecentView
from ..core.allan.sums import AllanSums
from ..core.compare import Reference, compare, reference_of_run
from ..core.errors import AllanError
from ..core.fit import clear_cache
from ..io.datasheets import load_sensor
from ..io.documents import results_from_document, results_to_document
from ..io.results import Results, analyse_sums
from ..io.text import read_json
from .allan_plot import AllanPlot
from .checkpointing import Total
from .diagnostics import AxisView, axis_status, status_name
from .parameters import ParameterGroup
from .qos import LATCHED
from .settings import EstimatorSettings
from .shell import Worker

FIT_SHARE = 0.05
"""A fit may keep a core busy for at most this share of the time."""


def load_references(settings: EstimatorSettings) -> tuple[Reference, ...]:
    """Return what the coefficients are to be held against.

    Raises
    ------
    AllanError
        When the datasheet or the former run cannot be read.
    """
    references = []
    if settings.sensor:
        references.append(load_sensor(settings.sensor).reference())
    if settings.baseline:
        former = results_from_document(read_json(settings.baseline), settings.baseline)
        noise = {name: axis.fit.noise for name, axis in former.axes.items()}
        references.append(reference_of_run(settings.baseline, noise))
    return tuple(references)


class ImuEstimate:
    """Fits the sums of one IMU when they have grown enough, and says how they stand.

    Parameters
    ----------
    node : Node
    label : str
        '' where the node has only this IMU.
    settings : ParameterGroup of EstimatorSettings
    references : sequence of Reference
    worker : Worker
        Where fits are computed.
    listener : callable, optional
        Called with the results of every fit.
    """

    def __init__(
        self,
        node: Node,
        label: str,
        settings: ParameterGroup[EstimatorSettings],
        references: Sequence[Reference],
        worker: Worker,
        listener: Callable[[Results], None] | None = None,
    ) -> None:
        self._node, self._label, self._settings = node, label, settings
        self._references, self._worker, self._listener = references, worker, listener
        self._total: Total | None = None
        self._results: Results | None = None
        self._fitted: tuple[AllanSums, ...] = ()
        self._trouble = ''
        self._fitting: Future[tuple[Results, float]] | None = None
        self._fit_ended = self._next_fit = 0.0
        self._recent: dict[tuple[str, ...], RecentView] = {}
        self._curves: dict[tuple[str, ...], RecentCurve | None] = {}
        self._changes: dict[str, Change] = {}
        home = f'~/{label}/' if label else '~/'
        self._publisher = node.create_publisher(String, f'{home}noise_model', LATCHED)
        self._plot = AllanPlot(node, home, lambda: settings.value.plot_period, worker)
        node.create_service(Trigger, f'{home}fit', self._on_fit)

    def take(self, total: Total) -> None:
        """Take the latest sums; fit them if they have grown enough."""
        self._total = total
        sums = total[0]
        if not sums or not _same_imu(sums, self._fitted):
            self._results, self._fitted, self._trouble, self._next_fit = None, (), '', 0.0
        self._look_back(sums)
        if self._fitting is None and time.monotonic() >= self._next_fit and self._has_grown(sums):
            self._start(total)

    def tick(self, now: float) -> None:
        """Learn what became of a fit, and show it to who looks."""
        self._plot.tick(now)
        if self._fitting is None or not self._fitting.done():
            return
        fitting, self._fitting = self._fitting, None
        try:
            self._results, took = fitting.result()
        except AllanError as error:
            self._trouble = str(error)
            return
        except Exception as error:  # a fault of ours must not end the gathering of evidence
            self._trouble = f'the fit failed ({error!r}); please report it with the log'
            self._node.get_logger().error(''.join(traceback.format_exception(error)))
            return
        self._trouble = ''
        self._fit_ended, self._next_fit = now, now + took * (1.0 / FIT_SHARE - 1.0)
        if not _same_imu(self._fitted, self._total[0] if self._total else ()):
            self._results = None  # it was of the IMU before
            return
        document = results_to_document(self._results, curves=False)
        text = json.dumps(document, separators=(',', ':'), allow_nan=False)
        self._publisher.publish(String(data=text))
        self._plot.take(self._results)
        if self._listener is not None:
            self._listener(self._results)

    def statuses(self, now: float) -> list[DiagnosticStatus]:
        """Return one status for each axis that has sums."""
        sums = self._total[0] if self._total else ()
        margin = self._settings.value.margin
        statuses = []
        for s in sums:
            for axis in s.axes:
                fit = self._results.axes.get(axis) if self._results else None
                noise = fit.fit.noise if fit else {}
                change = self._changes.get(axis)
                view = AxisView(
                    axis=axis,
                    sums=s,
                    result=fit,
                    method=self._results.method if self._results else '',
                    fit_age_s=now - self._fit_ended if fit else None,
                    trouble=self._trouble,
                    comparisons=tuple(
                        c for r in self._references if fit for c in compare(axis, noise, r, margin)
                    ),
                    margin=margin,
                    recent=self._curves.get(s.axes),
                    change=change if change and change.beyond(margin) else None,
                )
                name = status_name(
                    self._node, self._label, s.identity.frame_id, axis.replace('_', ' ')
                )
                hardware_id = s.identity.hardware_id or s.identity.frame_id
                statuses.append(axis_status(name, hardware_id, view))
        return statuses

    def _look_back(self, sums: tuple[AllanSums, ...]) -> None:
        """Hold what came lately against what was before."""
        now = self._node.get_clock().now().nanoseconds * 1e-9
        self._recent = {s.axes: self._recent.get(s.axes) or self._new_recent() for s in sums}
        self._curves, self._changes = {}, {}
        for s in sums:
            recent = self._recent[s.axes]
            recent.update(s, now)
            self._curves[s.axes] = recent.curve()
            for change in recent.changes():
                known = self._changes.get(change.axis)
                if known is None or change.evidence > known.evidence:
                    self._changes[change.axis] = change

    def _new_recent(self) -> RecentView:
        return RecentView(self._settings.value.recent_window)

    def _has_grown(self, sums: tuple[AllanSums, ...]) -> bool:
        samples, fitted = (max((s.samples for s in x), default=0) for x in (sums, self._fitted))
        return samples > 0 and samples >= fitted * (1.0 + self._settings.value.growth)

    def _start(self, total: Total) -> None:
        self._fitted = total[0]
        self._fitting = self._worker.submit(partial(_timed_fit, total, self._settings.value.method))

    def _on_fit(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._total is None or not self._total[0]:
            response.message = 'there are no sums yet'
        elif self._fitting is not None:
            response.message = 'a fit is under way; its result comes on noise_model'
        else:
            self._start(self._total)
            response.success = True
            response.message = 'fitting; the result comes on noise_model'
        return response


def _timed_fit(total: Total, method: str) -> tuple[Results, float]:
    """Return the results, and how long they took in s."""
    began = time.monotonic()
    try:
        results = analyse_sums(*total, method)
    finally:
        clear_cache()  # the next fit sees longer segments and needs other tables
    return results, time.monotonic() - began


def _same_imu(a: tuple[AllanSums, ...], b: tuple[AllanSums, ...]) -> bool:
    """Return whether both are of one IMU and one of them may be the other, later on."""
    return [(s.identity, s.axes) for s in a] == [(s.identity, s.axes) for s in b]
