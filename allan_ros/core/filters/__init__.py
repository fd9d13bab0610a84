# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a filter needs to know about a sensor: error growth, reductions, state space, bias."""
