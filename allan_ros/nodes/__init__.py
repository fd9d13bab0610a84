# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS nodes. Importing this package before numpy limits linear algebra to one thread."""

from .. import keep_to_one_thread

keep_to_one_thread()
