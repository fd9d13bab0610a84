# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise models for state estimators: error growth, reduced-order models, bias, noise in motion."""
