# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise models of sensors for filters: error growth, reduced models, state space, bias."""
