# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What several tests need to make and to compare."""
