# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics beside the noise model of one IMU: its bias at rest, and its Allan plot as an image."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

from geometry_msgs.msg import TwistWithCovarianceStamped
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from ..core.filters.bias import AxisBias, BiasModel, BiasTracker, TurnOnBias
from ..core.imu import AXES, SENSORS
from ..io.results import Results
from .node import AllanNode
from .settings import EstimatorSettings
from .shell import LATCHED, Worker
from .snapshot import Snapshot

PLACES = {'gyro': 'angular', 'accel': 'linear'}
"""Vector of the twist that holds the bias of a sensor."""

ROWS = {axis: (i + 3) % 6 for i, axis in enumerate(AXES)}
"""Row of an axis in the covariance of a twist: linear x, y, z, then angular x, y, z."""

UNKNOWN = -1.0
"""Variance of an axis whose bias is not known, as in sensor_msgs/Imu."""


class BiasPublisher:
    """Publishes the bias whenever there are new means of samples at rest.

    Parameters
    ----------
    node : AllanNode
    home : str
        Prefix of the topic.
    settings : EstimatorSettings
    """

    def __init__(self, node: AllanNode, home: str, settings: EstimatorSettings) -> None:
        tolerance = {'gyro': settings.bias_tolerance_gyro, 'accel': settings.bias_tolerance_accel}
        self._tracker = BiasTracker(tolerance)
        self._publisher = node.create_publisher(TwistWithCovarianceStamped, f'{home}bias', 10)
        self._last_ns = 0
        self._turn_on: dict[str, TurnOnBias] = {}

    def take(self, snapshot: Snapshot) -> None:
        """Take the means of a snapshot, and publish the bias if some are new."""
        for means in snapshot.means:
            for i, axis in enumerate(means.axes):
                self._tracker.take(axis, means.end_ns.tolist(), means.values[:, i].tolist())
        known = {axis: b for axis in AXES if (b := self._tracker.bias(axis)) is not None}
        latest = max((bias.end_ns for bias in known.values()), default=0)
        if known and latest != self._last_ns:
            self._last_ns = latest
            self._publisher.publish(bias_message(known, snapshot.frame_id))

    def use(self, results: Results | None) -> None:
        """Use the models of these results."""
        axes = results.axes if results is not None else {}
        self._turn_on = {axis: r.turn_on for axis, r in axes.items() if r.turn_on is not None}
        self._tracker.use({axis: BiasModel.of_fit(r.fit) for axis, r in axes.items()})

    def values(self, axis: str, unit: str) -> list[tuple[str, object]]:
        """Return the values of an axis for diagnostics."""
        bias = self._tracker.bias(axis)
        if bias is None:
            return []
        low, high = bias.estimate.ci95
        turn_on = self._turn_on.get(axis)
        scatter = (
            f'bias scatter between {turn_on.recordings} recordings [{unit}]' if turn_on else ''
        )
        return [
            (f'bias at rest [{unit}]', bias.estimate.value),
            (f'bias 95 % interval [{unit}]', f'{low:.6g} .. {high:.6g}'),
            ('bias optimal averaging time [s]', bias.optimal_s),
            (f'bias stays within +-{bias.tolerance:.3g} {unit} for [s]', bias.within_s),
            *([(scatter, turn_on.std)] if turn_on else []),
        ]

    def document(self) -> dict[str, dict[str, object]]:
        """Return the bias of each axis for the noise model document, in SI."""
        known = {axis: b for axis in AXES if (b := self._tracker.bias(axis)) is not None}
        return {axis: bias_document(bias) for axis, bias in known.items()}


def bias_document(bias: AxisBias) -> dict[str, object]:
    """Return the bias of one axis as a mapping, in SI."""
    return {
        'value': bias.estimate.value,
        'ci95': list(bias.estimate.ci95),
        'end_ns': bias.end_ns,
        'optimal_averaging_s': bias.optimal_s,
        'tolerance': bias.tolerance,
        'within_s': bias.within_s,
    }


def bias_message(known: dict[str, AxisBias], frame_id: str) -> TwistWithCovarianceStamped:
    """Return the message of these biases: the gyro as angular, the accelerometer as linear part."""
    message = TwistWithCovarianceStamped()
    message.header.frame_id = frame_id
    latest = max(bias.end_ns for bias in known.values())
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(latest, 10**9)
    covariance = [0.0] * 36
    for axis, row in ROWS.items():
        bias = known.get(axis)
        covariance[7 * row] = UNKNOWN if bias is None else bias.estimate.std**2
        if bias is not None:
            sensor, letter = axis.split('_')
            setattr(getattr(message.twist.twist, PLACES[sensor]), letter, bias.estimate.value)
    message.twist.covariance = covariance
    return message


FORMAT = 'png'
"""Format name in `sensor_msgs/CompressedImage`; image_transport decodes it."""

Pictures = dict[str, bytes]


class AllanPlot:
    """Publishes ``<home>allan_plot/<sensor>/compressed``, the plot that `allan analyze` writes.

    Nothing is drawn, and matplotlib is not loaded, before there is a subscriber.

    Parameters
    ----------
    node : Node
    home : str
        Prefix of the topics.
    period : callable
        Returns the shortest time between two plots in s.
    worker : Worker
        Where plots are drawn: a second of work must not delay a callback.
    """

    def __init__(self, node: Node, home: str, period: Callable[[], float], worker: Worker) -> None:
        self._node, self._period, self._worker = node, period, worker
        self._publishers = {
            sensor: node.create_publisher(
                CompressedImage, f'{home}allan_plot/{sensor}/compressed', LATCHED
            )
            for sensor in SENSORS
        }
        self._results: Results | None = None
        self._shown: dict[str, Results] = {}
        self._drawing: Future[Pictures] | None = None
        self._next = 0.0
        self._able = True

    def take(self, results: Results | None) -> None:
        """Take the results of the next plot; None for none."""
        self._results = results

    def tick(self, now: float) -> None:
        """Publish finished plots, and draw new ones for the present subscribers."""
        if self._drawing is not None:
            if self._drawing.done():
                drawing, self._drawing = self._drawing, None
                self._publish(drawing)
            return
        results = self._results
        if results is None or now < self._next or not self._able:
            return
        wanted = [
            sensor
            for sensor, publisher in self._publishers.items()
            if self._shown.get(sensor) is not results and publisher.get_subscription_count()
        ]
        if wanted:
            self._next = now + self._period()
            self._shown.update(dict.fromkeys(wanted, results))
            self._drawing = self._worker.submit(partial(_draw, results, wanted))

    def _publish(self, drawing: Future[Pictures]) -> None:
        try:
            pictures = drawing.result()
        except Exception as error:  # a plot that fails must not end the node
            self._able = False
            self._node.get_logger().warning(
                f'no allan_plot until the node is started again: it cannot be drawn ({error!r}); '
                'if matplotlib is missing, install python3-matplotlib'
            )
            return
        for sensor, picture in pictures.items():
            message = CompressedImage(format=FORMAT)
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.data.frombytes(picture)  # an array.array: no copy into a list of ints
            self._publishers[sensor].publish(message)


def _draw(results: Results, sensors: list[str]) -> Pictures:
    """Return sensor -> PNG, for the sensors in the results."""
    from ..io.plots import sensor_figure, to_png

    figures = {sensor: sensor_figure(results, sensor) for sensor in sensors}
    return {sensor: to_png(figure) for sensor, figure in figures.items() if figure is not None}
