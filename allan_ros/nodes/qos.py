# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of our own topics."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Reliable, and the last one is kept for who comes late: sums and noise model."""
