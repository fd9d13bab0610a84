# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The public functions and classes of the package, which the command line also uses."""
