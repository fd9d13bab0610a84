# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor models for filters: error growth, reductions, state space, bias."""
