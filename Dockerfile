# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
# Untested: needs a container engine. Builds the package in a ROS 2 image and starts the monitor:
#   docker build -t allan_ros . && docker run --net=host allan_ros imu:=/imu/data
ARG DISTRO=jazzy
FROM ros:${DISTRO}
ARG DISTRO
WORKDIR /ws
COPY . src/allan_ros
RUN apt-get update \
    && rosdep update --rosdistro "$DISTRO" \
    && rosdep install --from-paths src --ignore-src -y --rosdistro "$DISTRO" \
    && . "/opt/ros/$DISTRO/setup.sh" \
    && colcon build --packages-select allan_ros \
    && rm -rf /var/lib/apt/lists/*
ENTRYPOINT ["bash", "-c", ". install/setup.bash && exec ros2 launch allan_ros allan_ros.launch.py \"$@\"", "--"]
