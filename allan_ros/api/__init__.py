# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public functions and classes; the command line calls them, too."""
