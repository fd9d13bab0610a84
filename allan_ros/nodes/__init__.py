# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS nodes. This package is imported before numpy, so that fits use one thread."""

from .. import keep_to_one_thread

keep_to_one_thread()
