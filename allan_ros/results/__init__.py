# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
