# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Allan plot of one IMU as an image topic, drawn only while there is a subscriber."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from ..core.imu import SENSORS
from ..io.results import Results
from .qos import LATCHED
from .shell import Worker

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
