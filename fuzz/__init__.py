# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged inputs of every kind, and the one rule they are held to: see `harness`.

make fuzz                                        all targets, 60 s
python -m fuzz --seconds 600 mcap documents      two of them, ten minutes
python -m fuzz --seconds 2400 --write            the table of docs/engineering/reliability.md
"""
