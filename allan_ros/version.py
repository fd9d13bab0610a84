# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Version of the package, in a module that imports no other module of the package."""

__version__ = '1.1.0'
