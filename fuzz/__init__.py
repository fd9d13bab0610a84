# Copyright 2026 the allan_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged inputs of every kind, for `test/test_fuzz.py`; `make fuzz` tries many of them.

The rule that is checked: every input gives a valid result or an `AllanError` of one printable line,
and nothing is written next to the input. Each target is a module with ``INPUTS``, which draws the
inputs, and ``check``, which takes an input and an empty folder, returns whether the input was
accepted, and raises if the rule is broken.
"""
