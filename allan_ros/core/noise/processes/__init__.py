# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise processes, one class in each module. `allan_ros.core.noise.registry` finds them."""
