# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing with damaged inputs of every kind; `harness` states the rule that is checked.

make fuzz                                        all targets, 60 s
python -m fuzz --seconds 600 mcap documents      two of them, ten minutes
python -m fuzz --seconds 2400                    all targets, 40 min
"""
