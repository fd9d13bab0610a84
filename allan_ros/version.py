# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Version of the package. It has its own module, so that no other module imports the package."""

__version__ = '1.1.0'
